"""Kalman's rule for many Gaussians in one call."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

import sphfilter as sf
from sphfilter.core.kalman import conditioned


@pytest.mark.parametrize(("n", "k"), [(1, 1), (3, 2), (2, 4)])
def test_each_gaussian_is_that_of_the_closed_form(n, k):
    rng = np.random.default_rng(n + k)
    mean, off, H = (rng.standard_normal(shape) for shape in ((3, n), (3, k), (k, n)))
    A, B = rng.standard_normal((3, n, n)), rng.standard_normal((k, k))
    cov, R = A @ A.transpose(0, 2, 1) + 0.1 * np.eye(n), B @ B.T + 0.1 * np.eye(k)
    for x, P, log_p, m, C, d in zip(*conditioned(mean, cov, off, H, R), mean, cov, off, strict=True):
        S = H @ C @ H.T + R
        gain = np.linalg.solve(S, H @ C).T
        np.testing.assert_allclose(x, m + gain @ d, rtol=1e-10)
        np.testing.assert_allclose(P, C - gain @ S @ gain.T, rtol=1e-9)
        np.testing.assert_allclose(log_p, multivariate_normal(np.zeros(k), S).logpdf(d), rtol=1e-10)


@pytest.mark.parametrize("R", [1e-6, 1e-12, 1e-18])
def test_two_sharp_sensors_of_one_state_know_twice_as_much(R):
    """Of a spread of one, readings of 1e-9 differ by less than a rounding in S, which is singular then."""
    model = sf.LinearSDE([[0.0, 1.0], [0.0, 0.0]], noise=[[0.0], [1.0]])
    both = sf.GaussianMeasurement([[1.0, 0.0], [1.0, 0.0]], np.diag([R, R]))
    one = sf.GaussianMeasurement([[1.0, 0.0]], [[0.5 * R]])
    found, held = (sf.SPHFilter(model, sensor, [0.0, 0.0], np.eye(2)) for sensor in (both, one))
    found.update([0.1, 0.1 + 0.001 * np.sqrt(R)])
    held.update([0.1 + 0.0005 * np.sqrt(R)])
    np.testing.assert_allclose(found.x, held.x, rtol=1e-12)
    np.testing.assert_allclose(np.diag(found.P), np.diag(held.P), rtol=1e-5)
    more = -0.5 * np.log(4.0 * np.pi * R) - 0.25e-6  # what their difference says of them
    assert abs(found.log_evidence - held.log_evidence - more) < 1e-4
