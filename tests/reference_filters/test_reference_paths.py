"""Paths of a model in blocks: weak orders, automatic steps, threads, tails, failures."""

import numpy as np
import pytest
from density_cases import whitened
from scipy.integrate import solve_ivp

from reference_filters._blocks import split_steps, standard_normals
from reference_filters._normals import LANES
from reference_filters._paths import Paths
from sphfilter import consistency
from sphfilter.core.sde_steps import normals_per_step, shifted_path_steps
from sphfilter.errors import PropagationError
from sphfilter.model.sde import SDE, LinearSDE

#: A linear oscillator that does not say so, and the same with its exact transition.
HIDDEN = SDE(lambda x: (x[1], -x[0] - 0.4 * x[1]), 2, [[0.0], [1.0]], 0.7)
EXACT = LinearSDE([[0.0, 1.0], [-1.0, -0.4]], None, [[0.0], [1.0]], 0.7)


def affine_step(loop, rows, dt):
    """Return (A, B) of one step x' = A x + B ξ of the hidden oscillator; what is a sign stays a sign."""
    n_normals = rows * (1 if loop is split_steps else 3)
    out = []
    for x, xi in [*((e, 0) for e in np.eye(2)), *((np.zeros(2), k) for k in range(n_normals))]:
        pair = []
        for sign in (1.0, -1.0):
            z = np.zeros((n_normals, 1))
            if not x.any():
                z[xi] = sign
            X = sign * x[None]
            z = z.reshape(rows, n_normals // rows, 1)
            loop(X, 0.0, dt, HIDDEN.drift_batch, HIDDEN.noise_batch, HIDDEN.p, np.sqrt([[0.7]]), z)
            pair.append(X[0])
        out.append((pair[0] - pair[1]) / 2)
    out = np.array(out).T
    return out[:, :2], out[:, 2:]


@pytest.mark.parametrize(("loop", "low", "high"), [(split_steps, 1.9, 2.1), (shifted_path_steps, 2.8, 4.2)])
def test_weak_order_on_a_linear_oscillator(loop, low, high):
    """Mean and covariance of many steps, without sampling, against the exact transition."""
    Phi, _, Qd = EXACT.discretize(2.4)
    errors = []
    for n_steps in (12, 24, 48):
        A, B = affine_step(loop, 2 if loop is split_steps else 1, 2.4 / n_steps)
        mean, cov = np.eye(2), np.zeros((2, 2))
        for _ in range(n_steps):
            mean, cov = A @ mean, A @ cov @ A.T + B @ B.T
        errors.append(max(np.abs(mean - Phi).max(), np.abs(cov - Qd).max()))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all((orders > low) & (orders < high)), (errors, orders)


def spread_out(n, seed=0):
    return np.random.default_rng(seed).standard_normal((n, 2)) * [0.4, 0.8] + [1.0, -0.5]


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("tolerance", [2e-2, 3e-3])
def test_automatic_steps_keep_the_bias_within_the_tolerance(order, tolerance):
    x = spread_out(200_000)
    start = x.copy()
    n_steps = Paths(HIDDEN, order).move(x, 0.0, 2.5, x.var(axis=0), tolerance, np.random.default_rng(2))
    Phi, _, Qd = EXACT.discretize(2.5)
    mean, cov = Phi @ start.mean(axis=0), Phi @ np.cov(start.T) @ Phi.T + Qd
    noise = 4.5 / np.sqrt(len(x))
    assert consistency.distance(x.mean(axis=0), mean, cov) < tolerance + noise
    assert np.abs(whitened(np.cov(x.T), cov)).max() < tolerance + 2 * noise
    assert n_steps < 0.5 / np.sqrt(tolerance) * 12


@pytest.mark.parametrize("order", [2, 4])
def test_fixed_steps(order):
    x = spread_out(100)
    assert Paths(HIDDEN, order, step=0.3).move(x, 0.0, 1.0, np.ones(2), 1e-9, np.random.default_rng(0)) == 4


def test_noise_that_depends_on_the_state():
    """dx = σ x dW: E x² grows as exp(σ² t)."""
    model = SDE(lambda x: (0.0,), 1, lambda x: ((x[0],),), [[0.2]])
    x = np.ones((200_000, 1))
    Paths(model).move(x, 0.0, 1.0, np.zeros(1), 1e-3, np.random.default_rng(1))
    error = np.sqrt((np.exp(1.2) - np.exp(0.4)) / len(x))  # E x⁴ = exp(6 σ²)
    assert abs(np.mean(x**2) - np.exp(0.2)) < 4.5 * error + 1e-3


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3])
def test_steps_are_short_enough_where_little_noise_depends_on_the_state(tolerance):
    model = SDE.from_expressions(["x"], ["1.7*sin(x) - 0.222*x"], [["1e-6/(1 + x**2)"]])
    x = np.random.default_rng(4).normal(0.0, 4.0, (2000, 1))
    span, starts = (0.0, 2.0), x[:, 0].copy()
    Paths(model).move(x, *span, x.var(axis=0), tolerance, np.random.default_rng(5))
    exact = solve_ivp(lambda t, x: 1.7 * np.sin(x) - 0.222 * x, span, starts, rtol=1e-8, atol=1e-8).y[:, -1]
    assert np.sqrt(np.mean((x[:, 0] - exact) ** 2)) < tolerance * exact.std()


