"""Models: the three ways of writing one agree, derived quantities are right, bad input is named."""

import pickle
from functools import cache

import numpy as np
import pytest
from numba import njit
from scipy.integrate import quad_vec
from scipy.linalg import expm, solve_continuous_lyapunov

from sphfilter.errors import ModelError
from sphfilter.model.discretization import exponential
from sphfilter.model.measurements import GaussianMeasurement
from sphfilter.model.sde import SDE, LinearSDE

Q = np.array([[1.0, 0.3], [0.3, 2.0]])
X = np.random.default_rng(5).uniform(0.2, 1.5, (6, 2))


def duffing(x, t):
    return x[1], -0.4 * x[1] - x[0] * (-1.0 + 0.1 * x[0] ** 2)


def duffing_rows(X, t):
    return np.stack([X[:, 1], -0.4 * X[:, 1] - X[:, 0] * (-1.0 + 0.1 * X[:, 0] ** 2)], axis=1)


def only_raises(x, t):
    raise NotImplementedError


def three_forms():
    text = SDE.from_expressions(
        ["x", "v"], ["v", "-c*v - x*(g + e*x**2)"], [["0"], ["1"]], [[1.6]], {"c": 0.4, "g": -1.0, "e": 0.1}
    )
    noise = {"noise": [[0.0], [1.0]], "spectral_density": [[1.6]]}
    return [SDE(duffing, 2, **noise), SDE(duffing_rows, 2, vectorized=True, **noise), text]


def test_function_rows_and_text_agree():
    for model in three_forms():
        np.testing.assert_allclose(model.drift(X, 0.0), duffing_rows(X, 0.0), rtol=1e-14)
        np.testing.assert_allclose(model.noise(X, 0.0), np.tile([[0.0], [1.0]], (6, 1, 1)))
        np.testing.assert_allclose(model.diffusion(X, 0.0), np.tile(np.diag([0.0, 0.8]), (6, 1, 1)))
        np.testing.assert_array_equal(model.diffusion_divergence(X, 0.0), 0.0)
        np.testing.assert_allclose(model.divergence(X, 0.0), -0.4, rtol=1e-9)
        x = X[0, 0]
        np.testing.assert_allclose(model.jacobian(X[0], 0.0), [[0, 1], [1 - 0.3 * x**2, -0.4]], atol=1e-9)
        assert (model.dim, model.n_noise) == (2, 1)
        assert model.constant_diffusion and model.autonomous
        assert not model.linear and not model.state_dependent_noise
        np.testing.assert_array_equal(model.diffusion_rows, [False, True])


def test_states_of_one_dimension_may_return_a_number():
    model = SDE(lambda x: -(x[0] ** 3), 1, [[1.0]], 2.0)
    np.testing.assert_allclose(model.drift([[2.0]], 0.0), [[-8.0]])
    np.testing.assert_allclose(model.diffusion([[2.0]], 0.0), [[[1.0]]])


def test_arrays_integers_and_compiled_functions_are_accepted():
    as_array = SDE(lambda x, t: np.array([x[1], -x[0]]), 2)
    compiled = SDE(njit(lambda x, t: (x[1], -x[0])), 2)
    whole = SDE(lambda x, t: (1, 2), 2)
    np.testing.assert_allclose(as_array.drift(X, 0.0), compiled.drift(X, 0.0))
    np.testing.assert_allclose(whole.drift(X, 0.0), np.tile([1.0, 2.0], (6, 1)))


def test_parameters_are_data():
    def f(x, t, p):
        return x[1], -p[0] * x[1] - p[1] * x[0]

    model = SDE(f, 2, [[0], [1]], parameters={"c": 0.4, "k": 2.0})
    other = model.with_parameters(k=3.0)
    assert other.drift_batch is model.drift_batch
    assert dict(model.parameters) == {"c": 0.4, "k": 2.0} and dict(other.parameters) == {"c": 0.4, "k": 3.0}
    np.testing.assert_allclose(other.drift([[1.0, 0.5]], 0.0), [[0.5, -0.2 - 3.0]])
    np.testing.assert_allclose(model.drift([[1.0, 0.5]], 0.0), [[0.5, -0.2 - 2.0]])
    with pytest.raises(TypeError):
        model.parameters["c"] = 1.0
    with pytest.raises(ModelError, match=r"no parameter 'kk' \(did you mean 'k'"):
        model.with_parameters(kk=1.0)
    with pytest.raises(ModelError, match="one finite number"):
        model.with_parameters(k=np.nan)


