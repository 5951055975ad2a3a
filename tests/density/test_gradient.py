"""`ParticleDensity.gradient`: the derivative of the pdf, of kernels and log-densities."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import sphfilter as sf

MEAN, COV = np.array([0.5, -1.0]), np.array([[1.0, 0.6], [0.6, 2.0]])
X = stats.multivariate_normal(MEAN, 1.5 * COV).rvs(200, random_state=1)


def difference(density, X, step=1e-6):
    ahead = [(density.pdf(X + step * e) - density.pdf(X - step * e)) / (2 * step) for e in np.eye(X.shape[1])]
    return np.transpose(ahead)


@pytest.mark.parametrize("read_out", ["mixture", "log_density"])
def test_gradient_is_the_derivative_of_the_pdf(read_out):
    scheme = "auto" if read_out == "log_density" else "paper"
    density = sf.initialize(sf.Gaussian(MEAN, COV), 300, sf.SolverConfig(scheme=scheme))
    density = replace(density, read_out=read_out)
    found = density.gradient(X)
    assert found == pytest.approx(difference(density, X), abs=1e-8)
    assert np.abs(found).max() > 0.03
    assert density.gradient(X[0]) == pytest.approx(found[:1], rel=1e-9)


def test_gradient_of_a_log_density_is_that_of_the_gaussian_it_came_from():
    density = sf.initialize(sf.Gaussian(MEAN, COV), 300)
    exact = stats.multivariate_normal(MEAN, COV).pdf(X)[:, None] * -np.linalg.solve(COV, (X - MEAN).T).T
    assert density.gradient(X) == pytest.approx(exact, abs=1e-5)


@pytest.mark.parametrize("scheme", ["auto", "paper"])
def test_gradient_round_a_circle(scheme):
    domain = [("periodic", -np.pi, np.pi), None]
    gaussian = sf.Gaussian([3.0, 0.0], np.diag([0.3, 0.5]))
    density = sf.initialize(gaussian, 400, sf.SolverConfig(scheme=scheme), domain=domain)
    Y = np.random.default_rng(0).uniform([-np.pi + 0.01, -1.5], [np.pi - 0.01, 1.5], (100, 2))
    assert density.gradient(Y) == pytest.approx(difference(density, Y), abs=1e-8)
    assert density.gradient(Y + np.array([2 * np.pi, 0.0])) == pytest.approx(density.gradient(Y), abs=1e-9)


def test_gradient_is_zero_beyond_a_wall():
    density = sf.initialize(sf.Uniform([[0.0, 1.0]]), 50, domain=[("reflecting", 0.0, None)])
    assert density.gradient([[-0.02]]) == pytest.approx(0.0)
    assert density.gradient([[0.98]])[0, 0] < -1.0
