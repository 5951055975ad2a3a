"""Stone Soup's updater interface to densities of either kind: one, or one for every mode."""

import datetime
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from stonesoup.base import Property
from stonesoup.models.measurement.base import MeasurementModel
from stonesoup.types.array import CovarianceMatrix
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.multihypothesis import MultipleHypothesis
from stonesoup.types.prediction import GaussianMeasurementPrediction
from stonesoup.types.state import State
from stonesoup.types.update import Update
from stonesoup.updater.base import Updater

from ..._types import Floats
from ...config import FilterConfig, checked_filter_config
from ...density.distributions import Gaussian
from ...density.initialize import initialize
from ...density.modes import ModeDensities
from ...density.particle_density import ParticleDensity
from ...density.resample import max_particles_of
from ...errors import ModelError, PropagationError
from ...filter.update_again import Update as Origin
from ...filter.update_again import prediction_of, update_or_predict_again
from ...filter.update_modes import ModesUpdateInfo
from ...filter.update_modes_again import update_or_predict_modes_again
from ...info import Code, UpdateInfo, codes_of, schemes_of
from ...model.measurements import Sensor, is_gaussian
from ...model.named import driven
from ...prediction.again import Outcome
from ...prediction.mixing_modes import mixture
from ...validate import choice, count, short
from .association import (
    Association,
    Part,
    alone,
    check_sharpness,
    evidence_of_points,
    one_prediction,
    probability_of,
    resolved,
)
from .failures import ON_FAILURE, OnFailure, merged, multiplied, said
from .predictor import JumpMarkovPredictor, SPHPredictor
from .sensors import predicted, reading_of, sensor_for, typed
from .starts import Recent, current, started
from .states import DensityState, JumpMarkovState, SPHState, Step, origin_of


