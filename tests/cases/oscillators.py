"""A linear and a Duffing oscillator whose position is read, for tests of what is fitted to readings."""

import numpy as np

import sphfilter as sf
from reference_filters.kalman import KalmanFilter

OSCILLATOR = sf.SDE.from_expressions(
    ["x", "v"], ["v", "-k*x - c*v"], [["0"], ["s"]], [[1.0]], {"k": 1.0, "c": 0.4, "s": 1.2}
)
POSITION = sf.GaussianMeasurement(h=[[1.0, 0.0]], noise_cov=[[0.2]])
START = np.array([1.0, 0.0]), np.eye(2)
TIMES = 0.7 * np.arange(1, 21)
DUFFING = sf.SDE.from_expressions(
    ["x", "v"], ["v", "-c*v - x*(g + e*x**2)"], [["0"], ["1"]], [[1.6]], {"c": 0.4, "g": -1.0, "e": 0.1}
)


def readings(model, times, x0, seed):
    """Simulated readings (T, 1)."""
    return sf.simulate(model, POSITION, x0=x0, times=np.r_[0.0, times], rng=seed)[1][1:]


def exact(p):
    """The Kalman filter of the linear oscillator with parameters p."""
    return KalmanFilter(OSCILLATOR.with_parameters(**p), POSITION, *START)
