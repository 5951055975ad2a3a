"""States of a Stone Soup track that carry a density."""

import datetime
from dataclasses import replace
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import numpy as np
from stonesoup.base import Property, clearable_cached_property
from stonesoup.types.array import CovarianceMatrix, StateVector, StateVectors
from stonesoup.types.base import Type
from stonesoup.types.prediction import Prediction
from stonesoup.types.state import ParticleState, State, StateMutableSequence
from stonesoup.types.update import Update

from ..._types import Floats, Seed
from ...config import FilterConfig
from ...density.initialize import Gaussian, initialize
from ...density.particle_density import ParticleDensity
from ...errors import ModelError
from ...info import PredictInfo, UpdateInfo
from ...model.domain import Domain
from ...validate import count, covariance, generator, short

__all__ = ["DensityState", "SPHState", "SPHStatePrediction", "SPHStateUpdate", "Step", "current", "origin_of",
           "retimed", "started"]  # fmt: skip


class DensityState(Type):
    """What states have in common that are known by densities: they have a density and its moments."""

    from_state = staticmethod(State.from_state)
    _known_by: str  # name of the property that filters carry on: one density, or those of all modes

    @property
    def _carried(self) -> Any:
        return getattr(self, self._known_by)

    @property
    def _moments(self) -> tuple[Floats, Floats]:
        """Mean (n,) and covariance (n, n)."""
        raise NotImplementedError

    def _alone(self) -> State:
        """The state without what it came from."""
        plain = next(kind for kind in type(self).__mro__ if not issubclass(kind, Prediction | Update))
        return State.from_state(self, target_type=plain)

    @property
    def state_vector(self) -> StateVector:
        """The mean, over all modes if there are several, shape (n, 1)."""
        return _frozen(self._moments[0][:, None]).view(StateVector)

    @property
    def covar(self) -> CovarianceMatrix:
        """The covariance, over all modes if there are several, shape (n, n)."""
        return _frozen(self._moments[1]).view(CovarianceMatrix)

    @property
    def mean(self) -> StateVector:
        """The mean, shape (n, 1)."""
        return self.state_vector

    @property
    def ndim(self) -> int:
        """Number of states n."""
        return len(self.state_vector)

    def to_particle_state(self, n_particles: int, rng: Seed = None) -> ParticleState:
        """Draw equally weighted particles from the density.

        Parameters
        ----------
        n_particles : int
        rng : numpy Generator or seed, optional

        Returns
        -------
        stonesoup.types.state.ParticleState
        """
        n_particles = count("n_particles", n_particles)
        X = self.density.sample(n_particles, generator(rng))
        log_weight = np.full(n_particles, -np.log(n_particles))
        return ParticleState(StateVectors(X.T), log_weight=log_weight, timestamp=self.timestamp)

    def __reduce_ex__(self, protocol: Any) -> Any:
        """A prediction in a file has the density of its prior, not what that came from."""
        made, arguments, values, *rest = super().__reduce_ex__(protocol)
        prior = getattr(self, "prior", None)
        if isinstance(prior, DensityState) and isinstance(prior, Update):
            values = values | {"_property_prior": prior._alone()}
        return (made, arguments, values, *rest)

    def __copy__(self) -> "DensityState":
        other = type(self).__new__(type(self))
        other.__dict__.update(self.__dict__)
        return other


State.register(DensityState)  # as Stone Soup registers its own states whose vector is computed


class SPHState(DensityState):
    """A state known by its probability density.

    Parameters
    ----------
    density : ParticleDensity
    timestamp : datetime.datetime, optional
        What counts is the timestamp: `density.t` is set from it where a model depends on time.

    Attributes
    ----------
    state_vector, mean : StateVector, shape (n, 1)
        The mean; read-only.
    covar : CovarianceMatrix, shape (n, n)
    ndim : int

    Raises
    ------
    ModelError
        The density is no ParticleDensity.
    """

    _known_by = "density"
    density: ParticleDensity = Property(doc="Probability density of the state.")
    timestamp: datetime.datetime = Property(default=None, doc="Timestamp of the state. Default None.")

    @density.setter  # type: ignore[no-redef, attr-defined]  # Stone Soup makes a property of it
    def density(self, value: ParticleDensity) -> None:
        if not isinstance(value, ParticleDensity):
            raise ModelError(
                f"an SPHState takes a ParticleDensity such as sf.initialize makes, got {short(value)}"
            )
        self._property_density = value

    @clearable_cached_property("density")
    def _moments(self) -> tuple[Floats, Floats]:
        """Mean (n,) and covariance (n, n)."""
        return self.density.mean(), self.density.cov()


