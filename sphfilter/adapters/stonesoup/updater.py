"""Stone Soup's updater interface to the update: density times likelihood."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from stonesoup.base import Property
from stonesoup.types.state import State

from ..._types import Floats
from ...config import FilterConfig, checked_filter_config
from ...density.initialize import Gaussian
from ...density.particle_density import ParticleDensity
from ...density.resample import max_particles_of
from ...filter.reading_at_prior import predicted_reading
from ...filter.update_again import Update as UpdateOrigin
from ...filter.update_again import prediction_of, update_or_predict_again
from ...info import UpdateInfo
from ...model.measurements import GaussianSensor, Sensor
from ...prediction.again import Outcome
from ...validate import choice, count
from .association import Alone, Association, Part, alone, check_sharpness, resolved
from .density_updater import DensityUpdater
from .failures import ON_FAILURE, OnFailure, gaussian_on_particles, merged, multiplied
from .states import SPHState, SPHStateUpdate, Step, origin_of, started

__all__ = ["SPHUpdater"]

_START = 200  # particles of a Gaussian state, unless n_particles says otherwise


class SPHUpdater(DensityUpdater[SPHStateUpdate]):
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

    @property
    def _on_failure(self) -> OnFailure:
        return self.on_failure

    def _started(self, state: State) -> SPHState:
        n_particles = _START if self.n_particles is None else count("n_particles", self.n_particles)
        return started(state, n_particles, checked_filter_config(self.config))

    def _alone(self, state: SPHState, sensor: Sensor, z: Floats) -> Alone:
        """What a detection says alone; kept for data association, which scores it first and uses it then."""
        density, config = state.density, checked_filter_config(self.config)
        log_likelihood = sensor.log_likelihood(z, density.x, density.t)
        key = density, log_likelihood.tobytes(), config, self.n_particles
        return self._kept.result(
            key, lambda: alone(density, sensor, z, config, self.n_particles, log_likelihood)
        )

    def _multiplied(self, state: SPHState, sensor: Sensor, z: Any) -> Step:
        return _step(state, self._product(state, sensor, z, checked_filter_config(self.config)), sensor, z)

    def _product(
        self, state: SPHState, sensor: Sensor, z: Any, config: FilterConfig, times: int = 1
    ) -> Outcome[UpdateInfo]:
        origin, n_particles = (
            prediction_of(origin_of(state)),
            max_particles_of(state.density, self.n_particles),
        )
        model: Any = origin.model  # unknown where nothing was predicted, and not asked for then
        more = times * n_particles
        found = update_or_predict_again(origin, state.density, model, sensor, z, config, more)
        if times == 1:
            return found
        # on more particles now, not ever after
        return found._replace(density=replace(found.density, capacity=n_particles))

    def _associated(self, state: SPHState, missed: float, parts: Sequence[Part]) -> Step:
        density, association, z = state.density, Association(missed, parts), tuple(part.z for part in parts)
        moments = [(part.weight, *part.used) for part in parts]
        weights, means, covs = zip((missed, density.mean(), density.cov()), *moments, strict=True)
        mean = None if density.domain is not None else np.average(means, axis=0, weights=weights)

        def multiplied(times: int, config: FilterConfig) -> Outcome[UpdateInfo]:
            return self._product(state, association, z, config, times)

        check_sharpness(weights, covs, max_particles_of(density, self.n_particles))
        found = resolved(multiplied, checked_filter_config(self.config), density.dim, mean)
        return _step(state, found, association, z)

    def _gaussian(self, density: ParticleDensity, missed: float, parts: Sequence[Part]) -> ParticleDensity:
        each = [(missed, Gaussian(density.mean(), density.cov()))] if missed > 0.0 else []
        each += [(part.weight, multiplied(density, part.sensor, part.z)) for part in parts]
        bound, config = max_particles_of(density, self.n_particles), checked_filter_config(self.config)
        return gaussian_on_particles(merged(each), density, density.t, bound, config)

    def _reading(self, state: SPHState, sensor: GaussianSensor) -> tuple[Floats, Floats, Floats, Floats]:
        return state.density.mean(), *predicted_reading(state.density, sensor)

    def _said(self, density: ParticleDensity, **known: Any) -> UpdateInfo:
        usual: dict[str, Any] = {"accepted": True, "log_evidence": 0.0, "n_particles": density.n_particles}
        return UpdateInfo(**usual | known)


def _step(state: SPHState, found: Outcome[UpdateInfo], sensor: Sensor, z: Any) -> Step:
    before, after, info, _ = found
    origin = None if after is before else UpdateOrigin.after(origin_of(state), before, sensor, z)
    return Step(after, info, origin)
