"""What readings leave of the errors that a prior has, of its mean and of what its shape is."""

import math
from typing import Any

from .._types import Floats
from ..core._views import as_compiled
from ..core.cloud import inherited
from ..core.cloud.inherited import LEFT, log_evidence_off, shift_left, turned, whitener
from ..density.as_family import defect_in, may_miss, moments_on_line
from ..density.defect import Moments, Told, read_out, read_out_after, where
from ..density.particle_density import ParticleDensity


def evidence_error_of(prior: ParticleDensity, posterior: ParticleDensity) -> float:
    """Error of the log-evidence, nats, by what a prior's mean and variances may be off by along each axis."""
    if not prior.error > 0.0:
        return 0.0
    return float(prior.error * log_evidence_off(*where((moments_on_line(prior), moments_on_line(posterior)))))


def evidence_error_by(
    told: Told, log_mass: float, prior: ParticleDensity, posterior: ParticleDensity
) -> float:
    """Error of the log-evidence, nats, by what a prior's defect told and its mean over the posterior."""
    unsigned = evidence_error_of(prior.noted(error=told.unsigned), posterior)
    return math.hypot(log_mass - told.log_mass, unsigned)


def left_by_update(prior: ParticleDensity, posterior: ParticleDensity) -> tuple[float, float]:
    """Errors of mean and log-evidence that a prior brings to its posterior."""
    moments = moments_on_line(prior), moments_on_line(posterior)
    if not may_miss(prior):
        left = shift_left_by_update(moments[0][1], moments[1][1], posterior.gaussian)
        return left * prior.error, evidence_error_of(prior, posterior)
    family: Any = prior.family
    defect = defect_in(prior, family)
    after = read_out_after(family, defect, (posterior.x, posterior.mass), moments)
    return after.error, evidence_error_by(read_out(family, defect), after.log_mass, prior, posterior)


def of_shape(rough: float, moments: Moments) -> float:
    """Error of the mean by which a reading finds what a family got wrong of the shape of log p."""
    return float(inherited.of_shape(float(rough), *where(moments)))


def shift_left_by_update(prior: Floats, posterior: Floats, gaussian: bool = False) -> float:
    """Part of a shift of the mean that a reading leaves, by covariances (n, n) before and after it."""
    spread = turned(whitener(as_compiled(prior)), as_compiled(posterior))
    return float(shift_left(spread, 0.0 if gaussian else LEFT))
