"""Stone Soup's predictor interface to models that switch between modes."""

import datetime
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, Literal

from stonesoup.base import Property
from stonesoup.predictor.base import Predictor
from stonesoup.types.state import State
from stonesoup.types.track import Track

from ...config import FilterConfig, checked_filter_config
from ...density.modes import ModeDensities
from ...errors import ConfigError, ModelError, PropagationError
from ...model.jump_markov import JumpMarkovModel
from ...model.jump_markov import mode_probabilities as checked_probabilities
from ...prediction.switching import ModesInfo, ModesPrediction, predict_modes
from ...validate import choice, count, short
from .failures import said
from .jump_markov_states import JumpMarkovState, JumpMarkovStatePrediction
from .predictor import check_control, interval
from .recent import Recent
from .states import current, density_of, origin_of, remember

__all__ = ["JumpMarkovPredictor"]

_KEPT = 64  # predictions of late, which hypothesisers ask for once a detection
_ON_FAILURE = "drop", "raise"


class JumpMarkovPredictor(Predictor):
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
        check_control(self, control_model=self.control_model)
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
        choice("on_failure", self.on_failure, _ON_FAILURE)
        checked_probabilities(self.mode_probabilities, model)
        self._kept = Recent(_KEPT)

    def predict(
        self,
        prior: State | Track,
        timestamp: datetime.datetime | None = None,
        *,
        control_input: None = None,
        **kwargs: Any,
    ) -> JumpMarkovStatePrediction:
        """Predict to a timestamp.

        Parameters
        ----------
        prior : JumpMarkovState, SPHState, GaussianState, or a Track that ends in one
            That of another kind than the first begins a track: it is the density of all modes.
        timestamp : datetime.datetime
        **kwargs
            Options of other predictors (such as measurement=); nothing here depends on them.

        Returns
        -------
        JumpMarkovStatePrediction

        Raises
        ------
        ModelError
            Timestamps that are missing or run backwards, or a state of another model.
        PropagationError
            With ``on_failure="raise"``: a mode that is not unlikely cannot be carried. The prior is as it
            was.
        """
        check_control(self, control_input=control_input)
        prior = current(prior)
        before, dt = self.modes_of(prior), interval(prior.timestamp, timestamp)
        if dt < 0.0:
            raise ModelError(f"cannot predict back in time: from {prior.timestamp} to {timestamp}")
        modes, info = self._carried(before, dt)
        prediction = JumpMarkovStatePrediction(
            modes,
            self.transition_model.names,
            timestamp=timestamp,
            transition_model=self.transition_model,
            prior=prior,
            info=info,
        )
        if modes is before:
            return remember(prediction, origin_of(prior))
        failed = info.scheme == ""
        origin = None if failed else ModesPrediction(before, info.n_substeps, self.transition_model)
        return remember(prediction, origin)

    def modes_of(self, state: State) -> ModeDensities:
        """The densities of a state: of all modes, or that of a start in each of them.

        Raises
        ------
        ModelError
            A state of other modes or another number of states, or one that has lost its modes.
        """
        model = self.transition_model
        if isinstance(state, JumpMarkovState):
            if tuple(state.names) != model.names:
                raise ModelError(
                    f"the state has the modes {list(state.names)}, the model {list(model.names)}"
                )
            return state.modes
        if any(isinstance(prediction, JumpMarkovState) for prediction in _predictions(state)):
            raise ModelError(
                "the tracker has merged densities of modes into a Gaussian, which knows no mode; take one "
                "that keeps what the updater makes (SingleTargetTracker, MultiTargetTracker)"
            )
        if state.ndim != model.dim:
            raise ModelError(f"the state is of {state.ndim} numbers, those of the model of {model.dim}")
        density = density_of(state, self.n_particles, checked_filter_config(self.config), model.domain)
        w = checked_probabilities(self.mode_probabilities, model)
        return self._kept.result((density, w.tobytes()), lambda: ModeDensities.alike(w, density))

    def _carried(self, before: ModeDensities, dt: float) -> tuple[ModeDensities, ModesInfo]:
        """The densities dt seconds later; kept a while."""
        if dt == 0.0:
            return before, ModesInfo(error=before.error, skipped=("everything: the interval is empty",))
        model, t, config = self.transition_model, before.heaviest.t + dt, checked_filter_config(self.config)

        def carried() -> tuple[ModeDensities, ModesInfo]:
            try:
                return predict_modes(before, model, t, config, self.n_particles)
            except PropagationError as problem:
                if self.on_failure == "raise":
                    raise
                known: dict[str, Any] = said(problem, "left out, the densities are those before")
                return _left(before, t), ModesInfo(scheme="", error=before.error, **known)

        key = before, model, dt, config, self.n_particles, self.on_failure
        return self._kept.result(key, carried)


def _left(modes: ModeDensities, t: float) -> ModeDensities:
    """The densities as they are, at time t."""
    densities = [None if p is None else replace(p, t=t) for p in modes.densities]
    return ModeDensities(modes.log_w, densities, modes.splitting)


def _predictions(state: State) -> Iterable[State]:
    """What a state is an update of."""
    hypothesis = getattr(state, "hypothesis", None)
    several = hypothesis if isinstance(hypothesis, Iterable) else [hypothesis]
    return [getattr(each, "prediction", None) for each in several]
