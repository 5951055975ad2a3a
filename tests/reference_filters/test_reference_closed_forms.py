"""Closed forms against quadrature, against published values and against each other."""

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from reference_filters.closed_forms import (
    BenesFilter,
    DuffingSteadyState,
    drifted_uniform,
    linear_moments,
)
from sphfilter.errors import ModelError
from sphfilter.model.measurements import GaussianMeasurement


def test_linear_moments_solve_their_differential_equation():
    A = np.array([[0.0, 1.0], [-2.0, -0.3]])
    b = np.array([0.2, -0.7])
    S = np.array([[0.3, 0.1], [0.1, 0.9]])
    mean, cov = np.array([1.0, -0.5]), np.array([[0.5, 0.2], [0.2, 0.7]])

    def rates(t, y):
        P = y[2:].reshape(2, 2)
        return np.r_[A @ y[:2] + b, (A @ P + P @ A.T + S).ravel()]

    y = solve_ivp(rates, (0, 1.7), np.r_[mean, cov.ravel()], rtol=1e-11, atol=1e-12).y[:, -1]
    m, P = linear_moments(A, b, S, mean, cov, 1.7)
    np.testing.assert_allclose(np.r_[m, P.ravel()], y, rtol=1e-8)


@pytest.mark.parametrize("t", [3.0, 30.0, 1e3, 1e7])
def test_a_critically_damped_oscillator_comes_to_rest(t):
    """Damping ratio 1, frequency 1, S = .2 (002 Table 1): the variances are .05 at the end."""
    A, S = [[0.0, 1.0], [-1.0, -2.0]], np.diag([0.0, 0.2])
    mean, cov = linear_moments(A, [0.0, 0.3], S, [5.0, 5.0], np.eye(2) / 9, t)
    decay = np.exp(-t)
    Phi = decay * np.array([[1 + t, t], [-t, 1 - t]])
    np.testing.assert_allclose(mean, Phi @ [4.7, 5.0] + [0.3, 0.0], atol=1e-12)
    # ∫ S u uᵀ ds of u = e^-s (s, 1 - s)
    e = decay**2
    xx = 0.05 * (1 - e * (2 * t**2 + 2 * t + 1)) if t < 100 else 0.05
    xv, vv = (0.1 * t**2 * e, 0.05 * (1 - e * (2 * t**2 - 2 * t + 1))) if t < 100 else (0.0, 0.05)
    expected = Phi @ Phi.T / 9 + [[xx, xv], [xv, vv]]
    np.testing.assert_allclose(cov, expected, atol=1e-12)


def test_drifted_uniform_keeps_its_mass_and_moves():
    moment = [quad(lambda x, k=k: x**k * drifted_uniform(x, 0.5), -6, 8)[0] for k in range(3)]
    np.testing.assert_allclose(moment[:2], [1.0, 0.5], rtol=1e-9)
    assert moment[2] - 0.25 == pytest.approx(1 / 12 + 2 * 0.125 * 0.5, rel=1e-8)


@pytest.mark.parametrize(
    ("k", "b", "published"),
    [(1, 0.0, 1.25), (1, 0.1, 0.9871), (1, 1.0, 0.5422), (-1, -0.1, 8.5214), (-1, -1.0, 1.1099)],
)
def test_duffing_steady_state_has_the_published_variances(k, b, published):
    cov = DuffingSteadyState(c=0.4, k=k, e=k * b).cov()
    assert cov[0, 0] == pytest.approx(published, abs=6e-5)
    assert cov[1, 1] == pytest.approx(1.25)


def test_duffing_steady_state_makes_the_stationary_equation_vanish():
    c, k, e, q = 0.4, -1.0, 0.1, 1.6
    steady = DuffingSteadyState(c, k, e, q)
    x0, v0, d = 1.2, -0.7, 1e-3

    def p(x, v):
        return steady.pdf(np.array([[x, v]]))[0]

    def flux(x, v):
        return -(c * v + k * x + e * x**3) * p(x, v)

    advection = v0 * (p(x0 + d, v0) - p(x0 - d, v0)) + flux(x0, v0 + d) - flux(x0, v0 - d)
    diffusion = 0.5 * q * (p(x0, v0 + d) - 2 * p(x0, v0) + p(x0, v0 - d)) / d**2
    assert advection / (2 * d) == pytest.approx(diffusion, rel=1e-4)
    grid = np.linspace(-12, 12, 601)
    X = np.stack(np.meshgrid(grid, grid, indexing="ij"), -1).reshape(-1, 2)
    assert steady.pdf(X).sum() * 0.04**2 == pytest.approx(1.0, rel=1e-9)


POSITION = GaussianMeasurement(h=[[1.5]], noise_cov=[[0.6]])


def test_benes_transition_satisfies_the_fokker_planck_equation():
    x, e = 0.4, 1e-3

    def p(x, t):
        filt = BenesFilter(POSITION, m=0.3, s=0.2)
        filt.predict(t=t)
        return filt.pdf([x])[0]

    rate = (p(x, 1 + e) - p(x, 1 - e)) / (2 * e)
    flux = [np.tanh(y) * p(y, 1.0) for y in (x + e, x - e)]
    expected = -(flux[0] - flux[1]) / (2 * e) + 0.5 * (p(x + e, 1) - 2 * p(x, 1) + p(x - e, 1)) / e**2
    assert rate == pytest.approx(expected, rel=1e-4)


def test_benes_update_is_bayes_rule_with_its_evidence():
    filt = BenesFilter(POSITION, m=0.3, s=0.5)
    filt.predict(1.2)
    prior, z = filt.logpdf, 2.1
    x = np.linspace(-25, 25, 20001)
    joint = np.exp(prior(x) + POSITION.log_likelihood([z], x[:, None], 0.0))
    evidence = joint.sum() * (x[1] - x[0])
    mean = (x * joint).sum() / joint.sum()
    var = ((x - mean) ** 2 * joint).sum() / joint.sum()
    info = filt.update(z)
    assert info.log_evidence == pytest.approx(np.log(evidence), abs=1e-9)
    np.testing.assert_allclose(filt.pdf(x), joint / evidence, atol=1e-10)
    assert filt.x[0] == pytest.approx(mean, rel=1e-9)
    assert filt.P[0, 0] == pytest.approx(var, rel=1e-9)


def test_benes_far_out_does_not_overflow():
    filt = BenesFilter(POSITION, m=900.0, s=1.0)
    weights, means, _ = filt.components()
    assert weights[0] == 1.0
    assert filt.x[0] == pytest.approx(901.0)
    assert np.isfinite(filt.logpdf(means)).all()


def test_benes_rejects_a_negative_variance():
    with pytest.raises(ModelError, match="s >= 0"):
        BenesFilter(POSITION, s=-1.0)
