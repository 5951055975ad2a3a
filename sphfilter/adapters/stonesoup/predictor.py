"""Stone Soup's predictor interface to the solver."""

import datetime
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any

from stonesoup.base import Property
from stonesoup.models.transition.base import TransitionModel
from stonesoup.predictor.base import Predictor
from stonesoup.types.prediction import Prediction
from stonesoup.types.state import State
from stonesoup.types.track import Track

from ...config import FilterConfig, checked_filter_config
from ...density.particle_density import ParticleDensity
from ...errors import ModelError, PropagationError
from ...info import PredictInfo
from ...model.sde import SDE
from ...prediction.again import Outcome, or_as_cloud, predict_from_finer
from ...prediction.predict import Prediction as Origin
from ...prediction.predict import predict
from ...validate import choice, count
from .association import Association, predicted_apart
from .failures import ON_FAILURE, OnFailure, laid, linearised, said
from .recent import Recent
from .states import SPHState, SPHStatePrediction, current, density_of, origin_of, remember, retimed
from .transition import SDETransitionModel, transition_of

__all__ = ["SPHPredictor", "check_control", "interval"]

_KEPT = 64  # predictions of late, which hypothesisers ask for once a detection


class SPHPredictor(Predictor):
    """Carries the density of a state through the Fokker-Planck-Kolmogorov equation.

    Parameters
    ----------
    transition_model : SDETransitionModel, SDE, or linear Gaussian model
        Stone Soup's ConstantVelocity, OrnsteinUhlenbeck, Singer and combinations of them are turned into the
        linear equations whose transitions they are; others have to be given as an equation.
    n_particles : int
        Upper bound of the number of particles.
    config : FilterConfig, optional
    on_failure : "gaussian", "drop" or "raise"
        What comes of a density that could not be carried (`PropagationError`). With "gaussian" the Gaussian
        that the model linearised along the mean makes of its mean and covariance, as of an extended Kalman
        filter; where there is none, as with "drop". With "drop" the prediction is left out: the density
        stays what it was, at the new time. `info.status` says so, and why; `info.flagged` is True. With
        "raise" the error is raised, and ends a run of a tracker.

    Notes
    -----
    Predictions are deterministic. The last ones are kept under the values that went into them (density,
    model, parameters, interval), never under state objects, so that a changed state is predicted anew.
    """

    transition_model: TransitionModel = Property(
        doc="An SDETransitionModel, an SDE or a linear Gaussian model."
    )
    n_particles: int = Property(default=200, doc="Upper bound of the number of particles.")
    config: FilterConfig = Property(default=None, doc="Settings; the default is the best measured scheme.")
    on_failure: OnFailure = Property(
        default="gaussian", doc='What a prediction that fails becomes: "gaussian", "drop" or "raise".'
    )

    @transition_model.setter  # type: ignore[no-redef]  # Stone Soup makes a property of it
    def transition_model(self, model: SDETransitionModel | SDE | TransitionModel) -> None:
        self._property_transition_model = transition_of(model)

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        check_control(self, control_model=self.control_model)
        choice("on_failure", self.on_failure, ON_FAILURE)
        self._kept = Recent(_KEPT)

    def predict(
        self,
        prior: State | Track,
        timestamp: datetime.datetime | None = None,
        *,
        control_input: None = None,
        **kwargs: Any,
    ) -> SPHStatePrediction:
        """Predict to a timestamp.

        Parameters
        ----------
        prior : SPHState, GaussianState, or a Track that ends in one
        timestamp : datetime.datetime
        **kwargs
            Options of other predictors (such as measurement=); nothing here depends on them.

        Returns
        -------
        SPHStatePrediction

        Raises
        ------
        ModelError
            Timestamps that are missing or run backwards, or a state that is no density.
        PropagationError
            With ``on_failure="raise"``: the model blew up, or no lattice holds the density; says what to
            change. The prior is as it was.
        """
        check_control(self, control_input=control_input)
        prior = current(prior)
        sde, config = self.transition_model.sde, checked_filter_config(self.config)
        n_particles = count("n_particles", self.n_particles)
        density = density_of(prior, n_particles, config, sde.domain)
        dt = interval(prior.timestamp, timestamp)
        before, moved, info, _ = self._carried(prior, density, dt, config, n_particles)
        failed = info.scheme == ""
        prediction = Prediction.from_state(
            prior if isinstance(prior, SPHState) else SPHState(density, prior.timestamp),
            density=moved,
            timestamp=timestamp,
            transition_model=self.transition_model,
            prior=prior,
            info=info,
        )
        return remember(prediction, Origin(None if failed else before, info.mass_error, sde, moved.t))

    def _carried(
        self, prior: State, density: ParticleDensity, dt: float, config: FilterConfig, n_particles: int
    ) -> Outcome[PredictInfo]:
        """The `Outcome` of dt seconds; kept a while."""
        transition = self.transition_model
        sde, start = transition.sde, retimed(density, transition, prior.timestamp)
        key = start, sde, sde.p.tobytes(), dt, config, n_particles, self.on_failure

        def carried() -> Outcome[PredictInfo]:
            try:
                found = self._predicted(start, origin_of(prior), predicted, n_particles)
            except PropagationError as problem:
                if self.on_failure == "raise":
                    raise
                found = self._stand_in(problem, start, dt, config, n_particles)
            before, moved = retimed(found.before, transition, prior.timestamp), found.density
            if moved.capacity != n_particles:  # more particles for once are not more ever after
                moved = replace(moved, capacity=n_particles)
            return found._replace(before=before, density=moved)

        def predicted(
            density: ParticleDensity, most: int | None = None, config: Any = config
        ) -> tuple[ParticleDensity, PredictInfo]:
            density = retimed(density, transition, prior.timestamp)
            options: dict[str, Any] = {"n_particles": n_particles, "most_particles": most, "goes_on": False}
            return predict(density, sde, dt, config, **options)

        return self._kept.result(key, carried)

    def _stand_in(
        self,
        problem: PropagationError,
        start: ParticleDensity,
        dt: float,
        config: FilterConfig,
        n_particles: int,
    ) -> Outcome[PredictInfo]:
        """The `Outcome` of a prediction that failed; no scheme carried it."""
        if self.on_failure == "gaussian":
            with suppress(ModelError, PropagationError):
                gaussian = linearised(start, self.transition_model.sde, dt)
                moved = laid(gaussian, start, start.t + dt, n_particles, config)
                info = PredictInfo(scheme="", **said(problem, "a Gaussian stands for the density"))
                return Outcome(start, moved, info, n_particles)
        info = PredictInfo(scheme="", **said(problem, "left out, the density is that before"))
        return Outcome(start, replace(start, t=start.t + dt), info, n_particles)

    def _predicted(
        self,
        start: ParticleDensity,
        origin: Any,
        predicted: Callable[..., tuple[ParticleDensity, PredictInfo]],
        n_particles: int,
    ) -> Outcome[PredictInfo]:
        """The `Outcome` of what `predicted` makes of a density.

        Associations that are sharp and broad at once are predicted part by part.
        """
        sde, config = self.transition_model.sde, checked_filter_config(self.config)
        if isinstance(getattr(origin, "measurement", None), Association):
            try:
                return Outcome(start, *predicted(start, most=0), n_particles)
            except PropagationError:
                with suppress(PropagationError):
                    found = predicted_apart(origin, predicted, config, n_particles)
                    return Outcome(start, *found, n_particles)

        def attempted(config: Any) -> Outcome[PredictInfo]:
            def bounded(density: ParticleDensity) -> Outcome[PredictInfo]:
                return Outcome(density, *predicted(density, config=config), n_particles)

            return predict_from_finer(bounded, sde, start, origin, config, n_particles)

        return or_as_cloud(attempted, config)


def check_control(predictor: Predictor, **given: object) -> None:
    """Raise `ModelError` for a control that is given by name."""
    for name, value in given.items():
        if value is not None:
            raise ModelError(
                f"{type(predictor).__name__} takes no {name}: write the control into the drift of the SDE"
            )


def interval(start: datetime.datetime | None, end: datetime.datetime | None) -> float:
    """Seconds from one timestamp to another."""
    if start is None or end is None:
        raise ModelError(
            f"a prediction needs the timestamp of the state and one to predict to, got {start} and {end}"
        )
    return (end - start).total_seconds()
