"""Pictures of a benchmark: run time against error, one panel a scenario."""

import numpy as np
from matplotlib.ticker import LogFormatterSciNotation, LogLocator, NullFormatter

from experiments.show.style import COLOURS, frame, grid, legend_below, panels, save

from .expensive import COSTS, fastest
from .methods import label
from .summary import MEASURES, particle_law
from .told import told_figure

#: Smaller errors are drawn here: the exact filters have some.
_FLOOR = 1e-5
_EXPENSIVE_LEVELS = (0.1, 0.03, 0.01)
#: Colour, marker and width of a series; the SPH filter stands out.
_STYLES = {
    "sph": (COLOURS["sph"], "o", 2.4),
    "auto": ("#1B7A5A", "o", 1.2),
    "paper": ("#7BC8AE", "s", 1.4),
    "ekf": (COLOURS["ekf"], "D", 0.0),
    "ukf": (COLOURS["ukf"], "D", 0.0),
    "kf": ("0.25", "*", 0.0),
    "pf": ("#8DB9DC", "^", 1.3),
    "pf4": (COLOURS["pf"], "v", 1.3),
    "grid": ("#E69F00", "P", 1.3),
    "referee": ("0.55", "X", 1.0),
    "benes": ("0.25", "*", 0.0),
}
_OTHER_SCHEMES = ("#B8860B", "#6A4C93", "#1B4332")


def style(series):
    """Colour, marker, line width and fill of a series; two threads are hollow."""
    family, _, threads = series.partition(", ")
    if family.startswith("sph:"):
        colour = _OTHER_SCHEMES[sum(map(ord, family)) % len(_OTHER_SCHEMES)]
        return colour, "o", 1.4, True
    return *_STYLES[family], not threads


def draw(folder, outcomes):
    """Draw all pictures into a folder; returns their paths."""
    drawn = []
    for measure in MEASURES:
        shown = [o for o in outcomes if any(_points(o.lines, s, measure) for s in _series(o.lines))]
        if shown:
            drawn.append(save(frontier_figure(shown, measure), folder / f"frontier_{measure}.png"))
    telling = [o for o in outcomes if any(len(line.told) for line in o.lines)]
    if telling:
        drawn.append(save(told_figure(telling), folder / "told.png"))
    return drawn


