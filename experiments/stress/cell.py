"""What a cell of the stress grid is: one small filtering problem, made anew from its name and a seed."""

from collections.abc import Callable
from dataclasses import dataclass
from zlib import crc32

import numpy as np

import sphfilter as sf

__all__ = ["Cell", "Problem", "drawn"]


@dataclass(frozen=True, kw_only=True)
class Problem:
    """All that a filter is given, and what is known besides.

    Attributes
    ----------
    model, measurement
        As `SPHFilter` takes them.
    x0, P0 : ndarray, shapes (n,), (n, n)
        Gaussian start at time `t0`, seconds.
    times : ndarray, shape (T,)
    z : ndarray, shape (T, k)
        NaN where nothing was measured.
    truth : ndarray, shape (T, n), or None
        Drawn from the model and the start; None where the data were not (outliers), so that the distance
        to it says nothing of the filter.
    n_particles : int
        Bound given to the SPH filters.
    exact : callable, optional
        exact(problem) -> means (T, n), covariances (T, n, n), log-evidence (T,).
    exact_name : str
    """

    model: object
    measurement: object
    x0: np.ndarray
    P0: np.ndarray
    times: np.ndarray
    z: np.ndarray
    truth: np.ndarray | None = None
    n_particles: int = 200
    t0: float = 0.0
    exact: Callable | None = None
    exact_name: str = ""


@dataclass(frozen=True)
class Cell:
    """One square of the grid.

    Attributes
    ----------
    family, system, level, unit : str
        What is made hard, of which model, and how hard, in what unit.
    build : callable
        build(rng) -> Problem.
    quick : bool
        Part of the reduced grid.
    """

    family: str
    system: str
    level: str
    build: Callable
    unit: str = ""
    quick: bool = False

    @property
    def name(self):
        """Unique name, for the command line and for files."""
        return f"{self.family}/{self.system}/{self.level}".replace(" ", "_")

    def problem(self, seed):
        """Make the problem; the same name and seed give the same bits."""
        return self.build(np.random.default_rng([seed, crc32(self.name.encode())]))


def drawn(rng, model, sensor, x0, P0, *, interval, n_updates=6, t0=0.0, step=0.05, **more):
    """Return a `Problem` whose truth and measurements are drawn from its own start, model and sensor.

    Parameters
    ----------
    rng : Generator
    sensor : measurement model
    interval : float
        Seconds from the start to the first measurement, and between measurements.
    step : float
        Longest step of the simulated truth, seconds.
    **more
        Further attributes of the `Problem`.
    """
    x0, P0 = np.atleast_1d(np.asarray(x0, dtype=float)), np.atleast_2d(np.asarray(P0, dtype=float))
    times = t0 + interval * np.arange(n_updates + 1)
    start = x0 + np.linalg.cholesky(P0) @ rng.standard_normal(len(x0))
    truth, z = sf.simulate(model, sensor, start, times, rng, max_step=step)
    given = {"truth": truth[1:], "z": z[1:]} | more
    return Problem(model=model, measurement=sensor, x0=x0, P0=P0, times=times[1:], t0=t0, **given)
