"""The closed form of a Gaussian through a linear model, for those who ask for it."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

import sphfilter as sf
from reference_filters.kalman import KalmanFilter
from sphfilter.density.distributions import gaussian_log_pdf

A = [[0.0, 1.0], [-1.0, -0.1]]
MODEL = sf.LinearSDE(A=A, b=[0.2, 0.0], noise=[[0.0], [1.0]], spectral_density=[[0.4]])
SENSOR = sf.GaussianMeasurement(h=[[1.0, 0.0]], noise_cov=[[0.2]])
MEAN, COV = np.array([1.0, 0.0]), np.array([[0.5, 0.1], [0.1, 0.3]])
EXACT = sf.SolverConfig(exact_linear=True)


def gaussian(N=200):
    return sf.initialize(sf.Gaussian(MEAN, COV), N)


def after(t):
    Phi, c, Q = MODEL.discretize(t)
    return Phi @ MEAN + c, Phi @ COV @ Phi.T + Q


@pytest.mark.parametrize("n", [1, 2, 4])
def test_gaussian_log_pdf(n):
    rng = np.random.default_rng(n)
    root = rng.normal(size=(n, n))
    cov, mean, X = root @ root.T + np.eye(n), rng.normal(size=n), rng.normal(size=(9, n))
    expected = np.atleast_1d(multivariate_normal(mean, cov).logpdf(X))
    assert np.allclose(gaussian_log_pdf(mean, cov)(X), expected)


@pytest.mark.parametrize("t", [0.01, 1.0, 30.0])
def test_one_step_to_any_time(t):
    p, info = sf.predict(gaussian(), MODEL, t, EXACT)
    assert info.scheme == "exact_linear"
    assert (p.t, info.n_evaluations) == (t, 0)
    mean, cov = after(t)
    assert np.allclose(p.mean(), mean, atol=2e-4)
    assert np.allclose(p.cov(), cov, atol=2e-4)
    assert np.allclose(p.log_density, multivariate_normal(mean, cov).logpdf(p.x), atol=2e-3)
    assert p.n_particles <= 200


def test_filter_against_kalman():
    times = np.arange(1.0, 9.0)
    _, z = sf.simulate(MODEL, SENSOR, MEAN, np.concatenate([[0.0], times]), rng=3)
    exact = KalmanFilter(MODEL, SENSOR, MEAN, COV).run(times, z[1:])
    config = sf.FilterConfig(exact_linear=True)
    found = sf.SPHFilter(MODEL, SENSOR, MEAN, COV, n_particles=200, config=config).run(times, z[1:])
    assert np.allclose(found.x, exact.x, atol=1e-3)
    assert np.allclose(found.P, exact.P, atol=1e-3)
    assert found.log_evidence.sum() == pytest.approx(exact.log_evidence.sum(), abs=1e-3)


def test_agrees_with_the_steps_it_replaces():
    p, _ = sf.predict(gaussian(), MODEL, 1.0, EXACT)
    q, info = sf.predict(gaussian(), MODEL, 1.0)
    assert info.scheme == "log_density"
    assert np.allclose(p.mean(), q.mean(), atol=1e-3)
    assert np.allclose(p.cov(), q.cov(), atol=1e-3)


def test_a_density_that_is_not_gaussian_takes_the_steps():
    def pdf(X):
        normal = multivariate_normal([1.5, 0.0], 0.3 * np.eye(2)).pdf
        return normal(X) + normal(-X)

    p = sf.initialize(pdf, 400, box=[[-6, 6], [-6, 6]])
    moved, info = sf.predict(p, MODEL, 0.5, EXACT)
    assert info.scheme == "log_density"
    Phi, c, Q = MODEL.discretize(0.5)
    cov = 0.3 * np.eye(2) + np.diag([1.5**2, 0.0])
    assert np.allclose(moved.mean(), c, atol=1e-3)
    assert np.allclose(moved.cov(), Phi @ cov @ Phi.T + Q, atol=5e-3)


def test_a_model_that_is_not_linear_takes_the_steps():
    model = sf.SDE.from_expressions(["x", "v"], ["v", "-x**3"], [["0"], ["1"]], [[0.4]])
    _, info = sf.predict(gaussian(), model, 0.1, EXACT)
    assert info.scheme == "log_density"


def test_the_papers_particles_take_the_steps():
    config = sf.SolverConfig.paper()
    p = sf.initialize(sf.Gaussian(MEAN, COV), 200, config)
    exact = sf.SolverConfig(scheme=config.scheme, exact_linear=True)
    _, info = sf.predict(p, MODEL, 0.1, exact)
    assert info.scheme == "paper"


def test_not_asked_for_by_default():
    assert not sf.SolverConfig().exact_linear
    assert not sf.FilterConfig().exact_linear
