"""Pictures of the studies over particles, schemes and time steps."""

import numpy as np

from experiments.show.style import COLOURS, INK, frame, panels, plain_numbers, plt, save

from .studies import RULES
from .tables import groups, orders_of

_SCHEMES = {"auto": COLOURS["sph"], "log_density": COLOURS["sph"], "paper": COLOURS["sph_paper"]}
_STEPPERS = {"euler": COLOURS["ekf"], "midpoint": COLOURS["pf"], "rk4": COLOURS["sph"]}
_DRAWN = "mean", "cov", "l2"
_LABELS = {
    "mean": "error of the mean (std)",
    "cov": "error of the covariance",
    "l2": "density, relative L2 error",
}


def draw_filter(path, rows, slopes):
    """Draw a filter's errors against the number of particles, both logarithmic; returns the path.

    Rows begin with particles and `Distance`; `slopes` are the orders of each error in the particle spacing.
    """
    labels = {
        "mean": "mean (posterior std)",
        "cov": "covariance (relative)",
        "evidence": "log-evidence of a measurement (nat)",
    }
    figure, ax = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    counts = [count for count, *_ in rows]
    for (measure, label), mark in zip(labels.items(), "os^", strict=True):
        errors = [getattr(distance, measure) for _, distance, *_ in rows]
        ax.loglog(counts, errors, f"{mark}-", label=f"{label}, order {slopes[measure]:.1f}")
    ax.set_xticks(counts, map(str, counts), minor=False)
    ax.xaxis.minorticks_off()
    frame(ax, "", "particles at most", "rms error against the exact filter")
    ax.legend(frameon=False)
    return save(figure, path)


def draw_schemes(path, title, cells, truth, dim):
    """Draw errors against particles, and against run time, of every scheme; returns the path."""
    figure, axes = panels(2, 2, (9.6, 7.2))
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
    figure, (axes,) = panels(1, len(drawn), (4.3 * len(drawn), 4.4))
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
    ax.set(xscale="log", yscale="log")
    if np.isfinite(doubt):
        ax.axhline(doubt, color=INK, lw=0.8, ls=":")
    frame(ax, "", "", _LABELS[measure])
