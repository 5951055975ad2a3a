"""Pictures of a transient solution: densities, moments with their reference, exceedances."""

import numpy as np

from experiments.show.particles import mass_bar, mass_field
from experiments.show.style import ACCENT, INK, frame, legend_below, panels, plt, quantity, save

_MOST_DRAWN, _MOST_MARKED = 6, 30
_FAINTEST = 1e-7  # probability that is shown
_OURS, _THEIRS = ACCENT["sph"], INK


def draw(out, problem, solution, reference, rivals=()):
    """Draw all pictures into the folder `out`; returns their paths."""
    figures = {
        "densities": _densities(problem, solution),
        "moments": _moments(problem, solution, reference, rivals),
    }
    if any(q.powers is None for q in problem.quantities):
        figures["exceedance"] = _exceedances(problem, solution, reference)
    if reference is not None and reference.sampled:
        figures["confidence"] = _confidence(problem, solution, reference)
    if problem.settings.steady:
        figures["steady"] = _steady(problem, solution, rivals)
    return [save(figure, out / f"{name}.png") for name, figure in figures.items()]


def axes_of(problem):
    """States that are drawn against each other."""
    return problem.settings.axes or tuple(range(min(problem.model.dim, 2)))


def drawn_of(problem, solution):
    """Numbers of the densities that are drawn; -1 is the start."""
    wanted = problem.settings.times.drawn
    if wanted:
        every = np.append(problem.times, solution.start.t)
        chosen = [int(np.argmin(np.abs(every - t))) for t in wanted]
        return [-1 if k == len(problem.times) else k for k in dict.fromkeys(chosen)]
    last = len(problem.times) - 1
    return [-1, *np.unique(np.linspace(0, last, min(last + 1, _MOST_DRAWN - 1)).round().astype(int))]


