"""Peaks between nodes, against Gaussians."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from sphfilter.lattice.peaks import along_axes, peaks

WIDE = multivariate_normal(np.zeros(2), np.eye(2))


def test_a_peak_is_climbed_and_measured():
    cov = np.array([[0.04, -0.03], [-0.03, 0.05]])
    thin = multivariate_normal([0.5, -1.0], cov)

    def log_p(X):
        return np.atleast_1d(thin.logpdf(X)) + 3.0

    X = np.array([[0.4, -0.8], [0.6, -1.1]])
    found = peaks(log_p, X, log_p(X), np.eye(2))
    assert len(found) == 1
    assert found[0].x == pytest.approx([0.5, -1.0], abs=0.02)
    assert found[0].factor @ found[0].factor.T == pytest.approx(cov, abs=0.003)
    assert found[0].log_mass == pytest.approx(3.0, abs=0.05)


def test_two_peaks_are_told_apart():
    def log_p(X):
        return np.logaddexp(*(norm.logpdf(X[:, 0], m, 0.02) for m in (-1.0, 1.0)))

    X = np.array([[-1.01], [1.01], [0.99]])
    found = sorted(peaks(log_p, X, log_p(X), np.eye(1)), key=lambda peak: peak.x[0])
    assert [peak.x[0] for peak in found] == pytest.approx([-1.0, 1.0], abs=2e-3)


def test_what_is_thin_in_one_state_after_the_other_is_found_along_axes():
    def log_weight(X):
        parts = norm.logpdf(X - [0.7, -1.3], scale=0.02)
        return np.logaddexp(parts, norm.logpdf(X, scale=10.0)).sum(axis=1)

    found = along_axes(lambda X: WIDE.logpdf(X) + log_weight(X), log_weight, np.zeros(2), np.ones(2))
    assert np.abs(found - [0.7, -1.3]).max(axis=1).min() < 0.02