class DensityUpdater(Updater):
    """An updater whose detections bring their sensor along, or take its own.

    Each kind has its own `_by`, whose `n_particles`, `config` and `on_failure` count; `_info`, the class of
    its infos; `_started(state)`, a state known by densities; `_multiplied(state, sensor, z)`, the `Step` of a
    detection; `_alone(state, sensor, z)`, the `Part` that it is of several; `_associated(state, missed,
    parts)`, the `Step` of these; and `_gaussian(density, missed, parts)` if one may stand for a posterior.
    """

    _most_kept: int  # detections of late, which hypothesisers score first and updates use then
    _info: type[UpdateInfo]
    measurement_model: MeasurementModel = Property(
        default=None, doc="For detections without a measurement model of their own."
    )

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._kept = Recent(self._most_kept)

    @property
    def _config(self) -> FilterConfig:
        return self._by._config

    def predict_measurement(
        self,
        predicted_state: State,
        measurement_model: MeasurementModel | Sensor | None = None,
        measurement_noise: bool = True,
        **kwargs: Any,
    ) -> GaussianMeasurementPrediction:
        """Mean and covariance of the next detection, of a Gaussian sensor, and covariance with the state."""
        state = self._started(current(predicted_state))
        sensor = self._sensor(measurement_model, state.timestamp)
        if not is_gaussian(sensor):
            raise ModelError(
                "a measurement prediction needs a sensor with a noise covariance; associate detections of "
                "others by EvidenceHypothesiser(prob_gate=1)"
            )
        reading, S, cross = predicted(state, sensor)
        covar = S + sensor.noise_cov if measurement_noise else S
        return GaussianMeasurementPrediction(
            typed(sensor.residual(reading, 0.0), sensor, state._moments[0]),
            CovarianceMatrix(covar),
            timestamp=state.timestamp,
            cross_covar=CovarianceMatrix(cross),
        )

    def log_evidence(self, prediction: State, detection: Detection) -> float:
        """Logarithm of the predicted density of a detection: of the integral of density times likelihood.

        Of a model that switches, over all modes. Where nothing holds the product, which is next to nothing
        there, a sum over the particles is taken.
        """
        state = self._started(prediction)
        return self._alone(state, *self._asked(state, detection)).log_evidence

    def update(self, hypothesis: SingleHypothesis | MultipleHypothesis, **kwargs: Any) -> DensityState:
        """The posterior of a hypothesis, or of an association of several (PDA, JPDA).

        Parameters
        ----------
        hypothesis : SingleHypothesis or MultipleHypothesis
            Several hypotheses have probabilities and share one prediction: the posterior is the mixture of
            their posteriors (the prior, for a miss) as one density, not merged into a Gaussian. Of a model
            that switches it is so in every mode, and the mode has the probability of all.

        Returns
        -------
        SPHStateUpdate
            Of a `JumpMarkovUpdater` a JumpMarkovStateUpdate.

        Raises
        ------
        ModelError
            A detection, state or model that does not fit, or hypotheses of different times.
        PropagationError
            With ``on_failure="raise"``: no lattice holds the posterior, or the detection cannot have come
            about in any mode. The prediction is as it was.
        """
        several = isinstance(hypothesis, MultipleHypothesis)
        state = self._started(one_prediction(hypothesis) if several else hypothesis.prediction)
        step = self._of_several(state, hypothesis) if several else self._of_one(state, hypothesis)
        if step.after is state._carried:
            step = step._replace(origin=origin_of(state))
        timestamp = hypothesis.measurement.timestamp if not several and hypothesis else state.timestamp
        timestamp = state.timestamp if timestamp is None else timestamp
        return step.state(Update, state, timestamp=timestamp, hypothesis=hypothesis)

    def _of_one(self, state: DensityState, hypothesis: SingleHypothesis) -> Step:
        """The `Step` of one detection, or of a miss."""
        if not hypothesis:
            return self._unused(state)
        sensor, z = self._asked(state, hypothesis.measurement)
        try:
            return self._multiplied(state, sensor, z)
        except PropagationError as problem:
            part = self._alone(state, sensor, z)
            return self._stand_in(problem, state, 0.0, [part], part.log_evidence)

    def _of_several(self, state: DensityState, hypotheses: MultipleHypothesis) -> Step:
        """The `Step` of hypotheses that have probabilities; what would not be used alone is a miss."""
        missed, parts = 0.0, []
        for hypothesis in hypotheses:
            weight, part = probability_of(hypothesis), None
            if hypothesis and weight > 0.0:
                part = self._alone(state, *self._asked(state, hypothesis.measurement))
            if part is None or part.used is None:
                missed += weight
            else:
                parts.append(part._replace(weight=weight))
        try:
            return self._associated(state, missed, parts) if parts else self._unused(state)
        except PropagationError as problem:
            return self._stand_in(problem, state, missed, parts)

    def _unused(self, state: DensityState) -> Step:
        """The `Step` of no detection."""
        return Step(state._carried, self._said(state._carried, reason="no detection was used"))

    def _stand_in(
        self,
        problem: PropagationError,
        state: DensityState,
        missed: float,
        parts: Sequence[Part],
        log_evidence: float = 0.0,
    ) -> Step:
        """The `Step` of detections that no posterior could be made of, or `problem`."""
        before = state._carried
        if self._by.on_failure == "raise":
            raise problem
        if self._by.on_failure == "gaussian":
            with suppress(ModelError, PropagationError, np.linalg.LinAlgError):
                after = self._gaussian(before, missed, parts)
                told = said(problem, "a Gaussian stands for the posterior")
                return Step(after, self._said(after, log_evidence=log_evidence, **told))
        told = {"status": "left out", "code": Code.FALLBACK, "reason": f"not used: {problem}"}
        return Step(before, self._said(before, accepted=False, log_evidence=log_evidence, **told))

    def _said(self, carried: Any, **known: Any) -> Any:
        """The info of densities that no update has made."""
        usual = {"accepted": True, "log_evidence": 0.0, "n_particles": carried.n_particles}
        return self._info(**usual | known)

    def _once(self, state: DensityState, sensor: Sensor, z: Floats, make: Callable[[], Any]) -> Any:
        """What is made of a state and a detection, known by its likelihood; kept a while."""
        likelihood = tuple(sensor.log_likelihood(z, p.x, p.t).tobytes() for _, p in state._some)
        return self._kept.result((state._carried, likelihood, self._config, self._by.n_particles), make)

    def _asked(self, prediction: State, detection: Detection) -> tuple[Sensor, Floats]:
        sensor = self._sensor(detection.measurement_model, prediction.timestamp)
        return sensor, reading_of(detection, sensor)

    def _sensor(self, measurement_model: Any, timestamp: datetime.datetime | None) -> Sensor:
        own = self.measurement_model if measurement_model is None else measurement_model
        return sensor_for(own, timestamp)


