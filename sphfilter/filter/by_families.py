"""Prior times likelihood as a few families, each in a frame of its own."""

import math
from typing import Any

from ..density.as_family import families_density, settled, unrolled
from ..density.families_posterior import families_posterior
from ..density.gathering import gathered
from ..density.particle_density import ParticleDensity
from .asked import Asked, kept, said_of
from .by_family import elsewhere

_LIGHT = 0.03  # of the error that may be added, over the share of a family that is dropped
_HEAVY = 0.1  # share of families, below which one in their place may be off by more

__all__ = ["by_families"]


def by_families(
    density: ParticleDensity, asked: Asked, degree: int, allowed: float
) -> tuple[ParticleDensity, dict[str, Any]]:
    """Prior times likelihood as families, as few as add no more than `allowed`; one of a degree if that does.

    Raises
    ------
    PropagationError
        No families hold it, or other states explain the reading, too.
    """
    prior = density.families
    assert prior is not None
    found = families_posterior(prior, asked.log_weight, _LIGHT * allowed)
    new = families_density(density, found.families)
    missed = 0.0
    if not asked.linear:
        both = (prior.log_p, unrolled(density)), (found.families.log_p, unrolled(new))
        missed = elsewhere(density, asked, *both, found.log_evidence)
    error = math.hypot(kept(density, new) * density.error, found.error, missed)
    new = new.noted(error=error)
    one = settled(new, degree, allowed)
    if one is None:
        few, change = gathered(found.families, allowed, _HEAVY)
        one = families_density(new, few, error=math.hypot(error, change))
    return one, said_of(asked, "pieces", found.log_evidence, one.error, found.evidence_error)
