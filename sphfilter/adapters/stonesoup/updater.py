"""Stone Soup's updater interface to the update: density times likelihood."""

from dataclasses import replace

import numpy as np
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
from ...errors import ModelError, PropagationError
from ...info import UpdateInfo
from ...resample import bound
from ...update import predicted_reading
from ...validate import count
from .sensors import Association, reading_of, sensor_for, typed
from .states import SPHState, current, density_of, origin_of, remember

__all__ = ["SPHUpdater"]

_FINER = 1, 3, 9  # times the particles that an association is tried on
_RESOLVED = 0.01  # standard deviations that its mean may be off, and part of its mass
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
        prediction = _one_prediction(hypotheses)
        density, missed, parts, posteriors = self._density(prediction), 0.0, [], []
        for hypothesis in hypotheses:
            weight = _probability(hypothesis)
            found = self._updated(prediction, hypothesis.measurement) if hypothesis and weight else None
            if found is None or not found[2].accepted:  # what would not be used alone is not used here
                missed += weight
            else:
                sensor, z = self._asked(prediction, hypothesis.measurement)
                parts.append((sensor, z, weight, found[2].log_evidence))
                posteriors.append((weight, found[1]))
        if not parts:
            return self._posterior(prediction, hypotheses, (density, density, _nothing(density)), None)
        sensor, z = Association(missed, parts), tuple(part[1] for part in parts)
        found = self._resolved(prediction, sensor, z, [(missed, density), *posteriors])
        return self._posterior(prediction, hypotheses, found, (sensor, z))

    def _resolved(self, prediction, sensor, z, parts):
        """As `_multiplied`, on more particles where the posteriors' mixture needs them to have its mean."""
        expected = _mixed_mean(parts)
        for times in _FINER:
            try:
                prior, density, info = self._multiplied(prediction, sensor, z, times)
            except PropagationError:
                if times == _FINER[-1]:
                    raise
                continue
            error = _error(density, expected, info.log_evidence)
            if error < _RESOLVED:
                break
        if times > 1:
            told = "" if error < _RESOLVED else f", and has its mean within {error:.2g} standard deviations"
            info = replace(info, status=f"the association is on {times} times the particles{told}")
        return prior, density, info

    def _updated(self, prediction, detection):
        """Prior as it was used, posterior and info of one detection."""
        return self._multiplied(prediction, *self._asked(prediction, detection))

    def _multiplied(self, prediction, sensor, z, times=1):
        density, origin = self._density(prediction), origin_of(prediction)
        origin = origin if isinstance(origin, PredictionOrigin) else PredictionOrigin()
        n_particles = times * bound(density, self.n_particles)
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


def _mixed_mean(parts):
    """Mean of a mixture of densities with weights, shape (n,); None where means are those of angles."""
    if any(density.domain is not None for _, density in parts):
        return None
    return np.sum([weight * density.mean() for weight, density in parts], axis=0) / sum(w for w, _ in parts)


def _error(density, expected, log_mass):
    """How far a posterior is off its mean, in standard deviations, or off the mass one."""
    if expected is None:
        return abs(log_mass)
    return max(abs(log_mass), np.abs((density.mean() - expected) / np.sqrt(np.diag(density.cov()))).max())


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
