"""What updaters of densities share: the sensors of detections, and what these are predicted to read."""

import datetime
from typing import Any

from stonesoup.base import Property
from stonesoup.models.measurement.base import MeasurementModel
from stonesoup.types.array import CovarianceMatrix
from stonesoup.types.detection import Detection
from stonesoup.types.prediction import GaussianMeasurementPrediction
from stonesoup.types.state import State
from stonesoup.updater.base import Updater

from ..._types import Floats
from ...errors import ModelError
from ...model.measurements import GaussianSensor, Sensor, is_gaussian
from .sensors import reading_of, sensor_for, typed
from .states import current

__all__ = ["DensityUpdater"]


class DensityUpdater(Updater):
    """An updater whose detections bring their sensor along, or take its own.

    Parameters
    ----------
    measurement_model : MeasurementModel, GaussianMeasurement or LikelihoodMeasurement, optional
        For detections without one of their own.
    """

    measurement_model: MeasurementModel = Property(
        default=None, doc="For detections without a measurement model of their own."
    )

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
        x, reading, S, cross = self._reading(state, sensor)
        covar = S + sensor.noise_cov if measurement_noise else S
        return GaussianMeasurementPrediction(
            typed(sensor.residual(reading, 0.0), sensor, x),
            CovarianceMatrix(covar),
            timestamp=state.timestamp,
            cross_covar=CovarianceMatrix(cross),
        )

    def _reading(self, state: State, sensor: GaussianSensor) -> tuple[Floats, Floats, Floats, Floats]:
        """Mean (n,) of a state; of its noise-free reading mean (k,), covariance (k, k), and that of both."""
        raise NotImplementedError

    def _asked(self, prediction: State, detection: Detection) -> tuple[Sensor, Floats]:
        sensor = self._sensor(detection.measurement_model, prediction.timestamp)
        return sensor, reading_of(detection, sensor)

    def _sensor(
        self, measurement_model: MeasurementModel | Sensor | None, timestamp: datetime.datetime | None
    ) -> Sensor:
        return sensor_for(
            self.measurement_model if measurement_model is None else measurement_model, timestamp
        )
