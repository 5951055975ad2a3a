"""Exact filters of a forced line and of Beneš from a Gaussian start: against grids, and far in the tail."""

import numpy as np
import pytest

import sphfilter as sf
from reference_filters.exact import BenesFromGaussian, ForcedFilter
from reference_filters.grid import GridFilter
from reference_filters.kalman import KalmanFilter

_TIMES, _START = 0.4 * np.arange(1.0, 7.0), ([0.4], [[0.3]])
_READINGS = np.array([[0.9], [0.2], [np.nan], [1.4], [0.8], [-0.3]])
_SENSOR = sf.GaussianMeasurement([[1.0]], [[0.3]])


def _start():
    return np.array(_START[0]), np.array(_START[1])


@pytest.mark.parametrize(
    "drift, q, exact",
    [
        ("-6*(x - sin(t))", 0.6, lambda: ForcedFilter(6.0, 0.6, _SENSOR, *_start())),
        ("tanh(x)", 1.0, lambda: BenesFromGaussian(_SENSOR, *_start())),
    ],
)
def test_they_agree_with_the_grid(drift, q, exact):
    model = sf.SDE.from_expressions(["x"], [drift], [[1.0]], [[q]])
    grid = GridFilter(model, _SENSOR, *_START, size=192, tol=2e-4).run(_TIMES, _READINGS)
    found = exact().run(_TIMES, _READINGS)
    sd = np.sqrt(grid.P[:, 0, 0])
    assert np.abs((found.x - grid.x)[:, 0] / sd).max() < 2e-4
    np.testing.assert_allclose(found.P, grid.P, rtol=2e-4)
    np.testing.assert_allclose(found.log_evidence, grid.log_evidence, atol=2e-4)


def test_benes_holds_far_in_the_tail():
    """Far out tanh is 1: the posterior is that of a drifting Brownian motion."""
    z = 30.0 + _TIMES[:, None]
    model = sf.LinearSDE(A=[[0.0]], b=[1.0], noise=[[1.0]])
    found, brownian = (
        filt.run(_TIMES, z)
        for filt in (BenesFromGaussian(_SENSOR, *_start()), KalmanFilter(model, _SENSOR, *_start()))
    )
    # the start's own weight, cosh(x0), lies at both signs only if the posterior of the start does
    np.testing.assert_allclose(found.x[3:], brownian.x[3:], rtol=1e-6)
    np.testing.assert_allclose(found.P[3:], brownian.P[3:], rtol=1e-6)
