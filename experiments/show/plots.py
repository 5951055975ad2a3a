"""Pictures of a campaign: state histories with ±2σ bands, and consistency over time."""

from functools import partial

import numpy as np

from sphfilter import consistency

from ..scene.filters import name_of
from .histories import example_runs, history_figure
from .style import COLOURS, grid, legend_below, panels, plain_numbers, save
from .tables import counted

_REFEREES = ("kf", "grid", "benes")


def draw(out, scenario, filters, campaign, say=lambda text: None):
    """Draw all pictures of a campaign into the folder `out`; their paths. `say` is told what comes next."""
    drawn = []
    for kind, run in example_runs(campaign).items():
        drawn.append(out / f"history_{kind}.png")
        told = partial(_tell, say, drawn[-1].name)
        save(history_figure(scenario, filters, campaign, run, told), drawn[-1])
    drawn.append(out / "consistency.png")
    say(f"drawing {drawn[-1].name}")
    save(consistency_figure(scenario, campaign), drawn[-1])
    return drawn


def _tell(say, picture, name):
    say(f"drawing {picture}: {name_of(name)} (the numbers are safe)")


def consistency_figure(scenario, campaign):
    """Run-averaged NEES and NMEE with 95 % intervals, and RMS errors, over time (002 Figs 24, 28, 29)."""
    n = campaign.truth.shape[-1]
    figure, axes = panels(3, n, (max(4.4 * n, 7.0), 8.2), sharex=True)
    gs = axes[0, 0].get_gridspec()
    for ax in axes[0]:
        ax.remove()
    top = figure.add_subplot(gs[0, :])
    n_runs = len(campaign.truth)
    for name, result in campaign.results.items():
        style = {"color": COLOURS[name], "lw": 1.4, "marker": "o", "ms": 2.6, "label": name_of(name)}
        if name in _REFEREES:  # dashed, and above those that reach them: both are seen
            style |= {"ls": (0, (4, 3)), "zorder": 3.0, "marker": ""}
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
        grid(ax)
        ax.margins(x=0.01)
    figure.suptitle(f"{scenario.name}: averages over {counted(n_runs, 'run')}", fontsize=11)
    legend_below(figure, top)
    return figure


def _average(values):
    return consistency.run_average(values)[0]
