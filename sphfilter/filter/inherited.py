"""What readings leave of the errors that a prior has, of its mean and of what its shape is."""

import math
from typing import Any, NamedTuple

import numpy as np

from .._types import Floats
from ..core.cloud.lineages import LINES
from ..density.as_family import defect_in, may_miss, moments_on_line
from ..density.defect import OF_UNSIGNED, ROUGH, Moments, Told, read_out, read_out_after, steepness, told_at
from ..density.moments import whitener
from ..density.particle_density import ParticleDensity
from ..density.points import CloudState, Origin, Points

_LEFT = 0.25  # least part of an error² left; measured: half: no change, twice: .95, 1.06 times the work


def evidence_error_of(prior: ParticleDensity, posterior: ParticleDensity) -> float:
    """Error of the log-evidence, nats, by what a prior's mean and variances may be off by along each axis."""
    if not prior.error > 0.0:
        return 0.0
    return prior.error * _log_evidence_off((moments_on_line(prior), moments_on_line(posterior)))


def _log_evidence_off(moments: Moments) -> float:
    """By how much the log-evidence is off, nats, for each standard deviation that a prior's mean is off by.

    Its variances are off by √2 of that: what a Hermite polynomial of the second degree in log p makes of a
    variance, where one of the first shifts a mean by as much. A shift of the prior changes the evidence by
    the mean of the posterior, along the prior's axes, and a wider one by its mean square less one: that of a
    Gaussian, whatever the sensor.
    """
    (mean, cov), (own_mean, own_cov) = moments
    white = whitener(cov)
    shift, spread = white @ (own_mean - mean), white @ own_cov @ white.T
    wider = np.diag(spread) + shift**2 - 1.0
    return float(np.sqrt(np.sum(shift**2 + 0.5 * wider**2)))


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


def left_of_shape(moments: Moments) -> tuple[float, float]:
    """Part of an error of the mean that a reading leaves, or makes of a wrong shape; and what it adds, nats.

    Of that no more is known: it is taken for the lowest polynomials that are a shape, of degrees three and
    four, without a sign.
    """
    left = shift_left_by_update(moments[0][1], moments[1][1])
    return math.hypot(left, OF_UNSIGNED * steepness(moments, 2)), _log_evidence_off(moments)


def of_shape(rough: float, moments: Moments) -> float:
    """Error of the mean by which a reading finds what a family got wrong of the shape of log p."""
    return OF_UNSIGNED * rough * steepness(moments, ROUGH - 1) if rough > 0.0 else 0.0


def shift_left_by_update(prior: Floats, posterior: Floats, gaussian: bool = False) -> float:
    """Part of a shift of the mean that a reading leaves, by covariances (n, n) before and after it."""
    white = whitener(prior)
    ratio = float((white @ posterior @ white.T).trace()) / len(prior)
    return math.sqrt(min(max(ratio, 0.0 if gaussian else _LEFT), 1.0))


class Inherited(NamedTuple):
    """Errors that a posterior inherits."""

    error: float  # of the mean, in standard deviations
    evidence_error: float  # nats
    origin: Origin | None


def inherited(before: CloudState, after: Points, moments: Moments) -> Inherited:
    """What a cloud brings to its posterior, by the mean and covariance of both.

    Where the points began as a family, each is too light, or too heavy, by the defect of that where its first
    ancestor was. As long as lineages go back that far, they tell what that makes of mean and evidence.
    """
    (left, nats), origin = left_of_shape(moments), before.origin
    if origin is None or after.lineage is None:
        return Inherited(before.inherited * left, before.inherited * nats, None)
    (x, w, path, *_), (family, defect, unsigned, off, log_mass) = before.points, origin
    unsigned *= left
    if off is None:
        off = defect.at(family, x if path is None else path.x)
        log_mass = float(w @ off)
        unsigned = math.hypot(unsigned, of_shape(defect.rough(family), moments))
    told = told_at(after.x, after.w, off[after.lineage[-1] % len(off)], np.zeros((len(x[0]),) * 2), 0.0)
    errors = math.hypot(told.error, unsigned), math.hypot(told.log_mass - log_mass, unsigned * nats / left)
    origin = Origin(family, defect, unsigned, off, told.log_mass)
    return Inherited(*errors, origin if len(after.lineage) < LINES else None)
