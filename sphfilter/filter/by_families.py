"""Prior times likelihood as a few families, each in a frame of its own."""

import math
from typing import Any

from ..core.limits import LITTLE
from ..density.as_family import as_polynomials, families_density, moments_on_line
from ..density.families import HEAVY, merged_families
from ..density.families_posterior import AWAY, families_posterior
from ..density.particle_density import ParticleDensity
from .by_family import errors_beyond_nodes
from .inherited import left_by_update
from .reading_at_prior import ReadingAtPrior, info_fields


def by_families(
    density: ParticleDensity, asked: ReadingAtPrior, degree: int, allowed: float
) -> tuple[ParticleDensity, dict[str, Any]]:
    """Prior times likelihood as families, as few as add no more than `allowed`; one of a degree if that does.

    Raises
    ------
    PropagationError
        No families hold it, or other states explain the reading, too.
    """
    prior = density.families
    assert prior is not None
    found = families_posterior(prior, asked.log_weight, LITTLE / AWAY * allowed)
    new = families_density(density, found.families)
    missed, nats = 0.0, 0.0
    if not asked.linear:
        both = (prior.log_p, moments_on_line(density)), (found.families.log_p, moments_on_line(new))
        missed, nats = errors_beyond_nodes(density, asked, *both, found.log_evidence)
    left, evidence_error = left_by_update(density, new)
    error = math.hypot(left, found.error, missed)
    new = new.noted(error=error)
    one = as_polynomials(new, degree, allowed)
    if one is None:
        few, change = merged_families(found.families, allowed, HEAVY)
        one = families_density(new, few, error=math.hypot(error, change))
    told = found.log_evidence, one.error, math.hypot(found.evidence_error, evidence_error, nats)
    return one, info_fields(asked, "pieces", *told)