def test_linear_models_take_their_exact_transition():
    x = np.tile([1.0, -0.5], (100_000, 1))
    assert Paths(EXACT).move(x, 0.0, 2.5, np.zeros(2), 1e-2, np.random.default_rng(3)) == 1
    Phi, _, Qd = EXACT.discretize(2.5)
    assert np.abs(x.mean(axis=0) - Phi @ [1.0, -0.5]).max() < 4.5 * np.sqrt(Qd.max() / len(x))
    np.testing.assert_allclose(np.cov(x.T), Qd, atol=6.5 * Qd.max() / np.sqrt(len(x)))


@pytest.mark.parametrize("model", [HIDDEN, EXACT])
def test_threads_do_not_change_a_bit(model):
    found = []
    for n_threads in (1, 2, 3):
        x = spread_out(256 * 30 + 11)
        Paths(model, n_threads=n_threads).move(x, 0.0, 1.0, np.ones(2), 1e-2, np.random.default_rng(4))
        found.append(x)
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[0], found[2])
    assert len(np.unique(found[0][:, 0])) == len(x)


def test_fast_forcing_is_resolved():
    """x' = cos 40 t has no stiffness of its own: only the rate of change with time tells the step."""
    model = SDE(lambda x, t: (40.0 * np.cos(40.0 * t),), 1, [[1.0]], 1e-12)
    x = np.zeros((300, 1))
    Paths(model).move(x, 0.0, 1.0, np.ones(1), 1e-2, np.random.default_rng(0))
    np.testing.assert_allclose(x, np.sin(40.0), atol=2e-2)


def test_tails_of_a_stiffening_drift_stay_stable():
    """At 2.5 a step that suits the bulk of these states would be three times too long for the method."""
    model = SDE(lambda x: (-4.0 * x[0] ** 3,), 1, [[1.0]], 1.0)
    x = np.random.default_rng(5).standard_normal((20_000, 1))
    Paths(model).move(x, 0.0, 2.0, np.ones(1), 3e-2, np.random.default_rng(6))
    s = np.linspace(-2.5, 2.5, 20_001)
    p = np.exp(-2.0 * s**4)  # the steady state
    expected = (s**2 * p).sum() / p.sum()
    assert abs(np.mean(x**2) - expected) < 4.5 * np.std(x**2) / np.sqrt(len(x)) + 3e-2 * expected


def test_a_stiff_relaxation_oscillator_stays_stable():
    """On its slow branches hardly anything moves at rates of 24 and, far out, 300 per second."""
    model = SDE(lambda x: (x[1], -8.0 * x[1] * (x[0] ** 2 - 1.0) - x[0]), 2, [[0.0], [1.0]], [[0.8]])
    start, found = np.random.default_rng(9).standard_normal((8000, 2)) * [1.5, 1.0], []
    for tolerance in (3e-2, 1e-3):
        x = start.copy()
        n_steps = Paths(model).move(x, 0.0, 2.0, x.var(axis=0), tolerance, np.random.default_rng(10))
        assert 24.0 * 2.0 / 2.8 < n_steps < 3000
        found.append(x)
    spread = found[1].std(axis=0)
    noise = 4.5 * np.sqrt(2.0 / len(start))
    assert np.all(np.abs(found[0].mean(axis=0) - found[1].mean(axis=0)) / spread < 3e-2 + noise)
    np.testing.assert_allclose(found[0].std(axis=0), spread, rtol=3e-2 + 4 * noise)


def test_a_start_without_spread():
    x = np.zeros((500, 2))
    assert Paths(HIDDEN).move(x, 0.0, 1.0, np.zeros(2), 1e-2, np.random.default_rng(7)) > 0
    assert np.all(x.std(axis=0) > 0.1)


@pytest.mark.parametrize("step", [None, 0.1])
def test_a_blow_up_is_told(step):
    model = SDE(lambda x: (x[0] ** 3,), 1, [[1.0]], 0.1)
    paths, x = Paths(model, step=step), np.full((300, 1), 2.0)
    with pytest.raises(PropagationError, match=r"blew up between t = 0 and t = 5 s"):
        paths.move(x, 0.0, 5.0, np.ones(1), 1e-2, np.random.default_rng(8))


def test_exact_transitions_draw_normals():
    z = standard_normals(3, 100_001, 3)
    assert np.abs(z.mean(axis=0)).max() < 4.5 / np.sqrt(len(z))
    np.testing.assert_allclose(np.cov(z.T), np.eye(3), atol=6.5 / np.sqrt(len(z)))
    assert normals_per_step(3, True) == 9
    assert LANES % 8 == 0
