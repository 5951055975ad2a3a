"""Measurements that the acceptance test refuses, and two remedies (002 7.2, Fig 27).

002 puts particles farther out. That is of no use where a steep potential holds them back: there the rule that
bounds the part of the posterior on edge kernels, f_edge of (62), is what refuses, and relaxing it what helps.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import stats

from experiments.scene.filters import Factory
from sphfilter.campaign.campaign import draw_case, run_campaign

from ..show.style import ACCENT, INK, frame, legend_below, plt, quantity
from ..show.tables import counted
from .picture import Picture

__all__ = ["Coverage", "Rate", "rejected_measurements", "rejection_rates"]


class Coverage(NamedTuple):
    """How far out the particles reach, core and whole probability that a lattice holds; and f_edge."""

    represented_mass: float
    domain_mass: float
    f_edge: float = 1 / 3

    def __str__(self):
        return f"{self.represented_mass:g} / {self.domain_mass:g} / {self.f_edge:.2g}"

    def z_t(self, dim):
        """Z_T of 002 (39): radius of the core in standard deviations."""
        return float(np.sqrt(stats.chi2.ppf(self.represented_mass, dim)))


_NARROW, _WIDE = Coverage(0.99, 0.995), Coverage(0.999, 0.9999)
_LOOSE = 0.6  # f_edge


def rejected_measurements(scenario, seed, n_runs, known):
    """A run with refused measurements, the same run with the better remedy, and the rates of all settings."""
    config = scenario.settings.filters.sph_paper.config
    own = Coverage(config.scheme.represented_mass, config.scheme.domain_mass, config.acceptance.f_edge)
    loose = own._replace(f_edge=max(own.f_edge, _LOOSE))
    coverages = [*sorted({_NARROW, own, _WIDE}), *({loose} - {own})]
    known = {own: known["sph_paper"]} if "sph_paper" in known else {}
    results, refused, rates = rejection_rates(scenario, coverages, seed, n_runs, known)
    shown = own if refused[own].any() else _NARROW
    run = int(np.argmax(refused[shown].sum(axis=1)))
    remedy = min((_WIDE, loose), key=lambda c: refused[c][run].sum())
    case = draw_case(replace(scenario, between=True), seed, run)
    places, look = [["before", "rates"], ["after", "rates"]], {"figsize": (13, 6.2), "layout": "constrained"}
    figure, axes = plt.subplot_mosaic(places, width_ratios=[2.4, 1], **look)
    for key, coverage in (("before", shown), ("after", remedy)):
        _history(axes[key], scenario, case, results[coverage], run)
        n = int(refused[coverage][run].sum())
        title = f"{_describe(coverage, scenario.model.dim)}: {n} refused"
        frame(axes[key], title, "time (s)", quantity(scenario, _observed(scenario)[0]))
    axes["before"].sharex(axes["after"])
    axes["before"].sharey(axes["after"])
    axes["before"].set_xlabel("")
    legend_below(figure, axes["before"], columns=5)
    _bars(axes["rates"], scenario.model.dim, rates, n_runs)
    what = f"run {run}: refused measurements, and a remedy"
    figure.suptitle(f"{scenario.name}, the paper's scheme, {what}", fontsize=11)
    return Picture({"rejections": figure}, (_sentence(scenario, rates, n_runs),))


class Rate(NamedTuple):
    """Refused measurements out of all in the runs that did not fail."""

    refused: int
    total: int


def rejection_rates(scenario, coverages, seed, n_runs, known=None):
    """Run the SPH filter with each coverage on the runs of a campaign; `known` results are taken as they are.

    Returns
    -------
    results : dict of Coverage to FilterResult, runs first
    refused : dict of Coverage to ndarray of bool, shape (n_runs, T)
        False where a run failed.
    rates : dict of Coverage to Rate
    """
    results = dict(known or {})
    filters = {str(c): _factory(scenario, c) for c in coverages if c not in results}
    if filters:
        campaign = run_campaign(scenario, filters, n_runs, seed, ranks=False)
        results |= {c: campaign.results[str(c)] for c in coverages if c not in results}
    rates, refused = {}, {}
    for c in coverages:
        result = results[c]
        done = np.isfinite(result.x).all(axis=(1, 2))
        refused[c] = ~result.accepted & done[:, None]
        rates[c] = Rate(int(refused[c].sum()), int(done.sum()) * refused[c].shape[1])
    return results, refused, rates


def _factory(scenario, coverage):
    sph = scenario.settings.filters.sph_paper
    masses = {"represented_mass": coverage.represented_mass, "domain_mass": coverage.domain_mass}
    scheme = replace(sph.config.scheme, **masses)
    acceptance = replace(sph.config.acceptance, f_edge=coverage.f_edge)
    config = replace(sph.config, scheme=scheme, acceptance=acceptance)
    return Factory("sph_paper", scenario, replace(sph, config=config))


def _observed(scenario):
    """The first observed state, and what the sensor multiplies it by."""
    states, scales = scenario.measurement.directly_observed
    return int(states[0]), scales[0]


def _history(ax, scenario, case, result, run):
    """Truth, measurements, and the estimate before and after each; crosses mark refused measurements.

    The estimates are those of the campaign: predicting in shorter pieces, to draw lines in between, may turn
    the verdict on a measurement at the edge.
    """
    d, scale = _observed(scenario)
    t, accepted = result.t, result.accepted[run]
    z = case.z[np.isfinite(case.z[:, 0]), 0] / scale
    ax.plot(case.times, case.truth[:, d], color="0.25", lw=1.0, label="truth")
    for x, P, width, alpha, label in (
        (result.x_prior, result.P_prior, 8.0, 0.25, "SPH PAPER before the update, ± 2σ"),
        (result.x, result.P, 3.5, 0.9, "SPH PAPER after, ± 2σ"),
    ):
        ax.errorbar(t, x[run, :, d], 2 * np.sqrt(P[run, :, d, d]), ls="", elinewidth=width, alpha=alpha,
                    color=ACCENT["sph"], label=label)  # fmt: skip
    ax.plot(t[accepted], z[accepted], "o", ms=4.5, mfc="w", mec="k", mew=0.9, label="measurement", zorder=4)
    ax.plot(t[~accepted], z[~accepted], "X", ms=10, color=ACCENT["other"], mec="w", label="refused", zorder=5)
    ax.margins(x=0.01)


def _describe(coverage, dim):
    masses = f"$P_T$ = {coverage.represented_mass:g}, $\\tilde P_T$ = {coverage.domain_mass:g}"
    return f"$Z_T$ = {coverage.z_t(dim):.2f} ({masses}), $f_{{edge}}$ = {coverage.f_edge:.2g}"


def _bars(ax, dim, rates, n_runs):
    """Share of refused measurements with 95 % intervals of Wilson's, in per cent."""
    for k, rate in enumerate(rates.values()):
        share, low, high = (100 * v for v in _interval(rate))
        ax.bar(k, share, width=0.6, color=ACCENT["other"], alpha=0.75)
        ax.errorbar(k, share, [[share - low], [high - share]], color=INK, capsize=4, lw=1.2)
        place = {"xytext": (0, 4), "textcoords": "offset points", "ha": "center"}
        ax.annotate(f"{rate.refused} of {rate.total}", (k, high), fontsize=9, **place)
    labels = [f"{c.z_t(dim):.2f}\n{c.represented_mass:g}\n{c.domain_mass:g}\n{c.f_edge:.2g}" for c in rates]
    ax.set_xticks(range(len(rates)), labels)
    settings = r"$Z_T$ ; $P_T$ ; $\tilde P_T$ ; $f_{edge}$"
    frame(ax, f"{counted(n_runs, 'run')}: refused, 95 % interval", settings, "measurements refused (%)")
    ax.grid(axis="x", visible=False)
    ax.margins(y=0.12)
    ax.set_ylim(bottom=0)


def _interval(rate):
    """Share, and the bounds of its 95 % interval."""
    if rate.total == 0:
        return np.nan, np.nan, np.nan
    bounds = stats.binomtest(rate.refused, rate.total).proportion_ci(0.95, method="wilson")
    return rate.refused / rate.total, max(bounds.low, 0.0), bounds.high


def _sentence(scenario, rates, n_runs):
    dim = scenario.model.dim
    listed = ", ".join(
        f"{r.refused} of {r.total} with Z_T = {c.z_t(dim):.2f} (represented_mass {c.represented_mass:g}, "
        f"domain_mass {c.domain_mass:g}, f_edge {c.f_edge:.2g})"
        for c, r in rates.items()
    )
    return (
        f"rejections.png: measurements that SPH PAPER refused because they lie too far out for its "
        f"particles, in {counted(n_runs, 'run')}: {listed}. Particles farther out make that rarer, "
        f"except where a steep potential holds them back: there a larger f_edge does. Few "
        f"runs say little about the rates."
    )
