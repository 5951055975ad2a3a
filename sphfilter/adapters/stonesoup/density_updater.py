"""Stone Soup's updater interface to densities, one or that of every mode: the steps that updaters share."""

import datetime
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, Generic, TypeVar

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
from ...errors import ModelError, PropagationError
from ...info import Code
from ...model.measurements import Sensor, is_gaussian
from .association import Part, one_prediction, probability_of
from .failures import said
from .recent import Recent
from .sensors import reading_of, sensor_for, typed
from .states import DensityState, Step, current, origin_of

__all__ = ["DensityUpdater"]

Posterior = TypeVar("Posterior", bound=DensityState)


class DensityUpdater(Updater, Generic[Posterior]):
    """An updater whose detections bring their sensor along, or take its own.

    Each kind has its own `_started(state)`, a state known by densities; `_multiplied(state, sensor, z)`, the
    `Step` of a detection; `_alone(state, sensor, z)`, what that says `Alone`; `_associated(state, missed,
    parts)`, the `Step` of several; `_said(densities, **known)`, an info; `_on_failure`, a word of those in
    `ON_FAILURE`, with `_gaussian(density, missed, parts)` if it may be "gaussian"; and `_reading(state,
    sensor)`: mean (n,) of a state, mean (k,) and covariance (k, k) of its noise-free reading, and covariance
    (n, k) of the two.

    Parameters
    ----------
    measurement_model : MeasurementModel, GaussianMeasurement or LikelihoodMeasurement, optional
        For detections without one of their own.
    """

    _most_kept = 256  # detections of late, which hypothesisers score first and updates use then
    measurement_model: MeasurementModel = Property(
        default=None, doc="For detections without a measurement model of their own."
    )

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._kept = Recent(self._most_kept)

    def predict_measurement(
        self,
        predicted_state: State,
        measurement_model: MeasurementModel | Sensor | None = None,
        measurement_noise: bool = True,
        **kwargs: Any,
    ) -> GaussianMeasurementPrediction:
        """Mean and covariance of the next detection, and its covariance with the state.

        Returns
        -------
        GaussianMeasurementPrediction

        Raises
        ------
        ModelError
            The sensor is not Gaussian.
        """
        state = current(predicted_state)
        sensor = self._sensor(measurement_model, state.timestamp)
        if not is_gaussian(sensor):
            raise ModelError(
                "a measurement prediction needs a sensor with a noise covariance; associate detections of "
                "others by EvidenceHypothesiser(prob_gate=1)"
            )
        x, reading, S, cross = self._reading(self._started(state), sensor)
        covar = S + sensor.noise_cov if measurement_noise else S
        return GaussianMeasurementPrediction(
            typed(sensor.residual(reading, 0.0), sensor, x),
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

    def update(self, hypothesis: SingleHypothesis | MultipleHypothesis, **kwargs: Any) -> Posterior:
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
        if isinstance(hypothesis, MultipleHypothesis):
            return self._update_of_several(hypothesis)
        state, detection = self._started(hypothesis.prediction), hypothesis.measurement
        if not hypothesis:
            return self._posterior(state, hypothesis, self._unused(state))
        sensor, z = self._asked(state, detection)
        try:
            step = self._multiplied(state, sensor, z)
        except PropagationError as problem:
            part = Part(1.0, sensor, z, *self._alone(state, sensor, z))
            step = self._stand_in(problem, state, 0.0, [part], part.log_evidence)
        return self._posterior(state, hypothesis, step, detection.timestamp)

    def _update_of_several(self, hypotheses: MultipleHypothesis) -> Posterior:
        state = self._started(one_prediction(hypotheses))
        missed, parts = 0.0, []
        for hypothesis in hypotheses:
            weight, part = probability_of(hypothesis), None
            if hypothesis and weight > 0.0:
                asked = self._asked(state, hypothesis.measurement)
                part = Part(weight, *asked, *self._alone(state, *asked))
            if part is None or part.used is None:  # what would not be used alone is not used here
                missed += weight
            else:
                parts.append(part)
        try:
            step = self._associated(state, missed, parts) if parts else self._unused(state)
        except PropagationError as problem:
            step = self._stand_in(problem, state, missed, parts)
        return self._posterior(state, hypotheses, step)

    def _unused(self, state: DensityState) -> Step:
        """The `Step` of no detection."""
        before = state._carried
        return Step(before, self._said(before, reason="no detection was used"))

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
        if self._on_failure == "raise":
            raise problem
        if self._on_failure == "gaussian":
            with suppress(ModelError, PropagationError, np.linalg.LinAlgError):
                after = self._gaussian(before, missed, parts)
                told = said(problem, "a Gaussian stands for the posterior")
                return Step(after, self._said(after, log_evidence=log_evidence, **told))
        told = {"status": "left out", "code": Code.FALLBACK, "reason": f"not used: {problem}"}
        return Step(before, self._said(before, accepted=False, log_evidence=log_evidence, **told))

    def _posterior(
        self,
        state: DensityState,
        hypothesis: SingleHypothesis | MultipleHypothesis,
        step: Step,
        timestamp: datetime.datetime | None = None,
    ) -> Posterior:
        if step.after is state._carried:
            step = step._replace(origin=origin_of(state))
        timestamp = state.timestamp if timestamp is None else timestamp
        return step.state(Update, state, timestamp=timestamp, hypothesis=hypothesis)

    def _asked(self, prediction: State, detection: Detection) -> tuple[Sensor, Floats]:
        sensor = self._sensor(detection.measurement_model, prediction.timestamp)
        return sensor, reading_of(detection, sensor)

    def _sensor(
        self, measurement_model: MeasurementModel | Sensor | None, timestamp: datetime.datetime | None
    ) -> Sensor:
        return sensor_for(
            self.measurement_model if measurement_model is None else measurement_model, timestamp
        )
