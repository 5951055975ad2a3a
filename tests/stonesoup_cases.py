"""Models, clocks and detections that the tests of the Stone Soup adapter share."""

import datetime

import numpy as np
import pytest

import sphfilter as sf

pytest.importorskip("stonesoup")

from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.types.detection import Detection
from stonesoup.types.state import GaussianState

START = datetime.datetime(2026, 1, 1)


def at(seconds):
    """The time so many seconds after the start."""
    return START + datetime.timedelta(seconds=seconds)


def duffing():
    """A Duffing oscillator with two wells, as text."""
    return sf.SDE.from_expressions(
        states=["x", "v"],
        drift=["v", "-c*v - x*(g + e*x**2)"],
        noise=[["0"], ["1"]],
        spectral_density=[[1.6]],
        parameters={"c": 0.4, "g": -1.0, "e": 0.1},
    )


def position(variance=0.2):
    """A sensor of the first of two states."""
    return LinearGaussian(ndim_state=2, mapping=[0], noise_covar=np.array([[variance]]))


def gaussian(mean=(3.0, 0.0), variances=(0.2, 1.0), seconds=0.0):
    return GaussianState(list(mean), np.diag(variances), timestamp=at(seconds))


def seen(*z, seconds, model=None):
    """A detection of the values z."""
    return Detection(list(z), timestamp=at(seconds), measurement_model=model)


def off(state, mean, cov):
    """Errors of a state's mean and covariance, in standard deviations."""
    scale = np.sqrt(np.diag(cov))
    d_mean = (np.asarray(state.mean, dtype=float).ravel() - mean) / scale
    d_cov = (np.asarray(state.covar, dtype=float) - cov) / np.outer(scale, scale)
    return np.abs(d_mean).max(), np.abs(d_cov).max()