def frontier_figure(outcomes, measure):
    """Run time against one error, both logarithmic, a panel a scenario."""
    n_columns = min(len(outcomes), 3 if len(outcomes) <= 6 else 4)
    n_rows = -(-len(outcomes) // n_columns)
    size = (max(4.1 * n_columns, 6.4), 3.5 * n_rows + 1.0)
    figure, axes = panels(n_rows, n_columns, size, len(outcomes))
    for i, (ax, outcome) in enumerate(zip(axes.flat, outcomes, strict=False)):
        _panel(ax, outcome, measure)
        ax.set_xlabel(MEASURES[measure] if i + n_columns >= len(outcomes) else "", fontsize=8.5)
    for ax in axes[:, 0]:
        ax.set_ylabel("run time (s)", fontsize=9)
    figure.suptitle(f"Run time and {MEASURES[measure].partition(' (')[0]}, by filter and number of particles",
                    fontsize=11)  # fmt: skip
    _legend(figure, axes.flat[: len(outcomes)])
    return figure


def _series(lines):
    return dict.fromkeys(line.series for line in lines)


def _points(lines, series, measure):
    """Lines of a series that have a place on logarithmic axes."""
    here = [i for i in lines if i.series == series]
    return [i for i in here if np.isfinite(getattr(i, measure)) and getattr(i, measure) > 0]


def _errors(lines, measure):
    """One error of each line, none below the floor of the picture."""
    return [max(getattr(i, measure), _FLOOR) for i in lines]


def _panel(ax, outcome, measure):
    lines = outcome.lines
    for series in _series(lines):
        points = _points(lines, series, measure)
        if not points:
            continue
        colour, marker, width, filled = style(series)
        error, seconds = _errors(points, measure), [i.seconds for i in points]
        first = series.startswith(("sph", "paper"))
        look = {"color": colour, "lw": width, "ls": "-" if filled else "--", "zorder": 4 if first else 3}
        marks = {"marker": marker, "ms": 5.5 if first else 5, "mec": colour}
        ax.plot(error, seconds, **look, **marks, mfc=colour if filled else "white", label=label(series))
        if series in ("sph", "pf4", "grid"):
            _sizes(ax, points, error, colour)
    _law(ax, lines, measure)
    _unreliable(ax, outcome, measure)
    ax.set(xscale="log", yscale="log")
    here = [e for s in _series(lines) for e in _errors(_points(lines, s, measure), measure)]
    ax.set_xlim(0.5 * min(here), 2.0 * max(here))
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(LogLocator(numticks=12))
        axis.set_major_formatter(LogFormatterSciNotation())
        axis.set_minor_formatter(NullFormatter())
    ax.set_title(outcome.scenario.replace("_", " "), loc="left", fontsize=10, fontweight="bold")
    grid(ax)
    ax.tick_params(labelsize=8)


def _sizes(ax, points, error, colour):
    """Write the sizes of the first and the last point beside them."""
    for i in sorted({0, len(points) - 1}):
        size = points[i].size
        text = f"{size // 1000}k" if size >= 10_000 else f"{size}"
        place = {"xytext": (5, 3), "textcoords": "offset points", "zorder": 5}
        ax.annotate(text, (error[i], points[i].seconds), fontsize=7, color=colour, **place)


def _law(ax, lines, measure):
    """The particle filter's law, seconds = c / error², through its best point and beyond."""
    points = _points(lines, "pf4", measure) or _points(lines, "pf", measure)
    law = particle_law(lines, measure)
    if not points or not np.isfinite(law):
        return
    here = [i for s in _series(lines) for i in _points(lines, s, measure)]
    error = np.array([min(_errors(here, measure)), max(_errors(points, measure))])
    seconds = [i.seconds for i in here]
    ax.set_ylim(0.5 * min(seconds), 3.0 * max(seconds))
    ax.plot(
        error, law / error**2, ":", color="0.45", lw=1.2, zorder=2, label="particle filter's law, 1/error²"
    )


def _unreliable(ax, outcome, measure):
    """Shade the errors that are less than five times the reference's own."""
    own = getattr(outcome.reference, measure)
    if own > 0:
        ax.axvspan(0.1 * _FLOOR, 5 * own, color="0.5", alpha=0.13, lw=0, label="reference not good enough")


def _legend(figure, axes):
    legend_below(figure, *axes, columns=max(2, int(figure.get_figwidth() / 3.2)), fontsize=8.5)


def expensive_figure(lines, scenario):
    """Run time against the cost of one evaluation of the drift, a panel an error that is to be reached."""
    n = len(_EXPENSIVE_LEVELS)
    figure, (axes,) = panels(1, n, (3.4 * n, 4.3), sharey=True)
    for ax, error in zip(axes, _EXPENSIVE_LEVELS, strict=True):
        for series in _series(lines):
            _expensive_series(ax, [i for i in lines if i.series == series], error)
        frame(ax, f"error of the mean ≤ {error:g}", "seconds an evaluation of the drift", "")
    axes[0].set_ylabel("run time (s)")
    figure.suptitle(
        f"{scenario.replace('_', ' ')} with an expensive drift, each filter at its best size\n"
        "(dotted: more particles by the particle filter's law)",
        fontsize=10.5,
    )
    _legend(figure, axes)
    return figure


def _expensive_series(ax, lines, error):
    """One series: what its best size takes at each cost."""
    usable = [i for i in lines if i.threads == 1 and np.isfinite(i.drift)]
    best = {c: found for c in np.geomspace(1e-8, COSTS[-1], 60) if (found := fastest(usable, c, error))}
    if not best:
        return
    series = lines[0].series
    colour, _, width, _ = style(series)
    by_law = any(more > 1 for _, _, more in best.values())
    look = {"color": colour, "lw": width or 1.2, "ls": ":" if by_law else "-"}
    ax.loglog([*best], [seconds for _, seconds, _ in best.values()], label=label(series), **look)


def draw_expensive(folder, lines, scenario):
    """Draw the picture of an expensive drift; returns its path."""
    return save(expensive_figure(lines, scenario), folder / "expensive.png")
