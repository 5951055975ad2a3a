"""Pictures of a campaign: state histories with ±2σ bands, and consistency over time."""

from dataclasses import replace
from functools import partial

import matplotlib

matplotlib.use("Agg")  # files only: no window system is asked for

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from sphfilter import consistency
from sphfilter.campaign.campaign import draw_case

from ..scene.filters import name_of

__all__ = ["COLOURS", "consistency_figure", "draw", "draw_convergence", "example_runs", "history_figure",
           "losses", "plain_numbers"]  # fmt: skip

#: One colour a filter in every picture (Okabe & Ito: distinct for the colour-blind too).
COLOURS = {
    "kf": "#000000",
    "ekf": "#D55E00",
    "ukf": "#CC79A7",
    "pf": "#0072B2",
    "sph": "#009E73",
    "sph_paper": "#E69F00",
    "grid": "#56B4E9",
    "benes": "#000000",
}
_DPI = 130
#: Room around the truth, in its spans, and how far a filter that lost it is followed.
_ROOM, _FAR = 0.4, 4.0


def draw(out, scenario, filters, campaign, say=lambda text: None):
    """Draw all pictures of a campaign into the folder `out`; `say` is told what is drawn next.

    Returns
    -------
    list of Path
    """
    drawn = []
    for kind, run in example_runs(campaign).items():
        drawn.append(out / f"history_{kind}.png")
        told = partial(_tell, say, drawn[-1].name)
        _save(history_figure(scenario, filters, campaign, run, told), drawn[-1])
    drawn.append(out / "consistency.png")
    say(f"drawing {drawn[-1].name}")
    _save(consistency_figure(scenario, campaign), drawn[-1])
    return drawn


def _tell(say, picture, name):
    say(f"drawing {picture}: {name_of(name)} (the numbers are safe)")


def draw_convergence(out, rows, slopes):
    """Draw errors against the number of particles, both logarithmic; returns the path of the picture.

    Parameters
    ----------
    out : Path
    rows : list of (int, Distance, ...)
    slopes : dict of str to float
        Order of each error in the particle spacing.
    """
    labels = {
        "mean": "mean (posterior std)",
        "cov": "covariance (relative)",
        "evidence": "log-evidence of a measurement (nat)",
    }
    figure, ax = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    for (measure, label), mark in zip(labels.items(), "os^", strict=True):
        errors = [getattr(distance, measure) for _, distance, *_ in rows]
        label = f"{label}, order {slopes[measure]:.1f}"
        ax.loglog([count for count, *_ in rows], errors, f"{mark}-", label=label)
    ax.set(xlabel="particles at most", ylabel="rms error against the exact filter")
    ax.set_xticks([count for count, *_ in rows], [str(count) for count, *_ in rows], minor=False)
    ax.xaxis.minorticks_off()
    ax.grid(alpha=0.3)
    ax.legend(frameon=False)
    path = out / "convergence.png"
    _save(figure, path)
    return path


def _save(figure, path):
    figure.savefig(path, dpi=_DPI)
    plt.close(figure)


