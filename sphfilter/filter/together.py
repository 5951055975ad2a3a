"""Readings of one time as one, where the last brings out what a lattice has left out of those before it."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..config import FilterConfig
from ..core.cloud.control import WRONG
from ..core.limits import LARGEST_EXPONENT
from ..density.cloud import points_of
from ..density.memory import MISSED
from ..density.particle_density import ParticleDensity
from ..density.passage import age_of, stored_key
from ..errors import ModelError, PropagationError
from ..info import UpdateInfo
from ..lattice.check import Remote, remote
from ..model.measurements import Reading, Sensor
from ..model.sensors import Sensors
from ..prediction.predict import Prediction
from .update import update

_POINTS = 2048  # of the prior, as a posterior is surveyed by: 1 / √2048 = .02 of it may be overlooked
_KEY = 5  # of an age: these points
_HIGHER = 1.0  # nats above a posterior that knows nothing of them


def used_together(
    prediction: Prediction,
    once: tuple[ParticleDensity, UpdateInfo],
    measurement: Sensor,
    z: ArrayLike | None,
    config: FilterConfig,
    n_particles: Any,
) -> tuple[ParticleDensity, UpdateInfo]:
    """The posterior of all readings of one time at once, and what is said of the last; or as they were used.

    A lattice ends where little is left of a density by one reading. Of that the next may make much more.
    """
    (posterior, info), prior = once, prediction.prior
    if prior is None or posterior.gaussian or prior.domain is not None or not info.accepted:
        return once
    if "cloud" in (prior.read_out, posterior.read_out):  # points are weighed by all of them at once
        return once
    readings = (*prediction.readings, (measurement, z))
    far = _overlooked(prior, posterior, readings, prediction.log_evidence + info.log_evidence)
    if far.mean <= MISSED * config.target_error and far.variance <= 0.5 * WRONG:
        return once
    try:
        sensors = Sensors({str(k): sensor for k, (sensor, _) in enumerate(readings)})
        numbers = np.concatenate([Reading.of(numbers).z for _, numbers in readings])
        posterior, said = update(prior, sensors, numbers, config, n_particles=n_particles)
    except (ModelError, PropagationError):
        return once
    own = {"innovation": info.innovation, "innovation_cov": info.innovation_cov, "reason": info.reason}
    return posterior, replace(said, log_evidence=said.log_evidence - prediction.log_evidence, **own)


def _overlooked(
    prior: ParticleDensity, posterior: ParticleDensity, readings: Any, log_evidence: float
) -> Remote:
    """Moments that a prior times likelihoods of readings has where its posterior knows nothing of them."""
    x, mass = points_of(prior, _POINTS, stored_key(age_of(prior), _KEY))
    log_l = sum(sensor.log_likelihood(z, x, prior.t) for sensor, z in readings) - log_evidence
    overlooked = prior.logpdf(x) + log_l - posterior.logpdf(x) > _HIGHER
    mass = mass[overlooked] * np.exp(np.minimum(log_l[overlooked], LARGEST_EXPONENT))
    return remote(posterior.mean(), posterior.cov(), x[overlooked], mass)
