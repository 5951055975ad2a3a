"""Stone Soup's predictor interface to densities of either kind: one, or one for every mode."""

import datetime
from collections.abc import Callable, Hashable, Iterable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any, Literal

from stonesoup.base import Property
from stonesoup.models.transition.base import TransitionModel
from stonesoup.predictor.base import Predictor
from stonesoup.types.prediction import Prediction
from stonesoup.types.state import State
from stonesoup.types.track import Track

from ...config import FilterConfig, checked_filter_config
from ...density.initialize import initialize
from ...density.modes import ModeDensities
from ...density.particle_density import ParticleDensity
from ...errors import ConfigError, ModelError, PropagationError
from ...filter.budget import Budget
from ...info import PredictInfo
from ...model.dynamics import Dynamics
from ...model.jump_markov import JumpMarkovModel
from ...model.jump_markov import mode_probabilities as checked_probabilities
from ...prediction.again import Outcome, or_as_cloud, predict_from_finer
from ...prediction.jumping import suits
from ...prediction.predict import Prediction as Origin
from ...prediction.predict import predict
from ...prediction.switching import ModesInfo, ModesPrediction, predict_modes
from ...validate import choice, count
from .association import Association, predicted_apart
from .failures import ON_FAILURE, OnFailure, linearised, said
from .starts import Recent, current, retimed, started
from .states import DensityState, JumpMarkovState, SPHState, Step, origin_of
from .transition import SDETransitionModel, switching, transition_of


class DensityPredictor(Predictor):
    """A predictor of states known by densities: one, or one for every mode of a model that switches.

    Predictions are deterministic. The last ones are kept under the values that went into them (density,
    model, parameters, interval), never under state objects, so that a changed state is predicted anew.

    Each kind has its own `_started(state)`, a state known by densities; `_moved(state, before, dt)`, the
    `Step` that its model makes; and `_stand_in(problem, before, dt)`, the `Step` where that fails.
    """

    _most_kept = 64  # predictions of late, which hypothesisers ask for once a detection
    _words: tuple[str, ...] = ON_FAILURE
    _usual = FilterConfig()

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._check_control("control_model", self.control_model)
        choice("on_failure", self.on_failure, self._words)
        self._kept = Recent(self._most_kept)

    def predict(
        self,
        prior: State | Track,
        timestamp: datetime.datetime | None = None,
        *,
        control_input: None = None,
        **kwargs: Any,
    ) -> DensityState:
        """The prediction of a state, or of the last one of a track, to a timestamp.

        Parameters
        ----------
        prior : SPHState, GaussianState, or a Track that ends in one
            Of a `JumpMarkovPredictor` a JumpMarkovState too; that of another kind begins a track: it is the
            density of all modes.
        timestamp : datetime.datetime
        **kwargs
            Options of other predictors (such as measurement=); nothing here depends on them.

        Returns
        -------
        SPHStatePrediction
            Of a `JumpMarkovPredictor` a JumpMarkovStatePrediction.

        Raises
        ------
        ModelError
            Timestamps that are missing or run backwards, or a state that is no density or of another model.
        PropagationError
            With ``on_failure="raise"``: the model blew up, or no lattice holds the density, or that of a mode
            that is not unlikely; says what to change. The prior is as it was.
        """
        self._check_control("control_input", control_input)
        prior = current(prior)
        state, dt = self._started(prior), _interval(prior.timestamp, timestamp)
        step = self._step(state, state._carried, dt)
        model = self.transition_model
        return step.state(Prediction, state, timestamp=timestamp, transition_model=model, prior=prior)

    def _step(self, state: DensityState, before: Any, dt: float, *model: Hashable) -> Step:
        """The `Step` of dt seconds by a model that is known by these values; kept a while."""

        def made() -> Step:
            budget = Budget(self._config.time_budget)
            budget.begin()
            try:
                step = self._moved(state, before, dt)
            except PropagationError as problem:
                if self.on_failure == "raise":
                    raise
                step = self._stand_in(problem, before, dt)
            return step._replace(info=budget.end("", step.info, 0, repeated=False))

        key = before, *model, dt, self._config, self.n_particles, self.on_failure
        return self._kept.result(key, made)

    @property
    def _config(self) -> FilterConfig:
        return checked_filter_config(self._usual if self.config is None else self.config)

    def _check_control(self, name: str, value: object) -> None:
        """Raise `ModelError` for a control that is given."""
        if value is not None:
            raise ModelError(
                f"{type(self).__name__} takes no {name}: write the control into the drift of the SDE"
            )


