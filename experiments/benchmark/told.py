"""Errors that a filter tells of itself, against those that it makes."""

import numpy as np

from experiments.show.style import COLOURS, INK, grid, legend_below, panels

from .methods import size_text

#: Of a filter that tells nothing.
NONE = np.empty((0, 2))
_SHARES = (0.1, 0.5, 0.9)
_COLOURS = [COLOURS[name] for name in ("sph_paper", "ekf", "sph", "pf", "ukf")]
#: Times an error, within which it is that was told: what unflagged answers promise.
_WITHIN = 3.0


def told_and_left(rows):
    """Errors of all epochs of all runs, told and left, shape (K, 2), standard deviations."""
    pairs = [np.column_stack([row["told"], row["left"]]) for row in rows]
    found = np.concatenate(pairs) if pairs else NONE
    return found[np.all(np.isfinite(found) & (found > 0.0), axis=1)]


def ratios(line):
    """Error told over error left: the tenth, the fiftieth and the ninetieth per cent of the epochs."""
    if not len(line.told):
        return np.full(len(_SHARES), np.nan)
    return np.quantile(line.told[:, 0] / line.told[:, 1], _SHARES)


def sentence(line):
    """What the errors told are worth; empty where none are told."""
    if not len(line.told):
        return ""
    low, middle, high = ratios(line)
    within = np.mean(line.told[:, 1] <= _WITHIN * line.told[:, 0])
    return (
        f"{size_text(line.family, line.size).capitalize()}: the error told is {middle:.2g} times the error "
        f"left (median; {low:.2g} to {high:.2g} in eight of ten epochs); {within:.0%} of {len(line.told)} "
        f"errors are at most three times as large as told."
    )


def told_figure(outcomes):
    """Error left against error told, a panel a scenario, a point an epoch."""
    columns = min(len(outcomes), 5)
    rows = -(-len(outcomes) // columns)
    size = (max(2.7 * columns, 6.4), 2.7 * rows + 1.0)
    figure, axes = panels(rows, columns, size, len(outcomes), sharex=True, sharey=True)
    for i, (ax, outcome) in enumerate(zip(axes.flat, outcomes, strict=False)):
        _panel(ax, outcome)
        if i + columns >= len(outcomes):
            ax.set_xlabel("told (standard deviations)", fontsize=8.5)
    for ax in axes[:, 0]:
        ax.set_ylabel("left", fontsize=8.5)
    figure.suptitle("Errors of the mean at every measurement: left, against told", fontsize=11)
    legend_below(
        figure, *axes.flat[: len(outcomes)], columns=max(2, int(figure.get_figwidth() / 2.2)), fontsize=8.5
    )
    return figure


def _panel(ax, outcome):
    lines = [line for line in outcome.lines if len(line.told)]
    for line, colour in zip(lines, _COLOURS * len(lines), strict=False):
        marks = {"s": 9, "color": colour, "alpha": 0.55, "lw": 0, "zorder": 3}
        ax.scatter(*line.told.T, **marks, label=size_text(line.family, line.size))
    ends = np.array([1e-5, 1.0])
    ax.plot(ends, ends, color=INK, lw=0.9, label="as told")
    ax.plot(ends, _WITHIN * ends, ":", color=INK, lw=0.9, label="three times as much")
    own = outcome.reference.mean
    if own > 0.0:
        ax.axhspan(1e-9, own, color="0.5", alpha=0.13, lw=0, label="reference's own error")
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlim(3e-5, 1.0)
    ax.set_ylim(3e-5, 1.0)
    ax.set_title(outcome.scenario.replace("_", " "), loc="left", fontsize=9.5, fontweight="bold")
    grid(ax)
    ax.tick_params(labelsize=7.5)
