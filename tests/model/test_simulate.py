"""Simulation: exact moments, measured weak orders, reproducibility, shapes, messages."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.linalg import expm
from scipy.sparse import diags
from scipy.sparse.linalg import expm_multiply

from sphfilter.core.sde_steps import normals_per_step, steps
from sphfilter.errors import ModelError, PropagationError
from sphfilter.model.likelihood import LikelihoodMeasurement
from sphfilter.model.measurements import GaussianMeasurement
from sphfilter.model.paths import advance
from sphfilter.model.sde import SDE, LinearSDE
from sphfilter.model.simulate import simulate

POSITION = GaussianMeasurement([[1.0, 0.0]], [[0.2]])


def oscillator(x, t):
    return x[1], -x[0] - 0.4 * x[1]


def within(sample, expected, sigmas=4.5):
    """Assert that the mean of samples (R, ...) is the expected one within sampling error."""
    error = sample.std(axis=0) / np.sqrt(len(sample))
    assert np.all(np.abs(sample.mean(axis=0) - expected) < sigmas * error + 1e-12)


def take(model, x0, T, n_steps, normals):
    """Move copies of x0 over T in n_steps with the normals given, shape (n_steps, N, ...)."""
    x = np.repeat(np.array([x0], dtype=float), normals.shape[1], axis=0)
    L = np.linalg.cholesky(model.spectral_density)
    loop = steps(not model.state_dependent_noise)
    rows = np.ascontiguousarray(normals.transpose(0, 2, 1))
    loop(x, 0.0, T / n_steps, model.drift_batch, model.noise_batch, model.p, L, rows)
    return x


# --- exact ---


def test_linear_model_has_its_exact_moments():
    model = LinearSDE([[0.0, 1.0], [-1.0, -0.4]], [0.3, 0.0], [[0.0], [1.0]], 0.7)
    truth, _ = simulate(model, None, [1.0, 0.0], [0.0, 2.5], rng=1, n_paths=40_000)
    Phi, offset, Qd = model.discretize(2.5)
    x = truth[:, 1]
    mean = Phi @ [1.0, 0.0] + offset
    within(x, mean)
    d = x - mean
    within(d[:, :, None] * d[:, None, :], Qd)


def test_steps_of_a_linear_oscillator_have_its_exact_moments():
    model = SDE(oscillator, 2, [[0.0], [1.0]], 0.7)
    x = advance(model, np.tile([1.0, 0.0], (40_000, 1)), 0.0, 2.5, np.random.default_rng(2))
    Phi, _, Qd = LinearSDE([[0.0, 1.0], [-1.0, -0.4]], None, [[0.0], [1.0]], 0.7).discretize(2.5)
    d = x - Phi @ [1.0, 0.0]
    within(d, 0.0)
    within(d[:, :, None] * d[:, None, :], Qd)


def test_noise_that_varies_with_time():
    model = SDE(lambda x: (-x[0],), 1, lambda x, t: ((np.sin(8.0 * t),),), [[2.0]])
    x = advance(model, np.zeros((40_000, 1)), 0.0, 1.3, np.random.default_rng(3))
    s = np.linspace(0.0, 1.3, 20_001)
    variance = np.trapezoid(np.exp(-2 * (1.3 - s)) * 2.0 * np.sin(8.0 * s) ** 2, s)
    within(x[:, 0] ** 2, variance)


def test_without_noise_the_step_is_runge_kutta_4():
    model = SDE(oscillator, 2)
    exact = expm(np.array([[0.0, 1.0], [-1.0, -0.4]]) * 2.0) @ [1.0, 0.0]
    errors = []
    for n in (10, 20):
        x = take(model, [1.0, 0.0], 2.0, n, np.random.default_rng(0).standard_normal((n, 1, 3)))
        errors.append(np.abs(x[0] - exact).max())
    assert 3.7 < np.log2(errors[0] / errors[1]) < 4.3


# --- weak orders, free of sampling error: Gauss–Hermite nodes for the normals of one path ---


def nodes_of_one_step(n_normals, additive, degree=6):
    """Return (normals (1, N, n_normals), weights): all products of one-dimensional Gauss–Hermite nodes."""
    z, w = np.polynomial.hermite_e.hermegauss(degree)
    two = np.array([-1.0, 1.0]), np.array([0.5, 0.5])
    axes = [(z, w / w.sum())] * (2 * n_normals // 3 if additive else n_normals)
    axes += [two] * (n_normals - len(axes))
    grids = np.meshgrid(*[a[0] for a in axes], indexing="ij")
    weights = np.ones(1)
    for _, v in axes:
        weights = np.multiply.outer(weights, v)
    return np.stack([g.ravel() for g in grids], axis=1)[None], weights.ravel()


def expectation(model, x0, T, n_steps, power, grid):
    """Return E[x^power] of a scalar model by carrying the function back over the steps.

    The function is a polynomial through its values at the Chebyshev nodes of `grid` = (left, right, nodes).
    """
    additive = not model.state_dependent_noise
    normals, w = nodes_of_one_step(normals_per_step(1, additive), additive)
    left, right, k = grid
    s = np.cos(np.pi * np.arange(k) / (k - 1))
    nodes = 0.5 * (left + right + (right - left) * s)
    x = np.repeat(nodes, len(w))[:, None].copy()
    L = np.sqrt(model.spectral_density)
    normals, loop = np.tile(normals.transpose(0, 2, 1), (1, 1, k)), steps(additive)
    loop(x, 0.0, T / n_steps, model.drift_batch, model.noise_batch, model.p, L, normals)

    def basis(x):
        return np.polynomial.chebyshev.chebvander((2.0 * x - left - right) / (right - left), k - 1)

    if k > 3:  # a polynomial of high degree means nothing beyond its nodes
        x = np.clip(x, left, right)
    coefficients = np.linalg.inv(basis(nodes))
    step = np.einsum("kwc,w->kc", basis(x[:, 0]).reshape(k, len(w), k), w) @ coefficients
    u = nodes**power
    for _ in range(n_steps):
        u = step @ u
    return (basis(np.array([x0])) @ coefficients @ u)[0]


def backward_equation(drift, D, x0, T, power, left, right):
    """Return E[x^power] from ∂u/∂t = f u' + D u'' by finite differences, extrapolated in the spacing."""
    values = []
    for k in (601, 1201):
        x, h = np.linspace(left, right, k, retstep=True)
        up, down = D / h**2 + drift(x) / (2 * h), D / h**2 - drift(x) / (2 * h)
        up[0], down[-1] = 2 * D / h**2, 2 * D / h**2
        generator = diags([down[1:], np.full(k, -2 * D / h**2), up[:-1]], [-1, 0, 1], format="csc")
        u = expm_multiply(generator * T, x**power)
        values.append(CubicSpline(x, u)(x0))
    return (4 * values[1] - values[0]) / 3


