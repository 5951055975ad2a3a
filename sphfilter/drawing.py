"""Pictures of densities, results, forecasts and fits, one call each; matplotlib is asked for only here."""

from collections.abc import Callable, Sequence
from os import PathLike
from typing import Any

import numpy as np

from ._types import Floats
from .errors import ModelError, nearest

_COLOUR, _OTHER = "#009E73", "#D55E00"  # Okabe & Ito's, that the colour-blind tell apart


def _pyplot() -> Any:
    try:
        import matplotlib.pyplot as plt
    except ImportError as problem:
        raise ModelError("pictures need matplotlib: pip install sphfilter[plots]") from problem
    return plt


def chosen(known: Sequence[str], asked: Sequence[str] | str | None) -> list[int]:
    """Numbers of the states, or parameters, of these names; of all, if none are given."""
    if asked is None:
        return list(range(len(known)))
    names = [asked] if isinstance(asked, str) else list(asked)
    for name in names:
        if name not in known:
            near = nearest(str(name), known)
            raise ModelError(f"there is no {name!r} to be drawn{near}; there are: {', '.join(known)}")
    return [list(known).index(name) for name in names]


def _column(ax: Any, count: int) -> tuple[Any, list[Any]]:
    """Axes, one below the other, those given if any: as they are returned, and as a list."""
    if ax is None:
        size = 7.0, 1.2 + 1.9 * count
        _, ax = _pyplot().subplots(count, 1, figsize=size, sharex=True, squeeze=False, layout="constrained")
        ax = ax[0, 0] if count == 1 else ax[:, 0]
    own = list(np.ravel(np.asarray(ax, dtype=object)))
    if len(own) != count:
        raise ModelError(f"the picture takes {count} Axes, got {len(own)}")
    return ax, own


def _finish(ax: Any, xlabel: str, ylabel: str) -> None:
    ax.set(xlabel=xlabel, ylabel=ylabel)
    ax.grid(alpha=0.25, lw=0.5)
    ax.set_axisbelow(True)


def density(p: Any, names: Sequence[str], axes: Sequence[int], ax: Any = None) -> Any:
    """Draw the density of some states: a line, a map with the smallest regions, or all pairs."""
    if len(axes) > 6:
        raise ModelError(f"a picture has six states at most, got {len(axes)}; choose some by states=")
    ax = _one_or_pairs(names, axes, ax, lambda own, panel: _one_or_two(p, names, own, panel))
    if len(axes) <= 2:
        ax.set_title(f"t = {p.t:g}", loc="left", fontsize=9)
    return ax


def _one_or_two(p: Any, names: Sequence[str], axes: Sequence[int], ax: Any) -> None:
    own = p if list(axes) == list(range(p.dim)) else p.marginal(list(axes))
    ranges = [_range(own, a) for a in range(own.dim)]
    if own.dim == 1:
        x = np.linspace(*ranges[0], 400)
        _filled(ax, x, own.pdf(x[:, None]))
        ax.set_ylim(bottom=0.0)
        _finish(ax, names[axes[0]], "density")
        return
    x, y = (np.linspace(*ends, 120) for ends in ranges)
    values = own.pdf(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)).reshape(len(y), len(x))
    ordered = np.sort(values.ravel())[::-1]
    held = np.cumsum(ordered) / max(ordered.sum(), 1e-300)
    levels = [float(ordered[min(np.searchsorted(held, part), held.size - 1)]) for part in (0.99, 0.9, 0.5)]
    levels = [*np.unique([v for v in levels if v > 0.0]), float(ordered[0])]
    if len(np.unique(levels)) > 1:
        shades = [(0.0, 0.62, 0.45, 0.18 + 0.25 * k) for k in range(len(levels) - 1)]
        ax.contourf(x, y, values, levels=levels, colors=shades)
        ax.contour(x, y, values, levels=levels[:-1], colors=_COLOUR, linewidths=0.8)
    mean = own.mean()
    ax.plot(*mean, "+", color="0.2", ms=8)
    _finish(ax, names[axes[0]], names[axes[1]])


