"""Pictures of a campaign: state histories with ±2σ bands, and consistency over time."""

from dataclasses import replace

import matplotlib

matplotlib.use("Agg")  # files only: no window system is asked for

import matplotlib.pyplot as plt
import numpy as np

from sphfilter import consistency
from sphfilter.campaign import draw_case

__all__ = ["COLOURS", "consistency_figure", "draw", "example_runs", "history_figure"]

#: One colour a filter in every picture (Okabe & Ito: distinct for the colour-blind too).
COLOURS = {
    "kf": "#000000",
    "ekf": "#D55E00",
    "ukf": "#CC79A7",
    "pf": "#0072B2",
    "sph": "#009E73",
    "grid": "#56B4E9",
    "benes": "#000000",
}
_DPI = 130
#: Most a band may widen an axis, in spans of the truth: a filter that lost the truth runs out of the frame.
_WIDEN = 0.6


def draw(out, scenario, filters, campaign):
    """Draw all pictures of a campaign into the folder `out`.

    Returns
    -------
    list of Path
    """
    drawn = []
    for kind, run in example_runs(campaign).items():
        drawn.append(out / f"history_{kind}.png")
        _save(history_figure(scenario, filters, campaign.seed, run), drawn[-1])
    drawn.append(out / "consistency.png")
    _save(consistency_figure(scenario, campaign), drawn[-1])
    return drawn


def _save(figure, path):
    figure.savefig(path, dpi=_DPI)
    plt.close(figure)


def example_runs(campaign):
    """Choose the runs to draw, by kind.

    "typical" is the run of median NEES of the EKF (of the first filter, if there is no EKF) among those in
    which no filter lost the truth; "diverged" the one where a filter lost it worst, if there is any.

    Returns
    -------
    dict of str to int
    """
    dim = campaign.truth.shape[-1]
    nees = {name: consistency.nees(campaign.truth, r.x, r.P) for name, r in campaign.results.items()}
    worst = np.max([np.nan_to_num(v).mean(axis=1) for v in nees.values()], axis=0)
    lost = np.any([consistency.diverged(v, dim) for v in nees.values()], axis=0)
    score = np.nan_to_num(nees.get("ekf", next(iter(nees.values())))).mean(axis=1)
    chosen = {}
    if not lost.all():
        sound = np.flatnonzero(~lost)
        chosen["typical"] = int(sound[np.argsort(score[sound])[len(sound) // 2]])
    if lost.any():
        chosen["diverged"] = int(np.argmax(np.where(lost, worst, -1.0)))
    return chosen


def history_figure(scenario, filters, seed, run):
    """One run over time: a row for each filter, a column for each state (002 Figs 22–26, 30, 31).

    The run is drawn again with times in between the measurements; the particle filter draws anew.
    """
    case = draw_case(replace(scenario, between=True), seed, run)
    n = case.truth.shape[1]
    size = (max(4.2 * n, 7.0), 1.9 * len(filters) + 1.4)
    figure, axes = plt.subplots(
        len(filters), n, figsize=size, sharex=True, squeeze=False, layout="constrained"
    )
    reads = scenario.measurement.directly_observed
    for row, (name, make) in zip(axes, filters.items(), strict=True):
        result = _rerun(make, case)
        for d, ax in enumerate(row):
            ax.plot(case.times, case.truth[:, d], color="0.25", lw=1.0, label="truth")
            if result is not None:
                _band(ax, result, d, COLOURS[name])
            if reads is not None and d in reads[0]:
                j = list(reads[0]).index(d)
                ax.plot(case.times, case.z[:, j] / reads[1][j], "o", ms=3.2, mfc="w", mec="k", mew=0.9,
                        label="measurement", zorder=4)  # fmt: skip
            _frame(ax, case.truth[:, d])
        row[0].set_title(name.upper(), loc="left", color=COLOURS[name], fontweight="bold", fontsize=10)
    for d, ax in enumerate(axes[-1]):
        ax.set_xlabel("time (s)")
        figure.align_ylabels(axes[:, d])
    for ax, label, unit in zip(axes[0], scenario.labels, scenario.units, strict=True):
        ax.set_title(_quantity(label, unit), fontsize=10)
    figure.suptitle(f"{scenario.name}, run {run}: truth and estimate", fontsize=11)
    _legend(figure, axes)
    return figure


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


def _frame(ax, truth):
    """Limits around truth and band, but no wider than a lost filter's band would ask for."""
    low, high = truth.min(), truth.max()
    room = _WIDEN * (high - low)
    now = ax.get_ylim()
    ax.set_ylim(max(now[0], low - room), min(now[1], high + room))
    ax.margins(x=0.01)
    ax.grid(alpha=0.25, lw=0.5)


def consistency_figure(scenario, campaign):
    """Run-averaged NEES and NMEE with their 95 % intervals, and RMS errors, over time (002 Figs 24, 28, 29)."""
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
        style = {"color": COLOURS[name], "lw": 1.4, "marker": "o", "ms": 2.6, "label": name.upper()}
        top.plot(campaign.times, _average(consistency.nees(campaign.truth, result.x, result.P)), **style)
        nmee = _average(consistency.nmee(campaign.truth, result.x, result.P))
        rms = np.sqrt(_average((result.x - campaign.truth) ** 2))
        for d in range(n):
            axes[1, d].plot(campaign.times, nmee[:, d], **style)
            axes[2, d].plot(campaign.times, rms[:, d], **style)
    interval = {"color": "0.5", "alpha": 0.18, "lw": 0, "label": "95 % interval"}
    top.axhspan(*consistency.nees_bounds(n, n_runs), **interval)
    top.set_yscale("log")
    top.set_ylabel("NEES")
    top.tick_params(labelbottom=False)
    top.sharex(axes[2, 0])
    for d, (label, unit) in enumerate(zip(scenario.labels, scenario.units, strict=True)):
        axes[1, d].axhspan(*consistency.nmee_bounds(n_runs), **interval)
        axes[1, d].set_title(label, fontsize=10)
        axes[2, d].set_ylim(bottom=0)
        axes[2, d].set_xlabel("time (s)")
        axes[1, d].set_ylabel("NMEE")
        axes[2, d].set_ylabel("RMS error" + (f" ({unit})" if unit else ""))
    for ax in [top, *axes[1:].ravel()]:
        ax.grid(alpha=0.25, lw=0.5)
        ax.margins(x=0.01)
    figure.suptitle(f"{scenario.name}: averages over {n_runs} runs", fontsize=11)
    _legend(figure, np.array([[top]]))
    return figure


def _average(values):
    return consistency.run_average(values)[0]


def _quantity(label, unit):
    return f"{label} ({unit})" if unit else label


def _legend(figure, axes):
    """One legend under all panels."""
    entries = dict(zip(*reversed(axes[0, 0].get_legend_handles_labels()), strict=True))
    figure.legend(
        entries.values(), entries.keys(), loc="outside lower center", ncols=len(entries), frameon=False
    )