def test_weak_order_for_additive_noise():
    """Skewed double well; the step acts through quadrature over its normals: no sampling error."""

    def drift(x):
        return x - 0.5 * x**3 - 0.3

    model = SDE(lambda x: x[0] - 0.5 * x[0] ** 3 - 0.3, 1, [[1.0]], 0.5)
    exact = backward_equation(drift, 0.25, 0.2, 2.0, 2, -3.0, 3.0)
    errors = [abs(expectation(model, 0.2, 2.0, n, 2, (-3.0, 3.0, 81)) - exact) for n in (16, 32, 64)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(orders > 2.5), (errors, orders)
    # .05 over the curvature 2 of the wells: the longest step that the automatic choice takes there
    automatic = expectation(model, 0.2, 2.0, 80, 2, (-3.0, 3.0, 81))
    assert abs(automatic - exact) < 1e-5 * exact


def test_weak_order_for_multiplicative_noise():
    """E x and E x² obey closed linear equations, and a step carries quadratics into quadratics."""
    a, b, s2 = -1.0, 0.8, 0.09
    model = SDE(lambda x: (-x[0] + 0.8,), 1, lambda x, t: ((x[0],),), [[s2]])
    moments = expm(np.array([[0, 0, 0], [b, a, 0], [0, 2 * b, 2 * a + s2]]) * 1.5) @ [1.0, 0.5, 0.25]
    for power in (1, 2):
        found = [expectation(model, 0.5, 1.5, n, power, (0.0, 1.0, 3)) for n in (8, 16, 32)]
        errors = np.abs(np.array(found) - moments[power])
        orders = np.log2(errors[:-1] / errors[1:])
        assert np.all((orders > 1.8) & (orders < 2.6)), (errors, orders)


def bilinear():
    """Return a model with two correlated noises linear in the state, and the generator of its E[x xᵀ]."""
    A = np.array([[-1.0, 0.5], [0.2, -0.8]])
    B = [np.array([[0.5, 0.3], [0.0, 0.4]]), np.array([[0.1, -0.6], [0.5, 0.2]])]
    Q = np.array([[1.0, 0.3], [0.3, 0.7]])

    def drift(x):
        return -x[0] + 0.5 * x[1], 0.2 * x[0] - 0.8 * x[1]

    def noise(x):
        return (0.5 * x[0] + 0.3 * x[1], 0.1 * x[0] - 0.6 * x[1]), (0.4 * x[1], 0.5 * x[0] + 0.2 * x[1])

    generator = np.kron(A, np.eye(2)) + np.kron(np.eye(2), A)
    generator += sum(Q[i, j] * np.kron(B[i], B[j]) for i in range(2) for j in range(2))
    return SDE(drift, 2, noise, Q), A, generator


def test_one_step_with_two_noises_is_locally_of_third_order():
    """All moments of one step by quadrature over its normals and signs, against the exact second moments."""
    model, _, generator = bilinear()
    x0 = np.array([1.0, 0.5])
    z, w = np.polynomial.hermite_e.hermegauss(6)
    a, b, v = (g.ravel() for g in np.meshgrid(z, z, [-1.0, 1.0], indexing="ij"))
    weights = np.multiply.outer(np.multiply.outer(w, w), [0.5, 0.5]).ravel() / w.sum() ** 2
    errors = []
    for h in (0.1, 0.05, 0.025):
        x = take(model, x0, h, 1, np.stack([a, b, v], axis=1)[None].copy())
        second = np.einsum("N,Ni,Nj->ij", weights, x, x).ravel()
        errors.append(np.abs(second - expm(generator * h) @ np.kron(x0, x0)).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(orders > 2.7), (errors, orders)


@pytest.mark.slow
def test_automatic_steps_with_two_noises():
    model, A, generator = bilinear()
    x0 = np.array([1.0, 0.5])
    truth, _ = simulate(model, None, x0, [0.0, 1.0], rng=5, n_paths=200_000)
    x = truth[:, 1]
    within(x, expm(A) @ x0)
    within(x[:, :, None] * x[:, None, :], (expm(generator) @ np.kron(x0, x0)).reshape(2, 2))


def test_stratonovich_noise_follows_the_ordinary_chain_rule():
    """dx = σ x ∘ dW has x = x₀ exp(σ W): E x = x₀ exp(σ²t/2)."""
    model = SDE(lambda x: (0.0,), 1, lambda x, t: ((x[0],),), [[0.25]], interpretation="stratonovich")
    x = advance(model, np.ones((40_000, 1)), 0.0, 1.0, np.random.default_rng(8))
    within(x[:, 0], np.exp(0.125))


def test_automatic_step_is_fine_enough_where_the_start_tells_nothing():
    """At x = 0 this drift has no slope at all; the noise soon finds it."""
    model = SDE(lambda x: (-4.0 * x[0] ** 3,), 1, [[1.0]], 1.0)
    x = advance(model, np.zeros((4_000, 1)), 0.0, 2.0, np.random.default_rng(1))[:, 0]
    # stationary density exp(-2 x⁴): E x² by quadrature
    s = np.linspace(-2.5, 2.5, 20_001)
    p = np.exp(-2.0 * s**4)
    within(x**2, (s**2 * p).sum() / p.sum())


# --- the shell ---


def test_shapes():
    model, times = SDE(oscillator, 2, [[0.0], [1.0]], 0.7), [0.0, 0.0, 0.5, 1.0]
    truth, z = simulate(model, POSITION, [1.0, 0.0], times, rng=1)
    assert truth.shape == (4, 2) and z.shape == (4, 1)
    np.testing.assert_array_equal(truth[0], [1.0, 0.0])
    np.testing.assert_array_equal(truth[1], truth[0])
    assert z[0] != z[1]
    starts = np.array([[1.0, 0.0], [2.0, 0.0], [3.0, 0.0]])
    truth, z = simulate(model, POSITION, starts, times, rng=1)
    assert truth.shape == (3, 4, 2) and z.shape == (3, 4, 1)
    np.testing.assert_array_equal(truth[:, 0], starts)
    truth, z = simulate(model, None, [1.0, 0.0], times, rng=1, n_paths=1)
    assert truth.shape == (1, 4, 2) and z is None


def test_same_seed_same_bits_and_paths_differ():
    model = SDE(oscillator, 2, [[0.0], [1.0]], 0.7)
    a = simulate(model, POSITION, [1.0, 0.0], [0.0, 1.0], rng=7, n_paths=3)
    b = simulate(model, POSITION, [1.0, 0.0], [0.0, 1.0], rng=np.random.default_rng(7), n_paths=3)
    for one, other in zip(a, b, strict=True):
        np.testing.assert_array_equal(one, other)
    assert len(np.unique(a[0][:, 1, 0])) == 3


def test_black_box_gives_the_same_path():
    rows = SDE(lambda X, t: np.stack([X[:, 1], -X[:, 0] - 0.4 * X[:, 1]], axis=1), 2, [[0.0], [1.0]], 0.7,
               vectorized=True)  # fmt: skip
    a, _ = simulate(rows, None, [1.0, 0.0], [0.0, 1.0], rng=7, max_step=0.1)
    one = SDE(oscillator, 2, [[0.0], [1.0]], 0.7)
    b, _ = simulate(one, None, [1.0, 0.0], [0.0, 1.0], rng=7, max_step=0.1)
    np.testing.assert_allclose(a, b, rtol=1e-12)


def test_advance_leaves_its_input():
    x = np.ones((2, 2))
    advance(SDE(oscillator, 2, [[0.0], [1.0]]), x, 0.0, 1.0, np.random.default_rng(0), max_step=0.3)
    np.testing.assert_array_equal(x, 1.0)


def test_blow_up_is_told_with_time_state_and_remedy():
    model = SDE(lambda x: (x[0] ** 3,), 1, [[1.0]], 0.1)
    with pytest.raises(PropagationError, match=r"blew up between t=.* state 0 is .*max_step"):
        simulate(model, None, [1.0], [0.0, 1.0, 50.0], rng=1, max_step=0.1)
    with pytest.raises(PropagationError, match=r"blew up|blowing up"):
        simulate(model, None, [1.0], [0.0, 50.0], rng=1)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"x0": [1.0]}, r"x0 has shape \(1,\)"),
        ({"x0": [np.nan, 1.0]}, "x0 contains NaN"),
        ({"x0": np.ones((2, 2)), "n_paths": 3}, "x0 has 2 rows"),
        ({"n_paths": 0}, "n_paths must be"),
        ({"times": [0.0, -1.0]}, "times run backwards from 0 to -1"),
        ({"times": []}, "times is empty"),
        ({"times": [0.0, np.nan]}, "times contains NaN"),
        ({"rng": -1}, "rng must be"),
        ({"max_step": 0.0}, "max_step must be greater than zero"),
        ({"measurement": LikelihoodMeasurement(lambda z, X, t: X[:, 0])}, "cannot be simulated"),
    ],
)
def test_messages(arguments, says):
    given = {"measurement": None, "x0": [0.0, 0.0], "times": [0.0, 1.0], **arguments}
    with pytest.raises(ModelError, match=says):
        simulate(SDE(oscillator, 2, [[0.0], [1.0]]), **given)
