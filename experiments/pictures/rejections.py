"""Measurements that the acceptance test refuses, and the remedy: particles farther out (002 7.2, Fig 27)."""

from dataclasses import replace
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from scipy import stats

from experiments.filters import Factory
from sphfilter.campaign import draw_case, run_campaign

from ._style import ACCENT, INK, Picture, frame, quantity

__all__ = ["Coverage", "Rate", "rejected_measurements", "rejection_rates"]


class Coverage(NamedTuple):
    """How far out the particles reach: core and whole probability that a lattice holds."""

    represented_mass: float
    domain_mass: float

    def __str__(self):
        return f"{self.represented_mass:g} / {self.domain_mass:g}"

    def z_t(self, dim):
        """Z_T of 002 (39): radius of the core in standard deviations."""
        return float(np.sqrt(stats.chi2.ppf(self.represented_mass, dim)))


_NARROW, _WIDE = Coverage(0.99, 0.995), Coverage(0.999, 0.9999)


def rejected_measurements(scenario, seed, n_runs):
    """A run with refused measurements, the same run with wider particles, and the rates of three widths."""
    scheme = scenario.settings.filters.sph.config.scheme
    own = Coverage(scheme.represented_mass, scheme.domain_mass)
    coverages = sorted({_NARROW, own, _WIDE})
    rates, refused = rejection_rates(scenario, coverages, seed, n_runs)
    shown = own if refused[own].any() else _NARROW
    run = int(np.argmax(refused[shown].sum(axis=1)))
    case = draw_case(replace(scenario, between=True), seed, run)
    figure, axes = plt.subplot_mosaic(
        [["before", "rates"], ["after", "rates"]],
        figsize=(13, 6.2),
        width_ratios=[2.4, 1],
        layout="constrained",
    )
    _history(axes["before"], scenario, case, shown)
    _history(axes["after"], scenario, case, _WIDE)
    axes["before"].sharex(axes["after"])
    axes["before"].sharey(axes["after"])
    axes["before"].set_xlabel("")
    handles, labels = axes["before"].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    _bars(axes["rates"], scenario.model.dim, rates, n_runs)
    figure.suptitle(
        f"{scenario.name}, run {run}: refused measurements, and particles farther out", fontsize=11
    )
    return Picture({"rejections": figure}, (_sentence(scenario, rates, n_runs),))


class Rate(NamedTuple):
    """Refused measurements out of all in the runs that did not fail."""

    refused: int
    total: int


def rejection_rates(scenario, coverages, seed, n_runs):
    """Run the SPH filter with each coverage on the runs of a campaign.

    Returns
    -------
    rates : dict of Coverage to Rate
    refused : dict of Coverage to ndarray of bool, shape (n_runs, T)
        False where a run failed.
    """
    filters = {str(c): _factory(scenario, c) for c in coverages}
    results = run_campaign(scenario, filters, n_runs, seed).results
    rates, refused = {}, {}
    for c in coverages:
        done = np.isfinite(results[str(c)].x).all(axis=(1, 2))
        refused[c] = ~results[str(c)].accepted & done[:, None]
        rates[c] = Rate(int(refused[c].sum()), int(done.sum()) * refused[c].shape[1])
    return rates, refused


def _factory(scenario, coverage):
    sph = scenario.settings.filters.sph
    scheme = replace(sph.config.scheme, **coverage._asdict())
    return Factory("sph", scenario, replace(sph, config=replace(sph.config, scheme=scheme)))


def _history(ax, scenario, case, coverage):
    """Truth, estimate with ±2σ, and measurements of the first observed state; crosses mark refused ones."""
    states, scales = scenario.measurement.directly_observed
    d, z = states[0], case.z[:, 0] / scales[0]
    result = _factory(scenario, coverage)(case, None).run(case.times, case.z)
    m, s = result.x[:, d], np.sqrt(result.P[:, d, d])
    ax.plot(case.times, case.truth[:, d], color="0.25", lw=1.0, label="truth")
    ax.fill_between(case.times, m - 2 * s, m + 2 * s, color=ACCENT["sph"], alpha=0.22, lw=0, label="SPH ± 2σ")
    ax.plot(case.times, m, color=ACCENT["sph"], lw=1.4, label="SPH")
    taken = result.accepted & np.isfinite(z)
    ax.plot(case.times[taken], z[taken], "o", ms=3.6, mfc="w", mec="k", mew=0.9, label="measurement")
    ax.plot(case.times[~result.accepted], z[~result.accepted], "X", ms=10, color=ACCENT["other"], mec="w",
            label="refused", zorder=5)  # fmt: skip
    n = int((~result.accepted).sum())
    title = f"{_describe(coverage, scenario.model.dim)}: {n} refused"
    frame(ax, title, "time (s)", quantity(scenario, d))
    ax.margins(x=0.01)


def _describe(coverage, dim):
    masses = f"$P_T$ = {coverage.represented_mass:g}, $\\tilde P_T$ = {coverage.domain_mass:g}"
    return f"$Z_T$ = {coverage.z_t(dim):.2f} ({masses})"


def _bars(ax, dim, rates, n_runs):
    """Share of refused measurements with 95 % intervals of Wilson's, in per cent."""
    for k, rate in enumerate(rates.values()):
        share, low, high = (100 * v for v in _interval(rate))
        ax.bar(k, share, width=0.6, color=ACCENT["other"], alpha=0.75)
        ax.errorbar(k, share, [[share - low], [high - share]], color=INK, capsize=4, lw=1.2)
        ax.annotate(
            f"{rate.refused} of {rate.total}",
            (k, high),
            (0, 4),
            textcoords="offset points",
            ha="center",
            fontsize=9,
        )
    labels = [f"{c.z_t(dim):.2f}\n{c.represented_mass:g}\n{c.domain_mass:g}" for c in rates]
    ax.set_xticks(range(len(rates)), labels)
    frame(
        ax,
        f"{n_runs} runs: refused, 95 % interval",
        r"$Z_T$ ; $P_T$ ; $\tilde P_T$",
        "measurements refused (%)",
    )
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
        f"domain_mass {c.domain_mass:g})"
        for c, r in rates.items()
    )
    return (
        f"rejections.png: measurements that the SPH filter refused because they lie too far out for its "
        f"particles, in {n_runs} runs: {listed}. Particles farther out make that rarer; few runs say little "
        f"about the rates."
    )
