"""Pictures of the calibration of the published scheme."""

import numpy as np

from experiments.show.style import INK, frame, legend_below, logarithmic, panels, plt, save

__all__ = ["PUBLISHED_BUFFER", "draw"]

PUBLISHED_BUFFER = 8  # best M_B in 002 4.5

_ERROR = {"l2": "density, relative L2 error", "cov": "error of the covariance"}
_DASHES = "-", "--", ":"


def draw(path, pairs, plan, truth, measure):
    """Draw error, run time, time saved and bypass ratio over C_CFL, C_NNS and M_B; returns the path.

    Parameters
    ----------
    path : Path
    pairs : list of Pair
    plan : Plan
    truth : str
        What errors are against.
    measure : str
        The error drawn, "l2" or "cov".
    """
    figure, axes = panels(2, 3, (13.5, 7.6))
    n_last = len(plan.buffers)
    grid, buffers = pairs[:-n_last], pairs[-n_last:]
    _over_courant(axes[0, 0], axes[0, 1], grid, plan, measure)
    _over_buffer(axes[0, 2], buffers, plan)
    for ax, value, label in zip(axes[1], _values(measure), _LABELS, strict=True):
        _over_ratio(ax, grid, plan, value)
        frame(ax, "", "C_NNS", label)
    axes[1, 2].set_yscale("symlog", linthresh=1e-16)  # zero is on it
    axes[1, 2].set_ylim(bottom=-1e-17)
    legend_below(figure, axes[1, 0], columns=4)
    figure.suptitle(f"Published scheme, Gaussian kernel, against the {truth}, to {plan.end:g} s", fontsize=11)
    return save(figure, path)


_LABELS = (
    "processor time saved by bypassing (%)",
    "bypassed steps a search",
    "density with bypass from that without",
)


def _values(measure):
    return (
        lambda pair: pair.saved,
        lambda pair: pair.on.bypass_ratio,
        lambda pair: getattr(pair.difference, measure),
    )


def _over_courant(errors, seconds, pairs, plan, measure):
    for count, dash in zip(plan.counts, _DASHES, strict=False):
        chosen = [p for p in pairs if p.label["particles"] == count and p.label["c_nns"] == 1.0]
        c = [pair.label["c_cfl"] for pair in chosen]
        off = [getattr(pair.off.errors, measure) for pair in chosen]
        on = [getattr(pair.on.errors, measure) for pair in chosen]
        errors.plot(c, off, color=INK, ls=dash, label=f"{count} particles, off")
        errors.plot(c, on, "o", mfc="w", ms=6, color="C0" if dash == "-" else "C1", label=f"{count}, on")
        for which, colour in (("off", INK), ("on", "C0")):
            took = [getattr(pair, f"seconds_{which}") for pair in chosen]
            seconds.plot(c, took, color=colour, ls=dash, marker=".", label=f"{count}, {which}")
    frame(errors, "", "C_CFL", _ERROR[measure])
    frame(seconds, "", "C_CFL", "processor time (s)")
    for ax in (errors, seconds):
        logarithmic(ax, plain="xy")
        ax.legend(frameon=False, fontsize=8)
    low, high = errors.get_ylim()
    errors.set_ylim(0.5 * low, 3.0 * high)  # nearly equal errors are to look so


def _over_buffer(ax, pairs, plan):
    x = [0, *(pair.label["buffer"] for pair in pairs)]
    ax.plot(
        x, [0.0, *(pair.saved for pair in pairs)], color="C0", marker="o", label="processor time saved (%)"
    )
    ratios = [0.0, *(pair.on.bypass_ratio for pair in pairs)]
    ax.plot(x, ratios, color="C1", marker="s", ls="--", label="bypassed steps a search")
    ax.axvline(PUBLISHED_BUFFER, color=INK, lw=0.8, ls=":", label="published optimum")
    ax.legend(frameon=False, fontsize=8)
    frame(ax, f"{plan.buffer_count} particles, C_CFL = {plan.buffer_cfl:g}, C_NNS = 1", "M_B", "")


def _over_ratio(ax, pairs, plan, value):
    for count, dash in zip(plan.counts, _DASHES, strict=False):
        for shade, c in zip(np.linspace(0.0, 0.85, len(plan.of_grid)), plan.of_grid, strict=True):
            chosen = [p for p in pairs if p.label["particles"] == count and p.label["c_cfl"] == c]
            x, y = [p.label["c_nns"] for p in chosen], [value(p) for p in chosen]
            label = f"{count} particles, C_CFL = {c:g}"
            ax.plot(x, y, color=plt.cm.viridis(shade), ls=dash, marker="o", ms=3.5, label=label)