class SPHStatePrediction(Prediction, SPHState):
    """A predicted density; `info` says how it was carried (`PredictInfo`)."""

    info: PredictInfo = Property(default=None, doc="What the prediction did.")


class SPHStateUpdate(Update, SPHState):
    """A posterior density; `info` says what was done with the detection (`UpdateInfo`).

    After one detection `info.log_evidence` is the logarithm of its predicted density. After an association of
    several detections it is the logarithm of the integral of a posterior whose weights were given: zero but
    for the probability that the lattice does not resolve.
    """

    info: UpdateInfo = Property(default=None, doc="What the update did.")


def current(state: State | StateMutableSequence) -> State:
    """The last state of a track, or the state itself."""
    if isinstance(state, StateMutableSequence) and not isinstance(state, State):
        return state.state
    return state


def started(
    state: State, n_particles: int | Literal["auto"], config: FilterConfig, domain: Domain | None = None
) -> SPHState:
    """The state by its density, that of a Gaussian on particles: a Gaussian always on the same ones."""
    if isinstance(state, SPHState):
        return state
    if isinstance(state, DensityState):
        raise ModelError(
            f"a {type(state).__name__} has a density for every mode, which JumpMarkovPredictor and "
            f"JumpMarkovUpdater carry; take these, or SPHState(state.density, state.timestamp) for one model"
        )
    if isinstance(state, ParticleState) or not hasattr(state, "covar"):
        raise ModelError(
            f"a density starts from an SPHState or a GaussianState, got a {type(state).__name__}; of others "
            f"take GaussianState(state.mean, state.covar, timestamp=state.timestamp)"
        )
    mean = np.asarray(state.state_vector, dtype=float)
    cov = covariance("covar of the state", np.asarray(state.covar, dtype=float), dim=len(mean))
    density = _on_particles(mean.tobytes(), cov.tobytes(), len(mean), n_particles, config, domain)
    return SPHState(density, timestamp=state.timestamp)


@lru_cache(maxsize=64)  # by value: what a state is changed to later is another key
def _on_particles(
    mean: bytes,
    cov: bytes,
    n: int,
    n_particles: int | Literal["auto"],
    config: FilterConfig,
    domain: Domain | None,
) -> ParticleDensity:
    start = Gaussian(np.frombuffer(mean), np.frombuffer(cov).reshape(n, n))
    return initialize(start, n_particles, config, domain=domain)


@lru_cache(maxsize=64)  # the same density once more is the same object once more
def _at(density: ParticleDensity, t: float) -> ParticleDensity:
    return replace(density, t=t)


def retimed(
    density: ParticleDensity, transition: Any, timestamp: datetime.datetime | None
) -> ParticleDensity:
    """The density with the time that a timestamp is for the model."""
    t = density.t if transition.epoch is None else transition.time_of(timestamp)
    return density if density.t == t else _at(density, t)


class Step(NamedTuple):
    """Outcome of a prediction or an update."""

    after: Any  # what it ended with: a density, or those of all modes
    info: Any
    origin: Any = None  # where that comes from, should it have to be made again more finely

    def state(self, kind: Any, start: DensityState, **known: Any) -> Any:
        """The prediction or update, as `kind` is, that a state becomes; it knows its origin."""
        held = {start._known_by: self.after, "info": self.info}
        state = kind.from_state(start, **held, **known)
        state._origin = self.after, self.origin
        return state


def origin_of(state: State) -> Any:
    """Where the densities of a state come from, as its `Step` told; None if they are others by now."""
    carried, origin = getattr(state, "_origin", (None, None))
    return origin if carried is getattr(state, "_carried", None) else None


def _frozen(array: Floats) -> Floats:
    """An array that cannot be changed any more."""
    array.flags.writeable = False
    return array
