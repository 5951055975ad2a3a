"""Pictures of filters on measured data: estimates over time, and bands of forecasts."""

import numpy as np

from experiments.own_data.csv_data import LEVELS
from experiments.show.histories import readings
from experiments.show.style import COLOURS, filter_heading, grid, panels, quantity, save

__all__ = ["draw", "draw_forecasts"]


def draw(path, scenario, data, results):
    """Draw a row for each filter and a column for each state: mean, ±2σ, and what the sensor read of it.

    Inputs are in a last row, each over the intervals in which it was held.

    Parameters
    ----------
    path : Path
    scenario : Scenario
    data : Measurements
    results : dict of str to FilterResult
    """
    n, rows = scenario.model.dim, len(results) + bool(data.inputs)
    figure, axes = panels(rows, n, (max(4.8 * n, 7.0), 1.9 * rows + 1.2), sharex=True)
    for column in axes[: len(results)].T:
        for ax in column[1:]:
            ax.sharey(column[0])
    seen_any = False
    dots = {"ms": 4.5, "color": "0.1", "mec": "w", "mew": 0.6, "zorder": 4}
    for row, (name, result) in zip(axes[: len(results)], results.items(), strict=True):
        for d, ax in enumerate(row):
            std = np.sqrt(result.P[:, d, d])
            low, high = result.x[:, d] - 2 * std, result.x[:, d] + 2 * std
            ax.fill_between(result.t, low, high, color=COLOURS[name], alpha=0.22, lw=0)
            ax.plot(result.t, result.x[:, d], color=COLOURS[name], lw=1.2)
            if (seen := readings(scenario.measurement, data.z, d)) is not None:
                ax.plot(data.times, seen, "o", **dots)
                seen_any = True
            grid(ax)
            ax.margins(x=0.01)
        filter_heading(row[0], name)
    for d, ax in enumerate(axes[0]):
        ax.set_title(quantity(scenario, d), fontsize=10)
    unit, lowest = scenario.settings.data.time_unit, axes[-1]
    if data.inputs:
        lowest = [_inputs(*pair, d, n, data) for d, pair in enumerate(axes[-2:].T)]
    for ax in lowest:
        ax.set_xlabel(f"{data.time_name} ({unit})" if unit else data.time_name)
    title = f"{scenario.name}: estimate after each line ± 2σ (band)" + ", measurements (dots)" * seen_any
    figure.suptitle(title, fontsize=11)
    save(figure, path)


def _inputs(above, ax, column, n, data):
    """Draw the inputs of a column, or none; returns its lowest panel."""
    shown = list(data.inputs.items())[column::n]
    if not shown:
        ax.remove()
        above.tick_params(labelbottom=True)
        return above
    for name, values in shown:
        ax.plot(data.times, values, drawstyle="steps-pre", lw=1.3, label=name)  # held until the time
    ax.legend(fontsize=8, frameon=False)
    ax.set_title("inputs" if len(shown) > 1 else "input", loc="left", fontsize=9)
    grid(ax)
    return ax


def draw_forecasts(path, scores):
    """Draw a row for each filter, a column for each horizon: median and central intervals, and what came.

    Parameters
    ----------
    path : Path
    scores : dict of str to (dict of int to Score)
    """
    horizons = list(next(iter(scores.values())))
    shape = (len(scores), len(horizons))
    figure, axes = panels(*shape, (6.2 * shape[1], 1.9 * shape[0] + 1.2), sharex=True, sharey=True)
    for row, (name, of) in zip(axes, scores.items(), strict=True):
        for ax, h in zip(row, horizons, strict=True):
            score = of[h]
            for k in (1, 0):  # the wide one below
                low, high = score.intervals[:, k].T
                ax.fill_between(score.year, low, high, color=COLOURS[name], alpha=(0.35, 0.2)[k], lw=0)
            ax.plot(score.year, score.median, color=COLOURS[name], lw=1.3)
            ax.plot(score.year, score.observed, "o", ms=3.0, mfc="w", mec="k", mew=0.8)
            inside = ", ".join(f"{c:.0%}" for c in score.coverage[:2])
            ax.set_title(f"inside: {inside}", loc="right", fontsize=9)
            grid(ax)
            ax.margins(x=0.01)
        filter_heading(row[0], name)
        row[0].set_ylabel("sunspot number")
    top = max(np.max(of[h].observed) for of in scores.values() for h in horizons)
    axes[0, 0].set_ylim(0, 1.5 * top)
    for ax, h in zip(axes[0], horizons, strict=True):
        ax.set_title(f"{h} year{'s' if h > 1 else ''} ahead", fontsize=11)
    for ax in axes[-1]:
        ax.set_xlabel("year")
    levels = " and ".join(f"{level:.0%}" for level in LEVELS[:2])
    figure.suptitle(f"Forecasts: median and central {levels} intervals; circles: what came", fontsize=11)
    save(figure, path)