def test_a_function_sees_its_own_parameters_only():
    def polynomial(x, t, p):
        s = 0.0
        for k in range(p.size):
            s += p[k] * x[0] ** k
        return (s,)

    model = SDE(polynomial, 1, [[1.0]], parameters={"a": 1.0, "b": 2.0, "c": 3.0})
    np.testing.assert_allclose(model.drift([[2.0]], 0.0), [[17.0]])


def test_noise_parameters_of_text():
    model = SDE.from_expressions(["x", "v"], ["v", "-x"], [["0"], ["s"]], [[2.0]], {"s": 1.0})
    louder = model.with_parameters(s=3.0)
    assert louder.diffusion_batch is model.diffusion_batch
    np.testing.assert_allclose(louder.diffusion(X[:1], 0.0)[0], [[0, 0], [0, 9.0]])
    assert not louder.with_parameters(s=0.0).diffusion_rows.any()


def f(x, t):
    return -x[0], x[0] * x[1]


def g(x, t):
    return (x[0], 0.1 * t), (np.sin(x[1]), x[0] * x[1])


def f_rows(X, t):
    return np.stack([-X[:, 0], X[:, 0] * X[:, 1]], axis=1)


def g_rows(X, t):
    return np.array([g(x, t) for x in X])


@cache
def multiplicative(interpretation):
    """Return one model with full, state-dependent noise as a function, as rows and as text."""
    texts = ["-x", "x*y"], [["x", "0.1*t"], ["sin(y)", "x*y"]]
    return [
        SDE(f, 2, g, Q, interpretation=interpretation),
        SDE(f_rows, 2, g_rows, Q, vectorized=True, interpretation=interpretation),
        SDE.from_expressions(["x", "y"], *texts, Q, interpretation=interpretation),
    ]


