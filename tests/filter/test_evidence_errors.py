"""What is wrong with a prior is wrong with the evidence."""

from dataclasses import replace

import numpy as np
import pytest

import sphfilter as sf

COV = np.array([[1.0, 0.3], [0.3, 0.5]])


def log_evidence(mean, cov, z):
    start = sf.initialize(sf.Gaussian(mean, cov), "auto")
    return sf.update(start, sf.GaussianMeasurement([[1.0, -0.5]], [[0.2]]), [z])[1].log_evidence


@pytest.mark.parametrize("z", [0.0, 1.0, 3.0])
def test_a_prior_that_is_off_along_each_axis(z):
    """Differences of the evidence where mean and variances are off along each axis, by 1e-3 and √2 of it."""
    start = replace(sf.initialize(sf.Gaussian(np.zeros(2), COV), "auto"), error=1e-3)
    told = sf.update(start, sf.GaussianMeasurement([[1.0, -0.5]], [[0.2]]), [z])[1].evidence_error
    here, square = log_evidence(np.zeros(2), COV, z), 0.0
    for along in np.linalg.cholesky(COV).T:
        square += (log_evidence(1e-3 * along, COV, z) - here) ** 2
        square += (
            log_evidence(np.zeros(2), COV + 1e-3 * np.sqrt(2.0) * np.outer(along, along), z) - here
        ) ** 2
    assert told == pytest.approx(np.sqrt(square), rel=0.01)
