"""What is wrong with a prior is wrong with the evidence."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

import sphfilter as sf
from sphfilter.density.memory import Memory

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


@pytest.mark.parametrize(("b", "z"), [(0.2, 0.3), (0.2, 1.0), (0.4, 0.3), (1.0, 0.3), (1.0, 2.0)])
def test_a_family_tells_what_its_nodes_miss_of_the_integral(b, z):
    """A likelihood with an edge, exp(-|z - x| / b) / 2 b: two halves of Gaussians."""
    sensor = sf.LikelihoodMeasurement(lambda z, X, t: -np.abs(z[0] - X[:, 0]) / b - np.log(2.0 * b), 1)
    start = sf.initialize(sf.Gaussian([0.0], [[1.0]]), "auto").noted(needs=Memory(smooth=True))
    _, info = sf.update(start, sensor, [z], sf.FilterConfig(target_error=0.1))
    halves = [0.5 / b**2 + side * z / b + norm.logcdf(-side * z - 1.0 / b) for side in (-1.0, 1.0)]
    off = abs(info.log_evidence - np.logaddexp(*halves) + np.log(2.0 * b))
    assert info.rung == "family"
    assert 0.9 * off < info.evidence_error < 4.0 * off
