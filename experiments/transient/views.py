"""One picture of a density after the other: what a probe sees, or the cloud; for films, windows and files."""

import numpy as np

from experiments.show.particles import density_image, mass_bar
from experiments.show.style import ACCENT, frame, panels, quantity, save

from .plots import axes_of, cloud, ends
from .probe import points_of, probed

_DEPTH = 14.0  # nats of a log-density that are shown
_ARROWS = 15  # along an axis
_FAINT = 0.01  # of the longest, which has no arrow
_SHOWN = 1e-4  # of the highest density, where a velocity is drawn
_MOST = 6  # panels of a picture in a row
#: What a panel says its colours are.
_TITLES = {
    "density": "density",
    "log_density": "log-density (nat)",
    "smoothing_length": "smoothing length",
    "density_gradient": "gradient of the density",
    "velocity": "velocity of the probability",
}


class Views:
    """Draws densities into a figure of `size` inches, each in place of the one before."""

    def __init__(self, problem):
        self.problem, self.seen = problem, None
        probe = problem.settings.probe
        self.probe = probe if probe is not None and len(probe.long) <= 2 else None
        self.panels = 1 if self.probe is None else len(probe.data)
        self.size = 5.4 * self.panels, 4.2

    def expect(self, densities):
        """Make room for the particles of densities that are going to be shown."""
        for density in densities:
            self._see(density)

    def _see(self, density):
        """Widen what has been seen, lowest and highest of every state, by the particles of a density."""
        x = density.x if density.domain is None else density.domain.fold(density.x)
        both = x if self.seen is None else np.concatenate([x, self.seen])
        self.seen = np.stack([both.min(axis=0), both.max(axis=0)])

    def show(self, figure, density):
        """Draw a density into a figure."""
        figure.clear()
        axes = figure.subplots(1, self.panels, squeeze=False)[0]
        if self.probe is None:
            self._cloud(axes[0], density)
            return
        for ax, (name, value) in zip(axes, _values(self.problem, density).items(), strict=True):
            panel(ax, self.problem, name, value)
            ax.set_title(f"{_TITLES[name]}, t = {density.t:g}", loc="left", fontsize=10)

    def _cloud(self, ax, density):
        """The density of two states, particles of more, or a curve; the axes grow with what was seen."""
        shown = axes_of(self.problem)[:2]
        self._see(density)
        limits = [ends(self.seen[:, axis]) for axis in shown]
        title, names = f"t = {density.t:g}", [quantity(self.problem, axis) for axis in shown]
        if len(shown) == 2:
            flat = density.dim == 2  # of more states the particles are shown
            artist = density_image(ax, density, limits) if flat else cloud(ax, density, shown, size=7.0)
            mass_bar(ax.figure, artist, ax, "density")
            ax.set(xlim=limits[0], ylim=limits[1])
            frame(ax, title, *names)
            return
        grid = np.linspace(*limits[0], 400)
        alone = density if density.dim == 1 else density.marginal(shown)
        ax.plot(grid, alone.pdf(grid[:, None]), color=ACCENT["sph"])
        ax.set_ylim(bottom=0.0)
        frame(ax, title, names[0], "density")


def _values(problem, density):
    """What the probe sees of a density, by name, in the shape of its long sides; velocities where it is."""
    probe = problem.settings.probe
    shape = tuple(len(problem.settings.probe.axes[d]) for d in probe.long)
    X = points_of(probe)
    values = probed(problem, density, X, probe.data)
    if "velocity" in values:
        p = density.pdf(X)
        values["velocity"][p < _SHOWN * p.max()] = np.nan
    return {name: value.reshape(shape + value.shape[1:]) for name, value in values.items()}


def panel(ax, problem, name, value):
    """Draw one quantity: a curve along one side, an image along two, with arrows where it has a direction."""
    probe = problem.settings.probe
    sides, axes = probe.long, [probe.axes[d] for d in probe.long]
    names = [quantity(problem, d) for d in sides]
    if name == "log_density":
        value = np.where(value > value.max() - _DEPTH, value, np.nan)
    if len(sides) == 1:
        ax.plot(axes[0], value[:, sides[0]] if value.ndim == 2 else value, color=ACCENT["sph"], lw=1.4)
        ax.set_xlim(axes[0][0], axes[0][-1])
        frame(ax, _TITLES[name], names[0], _TITLES[name])
        return
    arrows = value[..., sides] if value.ndim == 3 else None
    image = value if arrows is None else np.linalg.norm(value, axis=-1)
    artist = ax.pcolormesh(*axes, image.T, cmap="viridis", shading="nearest", rasterized=True)
    low, high = artist.get_clim()
    if high - low < 1e-6 * abs(high):  # the same everywhere: rounding is no pattern
        artist.set_clim(0.9 * low, 1.1 * high)
    ax.figure.colorbar(artist, ax=ax, shrink=0.9, pad=0.02)
    if arrows is not None:
        _arrows(ax, axes, arrows, image)
    frame(ax, _TITLES[name], *names)


def _arrows(ax, axes, vectors, length):
    """Directions of vectors (K, L, 2), where their length (K, L) counts; it is in the colours."""
    thin = tuple(slice(step // 2, None, step) for step in (max(len(axis) // _ARROWS, 1) for axis in axes))
    where = [axis[part] for axis, part in zip(axes, thin, strict=True)]
    size = np.where(length > _FAINT * np.nanmax(length), length, np.nan)[thin]
    u, v = np.moveaxis(vectors[thin] / size[..., None], -1, 0)
    look = {"color": "w", "edgecolor": "0.3", "lw": 0.3, "width": 0.005, "pivot": "mid", "angles": "xy"}
    ax.quiver(*where, u.T, v.T, scale=1.3 * _ARROWS, scale_units="width", **look)


def probe_picture(path, problem, densities):
    """Draw what the probe sees of some densities, one a row; returns the path."""
    data = problem.settings.probe.data
    densities = densities[:_MOST]
    figure, axes = panels(len(densities), len(data), (4.6 * len(data), 3.6 * len(densities)))
    for row, density in zip(axes, densities, strict=True):
        for ax, (name, value) in zip(row, _values(problem, density).items(), strict=True):
            panel(ax, problem, name, value)
            ax.set_title(f"{_TITLES[name]}, t = {density.t:g}", loc="left", fontsize=10)
    return save(figure, path)