def example_runs(campaign):
    """Choose the runs to draw, by what became of the EKF (002 Figs 25, 26).

    "consistent" is the run of median NEES among those in which it kept the truth, "diverged" the one in which
    it lost it worst, if there is any. Without an EKF the filter of the largest NEES takes its place.

    Returns
    -------
    dict of str to int
    """
    nees = {
        name: np.nan_to_num(consistency.nees(campaign.truth, r.x, r.P))
        for name, r in campaign.results.items()
    }
    judged = nees.get("ekf", max(nees.values(), key=np.mean))
    lost = consistency.diverged(judged, campaign.truth.shape[-1])
    order = np.argsort(judged.mean(axis=1))
    kept, lost = order[~lost[order]], order[lost[order]]
    chosen = {"consistent": int(kept[len(kept) // 2])} if len(kept) else {}
    return chosen | ({"diverged": int(lost[-1])} if len(lost) else {})


def losses(campaign, run):
    """When each filter that lost the truth in a run was farthest off: the time of its largest NEES.

    Returns
    -------
    dict of str to float
        Times in seconds, of the filters that `consistency.diverged` finds, alone.
    """
    found, n = {}, campaign.truth.shape[-1]
    for name, result in campaign.results.items():
        nees = np.nan_to_num(consistency.nees(campaign.truth[run], result.x[run], result.P[run]))
        if consistency.diverged(nees, n):
            found[name] = float(campaign.times[np.argmax(nees)])
    return found


def history_figure(scenario, filters, campaign, run, say=lambda name: None):
    """One run over time: a row for each filter, a column for each state (002 Figs 22–26, 30, 31).

    The run is drawn again with times in between the measurements; the particle filter draws anew. Rows share
    their scales, but for those of filters that lost the truth. `say` gets the name of each filter.
    """
    case, lost = draw_case(replace(scenario, between=True), campaign.seed, run), losses(campaign, run)
    n = case.truth.shape[1]
    n_measured = np.isfinite(case.z).any(axis=1).sum()
    size = (max(n * np.clip(0.18 * n_measured, 4.2, 7.5), 7.0), 1.9 * len(filters) + 1.6)
    figure, axes = plt.subplots(
        len(filters), n, figsize=size, sharex=True, squeeze=False, layout="constrained"
    )
    for row, (name, make) in zip(axes, filters.items(), strict=True):
        say(name)
        _row(row, scenario, case, name, _rerun(make, case), lost.get(name))
    for d, ax in enumerate(axes[-1]):
        ax.set_xlabel("time (s)")
        figure.align_ylabels(axes[:, d])
    for ax, label, unit in zip(axes[0], scenario.labels, scenario.units, strict=True):
        ax.set_title(_quantity(label, unit), fontsize=10, loc="right")
    figure.suptitle(f"{scenario.name}, run {run}: {_verdict(lost)}", fontsize=11)
    _legend(figure, axes[0, 0], neutral=("estimate", "estimate ± 2σ"))
    return figure


def _verdict(lost):
    if not lost:
        return "truth and estimate"
    names = " and ".join(name_of(name) for name in lost)
    return f"{names} lost the truth, worst at the dotted line\n(scales of their own; all others share one)"


def _row(row, scenario, case, name, result, t_lost):
    """Truth, measurements and one filter, a panel a state."""
    reads = scenario.measurement.directly_observed
    for d, ax in enumerate(row):
        ax.plot(case.times, case.truth[:, d], color="0.25", lw=1.0, label="truth")
        if result is not None:
            _band(ax, result, d, COLOURS[name])
        if reads is not None and d in reads[0]:
            j = list(reads[0]).index(d)
            ax.plot(case.times, case.z[:, j] / reads[1][j], "o", ms=3.2, mfc="w", mec="k", mew=0.9,
                    label="measurement", zorder=4)  # fmt: skip
        strayed = result.x_prior[:, d] if t_lost is not None and result is not None else None
        _frame(ax, case.truth[:, d], strayed)
        if t_lost is not None:
            ax.axvline(t_lost, color="0.3", lw=1.0, ls=":")
    title = name_of(name) + ("" if t_lost is None else f", worst at {t_lost:g} s")
    row[0].set_title(title, loc="left", color=COLOURS[name], fontweight="bold", fontsize=10)


def _rerun(make, case):
    try:
        return make(case, np.random.default_rng(0)).run(case.times, case.z)
    except Exception:  # the campaign has reported it; the panel shows the truth alone
        return None


def _band(ax, result, d, colour):
    """Mean and ±2σ of state d; prior and posterior of an update share its time, so jumps are upright."""
    t = np.repeat(result.t, 2)
    m = np.stack([result.x_prior[:, d], result.x[:, d]], axis=1).ravel()
    s = np.sqrt(np.stack([result.P_prior[:, d, d], result.P[:, d, d]], axis=1).ravel())
    ax.fill_between(t, m - 2 * s, m + 2 * s, color=colour, alpha=0.22, lw=0, label="estimate ± 2σ")
    ax.plot(t, m, color=colour, lw=1.3, label="estimate")


def _frame(ax, truth, strayed=None):
    """Limits around the truth, and around an estimate that strayed from it, but not however far."""
    low, high = truth.min(), truth.max()
    span = high - low
    if strayed is not None:
        low, high = (
            max(min(low, strayed.min()), low - _FAR * span),
            min(max(high, strayed.max()), high + _FAR * span),
        )
    room = _ROOM * span
    ax.set_ylim(low - room, high + room)
    ax.margins(x=0.01)
    ax.grid(alpha=0.25, lw=0.5)


def consistency_figure(scenario, campaign):
    """Run-averaged NEES and NMEE with 95 % intervals, and RMS errors, over time (002 Figs 24, 28, 29)."""
    n = campaign.truth.shape[-1]
    figure, axes = plt.subplots(
        3, n, figsize=(max(4.4 * n, 7.0), 8.2), sharex=True, squeeze=False, layout="constrained"
    )
    gs = axes[0, 0].get_gridspec()
    for ax in axes[0]:
        ax.remove()
    top = figure.add_subplot(gs[0, :])
    n_runs = len(campaign.truth)
    for name, result in campaign.results.items():
        style = {"color": COLOURS[name], "lw": 1.4, "marker": "o", "ms": 2.6, "label": name_of(name)}
        style["zorder"] = 1.5 if name in ("kf", "grid", "benes") else 2.0  # beneath those that reach them
        top.plot(campaign.times, _average(consistency.nees(campaign.truth, result.x, result.P)), **style)
        nmee = _average(consistency.nmee(campaign.truth, result.x, result.P))
        rms = np.sqrt(_average((result.x - campaign.truth) ** 2))
        for d in range(n):
            axes[1, d].plot(campaign.times, nmee[:, d], **style)
            axes[2, d].plot(campaign.times, rms[:, d], **style)
    interval = {"color": "0.5", "alpha": 0.18, "lw": 0, "label": "95 % interval"}
    top.axhline(n, color="0.5", lw=0.8, ls="--", label="expected")
    top.axhspan(*consistency.nees_bounds(n, n_runs), **interval)
    top.set_yscale("log")
    plain_numbers(top.yaxis)
    top.set_ylabel("normalised estimation\nerror squared (NEES)")
    top.sharex(axes[2, 0])
    for d, (label, unit) in enumerate(zip(scenario.labels, scenario.units, strict=True)):
        axes[1, d].axhspan(*consistency.nmee_bounds(n_runs), **interval)
        axes[1, d].set_title(label, fontsize=10)
        axes[2, d].set_ylim(bottom=0)
        axes[2, d].set_xlabel("time (s)")
        axes[1, d].set_ylabel("" if d else "normalised mean\nestimation error (NMEE)")
        axes[2, d].set_ylabel("RMS error" + (f" ({unit})" if unit else ""))
    for ax in [top, *axes[1:].ravel()]:
        ax.grid(alpha=0.25, lw=0.5)
        ax.margins(x=0.01)
    figure.suptitle(f"{scenario.name}: averages over {n_runs} runs", fontsize=11)
    _legend(figure, top)
    return figure


def plain_numbers(axis):
    """Ticks of a logarithmic axis at 1, 2 and 5 of each decade, as plain numbers."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=20))
    axis.set_major_formatter(FuncFormatter(lambda value, place: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _average(values):
    return consistency.run_average(values)[0]


def _quantity(label, unit):
    return f"{label} ({unit})" if unit else label


def _legend(figure, ax, neutral=()):
    """One legend under all panels; the `neutral` entries are grey, where their colour differs by panel."""
    handles, labels = ax.get_legend_handles_labels()
    columns = min(len(labels), int(figure.get_figwidth() / 1.5))
    legend = figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)
    for handle, label in zip(legend.legend_handles, labels, strict=True):
        if label in neutral:
            handle.set_color("0.55")
            handle.set_alpha(0.4 if "σ" in label else 1.0)
