"""The picture of filters on measured data: estimates over time."""

import numpy as np

from experiments.show.histories import readings
from experiments.show.style import COLOURS, filter_heading, grid, panels, quantity, save


def draw(path, scenario, data, results):
    """Draw a row for each filter and a column for each state: mean, ±2σ, and what the sensor read of it.

    Inputs are in a last row, each over the intervals in which it was held. `data` are `Measurements`, results
    `FilterResult` by name.
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
