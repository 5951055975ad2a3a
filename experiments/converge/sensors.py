"""Sensors of one state on which more nodes have to help: bent, saturating, of two branches, with kinks."""

from dataclasses import dataclass
from functools import partial

import numpy as np

import sphfilter as sf
from experiments.benchmark.errors import root_mean_square
from reference_filters.fine_grid import fine_grid_filter
from sphfilter.campaign.campaign import Case
from sphfilter.errors import ConfigError, nearest

from .nodes import Problem

Q, _START, _N_READINGS = 0.6, (0.3, 1.5), 8
#: Text of a drift, and what it computes.
DRIFTS = {"-0.2*x": lambda x: -0.2 * x, "x - x**3": lambda x: x - x**3}


@dataclass(frozen=True)
class Sensor:
    """z = h(x) and Gaussian noise of variance `scale`, or Laplace noise of that width."""

    h: object
    scale: float
    laplace: bool = False

    def log_likelihood(self, z, x):
        """Of one reading, at states of any shape."""
        e = z - self.h(x)
        if self.laplace:
            return -np.abs(e) / self.scale - np.log(2.0 * self.scale)
        return -0.5 * e**2 / self.scale - 0.5 * np.log(2.0 * np.pi * self.scale)

    @property
    def measurement(self):
        """The sensor as filters take it."""
        if not self.laplace:
            return sf.GaussianMeasurement(lambda X: self.h(X[:, :1]), [[self.scale]], vectorized=True)
        return sf.LikelihoodMeasurement(
            lambda z, X, t: self.log_likelihood(z[0], X[:, 0]),
            sample=lambda X, t, rng: self.h(X[:, :1]) + rng.laplace(0.0, self.scale, (len(X), 1)),
        )


SENSORS = {
    "cubic": Sensor(lambda x: x**3, 1.0),
    "exponential": Sensor(lambda x: np.exp(0.7 * x), 0.3),
    "square": Sensor(lambda x: x**2, 0.3),
    "saturating": Sensor(np.tanh, 0.05),
    "angle": Sensor(lambda x: np.arctan2(x, 1.0), 0.03),
    "distance": Sensor(np.abs, 0.3),
    "Laplace": Sensor(lambda x: x, 0.5, laplace=True),
}


def problems(names, n_runs, seed):
    """What builds the `Problem` of each sensor and drift: runs of eight readings, a second apart.

    Without names these are all sensors.
    """
    for name in names:
        if name not in SENSORS:
            raise ConfigError(f"no sensor {name!r}{nearest(name, SENSORS)}; there are {', '.join(SENSORS)}")
    return [partial(_problem, name, drift, n_runs, seed) for drift in DRIFTS for name in names or SENSORS]


def _problem(name, drift, n_runs, seed):
    sensor, number = SENSORS[name], list(SENSORS).index(name)
    model, measurement = sf.SDE.from_expressions(["x"], [drift], [["1"]], [[Q]]), sensor.measurement

    def case(run):
        rng = np.random.default_rng([seed, number, run])
        times, x0, P0 = np.arange(_N_READINGS + 1.0), np.array(_START[:1]), np.array([_START[1:]])
        truth, z = sf.simulate(model, measurement, rng.normal(x0, np.sqrt(P0[0])), times, rng)
        return Case(times=times[1:], truth=truth[1:], z=z[1:], x0=x0, P0=P0, t0=0.0)

    def solved(case, size):
        found = fine_grid_filter(DRIFTS[drift], Q, sensor.log_likelihood, _START, case.z, 1.0, size=size)
        return found[:, :1], found[:, 1:2, None]

    def reference(case):
        (mean, cov), (coarse, _) = solved(case, 7201), solved(case, 3601)
        return mean, cov, root_mean_square((mean - coarse)[:, 0] / np.sqrt(cov[:, 0, 0]))

    def make(case, n_particles):
        return sf.SPHFilter(model, measurement, case.x0, case.P0, n_particles=n_particles)

    return Problem(name, drift, [case(run) for run in range(n_runs)], reference, make)
