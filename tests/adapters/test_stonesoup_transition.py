"""Equations as Stone Soup's transition models, and its linear models as equations."""

import datetime

import numpy as np
import pytest
from stonesoup_cases import START, duffing, gaussian

import sphfilter as sf

pytest.importorskip("stonesoup")

from scipy.linalg import expm
from scipy.stats import multivariate_normal
from stonesoup.base import Property
from stonesoup.models.base import GaussianModel, LinearModel
from stonesoup.models.transition.base import TransitionModel
from stonesoup.models.transition.linear import (
    CombinedLinearGaussianTransitionModel,
    ConstantAcceleration,
    ConstantVelocity,
    KnownTurnRate,
    LinearGaussianTimeInvariantTransitionModel,
    NthDerivativeDecay,
    OrnsteinUhlenbeck,
    RandomWalk,
    Singer,
)
from stonesoup.models.transition.nonlinear import ConstantTurn
from stonesoup.predictor.kalman import ExtendedKalmanPredictor
from stonesoup.types.array import StateVectors
from stonesoup.types.state import State

from sphfilter.adapters.stonesoup import SDETransitionModel, linear_sde

LONG = datetime.timedelta(seconds=2.3)


@pytest.mark.parametrize(
    "model",
    [
        RandomWalk(0.3),
        ConstantVelocity(0.3),
        ConstantAcceleration(1e-3),
        OrnsteinUhlenbeck(0.1, 0.5),
        Singer(0.1, 0.4),
        NthDerivativeDecay(3, 0.2, 0.1),
        CombinedLinearGaussianTransitionModel([ConstantVelocity(0.3), Singer(1e-3, 2.0), RandomWalk(5.0)]),
    ],
    ids=lambda model: type(model).__name__,
)
def test_linear_models_become_their_equation(model):
    sde = linear_sde(model)
    Phi, offset, Q = sde.discretize(LONG.total_seconds())
    np.testing.assert_allclose(Phi, model.matrix(time_interval=LONG), atol=1e-9)
    expected = np.asarray(model.covar(time_interval=LONG), dtype=float)
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(Q / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-8)
    assert not offset.any()


class Turning(LinearModel, GaussianModel, TransitionModel):
    """The transitions of a linear equation, as a model of Stone Soup's."""

    sde: sf.LinearSDE = Property()
    ndim_state = 2

    def matrix(self, time_interval, **kwargs):
        return self.sde.discretize(time_interval.total_seconds())[0]

    def covar(self, time_interval, **kwargs):
        return self.sde.discretize(time_interval.total_seconds())[2]


def test_turns_are_read_the_right_way_round():
    """More than half a turn in an interval looks like a slower one, which agrees at all of its multiples."""
    for rate in (2.0, 20.0, 32.0, 300.0):
        sde = sf.LinearSDE([[0.0, 1.0], [-(rate**2), -0.4]], noise=[[0.0], [1.0]])
        np.testing.assert_allclose(linear_sde(Turning(sde)).A, sde.A, rtol=1e-6, atol=1e-6 * rate)
    with pytest.raises(sf.ModelError, match="no linear equation"):
        linear_sde(Turning(sf.LinearSDE([[0.0, 1.0], [-(320.0**2), -0.4]], noise=[[0.0], [1.0]])))


def test_models_that_no_equation_has_are_refused():
    discrete = LinearGaussianTimeInvariantTransitionModel(
        transition_matrix=np.eye(2), covariance_matrix=np.eye(2)
    )
    turning = KnownTurnRate([0.1, 0.1], 0.3)  # whose covariance is that of no turn
    for model, sentence in (
        (discrete, "no linear equation"),
        (turning, "no linear equation"),
        (ConstantTurn([0.1, 0.1], 0.1), "from_expressions"),
        (lambda x: x, "from_expressions"),
    ):
        with pytest.raises(sf.ModelError, match=sentence):
            linear_sde(model)


def test_a_linear_equation_is_a_gaussian_transition_model():
    """Moments of what is drawn, densities, Jacobian, and Stone Soup's extended Kalman predictor on it."""
    A, g, Q = np.array([[0.0, 1.0], [-1.0, -0.4]]), np.array([[0.0], [1.0]]), np.array([[0.7]])
    model = SDETransitionModel(sf.LinearSDE(A, noise=g, spectral_density=Q), seed=2)
    dt = LONG.total_seconds()
    Phi, steps = expm(A * dt), np.linspace(0, dt, 4001)
    flow = np.array([expm(A * s) @ g for s in steps])[:, :, 0]
    covar = np.trapezoid(0.7 * flow[:, :, None] * flow[:, None, :], steps, axis=0)
    np.testing.assert_allclose(model.covar(time_interval=LONG), covar, atol=1e-6)
    state = State([1.0, -0.5], START)
    np.testing.assert_allclose(model.jacobian(state, time_interval=LONG), Phi, atol=1e-10)
    many = State(StateVectors(np.tile([[1.0], [-0.5]], 40_000)), START)
    drawn = np.asarray(model.function(many, noise=True, time_interval=LONG))
    np.testing.assert_allclose(drawn.mean(axis=1), Phi @ [1.0, -0.5], atol=0.015)
    np.testing.assert_allclose(np.cov(drawn), covar, atol=0.015)
    np.testing.assert_allclose(np.cov(model.rvs(40_000, time_interval=LONG)), covar, atol=0.015)
    place = State([0.2, 0.1], START)
    expected = multivariate_normal.pdf([0.2, 0.1], Phi @ [1.0, -0.5], covar)
    assert float(model.pdf(place, state, time_interval=LONG)) == pytest.approx(expected, rel=1e-4)
    moved = ExtendedKalmanPredictor(model).predict(gaussian(), START + LONG)
    np.testing.assert_allclose(moved.covar, Phi @ np.diag([0.2, 1.0]) @ Phi.T + covar, atol=1e-5)


def test_a_nonlinear_equation_draws_paths():
    """Geometric growth, whose moments are known; without noise the flow of the drift."""
    growth = sf.SDE.from_expressions(["x"], ["0.3*x"], noise=[["0.2*x"]])
    model = SDETransitionModel(growth, seed=4)
    many = State(StateVectors(np.full((1, 10_000), 2.0)), START)
    drawn = np.asarray(model.function(many, noise=True, time_interval=LONG), dtype=float)
    mean = 2.0 * np.exp(0.3 * LONG.total_seconds())
    assert drawn.mean() == pytest.approx(mean, rel=0.02)
    assert drawn.var() == pytest.approx(mean**2 * np.expm1(0.04 * LONG.total_seconds()), rel=0.08)
    still = model.function(State([2.0], START), time_interval=LONG)
    assert float(still[0]) == pytest.approx(mean, rel=1e-8)
    assert float(model.jacobian(State([2.0], START), time_interval=LONG)[0, 0]) == pytest.approx(
        mean / 2, rel=1e-3
    )
    with pytest.raises(sf.ModelError, match="not Gaussian"):
        model.covar(time_interval=LONG)


def test_seeds_and_refusals():
    drawn = [
        SDETransitionModel(duffing(), seed=s).function(State([1.0, 0.0], START), True, time_interval=LONG)
        for s in (1, 1, 2)
    ]
    np.testing.assert_array_equal(drawn[0], drawn[1])
    assert (drawn[0] != drawn[2]).all()
    with pytest.raises(sf.ModelError, match="an SDE or a DiscreteModel"):
        SDETransitionModel("x")