class SPHUpdater(DensityUpdater):
    """An updater of a density, by the likelihood of one detection or of an association of several.

    Parameters
    ----------
    measurement_model : MeasurementModel, GaussianMeasurement or LikelihoodMeasurement, optional
        For detections without one of their own.
    n_particles : int, optional
        Upper bound of the number of particles; by default the bound of the prediction.
    config : FilterConfig, optional
    on_failure : "gaussian", "drop" or "raise"
        As of `SPHPredictor`, of detections whose posterior could not be made. The Gaussian is that which an
        unscented Kalman filter makes of a detection, with the density's particles as its points (of a sensor
        that is not Gaussian, that of the particles weighted by their likelihood); of an association that
        with the moments of the mixture of these. Detections that are dropped count as missed: the posterior
        is the prediction, and `info.accepted` is False.
    """

    _most_kept = 256
    _info = UpdateInfo
    n_particles: int = Property(default=None, doc="Upper bound of the number of particles.")
    config: FilterConfig = Property(default=None, doc="Settings; the default is the best measured scheme.")
    on_failure: OnFailure = Property(
        default="gaussian", doc='What an update that fails becomes: "gaussian", "drop" or "raise".'
    )

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        choice("on_failure", self.on_failure, ON_FAILURE)

    @property
    def _by(self) -> "SPHUpdater":
        return self

    @property
    def _config(self) -> FilterConfig:
        return checked_filter_config(self.config)

    def _started(self, state: State) -> SPHState:
        usual = SPHPredictor.n_particles.default  # type: ignore[attr-defined]  # a Property of Stone Soup
        n_particles = usual if self.n_particles is None else count("n_particles", self.n_particles)
        return started(state, n_particles, self._config)

    def _alone(self, state: SPHState, sensor: Sensor, z: Floats) -> Part:
        make = partial(alone, state, sensor, z, self._config, self.n_particles)
        return self._once(state, sensor, z, make)

    def _multiplied(self, state: SPHState, sensor: Sensor, z: Any) -> Step:
        return _step(state, self._product(state, sensor, z, 1, self._config), sensor, z)

    def _product(
        self, state: SPHState, sensor: Sensor, z: Any, times: int, config: FilterConfig
    ) -> Outcome[UpdateInfo]:
        """The `Outcome` of an update on so many times the particles, the bound of which is kept."""
        density, origin = state.density, prediction_of(origin_of(state))
        bound = max_particles_of(density, self.n_particles)
        model: Any = origin.model  # unknown where nothing was predicted, and not asked for then
        found = update_or_predict_again(origin, density, model, sensor, z, config, times * bound)
        return found if times == 1 else found._replace(density=replace(found.density, capacity=bound))

    def _associated(self, state: SPHState, missed: float, parts: Sequence[Part]) -> Step:
        density, association, z = state.density, Association(missed, parts), tuple(part.z for part in parts)
        moments = [(part.weight, *part.used) for part in parts]
        weights, means, covs = zip((missed, density.mean(), density.cov()), *moments, strict=True)
        mean = None if density.domain is not None else np.average(means, axis=0, weights=weights)

        check_sharpness(weights, covs, max_particles_of(density, self.n_particles))
        product = partial(self._product, state, association, z)
        return _step(state, resolved(product, self._config, density.dim, mean), association, z)

    def _gaussian(self, density: ParticleDensity, missed: float, parts: Sequence[Part]) -> ParticleDensity:
        each = [(missed, Gaussian(density.mean(), density.cov()))] if missed > 0.0 else []
        each += [(part.weight, multiplied(density, part.sensor, part.z)) for part in parts]
        bound = max_particles_of(density, self.n_particles)
        return initialize(merged(each), bound, self._config, t=density.t, domain=density.domain)


