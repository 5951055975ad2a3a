"""Pictures of the studies of transient solutions over particles, schemes and time steps."""

import numpy as np

from experiments.show.plots import COLOURS, plain_numbers
from experiments.show.style import INK, frame, plt, save

from .studies import RULES
from .tables import groups, orders_of

__all__ = ["draw_schemes", "draw_steps"]

_SCHEMES = {
    "auto": COLOURS["sph"],
    "log_density": COLOURS["sph"],
    "corrected": COLOURS["pf"],
    "paper": COLOURS["sph_paper"],
}
_STEPPERS = {"euler": COLOURS["ekf"], "midpoint": COLOURS["pf"], "rk4": COLOURS["sph"]}
_DRAWN = "mean", "cov", "l2"
_LABELS = {
    "mean": "error of the mean (std)",
    "cov": "error of the covariance",
    "l2": "density, relative L2 error",
}


def draw_schemes(path, title, cells, truth, dim):
    """Draw errors against particles, and against run time, of every scheme; returns the path."""
    figure, axes = plt.subplots(2, 2, figsize=(9.6, 7.2), layout="constrained")
    last = "l2" if truth.nodes else "cov"
    for name, group in groups(cells, "scheme").items():
        group = [cell for cell in group if not cell.failure]
        sizes, style = [cell.n_particles for cell in group], {"color": _SCHEMES[name], "marker": "o", "ms": 4}
        found = orders_of([(cell.n_particles, cell.errors) for cell in group], "particles", dim)
        for ax, m in zip(axes.ravel(), _DRAWN, strict=False):
            errors = [getattr(cell.errors, m) for cell in group]
            ax.plot(sizes, errors, label=f"{name}, order {found[m]}", **style)
        seconds, errors = zip(
            *[(cell.seconds, getattr(cell.errors, last)) for cell in group], strict=True
        ) or ((), ())
        axes[1, 1].plot(seconds, errors, label=name, **style)
    for ax, m in zip(axes.ravel(), (*_DRAWN, last), strict=True):
        _finish(ax, truth, m)
        _legend(ax)
    for ax in axes.ravel()[:3]:
        ax.set_xlabel("particles")
        plain_numbers(ax.xaxis)
    axes[1, 1].set_xlabel("run time (s)")
    dotted = "" if truth.doubt is None else "\ndotted: bound of the grid's own error"
    figure.suptitle(f"{title}{dotted}", fontsize=11)
    return save(figure, path)


def draw_steps(path, title, rows, truth, rule):
    """Draw errors of every integrator against the time step; returns the path."""
    drawn = [m for m in _DRAWN if m != "l2" or truth.nodes]
    figure, axes = plt.subplots(1, len(drawn), figsize=(4.3 * len(drawn), 4.4), layout="constrained")
    for name, group in groups(rows, "integrator").items():
        group = [(cell, own) for cell, own in group if not cell.failure]
        steps, colour = [cell.label[rule] for cell, _ in group], _STEPPERS[name]
        found = orders_of([(cell.label[rule], own) for cell, own in group], "step")
        for ax, m in zip(axes, drawn, strict=True):
            own = [getattr(errors, m) for _, errors in group]
            whole = [getattr(cell.errors, m) for cell, _ in group]
            ax.plot(steps, own, color=colour, marker="o", ms=4, label=f"{name}, order {found[m]}")
            ax.plot(steps, whole, color=colour, ls=":", lw=1.2)
    for ax, m in zip(axes, drawn, strict=True):
        _finish(ax, truth, m)
        ax.set_xlabel(RULES[rule][0])
        plain_numbers(ax.xaxis)
        _legend(ax)
    figure.suptitle(f"{title}\nsolid: error of the step alone; dotted: against the {truth.name}", fontsize=10)
    return save(figure, path)


def _legend(ax):
    """A legend above the curves."""
    low, high = np.log10(ax.get_ylim())
    ax.set_ylim(10**low, 10 ** (high + 0.28 * (high - low)))
    ax.legend(frameon=False, fontsize=8, loc="upper right")


def _finish(ax, truth, measure):
    doubt = np.nan if truth.doubt is None else getattr(truth.doubt, measure)
    ax.set_xscale("log")
    ax.set_yscale("log")
    if np.isfinite(doubt):
        ax.axhline(doubt, color=INK, lw=0.8, ls=":")
    frame(ax, "", "", _LABELS[measure])