def test_stratonovich_term_and_divergence_of_diffusion():
    t = 0.7
    x, y = X.T
    g = np.array([[x, 0.1 * t + 0 * x], [np.sin(y), x * y]])  # g_ij
    zero, one = 0 * x, 1 + 0 * x
    dg = np.array([[[one, zero], [zero, y]], [[zero, zero], [np.cos(y), x]]])  # ∂_j g_il, first index j
    term = 0.5 * np.einsum("jkN,kl,jilN->Ni", g, Q, dg)
    divergence = 0.5 * (np.einsum("jikN,kl,jlN->Ni", dg, Q, g) + np.einsum("ikN,kl,jjlN->Ni", g, Q, dg))
    D = 0.5 * np.einsum("ikN,kl,jlN->Nij", g, Q, g)
    for ito, stratonovich in zip(multiplicative("ito"), multiplicative("stratonovich"), strict=True):
        np.testing.assert_allclose(stratonovich.drift(X, t) - ito.drift(X, t), term, rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(ito.diffusion(X, t), D, rtol=1e-13)
        np.testing.assert_allclose(ito.diffusion_divergence(X, t), divergence, rtol=1e-8, atol=1e-9)
        assert ito.state_dependent_noise and not ito.constant_diffusion and not ito.autonomous
        assert ito.diffusion_rows.all()
    a, _, b = multiplicative("stratonovich")
    np.testing.assert_allclose(a.divergence(X, t), b.divergence(X, t), rtol=1e-4, atol=1e-4)


def test_stratonovich_of_additive_noise_is_ito():
    for noise in ([[0.0], [1.0]], lambda x, t: ((0.0,), (1.0 + t,))):
        model = SDE(duffing, 2, noise, [[1.0]], interpretation="stratonovich")
        np.testing.assert_array_equal(model.drift(X, 0.0), duffing_rows(X, 0.0))


def test_time_dependent_noise():
    model = SDE(lambda x: (x[1], -x[0]), 2, lambda x, t: ((0.0,), (np.cos(t),)), [[2.0]])
    text = SDE.from_expressions(["x", "v"], ["v", "-x"], [["0"], ["cos(t)"]], [[2.0]])
    for m in (model, text):
        assert not (m.autonomous or m.constant_diffusion or m.state_dependent_noise or m.linear)
        np.testing.assert_allclose(m.diffusion(X, 1.0)[:, 1, 1], np.cos(1.0) ** 2)
        np.testing.assert_array_equal(m.diffusion_divergence(X, 1.0), 0.0)
    np.testing.assert_array_equal(text.diffusion_rows, [False, True])


def test_diffusion_itself():
    D = np.array([[0.0, 0.0, 0.0], [0.0, 2.0, 0.5], [0.0, 0.5, 1.0]])
    constant = SDE(lambda x: (x[0], x[1], x[2]), 3, diffusion=D)
    np.testing.assert_allclose(constant.diffusion(np.ones((1, 3)), 0.0)[0], D, atol=1e-15)
    np.testing.assert_array_equal(constant.diffusion_rows, [False, True, True])
    assert constant.n_noise == 2
    varying = [
        SDE(lambda x: (-x[0], -x[1]), 2, diffusion=lambda x, t: ((1 + x[0] ** 2, 0.1), (0.1, x[0] * x[1]))),
        SDE.from_expressions(["x", "y"], ["-x", "-y"], diffusion=[["1 + x**2", 0.1], [0.1, "x*y"]]),
    ]
    for model in varying:
        g = model.noise(X, 0.0)
        D = model.diffusion(X, 0.0)
        np.testing.assert_allclose(D[:, 0, 0], 1 + X[:, 0] ** 2)
        ok = np.linalg.eigvalsh(D).min(axis=1) > 0
        np.testing.assert_allclose((g @ g.transpose(0, 2, 1) / 2)[ok], D[ok], rtol=1e-12)
        expected = np.stack([2 * X[:, 0], X[:, 0]], axis=1)
        np.testing.assert_allclose(model.diffusion_divergence(X, 0.0), expected, rtol=1e-8, atol=1e-9)


def test_no_noise_is_pure_transport():
    for model in (SDE(duffing, 2), SDE.from_expressions(["x"], ["-x"]), LinearSDE([[1.0]])):
        assert not model.diffusion_rows.any() and model.constant_diffusion


def test_given_divergence_is_used():
    model = SDE(duffing, 2, divergence=lambda x, t: -0.4 + 7 * t)
    np.testing.assert_allclose(model.divergence(X, 1.0), 6.6)


def test_flags_of_functions_are_safe():
    def hidden(x, t):
        def inner():
            return t

        return (inner() * x[0],)

    assert not SDE(hidden, 1).autonomous
    assert not SDE(lambda x, t: (t * x[0],), 1).autonomous
    assert SDE(lambda x: (x[0],), 1).autonomous
    assert not SDE(lambda x, t: (-x[0],), 1).linear  # not provable: LinearSDE or text says it


@pytest.mark.parametrize(
    ("drift", "noise", "linear"),
    [
        (["v", "-k*x - 0.2*v + 3"], [["0"], ["k"]], True),
        (["v", "(x + 1)**2 - x**2"], [["0"], ["1"]], True),
        (["v", "-x + t"], [["0"], ["1"]], False),
        (["v", "-t*x"], [["0"], ["1"]], False),
        (["v", "-x"], [["0"], ["x"]], False),
        (["v", "-x"], [["0"], ["t"]], False),
        (["v", "-sign(x)"], [["0"], ["1"]], False),
        (["v", "-abs(x)"], [["0"], ["1"]], False),
        (["v", "-x**3"], [["0"], ["1"]], False),
    ],
)
def test_linear_text(drift, noise, linear):
    used = {"k": 1.5} if "k" in str(drift) else None
    model = SDE.from_expressions(["x", "v"], drift, noise, [[2.0]], used)
    assert model.linear is linear
    if linear:
        same = model.to_linear()
        np.testing.assert_allclose(same.drift(X, 0.0), model.drift(X, 0.0), atol=1e-12)
        np.testing.assert_allclose(same.diffusion(X, 0.0), model.diffusion(X, 0.0))
    else:
        with pytest.raises(ModelError, match="not known to be linear"):
            model.to_linear()


# --- linear models ---


def linear_model():
    A = [[0.0, 1.0, 0.0], [-4.0, -0.3, 0.5], [0.1, 0.0, -1.0]]
    return LinearSDE(A, [0.5, 0.0, -1.0], [[0, 0], [1, 0], [0.2, 1]], Q)


def test_linear_functions():
    model = linear_model()
    Y = np.random.default_rng(1).normal(size=(4, 3))
    np.testing.assert_allclose(model.drift(Y, 0.0), Y @ model.A.T + model.b)
    np.testing.assert_allclose(model.jacobian(Y[0], 0.0), model.A)
    np.testing.assert_allclose(model.divergence(Y, 0.0), np.trace(model.A))
    assert model.linear and model.to_linear() is model


@pytest.mark.parametrize("dt", [1e-3, 0.5, 7.0])
def test_discretize_against_quadrature(dt):
    model = linear_model()
    Phi, offset, Qd = model.discretize(dt)
    g = model.noise(np.zeros((1, 3)), 0.0)[0]
    S = g @ Q @ g.T
    integral = quad_vec(lambda s: expm(model.A * s) @ S @ expm(model.A.T * s), 0, dt, epsabs=1e-12)[0]
    drift = quad_vec(lambda s: expm(model.A * s) @ model.b, 0, dt, epsabs=1e-12)[0]
    np.testing.assert_allclose(Phi, expm(model.A * dt), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(Qd, integral, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(offset, drift, rtol=1e-8, atol=1e-12)


def test_discretize_limits():
    stiff = LinearSDE([[-1000.0, 3.0], [0.0, -1.0]], noise=np.eye(2), spectral_density=Q)
    _, _, Qd = stiff.discretize(50.0)
    np.testing.assert_allclose(Qd, solve_continuous_lyapunov(stiff.A, -Q), rtol=1e-9)
    brownian = LinearSDE(np.zeros((2, 2)), [1.0, 2.0], np.eye(2), Q)
    Phi, offset, Qd = brownian.discretize(3.0)
    np.testing.assert_allclose(Phi, np.eye(2))
    np.testing.assert_allclose(offset, [3.0, 6.0])
    np.testing.assert_allclose(Qd, 3 * Q)
    Phi, offset, Qd = linear_model().discretize(0.0)
    np.testing.assert_array_equal(Phi, np.eye(3))
    assert not offset.any() and not Qd.any()
    with pytest.raises(ModelError, match="negative"):
        brownian.discretize(-1.0)


# --- messages ---


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: SDE(lambda x, t: (x[0],), 2), r"drift returns 1 value\(s\), but 2 are needed"),
        (lambda: SDE(lambda x, t: x[0], 2), r"drift returns 1 value\(s\), but 2 are needed"),
        (lambda: SDE(lambda x, t: np.array([x[0]]), 2), "drift returns 1 value"),
        (lambda: SDE(lambda x, t: (x[0], x[2]), 2), r"reads beyond the state \(dim=2\)"),
        (lambda: SDE(lambda x, t, p: (x[0], p[0]), 2), r"the parameters \(0 given\)"),
        (lambda: SDE(lambda x, t: {1: x[0]}, 2), "must return a tuple of 2 numbers"),
        (lambda: SDE(lambda x, t: ("a", "b"), 2), "plain numbers"),
        (lambda: SDE(lambda x, t: (np.linalg.nothing(x), 1.0), 2), "vectorized=True"),
        (lambda: SDE(lambda a, b, c, d: (a, b), 2), "takes 4 arguments"),
        (lambda: SDE("x", 2), "must be a function"),
        (lambda: SDE(lambda X, t: X.T, 2, vectorized=True), "returned an array 2 × 3 for 3 states"),
        (lambda: SDE(duffing, 0), "dim must be a whole number"),
        (lambda: SDE(duffing, 2, [[0.0], [np.nan]]), "NaN"),
        (lambda: SDE(duffing, 2, [[0.0], [1.0], [0.0]]), r"noise has shape \(3, 1\)"),
        (lambda: SDE(duffing, 2, [0.0, 1.0]), r"noise has shape \(2,\)"),
        (lambda: SDE(lambda x: (x[0], x[1], x[2]), 3, [[0.0], [1.0]]), "a row for each of dim = 3 states"),
        (lambda: SDE(duffing, 2, [[0.0], [1.0]], [1.0, 2.0]), r"np\.diag\(spectral_density\)"),
        (lambda: SDE(only_raises, 2), "drift returns nothing: it raises"),
        (lambda: SDE(duffing_rows, 2), "pass vectorized=True for a numpy function of all states"),
        (lambda: SDE(duffing, 2, [["a"], [1]]), "must be numbers"),
        (lambda: SDE(duffing, 2, [[0.0], [1.0]], np.eye(2)), r"must be of shape \(1, 1\)"),
        (lambda: SDE(duffing, 2, [[0.0], [1.0]], [[-1.0]]), "not positive semidefinite"),
        (lambda: SDE(duffing, 2, np.eye(2), [[1, 2], [2, 1]]), "not positive semidefinite"),
        (lambda: SDE(duffing, 2, np.eye(2), [[1, 0.5], [0, 1]]), "not symmetric"),
        (lambda: SDE(duffing, 2, None, [[1.0]]), "without noise="),
        (lambda: SDE(duffing, 2, [[0], [1]], diffusion=np.eye(2)), "not both"),
        (lambda: SDE(duffing, 2, diffusion=-np.eye(2)), "not positive semidefinite"),
        (
            lambda: SDE.from_expressions(["x"], ["-x"], [["sqrt(q)"]], None, {"q": -1.0}),
            "not positive semidefi",
        ),
        (lambda: SDE(duffing, 2, diffusion=lambda x, t: ((-1.0, 0.0), (0.0, 1.0))), "not positive"),
        (lambda: SDE(duffing, 2, lambda x, t: ((0.0,), (x[0],))), "give spectral_density="),
        (lambda: SDE(duffing, 2, lambda x, t: (0.0, x[0]), 1.0), r"2 value\(s\), but 2 × 1"),
        (lambda: SDE(duffing, 2, interpretation="itoo"), "did you mean 'ito'"),
        (lambda: SDE(duffing, 2, parameters={"c": "a"}), "parameter c must be one finite number"),
        (
            lambda: SDE(
                lambda x: -x[0], 1, diffusion=lambda x, t: 1 + x[0] ** 2, interpretation="stratonovich"
            ),
            "noise= instead",
        ),
        (lambda: SDE.from_expressions(["x", "v"], ["v"]), "1 expressions, but there are 2 states"),
        (lambda: SDE.from_expressions("x", "x"), "lists of text"),
        (lambda: SDE.from_expressions(["x"], ["x"], ["1"]), "rows"),
        (lambda: SDE.from_expressions(["x"], ["x"], [["1"]], np.eye(2)), r"shape \(1, 1\)"),
        (lambda: SDE.from_expressions(["x"], ["x"], diffusion=[[-1]]), "not positive"),
        (lambda: SDE.from_expressions(["x", "y"], ["x", "y"], diffusion=[["x", "y"], ["x", 1]]), "symmetric"),
        (lambda: LinearSDE([[1.0, 2.0]]), "must be square"),
        (lambda: LinearSDE(np.eye(2), [1.0]), "b has shape"),
        (lambda: LinearSDE([[np.inf]]), "NaN or infinity"),
        (lambda: LinearSDE([[1.0]], noise=lambda x: ((1.0,),)), "constant matrix"),
        (lambda: linear_model().drift(np.ones((2, 2)), 0.0), r"needs \(N, 3\)"),
        (lambda: linear_model().with_parameters(k=1.0), "it has: none"),
    ],
)
def test_messages(make, says):
    with pytest.raises(ModelError, match=says):
        make()