def _filled(ax: Any, x: Floats, y: Floats) -> None:
    ax.fill_between(x, y, alpha=0.2, color=_COLOUR, lw=0)
    ax.plot(x, y, color=_COLOUR)


def _range(p: Any, axis: int) -> tuple[float, float]:
    low, high = p.quantile(axis, [5e-4, 1.0 - 5e-4])
    beside = 0.08 * (high - low) + 1e-12 * max(abs(low), abs(high), 1e-300)
    return low - beside, high + beside


def _pairs(names: Sequence[str], axes: Sequence[int], ax: Any, draw: Callable[[list[int], Any], None]) -> Any:
    """Panels of all pairs below a diagonal of single ones."""
    k = len(axes)
    if ax is None:
        _, ax = _pyplot().subplots(k, k, figsize=(2.1 * k, 2.0 * k), squeeze=False, layout="constrained")
    if np.shape(ax) != (k, k):
        raise ModelError(f"the picture takes {k} × {k} Axes, got an array of shape {np.shape(ax)}")
    for i in range(k):
        for j in range(k):
            panel = ax[i, j]
            if j > i:
                panel.set_axis_off()
                continue
            draw([axes[j]] if i == j else [axes[j], axes[i]], panel)
            panel.set_xlabel(names[axes[j]] if i == k - 1 else "")
            panel.set_ylabel(names[axes[i]] if j == 0 and i > 0 else "")
            if i == j:
                panel.set_yticks([])
    return ax


def result(found: Any, names: Sequence[str], axes: Sequence[int], truth: Floats | None, ax: Any) -> Any:
    """Draw means with twice their deviations over time, and what was flagged; the truth, if known."""
    if np.ndim(found.x) != 2:
        raise ModelError("a picture is of one run: take one of many")
    ax, panels = _column(ax, len(axes))
    std = np.sqrt(np.diagonal(found.P, axis1=1, axis2=2))
    for a, panel in zip(axes, panels, strict=True):
        x, wide = found.x[:, a], 2.0 * std[:, a]
        panel.fill_between(
            found.t, x - wide, x + wide, color=_COLOUR, alpha=0.2, lw=0, label="± 2 deviations"
        )
        panel.plot(found.t, x, color=_COLOUR, lw=1.4, label="mean")
        if truth is not None:
            panel.plot(found.t, truth[:, a], color="0.2", lw=1.0, ls="--", label="truth")
        said = np.asarray(found.flagged, dtype=bool)
        if said.any():
            panel.plot(found.t[said], x[said], "o", ms=4, mfc="none", color=_OTHER, label="flagged")
        _finish(panel, "t (s)" if panel is panels[-1] else "", names[a])
    panels[0].legend(loc="best", frameon=False, fontsize=8)
    return ax


def forecast(ahead: Any, axes: Sequence[int], ax: Any) -> Any:
    """Draw means and quantiles over time, and below them the probabilities of events."""
    ax, panels = _column(ax, len(axes) + bool(ahead.probability))
    order = np.argsort(ahead.levels)
    levels, count = ahead.levels[order], len(order) // 2
    for a, panel in zip(axes, panels, strict=False):
        each = ahead.quantiles[:, a][:, order]
        for k in range(count):
            label = f"{levels[k]:g} to {levels[-1 - k]:g}"
            panel.fill_between(
                ahead.t, each[:, k], each[:, -1 - k], color=_COLOUR, alpha=0.2, lw=0, label=label
            )
        if len(order) % 2:
            panel.plot(ahead.t, each[:, count], color=_COLOUR, lw=1.4, label=f"quantile {levels[count]:g}")
        panel.plot(ahead.t, ahead.mean[:, a], color="0.2", lw=1.0, ls="--", label="mean")
        _finish(panel, "t (s)" if panel is panels[-1] else "", ahead.states[a])
    panels[0].legend(loc="best", frameon=False, fontsize=8)
    if ahead.probability:
        panel = panels[-1]
        for name, p in ahead.probability.items():
            (line,) = panel.plot(ahead.t, p, lw=1.4, label=name)
            if "_passages" in vars(ahead):  # asked for before: it takes longer than the rest
                style = {"ls": ":", "color": line.get_color(), "label": f"{name}, by then"}
                panel.plot(ahead.t, ahead.first_passage[name], **style)
        panel.set_ylim(bottom=0.0)
        _finish(panel, "t (s)", "probability")
        panel.legend(loc="best", frameon=False, fontsize=8)
    return ax