def _step(state: SPHState, found: Outcome[UpdateInfo], sensor: Sensor, z: Any) -> Step:
    """The `Step` of an update that made its `Outcome` of a state."""
    before, after, info, _ = found
    origin = None if after is before else Origin.after(origin_of(state), before, sensor, z, info)
    return Step(after, info, origin)


class JumpMarkovUpdater(DensityUpdater):
    """An updater of densities of all modes by likelihoods, and of their probabilities by the evidence.

    Parameters
    ----------
    predictor : JumpMarkovPredictor
        Whose model and settings count here too.
    measurement_model : MeasurementModel, GaussianMeasurement or LikelihoodMeasurement, optional
        Of all modes; for detections without one of their own.

    Raises
    ------
    ModelError
        A predictor of another kind.
    """

    _most_kept = 64  # posteriors of all modes
    _info = ModesUpdateInfo
    predictor: JumpMarkovPredictor = Property(doc="Whose model and settings count here too.")

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        if not isinstance(self.predictor, JumpMarkovPredictor):
            raise ModelError(
                f"predictor must be a JumpMarkovPredictor, got {short(self.predictor)}; SPHUpdater goes with "
                f"others"
            )

    @property
    def _by(self) -> JumpMarkovPredictor:
        return self.predictor

    def _started(self, state: State) -> JumpMarkovState:
        return self.predictor._started(state)

    def _sensor(self, measurement_model: Any, timestamp: datetime.datetime | None) -> Sensor:
        return driven(super()._sensor(measurement_model, timestamp), self.predictor.transition_model.inputs)

    def _alone(self, state: JumpMarkovState, sensor: Sensor, z: Floats) -> Part:
        try:
            step = self._multiplied(state, sensor, z)
        except PropagationError:
            return Part(sensor, z, evidence_of_points(state, sensor, z), None)
        return Part(sensor, z, step.info.log_evidence, step if step.info.accepted else None)

    def _multiplied(self, state: JumpMarkovState, sensor: Sensor, z: Floats) -> Step:
        def made() -> Step:
            sensors, settings = dict.fromkeys(state.names, sensor), (self._config, self._by.n_particles)
            about = origin_of(state), state.modes, sensors, z
            return Step(*update_or_predict_modes_again(*about, *settings)[1:])

        return self._once(state, sensor, z, made)

    def _associated(self, state: JumpMarkovState, missed: float, parts: Sequence[Part]) -> Step:
        """The `Step` of a sum of posteriors in every mode, which says what was said of those that matter."""
        each = [(part.weight, part.used) for part in parts]
        modes = mixture([(missed, state.modes), *((w, step.after) for w, step in each)], self._config)
        infos = [step.info for w, step in each if w > self._config.target_error]
        status = dict.fromkeys(info.status for info in infos if info.status != "ok")
        code, scheme = codes_of(info for info in infos if info.status != "ok"), schemes_of(infos)
        return Step(modes, self._said(modes, status="; ".join(status) or "ok", code=code, scheme=scheme))

    def _said(self, carried: ModeDensities, **known: Any) -> ModesUpdateInfo:
        return super()._said(carried, error=carried.error, **known)
