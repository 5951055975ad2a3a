"""Measure the width of a cloud's kernels: `python tests/density/kernel_widths.py`.

Hellinger distances of clouds' densities from a grid's, prior and posterior, over widths.
"""

import numpy as np

import sphfilter as sf
from experiments.benchmark.densities import hellinger
from reference_filters.grid import GridFilter
from sphfilter.density import local_kernels
from sphfilter.density.particle_density import ParticleDensity

__all__ = ["SCENES", "clouds_and_grids"]

_WIDTHS = (0.75, 1.0, 1.2, 1.4, 1.6, 1.8)
_POINTS = (1000, 3000, 10_000)
_BESIDE, _BOTH = [["0"], ["1"]], [["1", "0"], ["0", "1"]]
#: States, drift, noise, spectral density, sensor, its variance, mean and variance of the start, interval.
SCENES = {
    "cycle": ("x v", "v; -0.1*v*(x**2 - 1) - x", _BESIDE, 0.8, "x", 0.4, (2, 0), 0.5, 2.5),
    "sharp cycle": ("x v", "v; -0.5*v*(x**2 - 1) - x", _BESIDE, 0.2, "x", 0.3, (2, 0), 0.4, 4.5),
    "wells": ("x v", "v; x - x**3 - 0.4*v", _BESIDE, 0.4, "x", 0.5, (0, 0), 0.4, 1.5),
    "wells squared": ("x v", "v; 2*x - x**3 - 0.25*v", _BESIDE, 0.3, "x**2", 0.5, (0.1, 0.2), 0.4, 2.0),
    "pendulum": ("x v", "v; -4*sin(x) - 0.2*v", _BESIDE, 0.5, "x", 0.3, (1.5, 0), 0.3, 1.2),
    "ring": ("x y", "-0.1*x; -0.1*y", _BOTH, 0.2, "sqrt(x**2 + y**2)", 0.05, (0.3, 0), 1.0, 1.0),
    "banana": ("x y", "-0.1*x; x**2 - y", _BOTH, 0.05, "y", 0.2, (0.2, 0), 0.8, 1.0),
    "product": ("x y", "-0.2*y; 0.2*x", _BOTH, 0.05, "x*y", 0.1, (1, 0.5), 0.6, 1.0),
    "one state, squared": ("x", "x - x**3", [["1"]], 0.6, "x**2", 0.1, (0.2,), 0.5, 1.0),
    "one state, cubed": ("x", "-x**3", [["1"]], 1.0, "x**3", 0.3, (0.5,), 1.0, 0.7),
}


def clouds_and_grids(name, sizes, epochs):
    """Yield the densities of clouds of some sizes, and the grid's, after every prediction and reading."""
    states, drift, noise, q, h, R, mean, variance, dt = SCENES[name]
    states, n = states.split(), len(mean)
    model = sf.SDE.from_expressions(states, drift.split("; "), noise, q * np.eye(len(noise[0])))
    sensor = sf.GaussianMeasurement.from_expressions(states, [h], [[R]])
    x0, P0 = np.array(mean, dtype=float), variance * np.eye(n)
    times = dt * np.arange(epochs + 1)
    _, z = sf.simulate(model, sensor, x0=x0 + 0.5 * np.sqrt(variance), times=times, rng=1)
    grid = GridFilter(model, sensor, x0, P0, size=192 if n == 2 else 600)
    filters = [
        sf.SPHFilter(
            model, sensor, x0, P0, n_particles=100, config=sf.FilterConfig(scheme=sf.CloudScheme(n_points=N))
        )
        for N in sizes
    ]
    for k in range(1, epochs + 1):
        for filt in (grid, *filters):
            filt.predict(t=times[k])
        yield [filt.density for filt in filters], grid.density
        for filt in (grid, *filters):
            filt.update(z[k])
        yield [filt.density for filt in filters], grid.density


class _Asked:
    """A density on the nodes of a box."""

    def __init__(self, density: ParticleDensity) -> None:
        self.density = density

    def on(self, box):
        return self.density.pdf(box.nodes()).reshape(box.shape)


def distance(density, grid):
    """Hellinger distance of a density from a grid's."""
    return hellinger(_Asked(density), grid)


def main():
    """Print the mean and the largest distance for every width."""
    found = {N: [] for N in _POINTS}
    for name in SCENES:
        for densities, grid in clouds_and_grids(name, _POINTS, 2):
            for N, density in zip(_POINTS, densities, strict=True):
                row = []
                for width in _WIDTHS:
                    local_kernels._WIDTH = width
                    density.form.__dict__.pop("mixture", None)
                    row.append(distance(density, grid))
                found[N].append(row)
    print("width     " + "".join(f"{width:14g}" for width in _WIDTHS))
    for N, rows in found.items():
        each = zip(np.mean(rows, axis=0), np.max(rows, axis=0), strict=True)
        print(f"{N:6d}    " + "".join(f"{mean:8.4f}{most:6.3f}" for mean, most in each))


if __name__ == "__main__":
    main()
