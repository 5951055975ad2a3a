"""What densities are at fixed points, and at their particles: arrays, npz and CSV files."""

from dataclasses import replace

import numpy as np

from sphfilter.density.storage import write_arrays
from sphfilter.files.write import write_csv

_FAINT = 1e-12  # density, over the highest, below which a velocity is but noise


def points_of(probe):
    """The points of a `Probe`, shape (M, n); the last state runs fastest."""
    return np.stack(np.meshgrid(*probe.axes, indexing="ij"), axis=-1).reshape(-1, len(probe.axes))


def probed(problem, density, X, data):
    """Quantities of a density at points X (M, n), by name: arrays (M,); (M, n) of gradients, velocities.

    The `data` are of those that `grids.Probe` knows. NaN where there is nothing: smoothing lengths and
    velocities of empty space.
    """
    return {name: _QUANTITIES[name](problem.model, density, X) for name in data}


def velocity(model, density, X):
    """Velocity of the probability at states X (M, n): f - div D - D grad p / p (002 (7), erratum)."""
    p, gradient = density.pdf(X), density.gradient(X)
    p = np.where(p > _FAINT * p.max(initial=0.0), p, np.nan)
    D = model.diffusion(X, density.t)
    spread = np.einsum("mij,mj->mi", D, gradient) / p[:, None]
    return model.drift(X, density.t) - model.diffusion_divergence(X, density.t) - spread


def _smoothing_length(model, density, X):
    """Mean of h over the kernels that reach a point, by what they carry there."""
    shape = replace(density, read_out="mixture", domain=None).form
    if density.domain is not None:
        shape, X = shape.around(density.domain), density.domain.fold(X)
    kernels = shape.mixture
    p = kernels.pdf(X)
    total = kernels._replace(mass=kernels.mass * kernels.h).pdf(X)
    return np.divide(total, p, out=np.full(len(X), np.nan), where=p > 0)


_QUANTITIES = {
    "density": lambda model, density, X: density.pdf(X),
    "log_density": lambda model, density, X: density.logpdf(X),
    "smoothing_length": _smoothing_length,
    "density_gradient": lambda model, density, X: density.gradient(X),
    "velocity": velocity,
}


class Probing:
    """Writes what a problem's probe sees of every density it is shown, into a folder."""

    def __init__(self, problem, folder):
        self.problem, self.folder = problem, folder
        self.points = points_of(problem.settings.probe)

    def __call__(self, number, density):
        """Write NUMBER.npz (t, axes, arrays in the shape of the grid) and NUMBER.csv (a line a point)."""
        probe, states = self.problem.settings.probe, self.problem.settings.model.states
        self.folder.mkdir(parents=True, exist_ok=True)
        values = probed(self.problem, density, self.points, probe.data)
        shape = tuple(len(axis) for axis in probe.axes)
        arrays = {"t": np.array(density.t)} | dict(zip(states, probe.axes, strict=True))
        arrays |= {name: value.reshape(shape + value.shape[1:]) for name, value in values.items()}
        write_arrays(self.folder / f"{number:04d}.npz", arrays)
        _write(self.folder / f"{number:04d}.csv", states, self.points, values)


def write_particles(path, problem, density):
    """Write particles, a line each: state, velocity, mass, smoothing length, density and its gradient."""
    values = {
        "velocity": velocity(problem.model, density, density.x),
        "mass": density.mass,
        "smoothing_length": density.h,
    }
    values |= probed(problem, density, density.x, ("density", "density_gradient"))
    _write(path, problem.settings.model.states, density.x, values)


def _write(path, states, X, values):
    """A line a state; a quantity with a component for each state has as many columns."""
    header, columns = list(states), [X]
    for name, value in values.items():
        header += [name] if value.ndim == 1 else [f"{name}_{state}" for state in states]
        columns.append(value.reshape(len(X), -1))
    write_csv(path, header, np.hstack(columns).tolist())
