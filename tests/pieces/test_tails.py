"""Gaussian pieces of a prior end before it does: what a reading leaves beyond them is told, not lost."""

import numpy as np
import pytest

import sphfilter as sf

X = np.linspace(-16.0, 10.0, 20_001)


@pytest.mark.parametrize("z", [-30.0, -5.0, 12.0])
def test_a_flat_side_of_a_sensor_keeps_its_tail(z):
    """exp(0.7 x) says little of states below zero: there the posterior is as wide as the prior."""
    model = sf.LinearSDE([[-0.1]], noise=[[0.3]])
    sensor = sf.GaussianMeasurement.from_expressions(["x"], ["exp(0.7*x)"], [[40.0]])
    flt = sf.SPHFilter(model, sensor, [1.0], [[6.0]])
    flt.predict(0.1)
    mean, variance = flt.x[0], flt.P[0, 0]
    info = flt.update([z])
    log_p = -0.5 * (X - mean) ** 2 / variance - 0.5 * (z - np.exp(0.7 * X)) ** 2 / 40.0
    p = np.exp(log_p - log_p.max())
    p /= p.sum()
    exact = p @ X
    spread = p @ (X - exact) ** 2
    assert abs(flt.x[0] - exact) < 3.0 * max(info.error, 0.01) * np.sqrt(spread)
    assert flt.P[0, 0] == pytest.approx(spread, rel=0.03)
