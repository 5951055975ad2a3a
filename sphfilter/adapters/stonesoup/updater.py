"""Stone Soup's updater interface to the update: density times likelihood."""

import datetime
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from stonesoup.base import Property
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.multihypothesis import MultipleHypothesis
from stonesoup.types.state import State
from stonesoup.types.update import Update

from ..._types import Floats
from ...config import FilterConfig, checked_filter_config
from ...density.initialize import Gaussian
from ...density.particle_density import ParticleDensity
from ...density.resample import particle_bound
from ...errors import ModelError, PropagationError
from ...filter.asked import predicted_reading
from ...filter.update_again import Update as UpdateOrigin
from ...filter.update_again import prediction_of, update_or_predict_again
from ...info import Code, UpdateInfo
from ...model.measurements import GaussianSensor, Sensor
from ...prediction.again import Outcome
from ...validate import choice, count
from .association import (
    Alone,
    Association,
    alone,
    check_sharpness,
    mixed_mean,
    one_prediction,
    probability_of,
    resolved,
)
from .density_updater import DensityUpdater
from .failures import ON_FAILURE, OnFailure, laid, merged, multiplied, said
from .recent import Recent
from .states import SPHState, SPHStateUpdate, density_of, origin_of, remember

__all__ = ["SPHUpdater"]

_KEPT = 256  # detections of late
_START = 200  # particles of a Gaussian state, unless n_particles says otherwise


