"""A sum of Gaussians times a linear reading, exactly."""

import math

from scipy.special import logsumexp

from ..core.kalman import conditioned
from ..density.as_family import pieces_density
from ..density.memory import error_budget
from ..density.particle_density import ParticleDensity
from ..density.pieces import OF_CHANGE, Pieces, merged
from ..lattice.level_set import root_of
from ..model.measurements import block, is_gaussian
from .inherited import left_by_update
from .reading_at_prior import Posterior, ReadingAtPrior, info_fields

_LIGHT = 1e-5  # what the lightest, dropped, carry together; measured: half, twice move means by 7e-4 at most


def by_pieces(density: ParticleDensity, asked: ReadingAtPrior, target: float) -> Posterior:
    """Each Gaussian of a sum times the reading of a linear sensor by Kalman's rule; those that it makes alike
    are merged, as far as a target error allows, standard deviations, rms over the states.
    """
    prior, sensor = density.pieces, asked.measurement
    assert prior is not None and is_gaussian(sensor) and sensor.H is not None
    off = sensor.residual(asked.numbers, sensor.predict(prior.mean, density.t))[:, asked.seen]
    H, R = sensor.H[asked.seen], block(sensor.noise_cov, asked.seen)
    mean, cov, log_p = conditioned(prior.mean, prior.cov, off, H, R)
    log_w = prior.log_w + log_p
    found = Pieces(log_w, mean, root_of(cov))
    found = found.some(found.heavy(_LIGHT)).normalised()
    pieces, change = merged(found, error_budget(density.error, target) / OF_CHANGE)
    new = pieces_density(density, pieces)
    left, evidence_error = left_by_update(density, new)
    error = math.hypot(left, OF_CHANGE * change)
    told = float(logsumexp(log_w)), error, evidence_error
    return new.noted(error=error), info_fields(asked, "pieces", *told)
