"""Cumulant equations: exact where they close, the published outcomes on Duffing's oscillators elsewhere."""

from math import comb

import numpy as np
import pytest
from scipy.optimize import brentq

import sphfilter as sf
from reference_filters._moment_ode import SIGMA_POINTS, propagate_moments
from reference_filters.closed_forms import DuffingSteadyState, linear_moments
from reference_filters.cumulant import cumulant_moments
from sphfilter.errors import ModelError
from sphfilter.model.sde import SDE, LinearSDE

START = sf.Gaussian([1.0, -0.5], [[0.3, 0.1], [0.1, 0.5]])
#: 000 (161).
SMALL = sf.Gaussian([0.0, 0.0], 0.09 * np.eye(2))


def duffing(k, b, shift=0.0):
    """000 (156): q = 1, c = .4, about another origin."""
    return SDE.from_expressions(
        ["x", "v"], ["v", "-c*v - k*(1 + b*(x - s)**2)*(x - s)"], [["0"], ["1"]], [[1.0]],
        {"c": 0.4, "k": k, "b": b, "s": shift},
    )  # fmt: skip


@pytest.mark.parametrize("order", [2, 4, 6, 8])
@pytest.mark.parametrize("text", [True, False])
def test_a_linear_model_is_exact_at_every_order(order, text):
    A, b, S = np.array([[0.0, 1.0], [-1.5, -0.4]]), np.array([0.0, 0.3]), np.diag([0.0, 0.8])
    model = SDE.from_expressions(["x", "v"], ["v", "0.3 - 1.5*x - 0.4*v"], [["0"], ["2"]], [[0.2]])
    model = model if text else LinearSDE(A, b, [[0.0], [1.0]], [[0.8]])
    found = cumulant_moments(model, START, [0.0, 1.3, 40.0], order)
    assert not found.diverged and found.order == order
    for i, t in enumerate(found.times):
        m, P = linear_moments(A, b, S, START.mean, START.cov, t)
        np.testing.assert_allclose(found.mean[i], m, atol=2e-6)
        second = [found.moment(a, central=True)[i] for a in [(2, 0), (1, 1), (0, 2)]]
        np.testing.assert_allclose(second, [P[0, 0], P[0, 1], P[1, 1]], atol=2e-6)
        if order >= 4:  # Isserlis
            fourth = P[0, 0] * P[1, 1] + 2 * P[0, 1] ** 2
            assert found.moment((2, 2), central=True)[i] == pytest.approx(fourth, abs=2e-5)
            raw = m[0] ** 4 + 6 * m[0] ** 2 * P[0, 0] + 3 * P[0, 0] ** 2
            assert found.moment((4, 0))[i] == pytest.approx(raw, rel=2e-5)


def test_cumulants_of_a_uniform_start_fade():
    """dx = -θ x dt + dW: those above two by e^(-kθt)."""
    model = SDE.from_expressions(["x"], ["-0.7*x"], [["1"]], [[0.5]])
    found = cumulant_moments(model, sf.Uniform([[1.0, 3.0]]), [0.0, 1.5], 6)
    before, after = found.cumulants
    np.testing.assert_allclose(before[1:], [2.0, 1 / 3, 0.0, -16 / 120, 0.0, 64 / 252], atol=1e-12)
    decay = np.exp(-0.7 * 1.5 * np.arange(3, 7))
    np.testing.assert_allclose(after[3:], before[3:] * decay, atol=1e-8)
    # E x⁴ of a uniform law on (1, 3): (3⁵ - 1) / 10
    assert found.moment((4,))[0] == pytest.approx(24.2)


def test_noise_that_is_a_polynomial_of_the_state():
    """dx = μ x dt + σ x dW: E x^k = E x₀^k exp((kμ + k(k-1)σ²/2) t), at any order."""
    model = SDE.from_expressions(["x"], ["mu*x"], [["s*x"]], parameters={"mu": -0.2, "s": 0.3})
    found = cumulant_moments(model, sf.Gaussian([2.0], [[0.25]]), [0.0, 1.0], 5)
    k = np.arange(6)
    growth = np.exp(-0.2 * k + 0.045 * k * (k - 1))
    np.testing.assert_allclose(found.moments[1], found.moments[0] * growth, rtol=2e-6)


def test_coefficients_that_change_with_time():
    """dx = (cos t - x) dt + t dW."""
    model = SDE.from_expressions(["x"], ["cos(t) - x"], [["where(t < 1, t, 1)"]])
    found = cumulant_moments(model, sf.Gaussian([0.5], [[0.2]]), [0.8], 3, t0=0.0)
    t, e = 0.8, np.exp(-0.8)
    assert found.mean.item() == pytest.approx(0.5 * e + 0.5 * (np.cos(t) + np.sin(t) - e), abs=1e-6)
    variance = 0.2 * e**2 + 0.5 * t**2 - 0.5 * t + 0.25 - 0.25 * e**2
    assert found.moment((2,), central=True).item() == pytest.approx(variance, abs=1e-6)


