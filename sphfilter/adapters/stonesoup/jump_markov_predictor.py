"""Stone Soup's predictor interface to models that switch between modes."""

import datetime
from collections.abc import Hashable, Iterable
from dataclasses import replace
from functools import partial
from typing import Any, Literal

from stonesoup.base import Property
from stonesoup.types.state import State

from ...config import FilterConfig, checked_filter_config
from ...density.modes import ModeDensities
from ...errors import ConfigError, ModelError, PropagationError
from ...model.jump_markov import JumpMarkovModel
from ...model.jump_markov import mode_probabilities as checked_probabilities
from ...prediction.jumping import suits
from ...prediction.switching import ModesInfo, ModesPrediction, predict_modes
from ...validate import count, short
from .failures import said
from .jump_markov_states import JumpMarkovState, JumpMarkovStatePrediction
from .predictor import DensityPredictor
from .states import Step, origin_of, started

__all__ = ["JumpMarkovPredictor"]


class JumpMarkovPredictor(DensityPredictor[JumpMarkovStatePrediction]):
    """Carries a density for every mode of a model that switches, as `JumpMarkovFilter` does.

    Parameters
    ----------
    transition_model : JumpMarkovModel
        Of modes that do not depend on time.
    mode_probabilities : array_like, shape (M,), or mapping of str to float, optional
        Of the modes where a track begins; ``model.stationary`` if not given.
    n_particles : int or "auto"
        As of `SPHFilter`, of each mode.
    config : FilterConfig, optional
        Without `time_budget`.
    on_failure : "drop" or "raise"
        What comes of densities that could not be carried (`PropagationError`), and of a detection that the
        updater can make no posterior of. With "drop" they stay what they were, and `info.status` says why;
        with "raise" the error is raised, and ends a run of a tracker.

    Raises
    ------
    ModelError
        A model of another kind, or one that depends on time.

    Notes
    -----
    The same start and detections give what `JumpMarkovFilter` gives of them.
    """

    _words = "drop", "raise"
    transition_model: JumpMarkovModel = Property(doc="A model that switches between modes.")
    mode_probabilities: Any = Property(default=None, doc="Of the modes where a track begins.")
    n_particles: int | Literal["auto"] = Property(
        default="auto", doc='Bound of the particles of each mode, or "auto".'
    )
    config: FilterConfig = Property(default=None, doc="Settings; the default is the best measured scheme.")
    on_failure: Literal["drop", "raise"] = Property(
        default="drop", doc='What a step that fails becomes: "drop" or "raise".'
    )

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        model = self.transition_model
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
        if checked_filter_config(self.config).time_budget is not None:
            raise ConfigError("JumpMarkovPredictor keeps no time_budget; leave it out, or raise target_error")
        if self.n_particles != "auto":
            count("n_particles", self.n_particles)
        checked_probabilities(self.mode_probabilities, model)

    def modes_of(self, state: State) -> ModeDensities:
        """The densities of a state: of all modes, or that of a start in each of them.

        Raises
        ------
        ModelError
            A state of other modes or another number of states, or one that has lost its modes.
        """
        return self._started(state).modes

    def _started(self, state: State) -> JumpMarkovState:
        model = self.transition_model
        if isinstance(state, JumpMarkovState):
            if tuple(state.names) != model.names:
                raise ModelError(
                    f"the state has the modes {list(state.names)}, the model {list(model.names)}"
                )
            return state
        if any(isinstance(prediction, JumpMarkovState) for prediction in _predictions(state)):
            raise ModelError(
                "the tracker has merged densities of modes into a Gaussian, which knows no mode; take one "
                "that keeps what the updater makes (SingleTargetTracker, MultiTargetTracker)"
            )
        if state.ndim != model.dim:
            raise ModelError(f"the state is of {state.ndim} numbers, those of the model of {model.dim}")
        config = checked_filter_config(self.config)
        density = started(state, self.n_particles, config, model.domain).density
        w = checked_probabilities(self.mode_probabilities, model)
        made = partial(ModeDensities.alike, w, density, summed=not suits(model))
        modes = self._kept.result((density, w.tobytes()), made)
        return JumpMarkovState(modes, model.names, state.timestamp)

    def _step(self, state: JumpMarkovState, before: ModeDensities, dt: float, *model: Hashable) -> Step:
        if dt < 0.0:
            end = state.timestamp + datetime.timedelta(seconds=dt)
            raise ModelError(f"cannot predict back in time: from {state.timestamp} to {end}")
        if dt == 0.0:
            info = ModesInfo(error=before.error, skipped=("everything: the interval is empty",))
            return Step(before, info, origin_of(state))
        return super()._step(state, before, dt, self.transition_model)

    def _moved(self, state: JumpMarkovState, before: ModeDensities, dt: float) -> Step:
        model, config = self.transition_model, checked_filter_config(self.config)
        modes, info = predict_modes(before, model, before.heaviest.t + dt, config, self.n_particles)
        return Step(modes, info, ModesPrediction(before, info.n_substeps, model))

    def _stand_in(self, problem: PropagationError, before: ModeDensities, dt: float) -> Step:
        told = said(problem, "left out, the densities are those before")
        info = ModesInfo(scheme="", error=before.error, **told)
        return Step(_left(before, before.heaviest.t + dt), info)


def _left(modes: ModeDensities, t: float) -> ModeDensities:
    """The densities as they are, at time t."""
    densities = [None if p is None else replace(p, t=t) for p in modes.densities]
    return ModeDensities(modes.log_w, densities, modes.splitting)


def _predictions(state: State) -> Iterable[State]:
    """The prediction that a state is an update of."""
    hypothesis = getattr(state, "hypothesis", None)
    several = hypothesis if isinstance(hypothesis, Iterable) else [hypothesis]
    return [getattr(each, "prediction", None) for each in several]