class SPHUpdater(DensityUpdater):
    """Multiplies densities with likelihoods, of one detection or of an association of several.

    Parameters
    ----------
    measurement_model : MeasurementModel, GaussianMeasurement or LikelihoodMeasurement, optional
        For detections without one of their own.
    n_particles : int, optional
        Upper bound of the number of particles; by default the bound of the prediction.
    config : FilterConfig, optional
    on_failure : "gaussian", "drop" or "raise"
        What comes of a detection, or an association of several, whose posterior could not be made
        (`PropagationError`). With "gaussian" the posterior is a Gaussian: of a detection that which an
        unscented Kalman filter makes, with the density's particles as its points (of a sensor that is not
        Gaussian, that of the particles weighted by their likelihood); of an association that with the mean
        and covariance of the mixture of these. Where there is none, as with "drop". With "drop" the
        detections are left out, as if they had been missed: the posterior is the prediction, and
        `info.accepted` is False. `info.status` says so, and why; `info.flagged` is True. With "raise" the
        error is raised, and ends a run of a tracker.
    """

    n_particles: int = Property(default=None, doc="Upper bound of the number of particles.")
    config: FilterConfig = Property(default=None, doc="Settings; the default is the best measured scheme.")
    on_failure: OnFailure = Property(
        default="gaussian", doc='What an update that fails becomes: "gaussian", "drop" or "raise".'
    )

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        choice("on_failure", self.on_failure, ON_FAILURE)
        self._kept = Recent(_KEPT)

    def log_evidence(self, prediction: State, detection: Detection) -> float:
        """Logarithm of the predicted density of a detection: of the integral of density times likelihood.

        Where no lattice holds the product, which is next to nothing there, a sum over the particles is taken.
        """
        return self._alone(prediction, *self._asked(prediction, detection)).log_evidence

    def update(self, hypothesis: SingleHypothesis | MultipleHypothesis, **kwargs: Any) -> SPHStateUpdate:
        """The posterior of a hypothesis, or of an association of several (PDA, JPDA).

        Parameters
        ----------
        hypothesis : SingleHypothesis or MultipleHypothesis
            Several hypotheses have probabilities and share one prediction: the posterior is the mixture of
            their posteriors (the prior, for a miss) as one density, not merged into a Gaussian.

        Returns
        -------
        SPHStateUpdate

        Raises
        ------
        ModelError
            A detection or model that does not fit, or hypotheses of different times.
        PropagationError
            With ``on_failure="raise"``: no lattice holds the posterior. The prediction is as it was.
        """
        if isinstance(hypothesis, MultipleHypothesis):
            return self._associated(hypothesis)
        prediction, detection = hypothesis.prediction, hypothesis.measurement
        if not hypothesis:
            density = self._density(prediction)
            return self._posterior(prediction, hypothesis, _unused(density), None)
        sensor, z = self._asked(prediction, detection)
        try:
            found = self._multiplied(prediction, sensor, z)
        except PropagationError as problem:
            log_evidence = self._alone(prediction, sensor, z).log_evidence
            found = self._stand_in(problem, prediction, 0.0, [(sensor, z, 1.0)], log_evidence)
            return self._posterior(prediction, hypothesis, found, None, detection.timestamp)
        return self._posterior(prediction, hypothesis, found, (sensor, z), detection.timestamp)

    def _associated(self, hypotheses: MultipleHypothesis) -> SPHStateUpdate:
        prediction = one_prediction(hypotheses)
        density, missed, parts, means, covs = self._density(prediction), 0.0, [], [], []
        for hypothesis in hypotheses:
            weight, one = probability_of(hypothesis), None
            if hypothesis and weight > 0.0:
                sensor, z = self._asked(prediction, hypothesis.measurement)
                one = self._alone(prediction, sensor, z)
            if (
                one is None or one.mean is None or one.cov is None
            ):  # what would not be used alone is not used here
                missed += weight
            else:
                parts.append((sensor, z, weight, one.log_evidence))
                means.append((weight, one.mean))
                covs.append((weight, one.cov))
        if not parts:
            return self._posterior(prediction, hypotheses, _unused(density), None)
        association, readings = Association(missed, parts), tuple(part[1] for part in parts)
        mixed = None if density.domain is not None else mixed_mean([(missed, density.mean()), *means])

        def multiplied(times: int, config: FilterConfig) -> Outcome[UpdateInfo]:
            return self._multiplied(prediction, association, readings, times, config)

        try:
            check_sharpness([(missed, density.cov()), *covs], particle_bound(density, self.n_particles))
            found = resolved(multiplied, checked_filter_config(self.config), density.dim, mixed)
        except PropagationError as problem:
            found = self._stand_in(problem, prediction, missed, [part[:3] for part in parts])
            return self._posterior(prediction, hypotheses, found, None)
        return self._posterior(prediction, hypotheses, found, (association, readings))

    def _stand_in(
        self,
        problem: PropagationError,
        prediction: State,
        missed: float,
        parts: Sequence[tuple[Sensor, Floats, float]],
        log_evidence: float = 0.0,
    ) -> Outcome[UpdateInfo]:
        """The `Outcome` of detections with weights that no posterior could be made of, or `problem`."""
        if self.on_failure == "raise":
            raise problem
        density, config = self._density(prediction), checked_filter_config(self.config)
        known: dict[str, Any] = {"log_evidence": log_evidence}
        if self.on_failure == "gaussian":
            with suppress(ModelError, PropagationError, np.linalg.LinAlgError):
                each = [(missed, Gaussian(density.mean(), density.cov()))] if missed > 0.0 else []
                each += [(weight, multiplied(density, sensor, z)) for sensor, z, weight in parts]
                n_particles = particle_bound(density, self.n_particles)
                posterior = laid(merged(each), density, density.t, n_particles, config)
                known |= said(problem, "a Gaussian stands for the posterior")
                info = UpdateInfo(accepted=True, n_particles=posterior.n_particles, **known)
                return Outcome(density, posterior, info, n_particles)
        known |= {"reason": f"not used: {problem}", "n_particles": density.n_particles}
        info = UpdateInfo(accepted=False, code=Code.FALLBACK, status="left out", **known)
        return Outcome(density, density, info, density.n_particles)

    def _alone(self, prediction: State, sensor: Sensor, z: Floats) -> Alone:
        """What a detection says alone; kept for data association, which scores it first and uses it then."""
        density, config = self._density(prediction), checked_filter_config(self.config)
        log_likelihood = sensor.log_likelihood(z, density.x, density.t)
        key = density, log_likelihood.tobytes(), config, self.n_particles
        return self._kept.result(
            key, lambda: alone(density, sensor, z, config, self.n_particles, log_likelihood)
        )

    def _multiplied(
        self, prediction: State, sensor: Sensor, z: Any, times: int = 1, config: FilterConfig | None = None
    ) -> Outcome[UpdateInfo]:
        density, origin = self._density(prediction), prediction_of(origin_of(prediction))
        n_particles = particle_bound(density, self.n_particles)
        config = checked_filter_config(self.config) if config is None else config
        model: Any = origin.model  # unknown where nothing was predicted, and not asked for then
        found = update_or_predict_again(origin, density, model, sensor, z, config, times * n_particles)
        if times == 1:
            return found
        # on more particles now, not ever after
        return found._replace(density=replace(found.density, capacity=n_particles))

    def _posterior(
        self,
        prediction: State,
        hypothesis: SingleHypothesis | MultipleHypothesis,
        found: Outcome[UpdateInfo],
        asked: tuple[Sensor, Any] | None,
        timestamp: datetime.datetime | None = None,
    ) -> SPHStateUpdate:
        prior, density, info, _ = found
        timestamp = prediction.timestamp if timestamp is None else timestamp
        state = prediction if isinstance(prediction, SPHState) else SPHState(prior, timestamp)
        posterior = Update.from_state(
            state, density=density, timestamp=timestamp, hypothesis=hypothesis, info=info
        )
        if asked is not None and density is not prior:
            return remember(posterior, UpdateOrigin.after(origin_of(prediction), prior, *asked))
        return remember(posterior, origin_of(prediction)) if density is state.density else posterior

    def _reading(self, state: State, sensor: GaussianSensor) -> tuple[Floats, Floats, Floats, Floats]:
        density = self._density(state)
        return density.mean(), *predicted_reading(density, sensor)

    def _density(self, state: State) -> ParticleDensity:
        n_particles = _START if self.n_particles is None else count("n_particles", self.n_particles)
        return density_of(state, n_particles, checked_filter_config(self.config))


def _unused(density: ParticleDensity) -> Outcome[UpdateInfo]:
    """The `Outcome` of no detection."""
    n, reason = density.n_particles, "no detection was used"
    info = UpdateInfo(accepted=True, log_evidence=0.0, reason=reason, n_particles=n)
    return Outcome(density, density, info, n)