@pytest.mark.parametrize("order", [2, 3])
def test_the_lorenz_system_closed_as_gaussian(order):
    """Second order is the Gaussian closure, which sigma points have exactly for products of two states."""
    model = SDE.from_expressions(
        ["x", "y", "z"], ["10*(y - x)", "28*x - x*z - y", "x*y - 8*z/3"], np.eye(3).tolist(), np.eye(3)
    )
    start = sf.Gaussian([1.0, 2.0, 10.0], np.diag([0.5, 0.3, 0.8]))
    found = cumulant_moments(model, start, [0.12], order, rtol=1e-9)
    m, P, _ = propagate_moments(model, SIGMA_POINTS, start.mean, start.cov, 0.0, 0.12, 0.0, 1e-10)
    second = [found.moment(np.eye(3, dtype=int)[i] + np.eye(3, dtype=int)[j], True).item()
              for i in range(3) for j in range(3)]  # fmt: skip
    if order == 2:
        np.testing.assert_allclose(found.mean[0], m, rtol=1e-7)
        np.testing.assert_allclose(second, P.ravel(), rtol=1e-6)
    else:  # the third cumulants matter
        assert np.abs(np.array(second) / P.ravel() - 1.0).max() > 1e-3


def neglected(m2, k, b, order, T=1.25):
    """Cumulant Q + 2 of x, for stationary moments with E x² = m2 and E x^(p-1) V' = (p-1) T E x^(p-2)."""
    m = {0: 1.0, 2: m2}
    for p in range(2, order + 1, 2):
        m[p + 2] = ((p - 1) * T * m[p - 2] - k * m[p]) / (k * b)
    kappa = {}
    for p in range(2, order + 3, 2):
        kappa[p] = m[p] - sum(comb(p - 1, j - 1) * kappa[j] * m[p - j] for j in range(2, p, 2))
    return kappa[order + 2]


@pytest.mark.parametrize(
    ("k", "b", "exact", "orders"),
    [(1.0, 0.1, 0.9871, (2, 4, 6, 8)), (1.0, 1.0, 0.5422, (2, 4, 6, 8)), (-1.0, -0.1, 8.5214, (2, 4, 6)),
     (-1.0, -1.0, 1.1099, (2, 4, 6))],
)  # fmt: skip
def test_steady_states_of_duffings_oscillators(k, b, exact, orders):
    """They come near the exact one where it has one mode; where it has two, the variance of x is wrong."""
    errors = []
    for order in orders:
        found = cumulant_moments(duffing(k, b), SMALL, [0.0, 80.0], order)
        assert not found.diverged
        variance = found.moment((2, 0))[-1]
        assert variance == pytest.approx(
            brentq(neglected, 0.999 * variance, 1.001 * variance, args=(k, b, order), xtol=1e-12), rel=2e-5
        )
        assert found.moment((0, 2))[-1] == pytest.approx(1.25, rel=2e-5)
        errors.append(abs(variance / exact - 1.0))
    assert np.all(np.diff(errors) < 0.0)
    if k > 0:
        assert errors[-1] < 0.01  # 000 section 4.2.8: of the order of 1 % at order 8
    else:
        assert errors[-1] > 0.1


def test_gaussian_closure_by_hand():
    """Order 2 of the weakly nonlinear one: σ² + 3 b σ⁴ = 1.25."""
    found = cumulant_moments(duffing(1.0, 0.1), SMALL, [60.0], 2)
    assert found.moment((2, 0)).item() == pytest.approx((np.sqrt(2.5) - 1.0) / 0.6, rel=1e-6)
    assert DuffingSteadyState(0.4, 1.0, 0.1).cov()[0, 0] == pytest.approx(0.987087, abs=1e-6)


def test_the_way_to_the_steady_state():
    """Monte Carlo of 10⁶ paths: E x² and E v² of the weakly nonlinear oscillator at t = 1, 2, 5."""
    found = cumulant_moments(duffing(1.0, 0.1), SMALL, [1.0, 2.0, 5.0], 8)
    np.testing.assert_allclose(found.moment((2, 0)), [0.27740, 0.70618, 0.92042], rtol=4e-3)
    np.testing.assert_allclose(found.moment((0, 2)), [0.56998, 0.62021, 1.07499], rtol=4e-3)