def _densities(problem, solution):
    axes = axes_of(problem)
    if len(axes) == 1:
        return _curves(problem, solution, axes[0])
    drawn = drawn_of(problem, solution)
    columns = min(len(drawn), 3)
    rows = -(-len(drawn) // columns)
    figure = plt.figure(figsize=(3.9 * columns, 3.4 * rows), layout="constrained")
    for place, k in enumerate(drawn, start=1):
        three = len(axes) == 3
        ax = figure.add_subplot(rows, columns, place, **({"projection": "3d"} if three else {}))
        density = solution.start if k < 0 else solution.trajectory.densities[k]
        artist = cloud(ax, density, axes, size=3.0 if three else 7.0)
        title = f"t = {density.t:g}, {density.n_particles} particles"
        frame(ax, title, *(quantity(problem, axis) for axis in axes[:2]))
        if three:
            ax.set_zlabel(quantity(problem, axes[2]))
    mass_bar(figure, artist, figure.axes, "density")
    figure.suptitle(problem.title, fontsize=11)
    return figure


def cloud(ax, density, axes, size):
    """Particles coloured by the logarithm of the density there, the highest on top."""
    x = density.x if density.domain is None else density.domain.fold(density.x)
    return mass_field(ax, x[:, list(axes)], density.pdf(density.x), size)


def _curves(problem, solution, axis):
    """Densities of one state."""
    figure, ax = plt.subplots(figsize=(8, 4.2), layout="constrained")
    drawn = drawn_of(problem, solution)
    for shade, k in zip(np.linspace(0.0, 0.85, len(drawn)), drawn, strict=True):
        density = solution.start if k < 0 else solution.trajectory.densities[k]
        alone = density if density.dim == 1 else density.marginal([axis])
        span = ends(density.x[:, axis], 0.25)
        if density.domain is not None and density.domain.periodic[axis]:
            span = density.domain.low[axis], density.domain.high[axis]
        x = np.linspace(*span, 400)
        ax.plot(x, alone.pdf(x[:, None]), color=plt.cm.viridis(shade), label=f"t = {density.t:g}")
    ax.legend(frameon=False)
    ax.set_ylim(bottom=0)
    frame(ax, problem.title, quantity(problem, axis), "density")
    return figure


def _moments(problem, solution, reference, rivals):
    figure, shown = _panels(problem, "moments")
    for ax, j in shown:
        if reference is not None:
            value, width = reference.values[:, j], reference.half_width[:, j]
            ax.fill_between(problem.times, value - width, value + width, color=_THEIRS, alpha=0.25, lw=0)
            ax.plot(problem.times, value, color=_THEIRS, lw=1.2, ls=":", label=reference.name)
        ax.plot(*_history(problem, solution, j), color=_OURS, **_joined(problem), label="SPH", zorder=1)
        room = _room(ax, problem, solution, problem.quantities[j].powers)
        for shade, rival in zip(np.linspace(0.3, 0.9, len(rivals)), rivals, strict=True):
            ax.plot(problem.times, rival.values[:, j], color=plt.cm.plasma(shade), lw=0.9, label=rival.name)
        ax.set_ylim(room)  # equations that diverge leave the picture
    legend_below(figure, shown[0][0], columns=3)
    return figure


def _history(problem, solution, j):
    """Times and values of a quantity, the start's first."""
    first = problem.quantities[j].of(solution.start)
    return np.append(solution.start.t, problem.times), np.append(first, solution.values[:, j])


def _joined(problem):
    """A line through many times of output; marks, thinly joined, at few: what lies between is not known."""
    few = len(problem.times) <= _MOST_MARKED
    return {"marker": "o", "ms": 3.2, "lw": 0.6} if few else {"lw": 1.4}


def _confidence(problem, solution, reference):
    """Ẑ of every moment, 000 (144): within ±1 where the 95 % interval of the paths holds it."""
    title = f"error of the moments in half widths of the 95 % interval of {reference.name}"
    figure, shown = _panels(problem, title)
    for ax, j in shown:
        with np.errstate(divide="ignore", invalid="ignore"):
            Z = (solution.values[:, j] - reference.values[:, j]) / reference.half_width[:, j]
        ax.axhspan(-1.0, 1.0, color=_THEIRS, alpha=0.15, lw=0)
        ax.plot(problem.times, Z, color=_OURS, lw=1.2)
        ax.set_yscale("symlog", linthresh=2.0, linscale=1.0)
        far = max(2.0, 1.2 * np.nanmax(np.abs(np.where(np.isfinite(Z), Z, 0.0))))
        ax.set_ylim(-far, far)
    return figure


def _panels(problem, title):
    """A figure with a panel for each moment that is shown; returns it and (axes, number of the quantity)."""
    shown = [j for j, q in enumerate(problem.quantities) if q.powers is not None and _shown(problem, q)]
    columns = min(len(shown), 3)
    rows = -(-len(shown) // columns)
    figure, axes = panels(rows, columns, (3.9 * columns, 2.5 * rows + 0.6), len(shown), sharex=True)
    for ax, j in zip(axes.flat, shown, strict=False):
        frame(ax, problem.quantities[j].name, "", "")
    for ax in axes[-1]:
        ax.set_xlabel("t")
    figure.suptitle(f"{problem.name}: {title}", fontsize=11)
    return figure, list(zip(axes.flat, shown, strict=False))


def _shown(problem, quantity):
    """Has the picture of moments a panel for it? Beyond three states not for what mixes two."""
    asked = quantity.powers in problem.settings.statistics.moments
    return problem.model.dim <= 3 or asked or np.count_nonzero(quantity.powers) == 1


def _room(ax, problem, solution, powers):
    """Ends of an axis that do not magnify what is nothing beside the size of the states."""
    squares = [
        [q.powers for q in problem.quantities].index(tuple(row)) for row in 2 * np.eye(problem.model.dim)
    ]
    sizes = np.sqrt(np.nanmax(solution.values[:, squares], axis=0))
    low, high = ax.get_ylim()
    least, middle = 0.05 * np.prod(sizes ** np.array(powers)), 0.5 * (low + high)
    return min(low, middle - least), max(high, middle + least)


def _exceedances(problem, solution, reference):
    figure, ax = plt.subplots(figsize=(8, 5), layout="constrained")
    asked, empty = [j for j, q in enumerate(problem.quantities) if q.powers is None], False
    for shade, j in zip(np.linspace(0.0, 0.9, len(asked)), asked, strict=True):
        colour = plt.cm.viridis(shade)
        t, p = _history(problem, solution, j)
        p[p <= 0.0] = np.nan  # no particle lies there: a gap, for zero has no place on this axis
        empty |= np.isnan(p).any()
        ax.plot(t, p, color=colour, **_joined(problem), label=problem.quantities[j].name)
        if reference is not None:
            value, width = reference.values[:, j], reference.half_width[:, j]
            shown = np.where(value > width, value, np.nan)
            look = {"fmt": "o", "ms": 4, "lw": 0.8, "color": colour, "mfc": "w", "mec": INK, "mew": 0.6}
            ax.errorbar(problem.times, shown, width, **look)
    ax.set_yscale("log")
    ax.set_ylim(max(_FAINTEST, ax.get_ylim()[0]), 1.5)
    ax.legend(frameon=False, fontsize=9, ncols=2)
    against = "" if reference is None else f"; circles: {reference.name}, 95 %"
    gaps = "\n(no line where no particle lies)" if empty else ""
    frame(ax, f"{problem.name}: probability of exceedance{against}{gaps}", "t", "probability")
    return figure


def _steady(problem, solution, rivals):
    """Relative errors against the steady state, 000 (158)."""
    rows = problem.settings.steady
    figure, (axes,) = panels(1, len(rows), (3.9 * len(rows), 3.6), sharey=True)
    for ax, row in zip(axes, rows, strict=True):
        j = [q.powers for q in problem.quantities].index(row.powers)
        for shade, rival in zip(np.linspace(0.3, 0.9, len(rivals)), rivals, strict=True):
            _error_curve(ax, problem, rival.values[:, j], row.value, plt.cm.plasma(shade), rival.name)
        _error_curve(ax, problem, solution.values[:, j], row.value, _OURS, "SPH")
        ax.axhline(0.01, color=INK, lw=0.8, ls=":")
        ax.set_yscale("log")
        ax.set_ylim(1e-6, 10)
        frame(ax, problem.quantities[j].name, "t", "relative error" if ax is axes[0] else "")
    legend_below(figure, axes[0], columns=5)
    figure.suptitle(f"{problem.name}: distance from the steady state; dotted: 1 %", fontsize=11)
    return figure


def _error_curve(ax, problem, value, exact, colour, label):
    error = np.abs(value - exact) / abs(exact)
    ax.plot(problem.times, np.maximum(error, 1e-8), color=colour, lw=1.2, label=label)


def ends(x, part=0.05):
    """Ends of an axis that shows all of x."""
    room = part * (x.max() - x.min())
    return x.min() - room, x.max() + room
