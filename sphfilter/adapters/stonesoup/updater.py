"""Stone Soup's updater interface to the update: density times likelihood."""

from stonesoup.base import Property
from stonesoup.models.measurement.base import MeasurementModel
from stonesoup.types.array import CovarianceMatrix
from stonesoup.types.multihypothesis import MultipleHypothesis
from stonesoup.types.prediction import GaussianMeasurementPrediction
from stonesoup.types.update import Update
from stonesoup.updater.base import Updater

from ...adapt import Prediction as PredictionOrigin
from ...adapt import Update as UpdateOrigin
from ...adapt import update_repeating
from ...config import FilterConfig, checked_filter_config
from ...errors import ModelError
from ...info import UpdateInfo
from ...resample import bound
from ...update import predicted_reading
from ...validate import count
from .sensors import Association, reading_of, sensor_for, typed
from .states import SPHState, current, density_of, origin_of, remember

__all__ = ["SPHUpdater"]

_START = 200  # particles of a Gaussian state, unless n_particles says otherwise


class SPHUpdater(Updater):
    """Multiplies densities with likelihoods, of one detection or of an association of several.

    Parameters
    ----------
    measurement_model : MeasurementModel, GaussianMeasurement or LikelihoodMeasurement, optional
        For detections without one of their own.
    n_particles : int, optional
        Upper bound of the number of particles; by default that of the prediction.
    config : FilterConfig, optional
    """

    measurement_model: MeasurementModel = Property(
        default=None, doc="For detections without a measurement model of their own."
    )
    n_particles: int = Property(default=None, doc="Upper bound of the number of particles.")
    config: FilterConfig = Property(default=None, doc="Settings; the default is the best measured scheme.")

    def predict_measurement(self, predicted_state, measurement_model=None, measurement_noise=True, **kwargs):
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
        density = self._density(state)
        sensor = self._sensor(measurement_model, state.timestamp)
        if sensor.noise_cov is None:
            raise ModelError(
                "a measurement prediction needs a sensor with a noise covariance; associate detections of "
                "others by EvidenceHypothesiser(prob_gate=1)"
            )
        reading, spread, cross = predicted_reading(density, sensor)
        covar = spread + sensor.noise_cov if measurement_noise else spread
        return GaussianMeasurementPrediction(
            typed(sensor.residual(reading, 0.0), sensor, density.mean()),
            CovarianceMatrix(covar),
            timestamp=state.timestamp,
            cross_covar=CovarianceMatrix(cross),
        )

    def log_evidence(self, prediction, detection):
        """Logarithm of the predicted density of a detection: of the integral of density times likelihood."""
        return self._updated(prediction, detection)[2].log_evidence

    def update(self, hypothesis, **kwargs):
        """The posterior of a hypothesis, or of an association of several (PDA, JPDA).

        Parameters
        ----------
        hypothesis : SingleHypothesis or MultipleHypothesis
            Several have probabilities, and one prediction: the posterior is the mixture of theirs, of the
            prior for a miss, itself and not merged into one Gaussian.

        Returns
        -------
        SPHStateUpdate

        Raises
        ------
        ModelError
            A detection or model that does not fit, or hypotheses of different times.
        PropagationError
            No lattice holds the posterior. The prediction is as it was.
        """
        if isinstance(hypothesis, MultipleHypothesis):
            return self._associated(hypothesis)
        prediction = hypothesis.prediction
        if not hypothesis:
            density = self._density(prediction)
            return self._posterior(prediction, hypothesis, (density, density, _nothing(density)), None)
        sensor, z = self._asked(prediction, hypothesis.measurement)
        found = self._updated(prediction, hypothesis.measurement)
        return self._posterior(prediction, hypothesis, found, (sensor, z), hypothesis.measurement.timestamp)

    def _associated(self, hypotheses):
        missed, parts = 0.0, []
        prediction = _one_prediction(hypotheses)
        for hypothesis in hypotheses:
            weight = _probability(hypothesis)
            info = self._updated(prediction, hypothesis.measurement)[2] if hypothesis and weight else None
            if info is None or not info.accepted:  # a detection that would not be used alone is not used here
                missed += weight
            else:
                sensor, z = self._asked(prediction, hypothesis.measurement)
                parts.append((sensor, z, weight, info.log_evidence))
        density = self._density(prediction)
        if not parts:
            return self._posterior(prediction, hypotheses, (density, density, _nothing(density)), None)
        sensor, z = Association(missed, parts), tuple(part[1] for part in parts)
        return self._posterior(prediction, hypotheses, self._multiplied(prediction, sensor, z), (sensor, z))

    def _updated(self, prediction, detection):
        """Prior as it was used, posterior and info of one detection."""
        return self._multiplied(prediction, *self._asked(prediction, detection))

    def _multiplied(self, prediction, sensor, z):
        density, origin = self._density(prediction), origin_of(prediction)
        origin = origin if isinstance(origin, PredictionOrigin) else PredictionOrigin()
        n_particles = bound(density, self.n_particles)
        config = checked_filter_config(self.config)
        return update_repeating(origin, density, origin.model, sensor, z, config, n_particles)

    def _posterior(self, prediction, hypothesis, found, asked, timestamp=None):
        prior, density, info = found
        timestamp = prediction.timestamp if timestamp is None else timestamp
        state = prediction if isinstance(prediction, SPHState) else SPHState(prior, timestamp)
        posterior = Update.from_state(
            state, density=density, timestamp=timestamp, hypothesis=hypothesis, info=info
        )
        if density is not prior:
            return remember(posterior, UpdateOrigin(prior, *asked))
        return remember(posterior, origin_of(prediction)) if density is state.density else posterior

    def _asked(self, prediction, detection):
        sensor = self._sensor(detection.measurement_model, prediction.timestamp)
        return sensor, reading_of(detection, sensor)

    def _sensor(self, measurement_model, timestamp):
        return sensor_for(
            self.measurement_model if measurement_model is None else measurement_model, timestamp
        )

    def _density(self, state):
        n_particles = _START if self.n_particles is None else count("n_particles", self.n_particles)
        return density_of(state, n_particles, checked_filter_config(self.config))


def _one_prediction(hypotheses):
    """The prediction that hypotheses share."""
    predictions = [hypothesis.prediction for hypothesis in hypotheses]
    if not predictions:
        raise ModelError("there is no hypothesis: data association keeps one at least, that of a miss")
    times = {prediction.timestamp for prediction in predictions}
    if len(times) > 1:
        raise ModelError(
            f"the detections of an association have {len(times)} timestamps: give those of one time to it, "
            f"or associate each alone (NearestNeighbour)"
        )
    return predictions[0]


def _probability(hypothesis):
    if not hasattr(hypothesis, "probability"):
        raise ModelError(
            "an association needs hypotheses with probabilities (PDAHypothesiser, EvidenceHypothesiser), "
            f"got a {type(hypothesis).__name__}"
        )
    return float(hypothesis.probability)


def _nothing(density):
    return UpdateInfo(
        accepted=True, log_evidence=0.0, reason="no detection was used", n_particles=density.n_particles
    )
