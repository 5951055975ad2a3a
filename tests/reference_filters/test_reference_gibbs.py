"""Gibbs' steady state: against Duffing's, Bessel functions, Gaussians, and the equation it solves."""

import numpy as np
import pytest
from scipy.special import i0, i1, iv

from reference_filters.closed_forms import DuffingSteadyState, linear_moments
from reference_filters.gibbs import GibbsSteadyState
from sphfilter.errors import ModelError


def double_well(x):
    return -0.5 * x[:, 0] ** 2 + 0.025 * x[:, 0] ** 4


def test_it_is_duffings_steady_state():
    exact = DuffingSteadyState(c=0.4, k=-1.0, e=0.1)
    found = GibbsSteadyState(double_well, [[-9.0, 9.0]], c=0.4)
    X = np.random.default_rng(0).standard_normal((50, 2)) * [3.0, 1.2]
    np.testing.assert_allclose(found.pdf(X), exact.pdf(X), rtol=1e-10)
    assert found.moment((2, 0)) == pytest.approx(exact.cov()[0, 0], rel=1e-11)
    assert found.moment((2, 0)) == pytest.approx(8.521362, abs=1e-6)
    assert found.moment((0, 4)) == pytest.approx(3 * 1.25**2, rel=1e-12)
    assert found.moment((1, 1)) == 0.0 and found.moment((0, 0)) == pytest.approx(1.0)


def test_a_pendulum_on_its_ring_is_von_mises():
    """κ = 2 c ω² / q."""
    c, q, w2 = 0.2, 0.5, 3.0
    found = GibbsSteadyState(lambda x: w2 * (1 - np.cos(x[:, 0])), [[-np.pi, np.pi]], c, q)
    kappa = 2 * c * w2 / q
    assert found.expectation(lambda x: np.cos(x[:, 0])) == pytest.approx(i1(kappa) / i0(kappa), rel=1e-12)
    assert found.expectation(lambda x: np.cos(2 * x[:, 0])) == pytest.approx(
        iv(2, kappa) / i0(kappa), rel=1e-12
    )
    at = np.array([[0.7, 0.0]])
    density = np.exp(kappa * np.cos(0.7)) / (2 * np.pi * i0(kappa)) / np.sqrt(2 * np.pi * q / (2 * c))
    assert found.pdf(at)[0] == pytest.approx(density, rel=1e-12)


def test_two_coupled_carts():
    """Linear springs: the stationary Gaussian of the carts of 002 Table 4; and with ε = .2."""
    A = np.array([[0, 1, 0, 0], [-2, -0.4, 1, 0], [0, 0, 0, 1], [1, 0, -2, -0.4]], dtype=float)
    _, cov = linear_moments(A, None, np.diag([0, 0.4, 0, 0.4]), np.zeros(4), np.eye(4), 500.0)

    def potential(x, e):
        a, b = x[:, 0], x[:, 1]
        return 0.5 * a**2 + 0.25 * e * a**4 + 0.5 * (a - b) ** 2 + 0.5 * b**2

    box = [[-6.0, 6.0]] * 2
    linear = GibbsSteadyState(lambda x: potential(x, 0.0), box, c=0.4, q=0.4)
    for i, j in [(0, 0), (0, 2), (2, 2), (1, 1), (1, 3), (0, 3)]:
        powers = np.eye(4, dtype=int)[i] + np.eye(4, dtype=int)[j]
        assert linear.moment(powers) == pytest.approx(cov[i, j], abs=1e-11)
    stiff = GibbsSteadyState(lambda x: potential(x, 0.2), box, 0.4, 0.4, (0, 2), (1, 3))
    # Monte Carlo of the transient, 10⁶ paths at t = 20: .29935, .14985, .32539
    found = [stiff.moment(a) for a in [(2, 0, 0, 0), (1, 0, 1, 0), (0, 0, 2, 0)]]
    np.testing.assert_allclose(found, [0.29935, 0.14985, 0.32539], atol=1.5e-3)
    # E x ∂V/∂x = T
    virial = 2 * found[0] + 0.2 * stiff.moment((4, 0, 0, 0)) - found[1]
    assert virial == pytest.approx(stiff.temperature, rel=1e-10)


def test_it_solves_the_stationary_equation():
    c, q, d, e = 0.3, 0.8, 1e-3, np.eye(2) * 1e-3
    steady = GibbsSteadyState(lambda x: np.cosh(x[:, 0]), [[-5.0, 5.0]], c, q)
    y = np.array([0.8, -0.5])

    def p(s):
        return steady.pdf(s[None])[0]

    def flux(s):
        return -(c * s[1] + np.sinh(s[0])) * p(s)

    advection = (y[1] * (p(y + e[0]) - p(y - e[0])) + flux(y + e[1]) - flux(y - e[1])) / (2 * d)
    assert advection == pytest.approx(0.5 * q * (p(y + e[1]) - 2 * p(y) + p(y - e[1])) / d**2, rel=1e-4)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"box": [[1.0, 0.0]]}, "low, high"),
        ({"box": [[0.0, 1.0]] * 4}, "one to three"),
        ({"c": 0.0}, "c must be"),
        ({"q": -1.0}, "q must be"),
        ({"positions": (1,)}, "share the 2 states"),
    ],
)
def test_what_does_not_fit_is_said(arguments, words):
    with pytest.raises(ModelError, match=words):
        GibbsSteadyState(**{"potential": double_well, "box": [[-9.0, 9.0]], "c": 0.4, **arguments})