class SPHPredictor(DensityPredictor):
    """A predictor that carries the density of a state through the Fokker-Planck-Kolmogorov equation.

    Parameters
    ----------
    transition_model : SDETransitionModel, SDE, DiscreteModel, or linear Gaussian model
        Stone Soup's ConstantVelocity, OrnsteinUhlenbeck, Singer and combinations of them are turned into the
        linear equations whose transitions they are; others have to be given as an equation.
    n_particles : int
        Upper bound of the number of particles.
    config : FilterConfig, optional
        A prediction that takes longer than its `time_budget` says so, `Code.LATE`: it has no fewer points.
    on_failure : "gaussian", "drop" or "raise"
        What comes of a density that could not be carried (`PropagationError`). With "gaussian" the Gaussian
        that the model linearised along the mean makes of its mean and covariance, as of an extended Kalman
        filter; where there is none, as with "drop". With "drop" the prediction is left out: the density
        stays what it was, at the new time. `info.status` says so, and why; `info.flagged` is True. With
        "raise" the error is raised, and ends a run of a tracker.
    """

    transition_model: TransitionModel = Property(
        doc="An SDETransitionModel, an SDE, a DiscreteModel or a linear Gaussian model."
    )
    n_particles: int = Property(default=200, doc="Upper bound of the number of particles.")
    config: FilterConfig = Property(default=None, doc="Settings; the default is the best measured scheme.")
    on_failure: OnFailure = Property(
        default="gaussian", doc='What a prediction that fails becomes: "gaussian", "drop" or "raise".'
    )

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        given: Any = self.n_particles
        if given == "auto":
            raise ConfigError(
                'SPHPredictor takes a bound of the particles, such as n_particles=400, not "auto"; '
                "JumpMarkovPredictor of a model of one mode chooses by itself"
            )
        count("n_particles", given)

    @transition_model.setter  # type: ignore[no-redef]  # Stone Soup makes a property of it
    def transition_model(self, model: SDETransitionModel | Dynamics | TransitionModel) -> None:
        self._property_transition_model = transition_of(model)

    @property
    def _settings(self) -> tuple[FilterConfig, int]:
        return self._config, count("n_particles", self.n_particles)

    def _started(self, state: State) -> SPHState:
        config, n_particles = self._settings
        return started(state, n_particles, config, self.transition_model.sde.domain)

    def _step(self, state: SPHState, before: ParticleDensity, dt: float, *model: Hashable) -> Step:
        sde, start = self.transition_model.sde, retimed(before, self.transition_model, state.timestamp)
        return super()._step(state, start, dt, sde, sde.p.tobytes())

    def _moved(self, state: SPHState, before: ParticleDensity, dt: float) -> Step:
        transition, n_particles = self.transition_model, self._settings[1]

        def predicted(density: ParticleDensity, config: Any, most: int | None = None) -> Outcome[PredictInfo]:
            density = retimed(density, transition, state.timestamp)
            options: dict[str, Any] = {"n_particles": n_particles, "most_particles": most, "goes_on": False}
            return Outcome(density, *predict(density, transition.sde, dt, config, **options), n_particles)

        before, moved, info, _ = self._predicted(before, origin_of(state), predicted)
        moved = _bounded(moved, n_particles)
        return Step(moved, info, Origin(before, info.mass_error, transition.sde, moved.t))

    def _predicted(
        self, start: ParticleDensity, origin: Any, predicted: Callable[..., Outcome[PredictInfo]]
    ) -> Outcome[PredictInfo]:
        """The `Outcome` of what `predicted` makes of a density and a configuration.

        Associations that are sharp and broad at once are predicted part by part.
        """
        sde, (config, n_particles) = self.transition_model.sde, self._settings
        if isinstance(getattr(origin, "measurement", None), Association):
            try:
                return predicted(start, config, most=0)
            except PropagationError:
                with suppress(PropagationError):
                    found = predicted_apart(origin, predicted, config, n_particles)
                    return found._replace(before=start)

        def attempted(config: Any) -> Outcome[PredictInfo]:
            known = sde, start, origin, config, n_particles
            return predict_from_finer(partial(predicted, config=config), *known)

        return or_as_cloud(attempted, config)

    def _stand_in(self, problem: PropagationError, before: ParticleDensity, dt: float) -> Step:
        sde, t, (config, n_particles) = self.transition_model.sde, before.t + dt, self._settings
        moved, what = replace(before, t=t), "left out, the density is that before"
        if self.on_failure == "gaussian":
            with suppress(ModelError, PropagationError):
                moved = initialize(
                    linearised(before, sde, dt), n_particles, config, t=t, domain=before.domain
                )
                what = "a Gaussian stands for the density"
        info = PredictInfo(scheme="", **said(problem, what))
        return Step(_bounded(moved, n_particles), info, Origin(model=sde, t=t))


