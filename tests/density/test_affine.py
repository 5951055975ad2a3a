"""Densities moved until their points have given moments."""

import numpy as np
import pytest
from scipy import stats

import sphfilter as sf
from sphfilter.density.affine import with_moments

MEAN, COV = np.array([1.0, -2.0, 0.5]), np.array([[2.0, 0.3, 0.1], [0.3, 0.5, -0.2], [0.1, -0.2, 1.0]])


def test_points_get_the_moments_and_densities_follow():
    """A Gaussian cut off at the end of its lattice becomes the one that was meant, but for its end."""
    density = sf.initialize(sf.Gaussian(MEAN, COV), 800)
    lost = np.trace(np.linalg.solve(COV, COV - density.cov("points"))) / 3
    assert 0.001 < lost < 0.05
    moved = with_moments(density, *density.moments)
    assert moved.mass @ moved.x == pytest.approx(density.mean(), abs=1e-12)
    assert moved.cov("points") == pytest.approx(density.cov(), abs=1e-12)
    stretched = stats.multivariate_normal(MEAN, COV / (1 - lost)).logpdf(moved.x)
    assert moved.log_density == pytest.approx(stretched, abs=0.02)
    assert moved.h == pytest.approx(density.h / np.sqrt(1 - lost), rel=1e-3)


def test_moment_corrected_sums_keep_the_moments_of_a_field():
    """Four states, where a lattice of a thousand nodes lacks a per cent of the covariance."""
    A = np.diag([-1.0, -0.5, -0.3, -0.8]) + np.diag([0.7, 0.2, 0.4], 1)
    model = sf.LinearSDE(A=A, noise=0.5 * np.eye(4))
    start = sf.initialize(sf.Gaussian(np.ones(4), np.eye(4)), 1000)
    density, _ = sf.predict(start, model, 1.0, sf.SolverConfig(scheme="corrected"))
    Phi, _, Qd = model.discretize(1.0)
    cov = Phi @ Phi.T + Qd
    scale = np.sqrt(np.diag(cov))
    assert np.abs((density.cov() - cov) / np.outer(scale, scale)).max() < 5e-4
    assert density.mean() == pytest.approx(Phi @ np.ones(4), abs=1e-4)