def test_error_inside_a_vectorised_function_reaches_the_caller():
    def fails(X, t):
        if t > 1.0:
            raise RuntimeError("outside the table")
        return -X

    model = SDE(fails, 2, vectorized=True)
    model.drift(X, 0.0)
    with pytest.raises(RuntimeError, match="outside the table"):
        model.drift(X, 2.0)


def test_a_function_undefined_at_the_probe_is_no_error():
    def picky(x, t):
        if x[0] < 5.0:
            raise ValueError("x is small")
        return (-x[0],)

    assert SDE(picky, 1).drift([[6.0]], 0.0)[0, 0] == -6.0


def test_pickling():
    models = [*three_forms(), SDE(f, 2, g, Q, interpretation="stratonovich"), linear_model()]
    models[2] = models[2].with_parameters(c=0.9)
    for model in models:
        copy = pickle.loads(pickle.dumps(model))
        Y = np.random.default_rng(0).uniform(0.2, 1, (3, model.dim))
        np.testing.assert_array_equal(copy.drift(Y, 0.3), model.drift(Y, 0.3))
        np.testing.assert_array_equal(copy.diffusion(Y, 0.3), model.diffusion(Y, 0.3))
        assert dict(copy.parameters) == dict(model.parameters) and copy.states == model.states