class JumpMarkovPredictor(DensityPredictor):
    """A predictor that carries a density for every mode of a model that switches, as `JumpMarkovFilter` does.

    The same start, detections and configuration give what `JumpMarkovFilter` gives of them.

    Parameters
    ----------
    transition_model : JumpMarkovModel
        Of modes that do not depend on time.
    mode_probabilities : array_like, shape (M,), or mapping of str to float, optional
        Of the modes where a track begins; ``model.stationary`` if not given.
    n_particles : int or "auto"
        As of `SPHFilter`, of each mode.
    config : FilterConfig, optional
        As of `SPHPredictor`. By default the target error is .05 standard deviations: the .1 % that it adds
        to the errors of a track is little beside what clutter leaves open.
    on_failure : "drop" or "raise"
        What comes of densities that could not be carried (`PropagationError`), and of a detection that the
        updater can make no posterior of. With "drop" they stay what they were, and `info.status` says why;
        with "raise" the error is raised, and ends a run of a tracker.

    Raises
    ------
    ModelError
        A model of another kind, or one that depends on time.
    """

    _words = "drop", "raise"
    _usual = FilterConfig(target_error=0.05)
    transition_model: JumpMarkovModel = Property(doc="A model that switches between modes.")
    mode_probabilities: Any = Property(default=None, doc="Of the modes where a track begins.")
    n_particles: int | Literal["auto"] = Property(
        default="auto", doc='Bound of the particles of each mode, or "auto".'
    )
    config: FilterConfig = Property(default=None, doc="Settings; by default the target error is .05.")
    on_failure: Literal["drop", "raise"] = Property(
        default="drop", doc='What a step that fails becomes: "drop" or "raise".'
    )

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        model = switching(self.transition_model)
        if self.n_particles != "auto":
            count("n_particles", self.n_particles)
        checked_probabilities(self.mode_probabilities, model)

    def modes_of(self, state: State) -> ModeDensities:
        """The densities of a state: of all modes, or that of a start in each; refuses what `predict` does."""
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
        density = started(state, self.n_particles, self._config, model.domain).density
        w = checked_probabilities(self.mode_probabilities, model)
        alike = partial(ModeDensities.alike, w, density, summed=not suits(model))
        modes = self._kept.result((density, w.tobytes()), alike)
        return JumpMarkovState(modes, model.names, state.timestamp)

    def _step(self, state: JumpMarkovState, before: ModeDensities, dt: float, *model: Hashable) -> Step:
        if dt == 0.0:
            info = ModesInfo(error=before.error, skipped=("everything: the interval is empty",))
            return Step(before, info, origin_of(state))
        return super()._step(state, before, dt, self.transition_model)

    def _moved(self, state: JumpMarkovState, before: ModeDensities, dt: float) -> Step:
        model, t = self.transition_model, before.heaviest.t + dt
        modes, info = predict_modes(before, model, t, self._config, self.n_particles)
        return Step(modes, info, ModesPrediction(before, info.n_substeps, model))

    def _stand_in(self, problem: PropagationError, before: ModeDensities, dt: float) -> Step:
        t, told = before.heaviest.t + dt, said(problem, "left out, the densities are those before")
        left = [None if p is None else replace(p, t=t) for p in before.densities]
        info = ModesInfo(scheme="", error=before.error, **told)
        return Step(before.noted(densities=left, ripples=None), info)


def _predictions(state: State) -> Iterable[State]:
    """The predictions that a state is an update of."""
    hypothesis = getattr(state, "hypothesis", None)
    several = hypothesis if isinstance(hypothesis, Iterable) else [hypothesis]
    return [getattr(each, "prediction", None) for each in several]


def _bounded(density: ParticleDensity, n_particles: int) -> ParticleDensity:
    """The density with its bound, of which it may have had more particles for once."""
    return density if density.capacity == n_particles else replace(density, capacity=n_particles)


def _interval(start: datetime.datetime | None, end: datetime.datetime | None) -> float:
    """Seconds from one timestamp to a later one."""
    if start is None or end is None:
        raise ModelError(
            f"a prediction needs the timestamp of the state and one to predict to, got {start} and {end}"
        )
    if end < start:
        raise ModelError(f"cannot predict back in time: from {start} to {end}")
    return (end - start).total_seconds()
