"""A damped oscillator for referees to follow, and how far their answers are from exact ones."""

import numpy as np
from density_cases import whitened

import sphfilter as sf
from sphfilter import consistency

OSCILLATOR = sf.LinearSDE(A=[[0.0, 1.0], [-1.0, -0.2]], noise=[[0.0], [1.0]], spectral_density=[[0.8]])
POSITION = sf.GaussianMeasurement(h=[[1.0, 0.0]], noise_cov=[[0.4]])
X0, P0 = np.array([1.0, -0.5]), np.array([[0.5, 0.1], [0.1, 0.7]])


def errors(result, truth):
    """Largest errors of mean (standard deviations), covariance (relative) and log-evidence (nats)."""
    return (
        consistency.distance(result.x, truth.x, truth.P).max(),
        np.abs(whitened(result.P, truth.P)).max(),
        np.abs(result.log_evidence - truth.log_evidence).max(),
    )
