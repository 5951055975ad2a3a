"""Prior times likelihood as a cloud of weighted points, which any likelihood leaves."""

import math
from typing import Any

import numpy as np

from ..config import CloudScheme, FilterConfig
from ..density.as_cloud import cloud_of
from ..density.cloud import systematic
from ..density.particle_density import ParticleDensity
from ..density.passage import key_at
from ..density.points import Points
from ..errors import PropagationError
from ..info import DOUBTFUL, Code
from ..prediction.cloud import apart, as_points
from .asked import Asked, kept
from .guided import weighed

__all__ = ["by_cloud"]

_FEW = 50.0  # independent points, below which a shadow that sees the same few cannot tell the error
_WRONG = 0.2  # of a variance, from which it is said
_READING = 2  # of a key: the draws of a reading


def by_cloud(
    density: ParticleDensity, asked: Asked, n_particles: int, config: FilterConfig, why: str = ""
) -> tuple[ParticleDensity, dict[str, Any]]:
    """Prior times likelihood as a cloud of weighted points, and what the update says."""
    scheme = config.scheme if isinstance(config.scheme, CloudScheme) else CloudScheme()
    state = as_points(density, scheme.n_points)
    t, domain = density.t, density.domain
    found = weighed(state.points, (asked,), key_at(t, _READING), domain)
    if not math.isfinite(found.log_evidence):
        raise PropagationError(
            "prior times likelihood is zero wherever the prior has particles: check the measurement, its "
            "unit and its noise"
        )
    beside = weighed(state.shadow, (asked,), key_at(t, _READING + 1), domain)
    shadow, told = beside.points, state.told
    if math.isfinite(beside.log_evidence):
        off = found.log_evidence - beside.log_evidence
        told = told.after(*apart(found.points, shadow, domain, found.moments, beside.moments), off**2)
    else:  # none of the few sees the reading: a part of the many goes on beside them
        shadow = _part_of(found.points, len(state.shadow.w))
        told = told.after(1.0, 1.0, 1.0)
    errors, pace = told.errors, state.pace
    after = pace._replace(legs=0, bias=0.0)
    state = state._replace(points=found.points, shadow=shadow, told=told, pace=after)
    new = cloud_of(density, state, found.moments, capacity=n_particles, lost=density.lost)
    if state.inherited > 0.0:
        state = state._replace(inherited=state.inherited * kept(density, new))
    error = math.hypot(max(errors.mean, _least(found.effective)), pace.bias, state.inherited)
    new = new.noted(cloud=state, error=error)
    status = f"on a cloud of {new.n_particles} points: the mean is good to {error:.2g} standard deviations"
    code, doubt = Code.CLOUD, 2.0 * errors.variance
    if doubt > _WRONG and error < DOUBTFUL:  # which is said of the mean already
        status, code = f"{status}, but the variance may be off by {doubt:.0%}", code | Code.UNRESOLVED
    return new, {
        "accepted": True,
        "log_evidence": found.log_evidence,
        "reason": asked.outlying,
        "error": error,
        "evidence_error": max(errors.log_evidence, _least(found.families)),
        "status": f"{status}; {why}" if why else status,
        "code": code,
        "scheme": "cloud",
    }


def _least(number: float) -> float:
    """Error of an average of so many independent points, where they are few."""
    return 1.0 / math.sqrt(number) if number < _FEW else 0.0


def _part_of(points: Points, count: int) -> Points:
    """Some of a posterior's points, each as heavy as the others."""
    return Points(points.x[systematic(points.w, count)], np.full(count, 1.0 / count))
