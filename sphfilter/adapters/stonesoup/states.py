"""States of a Stone Soup track that carry a density, or one for every mode of a model that switches."""

import datetime
from typing import Any, NamedTuple

import numpy as np
from stonesoup.base import Property, clearable_cached_property
from stonesoup.types.array import CovarianceMatrix, StateVector, StateVectors
from stonesoup.types.base import Type
from stonesoup.types.prediction import Prediction
from stonesoup.types.state import ParticleState, State
from stonesoup.types.update import Update

from ..._types import Floats, Seed
from ...config import FilterConfig
from ...density.modes import ModeDensities
from ...density.particle_density import ParticleDensity
from ...errors import ModelError
from ...filter.update_modes import ModesUpdateInfo
from ...info import PredictInfo, UpdateInfo
from ...prediction.mixing_modes import whatever_the_mode
from ...prediction.switching import ModesInfo
from ...validate import count, generator, short


class DensityState(Type):
    """A state known by densities, which its kind says.

    `_some` are logarithms of weights and densities, `_moments` mean (n,) and covariance (n, n).
    """

    from_state = staticmethod(State.from_state)
    _known_by: str  # name of the property that filters carry on: one density, or those of all modes

    @property
    def _carried(self) -> Any:
        return getattr(self, self._known_by)

    @property
    def state_vector(self) -> StateVector:
        """The mean, over all modes if there are several, shape (n, 1); read-only."""
        return _frozen(self._moments[0][:, None]).view(StateVector)

    mean = state_vector

    @property
    def covar(self) -> CovarianceMatrix:
        """The covariance, over all modes if there are several, shape (n, n); read-only."""
        return _frozen(self._moments[1]).view(CovarianceMatrix)

    @property
    def ndim(self) -> int:
        """Number of states n."""
        return len(self.state_vector)

    def to_particle_state(self, n_particles: int, rng: Seed = None) -> ParticleState:
        """A `ParticleState` of equally weighted particles, drawn from the density by a generator or seed."""
        n_particles = count("n_particles", n_particles)
        X = self.density.sample(n_particles, generator(rng))
        log_weight = np.full(n_particles, -np.log(n_particles))
        return ParticleState(StateVectors(X.T), log_weight=log_weight, timestamp=self.timestamp)

    def __reduce_ex__(self, protocol: Any) -> Any:
        """A prediction in a file has the density of its prior, not what that came from."""
        made, arguments, values, *rest = super().__reduce_ex__(protocol)
        prior = getattr(self, "prior", None)
        if isinstance(prior, DensityState) and isinstance(prior, Update):
            plain = next(kind for kind in type(prior).__mro__ if not issubclass(kind, Prediction | Update))
            values = values | {"_property_prior": State.from_state(prior, target_type=plain)}
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

    @property
    def _some(self) -> list[tuple[float, ParticleDensity]]:
        return [(0.0, self.density)]

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


class JumpMarkovState(DensityState):
    """A state known by a density for every mode of a model that switches, and their probabilities.

    Predictions and updates make it; a track starts from a GaussianState, or an SPHState.

    Parameters
    ----------
    modes : ModeDensities
    names : tuple of str, length M
        Of the modes.
    timestamp : datetime.datetime, optional
    """

    _known_by = "modes"
    modes: ModeDensities = Property(doc="Densities of all modes, and their probabilities.")
    names: tuple[str, ...] = Property(doc="Names of the modes.")
    timestamp: datetime.datetime = Property(default=None, doc="Timestamp of the state. Default None.")

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        if not isinstance(self.modes, ModeDensities) or len(self.modes.densities) != len(self.names):
            raise ModelError(
                f"a JumpMarkovState takes ModeDensities of the modes {list(self.names)}, as those of another "
                f"state are, got {short(self.modes)}"
            )

    @property
    def _some(self) -> list[tuple[float, ParticleDensity]]:
        return [(log_w, p) for _, log_w, p in self.modes.some]

    @property
    def _moments(self) -> tuple[Floats, Floats]:
        """Mean (n,) and covariance (n, n) over all modes."""
        return self.modes.moments

    @clearable_cached_property("modes")
    def density(self) -> ParticleDensity:
        """The density of the states, whatever the mode: the sum of all modes, made when it is asked for."""
        return whatever_the_mode(self.modes, FilterConfig().target_error)

    @property
    def mode_probabilities(self) -> Floats:
        """Probabilities of the modes, shape (M,), in the order of `names`."""
        return self.modes.w

    @property
    def mode(self) -> str:
        """Name of the most probable mode."""
        return self.names[int(np.argmax(self.modes.log_w))]

    @property
    def densities(self) -> dict[str, ParticleDensity]:
        """Densities by mode, of those that have a probability."""
        return {self.names[i]: p for i, _, p in self.modes.some}


class JumpMarkovStatePrediction(Prediction, JumpMarkovState):
    """Predicted densities of all modes; `info` says how they were carried (`ModesInfo`)."""

    info: ModesInfo = Property(default=None, doc="What the prediction did.")


class JumpMarkovStateUpdate(Update, JumpMarkovState):
    """Posterior densities of all modes; `info` says what was done with the detection (`ModesUpdateInfo`).

    After one detection `info.log_evidence` is the logarithm of its predicted density; after an association of
    several, whose weights were given, zero.
    """

    info: ModesUpdateInfo = Property(default=None, doc="What the update did.")


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
    """The array, read-only; what comes out of a file is not."""
    array.flags.writeable = False
    return array
