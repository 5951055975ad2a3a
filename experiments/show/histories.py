"""One run over time: truth, measurements and every filter's estimate with its ±2σ band."""

from dataclasses import replace
from functools import reduce

import numpy as np

import sphfilter as sf
from sphfilter import consistency
from sphfilter.campaign.campaign import draw_case
from sphfilter.campaign.one_run import put_through

from ..scene.filters import name_of
from .style import COLOURS, filter_heading, grid, legend_below, panels, quantity

#: Room around the truth, in its spans, and how far a filter that lost it is followed.
_ROOM, _FAR = 0.4, 4.0


def example_runs(campaign):
    """Numbers of the runs to draw, by what became of the EKF (002 Figs 25, 26).

    "consistent" is the run of median NEES among those in which it kept the truth, "diverged" the one in which
    it lost it worst, if there is any. Without an EKF the filter of the largest NEES takes its place.
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
    """When each filter that lost the truth in a run was farthest off: times of its largest NEES, seconds.

    By the names of those filters that `consistency.diverged` finds.
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
    figure, axes = panels(len(filters), n, size, sharex=True)
    for row, (name, make) in zip(axes, filters.items(), strict=True):
        say(name)
        _row(row, scenario, case, name, _rerun(make, case), lost.get(name))
    for d, ax in enumerate(axes[-1]):
        ax.set_xlabel("time (s)")
        figure.align_ylabels(axes[:, d])
    for d, ax in enumerate(axes[0]):
        ax.set_title(quantity(scenario, d), fontsize=10, loc="right")
    figure.suptitle(f"{scenario.name}, run {run}: {_verdict(lost)}", fontsize=11)
    legend = legend_below(figure, axes[0, 0])
    for handle, text in zip(legend.legend_handles, legend.get_texts(), strict=True):
        if "estimate" in text.get_text():  # its colour differs by panel
            handle.set(color="0.55", alpha=0.4 if "σ" in text.get_text() else 1.0)
    return figure


def _verdict(lost):
    if not lost:
        return "truth and estimate"
    names = " and ".join(name_of(name) for name in lost)
    return f"{names} lost the truth, worst at the dotted line\n(scales of their own; all others share one)"


def _row(row, scenario, case, name, result, t_lost):
    """Truth, measurements and one filter, a panel a state."""
    dots = {"ms": 3.2, "mfc": "w", "mec": "k", "mew": 0.9, "label": "measurement", "zorder": 4}
    for d, ax in enumerate(row):
        ax.plot(case.times, case.truth[:, d], color="0.25", lw=1.0, label="truth")
        if result is not None:
            _band(ax, result, d, COLOURS[name])
        if (seen := readings(scenario.measurement, case.z, d)) is not None:
            ax.plot(case.times, seen, "o", **dots)
        strayed = result.x_prior[:, d] if t_lost is not None and result is not None else None
        _frame(ax, case.truth[:, d], strayed)
        if t_lost is not None:
            ax.axvline(t_lost, color="0.3", lw=1.0, ls=":")
    filter_heading(row[0], name, "" if t_lost is None else f", worst at {t_lost:g} s")


def readings(measurement, z, state):
    """What a sensor read of a state, shape (T,), of measurements z (T, k); None if it does not read it.

    Of several sensors, the first that has a reading at a time.
    """
    if isinstance(measurement, sf.Sensors):
        parts = ((sensor, z[:, measurement.rows(name)]) for name, sensor in measurement.items())
        found = [seen for part in parts if (seen := readings(*part, state)) is not None]
        return reduce(lambda one, other: np.where(np.isnan(one), other, one), found) if found else None
    reads = measurement.directly_observed
    if reads is None or state not in reads[0]:
        return None
    j = list(reads[0]).index(state)
    return z[:, j] / reads[1][j]


def _rerun(make, case):
    try:
        return put_through(make(case, np.random.default_rng(0)), case)
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
    grid(ax)
