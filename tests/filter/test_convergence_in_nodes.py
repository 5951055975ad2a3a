"""More nodes never make a filter much worse, and nothing is refused on the way: sensors of one state."""

import numpy as np
import pytest

import sphfilter as sf
from experiments.converge.sensors import DRIFTS, SENSORS, Q
from reference_filters.fine_grid import fine_grid_filter

START, SECONDS = (0.3, 1.5), 1.0


@pytest.mark.parametrize("drift", ["-0.2*x", pytest.param("x - x**3", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", SENSORS)
def test_no_more_nodes_make_it_worse(name, drift):
    """Errors of the mean in standard deviations, until they are below 1e-5; each is told within a factor."""
    sensor = SENSORS[name]
    truth = np.array([0.9, -0.4, 1.3, 0.2])
    readings = sensor.h(truth) + np.array([0.1, -0.2, 0.15, 0.05])
    exact = fine_grid_filter(DRIFTS[drift], Q, sensor.log_likelihood, START, readings, SECONDS)
    model = sf.SDE.from_expressions(["x"], [drift], [["1"]], [[Q]])
    before, errors = np.inf, []
    for N in (50, 100, 400, 1600):
        flt = sf.SPHFilter(model, sensor.measurement, x0=START[:1], P0=[[START[1]]], n_particles=N)
        result = flt.run(SECONDS * np.arange(1, 5), readings)
        error = np.sqrt(np.mean((result.x[:, 0] - exact[:, 0]) ** 2 / exact[:, 1]))
        assert error < max(1.5 * before, 1e-5), N
        assert error < 10.0 * np.sqrt(np.mean(result.error**2)) + 1e-5
        before, errors = error, [*errors, error]
    assert errors[-1] < 2e-5 and errors[0] < 5e-3
    assert flt.log_evidence == pytest.approx(exact[-1, 2], abs=2e-4)
