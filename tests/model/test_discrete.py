"""Models in discrete time: what they are made of, how they are drawn, and what is refused."""

import math
import pickle

import numpy as np
import pytest

import sphfilter as sf


def kick(x, w, t, p):
    return x[0] * math.exp(p[0] * w[0]), x[1] + t * w[1]


def kicked(X, W, t, p):
    return np.stack([X[:, 0] * np.exp(p[0] * W[:, 0]), X[:, 1] + t * W[:, 1]], axis=1)


X, W = np.array([[1.0, 2.0], [-0.5, 0.3]]), np.array([[0.4, -1.0], [1.5, 0.2]])
KICKS = {"dim": 2, "noises": 2, "parameters": {"s": 0.3}, "period": 0.5}
TEXT = ["x * exp(s*u)", "y + t*v"], ["u", "v"]


@pytest.mark.parametrize(
    "model",
    [
        sf.DiscreteModel(kick, **KICKS),
        sf.DiscreteModel(kicked, vectorized=True, **KICKS),
        sf.DiscreteModel.from_expressions(["x", "y"], TEXT[0], noises=TEXT[1], parameters={"s": 0.3}),
    ],
)
def test_a_map_of_the_noise_is_what_it_says_however_it_is_written(model):
    moved = model.transition(X, 2.0, W)
    np.testing.assert_allclose(moved, kicked(X, W, 2.0, [0.3]), rtol=1e-14)
    still = np.array([[1.0, 0.0, 0.3, 0.0], [0.0, 1.0, 0.0, 2.0]])
    np.testing.assert_allclose(model.jacobian(X[:1], 2.0)[0], still, atol=1e-8)
    again = pickle.loads(pickle.dumps(model.with_parameters(s=0.1))) if model.states[0] == "x" else model
    s = again.parameters["s"]
    np.testing.assert_array_equal(
        again.transition(X, 2.0, W), again.with_parameters(s=s).transition(X, 2.0, W)
    )
    assert not (model.linear or model.autonomous) and model.n_noise == 2


def test_noise_stands_beside_a_map_with_its_covariance_and_may_depend_on_the_state():
    Q = np.array([[0.5, 0.2], [0.2, 0.3]])
    beside = sf.DiscreteModel(lambda x: (x[0] ** 2, x[0] * x[1]), 2, covariance=Q)
    assert beside.gaussian_noise and beside.autonomous and not beside.linear
    np.testing.assert_allclose(beside.transition(X, 0.0, W), np.stack([X[:, 0] ** 2, X.prod(1)], 1) + W)
    by_state = sf.DiscreteModel(
        lambda x: (x[0], x[1]), 2, lambda x, t: ((x[1],), (t,)), [[2.0]], inputs={"u": 1.0}
    )
    moved = by_state.transition(X, 3.0, W[:, :1])
    np.testing.assert_allclose(moved, X + np.stack([X[:, 1], [3.0, 3.0]], axis=1) * W[:, :1])
    text = sf.DiscreteModel.from_expressions(["x", "y"], ["x", "y"], [["y"], ["t"]], [[2.0]])
    np.testing.assert_allclose(text.transition(X, 3.0, W[:, :1]), moved)
    assert not by_state.autonomous and text.gaussian_noise and not text.linear


def test_paths_have_the_moments_of_the_model_over_any_number_of_steps():
    F, Q = np.array([[1.0, 0.5], [-0.2, 0.8]]), np.array([[0.1, 0.05], [0.05, 0.2]])
    linear = sf.DiscreteModel.from_matrices(F, Q, B=[[0.0], [1.0]], b=[0.3, 0.0], period=0.5)
    Phi, offset, Qd = linear.with_inputs([2.0]).discretize(1.5)
    np.testing.assert_allclose(Phi, np.linalg.matrix_power(F, 3))
    np.testing.assert_allclose(Qd, Q + F @ Q @ F.T + F @ F @ Q @ F.T @ F.T)
    np.testing.assert_allclose(offset, (np.eye(2) + F + F @ F) @ [0.3, 2.0])
    plain = sf.DiscreteModel(lambda x: (x[0] + 0.5 * x[1] + 0.3, 0.8 * x[1] - 0.2 * x[0] + 2.0), 2, None, Q,
                             period=0.5)  # fmt: skip
    ends, _ = sf.simulate(plain, None, [1.0, -1.0], [0.0, 1.5], rng=4, n_paths=40_000)
    np.testing.assert_allclose(ends[:, 1].mean(axis=0), Phi @ [1.0, -1.0] + offset, atol=0.02)
    np.testing.assert_allclose(np.cov(ends[:, 1].T), Qd, atol=0.02)
    still, _ = sf.simulate(sf.DiscreteModel(lambda x: (2.0 * x[0],), 1), None, [1.0], [0.0, 3.0], rng=1)
    assert still[1, 0] == 8.0


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: sf.DiscreteModel(lambda x: (x[0],), 1, lambda x, t: ((1.0,),)), "give covariance="),
        (lambda: sf.DiscreteModel(lambda x: (x[0],), 1, covariance=np.eye(2)), r"of shape \(1, 1\)"),
        (lambda: sf.DiscreteModel(lambda x, w: (x[0],), 1, [[1.0]], noises=1), "not both"),
        (lambda: sf.DiscreteModel(lambda x: (x[0],), 1, noises=1), r"function of \(x, w, ...\)"),
        (lambda: sf.DiscreteModel(lambda x, w: (x[1],), 1, noises=1), "reads beyond"),
        (lambda: sf.DiscreteModel(lambda x: (x[0],), 1, period=0.0), "period"),
        (lambda: sf.DiscreteModel(lambda x: (x[0],), 1, domain=[("reflecting", 0, 1)]), "periodic axes only"),
        (
            lambda: sf.DiscreteModel.from_expressions(["x"], ["x"], [["1", "1"]], [[1.0]]),
            r"must be \(1, 1\): a column",
        ),
        (lambda: sf.DiscreteModel.from_expressions(["x"], ["x", "1"]), "2 expressions for 1 states"),
        (lambda: sf.DiscreteModel.from_expressions(["x"], ["x + w"]), "unknown name 'w'"),
        (lambda: sf.DiscreteModel.from_matrices([[1.0]], [[-1.0]]), "not positive semidefinite"),
        (lambda: sf.DiscreteModel(lambda x: (x[0],), 1, periods=2.0), "did you mean"),
        (lambda: sf.DiscreteModel(lambda x: (x[0],), 1).discretize(1.0), "not known to be linear"),
        (lambda: sf.DiscreteModel(lambda x: (x[0],), 1).transition([[1.0, 2.0]], 0.0), r"shape \(1, 2\)"),
    ],
)
def test_what_is_wrong_is_said(make, said):
    with pytest.raises((sf.ModelError, sf.ExpressionError, TypeError), match=said):
        make()


def test_a_path_that_leaves_the_numbers_is_named():
    model = sf.DiscreteModel(lambda x: (x[0] ** 3,), 1)
    with pytest.raises(sf.PropagationError, match="the model blew up in the step at t = 5"):
        sf.simulate(model, None, [10.0], [0.0, 9.0], rng=1)
