"""Stochastic differential equations as Stone Soup's transition models, and the way back for linear ones."""

import datetime
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp
from scipy.linalg import logm
from scipy.stats import multivariate_normal
from stonesoup.base import Property
from stonesoup.models.base import GaussianModel, LinearModel
from stonesoup.models.transition.base import TransitionModel
from stonesoup.types.array import CovarianceMatrix, StateVector, StateVectors
from stonesoup.types.numeric import Probability
from stonesoup.types.state import State

from ..._types import Floats
from ...errors import ModelError
from ...model.discrete import DiscreteModel
from ...model.discretization import exponential
from ...model.dynamics import Dynamics
from ...model.jump_markov import JumpMarkovModel
from ...model.paths import advance
from ...model.sde import LinearSDE
from ...validate import generator, short

_SAME = 1e-8  # error of a transition: Stone Soup's integrals, by scipy's `quad`, have sqrt(eps) = 1.5e-8
_FLOW_TOLERANCE = _SAME / 100  # = 1e-10, of an integrator, whose errors add up over its steps
#: Intervals τ, seconds, that a linear model is read at: its turns there have to be less than π, so that those
#: of up to π / τ = 3, 31 and 314 rad/s are read.
_READ_AT = 1.0, 0.1, 0.01
#: Those at which the equation has to agree, none a multiple of those: 0.3137 / 0.01 = 31.37. At multiples
#: that of a turn the other way round, less than π, agrees as well. Whole microseconds, as of timestamps.
_CHECKED_AT = 0.3137, 0.7071, 5.0333


class SDETransitionModel(TransitionModel):
    """A stochastic differential equation as a transition model, for Stone Soup's simulators and filters too.

    Parameters
    ----------
    sde : SDE or DiscreteModel
        One in discrete time goes over intervals of whole steps.
    epoch : datetime.datetime, optional
        Where the model's time is zero; needed if drift or noise depend on time.
    seed : int, optional
        Seed of the noise that `function` draws.

    Notes
    -----
    `function` moves states (n, N) over `time_interval` along paths whose error in distribution is far below
    that of a filter (`sphfilter.simulate`), or without noise along the drift. Covariances, `rvs` and `pdf`
    of the transition are known for linear models only.
    """

    sde: Dynamics = Property(doc="The equation, or model in discrete time.")
    epoch: datetime.datetime = Property(
        default=None, doc="Where the model's time is zero; needed if drift or noise depend on time."
    )
    seed: int = Property(default=None, doc="Seed of the noise that `function` draws.")

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        if not isinstance(self.sde, Dynamics):
            raise ModelError(f"sde must be an SDE or a DiscreteModel, got {short(self.sde)}")
        if self.epoch is None and not self.sde.autonomous:
            raise ModelError(
                "drift or noise may depend on time: give epoch=, the datetime of the model's t = 0"
            )
        self._rng = generator(self.seed)

    @property
    def ndim_state(self) -> int:
        """Number of states n."""
        return self.sde.dim

    def time_of(self, timestamp: datetime.datetime | None) -> float:
        """The model's time at a timestamp, seconds; zero for all timestamps where no time is needed."""
        if self.epoch is None:
            return 0.0
        if timestamp is None:
            raise ModelError("the model depends on time: states need a timestamp")
        return (timestamp - self.epoch).total_seconds()

    def function(
        self,
        state: State,
        noise: bool | ArrayLike | None = False,
        *,
        time_interval: datetime.timedelta,
        **kwargs: Any,
    ) -> StateVector | StateVectors:
        """States (n, N) moved over `time_interval`, with noise of their own if `noise`."""
        X = np.asarray(state.state_vector, dtype=float).T
        t, dt = self.time_of(state.timestamp), time_interval.total_seconds()
        if noise is None or isinstance(noise, bool | np.bool_):
            moved = advance(self.sde, X, t, t + dt, self._rng) if noise and dt else self._flow(X, t, dt)
        else:
            self._gaussian(dt)
            moved = self._flow(X, t, dt) + np.asarray(noise, dtype=float).T
        moved = self.sde.domain.wrap(moved)
        return moved.T.view(StateVector if len(moved) == 1 else StateVectors)

    def _flow(self, X: Floats, t: float, dt: float) -> Floats:
        """States (N, n) moved along the drift alone."""
        sde: Any = self.sde
        if sde.linear:
            Phi, offset, _ = sde.discretize(dt)
            return X @ Phi.T + offset
        if isinstance(sde, DiscreteModel):
            for start in sde.starts(t, t + dt):
                X = sde.transition(X, start)
            return X

        def rate(s: float, flat: Floats) -> Floats:
            return sde.drift(flat.reshape(X.shape), s).ravel()

        path = solve_ivp(rate, (t, t + dt), X.ravel(), rtol=_FLOW_TOLERANCE, atol=_FLOW_TOLERANCE)
        return path.y[:, -1].reshape(X.shape)

    def _gaussian(self, dt: float) -> tuple[Floats, Floats, Floats]:
        if not self.sde.linear:
            raise ModelError(
                "the transition density of this model is not Gaussian: function(noise=True) draws from it"
            )
        return self.sde.discretize(dt)

    def jacobian(self, state: State, *, time_interval: datetime.timedelta, **kwargs: Any) -> Floats:
        """Derivative (n, n) of where a state goes without noise."""
        if self.sde.linear:
            return self._gaussian(time_interval.total_seconds())[0]
        return super().jacobian(state, time_interval=time_interval, **kwargs)

    def covar(self, *, time_interval: datetime.timedelta, **kwargs: Any) -> CovarianceMatrix:
        """Covariance (n, n) of the noise over an interval, of a linear model."""
        return self._gaussian(time_interval.total_seconds())[2].view(CovarianceMatrix)

    def rvs(
        self, num_samples: int = 1, *, time_interval: datetime.timedelta, **kwargs: Any
    ) -> StateVector | StateVectors:
        """Noise (n, num_samples) of an interval, drawn of a linear model."""
        Q = self._gaussian(time_interval.total_seconds())[2]
        drawn = self._rng.multivariate_normal(np.zeros(len(Q)), Q, num_samples, method="eigh").T
        return drawn.view(StateVector if num_samples == 1 else StateVectors)

    def pdf(
        self, state1: State, state2: State, *, time_interval: datetime.timedelta, **kwargs: Any
    ) -> Probability | NDArray[Any]:
        """Density of state1 where state2 goes, of a linear model."""
        expected = self.function(state2, time_interval=time_interval)
        off = np.asarray(state1.state_vector - expected, dtype=float)
        Q = self._gaussian(time_interval.total_seconds())[2]
        log_p = np.atleast_1d(multivariate_normal.logpdf(off.T, cov=Q, allow_singular=True))
        p = Probability.from_log_ufunc(log_p)
        return p[0] if len(p) == 1 else p