@pytest.mark.parametrize(
    ("made", "meant"),
    [
        (lambda: SDE.from_expressions(["x"], ["-x"], noises=[["1"]]), "'noise'"),
        (lambda: SDE(lambda x, t: (-x[0],), dim=1, paramters={}), "'parameters'"),
        (lambda: LinearSDE([[0.0]], nois=[[1.0]]), "'noise'"),
        (lambda: GaussianMeasurement([[1.0]], noise_cv=[[1.0]]), "'noise_cov'"),
        (lambda: GaussianMeasurement.from_expressions(["x"], ["x"], [[1.0]], angels=[0]), "'angles'"),
    ],
)
def test_a_mistyped_keyword_names_the_nearest(made, meant):
    with pytest.raises(TypeError, match=rf"has no argument '.*' \(did you mean {meant}\?\)"):
        made()


@pytest.mark.parametrize("scale", [1e-9, 0.3, 5.0, 300.0])
def test_exponentials_are_those_of_scipy(scale):
    rng = np.random.default_rng(3)
    for n in (1, 2, 4, 8):
        stable = rng.normal(size=(n, n)) - 3.0 * np.sqrt(n) * np.eye(n)
        for X in (stable * scale, np.diag(np.full(n - 1, scale), 1), np.zeros((n, n))):
            np.testing.assert_allclose(exponential(X), expm(X), rtol=1e-10, atol=1e-13 * max(1.0, scale))