@pytest.mark.parametrize("b", [-0.1, -1.0])
def test_order_eight_diverges_on_two_modes(b):
    """000 Table 4, and what is left is a value: no error, no warning."""
    found = cumulant_moments(duffing(-1.0, b), SMALL, [1.0, 10.0, 50.0, 50.0, 60.0], 8, rtol=1e-5)
    assert "no density has such cumulants" in found.diverged or "without bound" in found.diverged
    assert np.isfinite(found.cumulants[:2]).all() and np.isnan(found.cumulants[2:]).all()
    assert np.isnan(found.moment((2, 0))[2:]).all() and np.isnan(found.mean[2:]).all()
    blown = cumulant_moments(
        SDE.from_expressions(["x"], ["x**3"], [["1"]]), sf.Gaussian([1.0], [[1.0]]), [9.0], 4
    )
    assert blown.diverged and np.isnan(blown.cumulants).all()


def test_fixed_steps_are_of_fourth_order():
    exact = cumulant_moments(duffing(1.0, 1.0), SMALL, [3.0], 4, rtol=1e-10).moment((2, 0))
    errors = [
        abs(cumulant_moments(duffing(1.0, 1.0), SMALL, [3.0], 4, step=h).moment((2, 0)) - exact).item()
        for h in (0.1, 0.05)
    ]
    assert 12 < errors[0] / errors[1] < 22
    assert errors[1] < 2e-5


def test_another_origin_and_other_units_change_nothing():
    near = cumulant_moments(duffing(-1.0, -1.0), SMALL, [4.0], 6)
    far = cumulant_moments(duffing(-1.0, -1.0, 1000.0), sf.Gaussian([1000.0, 0.0], SMALL.cov), [4.0], 6)
    np.testing.assert_allclose(far.cumulants[0, 3:], near.cumulants[0, 3:], rtol=1e-5, atol=1e-5)
    small = SDE.from_expressions(["x", "v"], ["v", "-0.4*v + (1 - 1e8*x**2)*x"], [["0"], ["1e-4"]], [[1.0]])
    found = cumulant_moments(small, sf.Gaussian([0.0, 0.0], 0.09e-8 * np.eye(2)), [4.0], 6)
    units = np.array([1e-4 ** sum(a) for a in found.powers])
    np.testing.assert_allclose(found.cumulants[0] / units, near.cumulants[0], atol=1e-6)


def test_four_states():
    """The nonlinear carts of 002 (38) at order 4: Monte Carlo of 10⁶ paths at t = 4."""
    model = SDE.from_expressions(
        ["x1", "v1", "x2", "v2"], ["v1", "-2*x1 - 0.2*x1**3 - 0.4*v1 + x2", "v2", "x1 - 2*x2 - 0.4*v2"],
        [["0", "0"], ["1", "0"], ["0", "0"], ["0", "1"]], 0.4 * np.eye(2),
    )  # fmt: skip
    found = cumulant_moments(model, sf.Gaussian(np.zeros(4), 0.5 * np.eye(4)), [4.0], 4)
    second = [found.moment(a).item() for a in [(2, 0, 0, 0), (1, 0, 1, 0), (0, 2, 0, 0), (0, 0, 2, 0)]]
    np.testing.assert_allclose(second, [0.324432, 0.127606, 0.556243, 0.344764], atol=2e-3)


@pytest.mark.parametrize(
    ("model", "words"),
    [
        (SDE.from_expressions(["x"], ["sin(x)"], [["1"]]), "drift of x, 'sin.x.', is no polynomial"),
        (SDE.from_expressions(["x"], ["x**p"], [["1"]], parameters={"p": 0.5}), "is no polynomial"),
        (SDE.from_expressions(["x"], ["x*abs(x)"], [["1"]]), "is no polynomial"),
        (SDE.from_expressions(["x"], ["-x**3"], [["exp(x)"]]), "diffusion is no polynomial"),
        (SDE(lambda x: (-(x[0] ** 3),), 1, [[1.0]]), "from_expressions"),
        (SDE.from_expressions(["x"], ["1"], [["1"]], domain=[("periodic", 0.0, 1.0)]), "without walls"),
        (SDE.from_expressions(["x"], ["-x**3"], [["x"]], interpretation="stratonovich"), "Itô"),
    ],
)  # fmt: skip
def test_models_that_are_no_polynomials_are_refused(model, words):
    with pytest.raises(ModelError, match=words):
        cumulant_moments(model, sf.Gaussian([0.0], [[1.0]]), [1.0], 2)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"order": 1}, "order"),
        ({"times": [1.0], "t0": 2.0}, "before the start"),
        ({"start": [0.0, 0.0]}, "Gaussian or a Uniform"),
        ({"start": sf.Gaussian([0.0], [[1.0]])}, "mean of the start"),
        ({"step": -1.0}, "step"),
    ],
)
def test_what_does_not_fit_is_said(change, words):
    with pytest.raises(ModelError, match=words):
        cumulant_moments(duffing(1.0, 0.1), **{"start": SMALL, "times": [1.0], "order": 2, **change})
    with pytest.raises(ModelError, match="raise the order"):
        cumulant_moments(duffing(1.0, 0.1), SMALL, [0.1], 2).moment((4, 0))
