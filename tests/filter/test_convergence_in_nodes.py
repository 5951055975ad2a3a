"""More nodes never make a filter much worse, and nothing is refused on the way: sensors of one state."""

import numpy as np
import pytest
from fine_grid import fine_grid_filter

import sphfilter as sf

Q, START, SECONDS = 0.6, (0.3, 1.5), 1.0
DRIFTS = {"-0.2*x": lambda x: -0.2 * x, "x - x**3": lambda x: x - x**3}


def gaussian(h, R):
    def log_likelihood(z, x):
        return -0.5 * (z - h(x)) ** 2 / R - 0.5 * np.log(2.0 * np.pi * R)

    return log_likelihood, sf.GaussianMeasurement(lambda X: h(X[:, :1]), [[R]], vectorized=True), h


def laplace(scale):
    def log_likelihood(z, x):
        return -np.abs(z - x) / scale - np.log(2.0 * scale)

    sensor = sf.LikelihoodMeasurement(lambda z, X, t: log_likelihood(z[0], X[:, 0]))
    return log_likelihood, sensor, lambda x: x


SENSORS = {
    "cubic": lambda: gaussian(lambda x: x**3, 1.0),
    "exponential": lambda: gaussian(lambda x: np.exp(0.7 * x), 0.3),
    "square": lambda: gaussian(lambda x: x**2, 0.3),
    "saturating": lambda: gaussian(np.tanh, 0.05),
    "angle": lambda: gaussian(lambda x: np.arctan2(x, 1.0), 0.03),
    "distance": lambda: gaussian(np.abs, 0.3),
    "Laplace": lambda: laplace(0.5),
}


@pytest.mark.parametrize("drift", ["-0.2*x", pytest.param("x - x**3", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", SENSORS)
def test_no_more_nodes_make_it_worse(name, drift):
    """Errors of the mean in standard deviations, until they are below 1e-5; each is told within a factor."""
    log_likelihood, sensor, h = SENSORS[name]()
    truth = np.array([0.9, -0.4, 1.3, 0.2])
    readings = h(truth) + np.array([0.1, -0.2, 0.15, 0.05])
    exact = fine_grid_filter(DRIFTS[drift], Q, log_likelihood, START, readings, SECONDS)
    model = sf.SDE.from_expressions(["x"], [drift], [["1"]], [[Q]])
    before, errors = np.inf, []
    for N in (50, 100, 400, 1600):
        flt = sf.SPHFilter(model, sensor, x0=START[:1], P0=[[START[1]]], n_particles=N)
        result = flt.run(SECONDS * np.arange(1, 5), readings)
        error = np.sqrt(np.mean((result.x[:, 0] - exact[:, 0]) ** 2 / exact[:, 1]))
        assert error < max(1.5 * before, 1e-5), N
        assert error < 10.0 * np.sqrt(np.mean(result.error**2)) + 1e-5
        before, errors = error, [*errors, error]
    assert errors[-1] < 2e-5 and errors[0] < 5e-3
    assert flt.log_evidence == pytest.approx(exact[-1, 2], abs=2e-4)