def transition_of(model: SDETransitionModel | Dynamics | TransitionModel) -> SDETransitionModel:
    """A transition model as `SDETransitionModel`: as it is, from an SDE, or from a linear Gaussian model."""
    if isinstance(model, SDETransitionModel):
        return model
    if isinstance(model, JumpMarkovModel):
        raise ModelError("a JumpMarkovModel switches between modes: JumpMarkovPredictor carries them")
    return SDETransitionModel(model if isinstance(model, Dynamics) else linear_sde(model))


def switching(model: JumpMarkovModel) -> JumpMarkovModel:
    """A model that switches between modes as it is, if none of them depends on time."""
    if not isinstance(model, JumpMarkovModel):
        raise ModelError(
            f"transition_model must be a JumpMarkovModel, got {short(model)}; SPHPredictor takes others"
        )
    timed = [name for name, mode in model.modes.items() if not mode.autonomous]
    if timed:
        raise ModelError(
            f"the modes {timed} may depend on time, which JumpMarkovPredictor does not count; write them "
            f"without it, or take JumpMarkovFilter"
        )
    return model


def linear_sde(model: LinearModel) -> LinearSDE:
    """The equation dX = A X dt + g dW whose transitions are those of one of Stone Soup's linear models.

    Parameters
    ----------
    model : LinearModel and GaussianModel
        Such as ConstantVelocity, OrnsteinUhlenbeck or a combination of them.

    Returns
    -------
    LinearSDE

    Raises
    ------
    ModelError
        There is no such equation: the model is of another kind or of discrete time, or its noise is not
        white.
    """
    if not (isinstance(model, LinearModel) and isinstance(model, GaussianModel)):
        raise ModelError(
            f"transition_model must be an SDE, an SDETransitionModel or a linear Gaussian model, got a "
            f"{type(model).__name__}; write the equation behind it as SDE.from_expressions"
        )
    for tau in _READ_AT:
        sde = _read(*_transition(model, tau), tau)
        if sde is not None and all(_same(sde, model, dt) for dt in _CHECKED_AT):
            return sde
    raise ModelError(
        f"no linear equation with white noise has the transitions of this {type(model).__name__} over "
        f"{_CHECKED_AT} seconds; write the equation itself as LinearSDE(A, noise=..., spectral_density=...)"
    )


def _transition(model: LinearModel, dt: float) -> tuple[Floats, Floats]:
    step = {"time_interval": datetime.timedelta(seconds=dt)}
    return np.asarray(model.matrix(**step), dtype=float), np.asarray(model.covar(**step), dtype=float)


def _read(F: Floats, Q: Floats, tau: float) -> LinearSDE | None:
    """The equation with transition matrix F and covariance Q over tau seconds, or None.

    F = exp(A tau), and Q is linear in the intensity q of the noise: vec Q = int_0^tau exp(K s) ds vec q with
    K = A x I + I x A.
    """
    n = len(F)
    A = logm(F) / tau
    if np.iscomplexobj(A) or not np.isfinite(A).all():
        return None
    A[np.abs(A) < 1e-12 * np.abs(A).max(initial=0.0)] = 0.0
    K = np.kron(A, np.eye(n)) + np.kron(np.eye(n), A)
    zero, one = np.zeros_like(K), np.eye(n * n)
    integral = exponential(np.block([[K, one], [zero, zero]]) * tau)[: n * n, n * n :]
    q = np.linalg.solve(integral, Q.ravel()).reshape(n, n)
    q[np.abs(q) < 1e-12 * np.abs(q).max(initial=0.0)] = 0.0
    values, vectors = np.linalg.eigh(0.5 * (q + q.T))
    if values[0] < -_SAME * values[-1]:
        return None
    kept = values > _SAME * values[-1]
    return LinearSDE(A, noise=vectors[:, kept] * np.sqrt(values[kept])) if kept.any() else None


def _same(sde: LinearSDE, model: LinearModel, dt: float) -> bool:
    """Whether the transitions over dt agree, in the units of their own noise."""
    F, Q = _transition(model, dt)
    Phi, _, Qd = sde.discretize(dt)
    scale = np.sqrt(np.diag(Q))
    unit = np.outer(scale, scale)
    return np.allclose(Phi, F, rtol=_SAME, atol=_SAME) and bool(np.all(np.abs(Qd - Q) <= _SAME * unit))