def fit(found: Any, names: Sequence[str], axes: Sequence[int], ax: Any) -> Any:
    """Draw estimates of parameters with ellipses of one and two standard errors."""
    middle, cov = np.array([*found.estimate.values()]), found.covariance
    wide = np.sqrt(np.diag(cov))
    if not np.isfinite(wide[list(axes)]).all():
        raise ModelError(
            "a parameter on a bound has no standard error to be drawn; choose others by parameters="
        )

    def draw(own: list[int], panel: Any) -> None:
        a, b = own[0], own[-1]
        if a == b:
            x = middle[a] + np.linspace(-4.0, 4.0, 400) * wide[a]
            _filled(panel, x, np.exp(-0.5 * ((x - middle[a]) / wide[a]) ** 2))
            panel.set_yticks([])
            _finish(panel, names[a], "")
            return
        angle = np.linspace(0.0, 2.0 * np.pi, 120)
        root = np.linalg.cholesky(cov[np.ix_(own, own)])
        ring = root @ np.stack([np.cos(angle), np.sin(angle)])
        for errors in (1.0, 2.0):
            panel.plot(*(middle[own][:, None] + errors * ring), color=_COLOUR, lw=1.2)
        panel.plot(*middle[own], "+", color="0.2", ms=8)
        _finish(panel, names[a], names[b])

    return _one_or_pairs(names, axes, ax, draw)


def posterior(found: Any, names: Sequence[str], axes: Sequence[int], ax: Any) -> Any:
    """Draw histograms of weighted draws beside the Gaussians of a fit, and pairs as the draws themselves."""
    sizes = 30.0 * found.weights / found.weights.max()

    def draw(own: list[int], panel: Any) -> None:
        a, b = own[0], own[-1]
        if a != b:
            panel.scatter(found.draws[:, a], found.draws[:, b], s=sizes, color=_COLOUR, alpha=0.4, lw=0)
            _finish(panel, names[a], names[b])
            return
        low, high = found.quantile(names[a], [2e-3, 1.0 - 2e-3])
        bins: Any = np.linspace(low, high, 30)
        panel.hist(found.draws[:, a], bins, weights=found.weights, density=True, color=_COLOUR, alpha=0.4)
        middle, wide = found.estimate[names[a]], found.standard_error[names[a]]
        if np.isfinite(wide):
            x = np.linspace(low, high, 400)
            y = np.exp(-0.5 * ((x - middle) / wide) ** 2) / (wide * np.sqrt(2.0 * np.pi))
            panel.plot(x, y, color="0.2", lw=1.0, ls="--", label="Gaussian of the fit")
            panel.legend(loc="best", frameon=False, fontsize=8)
        panel.set_yticks([])
        _finish(panel, names[a], "")

    return _one_or_pairs(names, axes, ax, draw)


def _one_or_pairs(
    names: Sequence[str], axes: Sequence[int], ax: Any, draw: Callable[[list[int], Any], None]
) -> Any:
    """One panel of one or two parameters, or all pairs."""
    if len(axes) > 2:
        return _pairs(names, axes, ax, draw)
    ax = _pyplot().subplots(figsize=(5.5, 4.2), layout="constrained")[1] if ax is None else ax
    draw(list(axes), ax)
    return ax


def save(ax: Any, path: str | PathLike[str]) -> None:
    """Write the figure of Axes, one or an array, to a file, and close it."""
    figure = np.ravel(np.asarray(ax, dtype=object))[0].figure
    figure.savefig(path, dpi=130)
    _pyplot().close(figure)
