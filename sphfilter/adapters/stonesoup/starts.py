"""States by their density, as steps begin with them: of Gaussians, of tracks; and results of late."""

import datetime
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from stonesoup.types.state import ParticleState, State, StateMutableSequence

from ...config import FilterConfig
from ...density.distributions import Gaussian
from ...density.initialize import initialize
from ...density.particle_density import ParticleDensity
from ...errors import ModelError
from ...model.domain import Domain
from ...validate import covariance
from .states import DensityState, SPHState


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
    density = _on_particles(mean.tobytes(), cov.tobytes(), n_particles, config, domain)
    return SPHState(density, timestamp=state.timestamp)


@lru_cache(maxsize=64)  # by value: what a state is changed to later is another key
def _on_particles(
    mean: bytes, cov: bytes, n_particles: int | Literal["auto"], config: FilterConfig, domain: Domain | None
) -> ParticleDensity:
    x = np.frombuffer(mean)
    start = Gaussian(x, np.frombuffer(cov).reshape(len(x), len(x)))
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


class Recent(OrderedDict[Hashable, Any]):
    """The last `size` results by their keys, which are values, never objects that can change.

    Copies and pickles begin empty.
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        self._size = size

    def result(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """The result of a key, made where it is not known."""
        if key not in self:
            self[key] = make()
            if len(self) > self._size:
                self.popitem(last=False)
        return self[key]

    def __reduce__(self) -> tuple[Any, ...]:
        return Recent, (self._size,)
