"""Prior times likelihood as one exponential family, in a frame of its own."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from .._types import Floats
from ..density.as_family import family_density, family_of, unrolled
from ..density.family_posterior import family_posterior
from ..density.particle_density import ParticleDensity
from ..errors import PropagationError
from ..info import DOUBTFUL, MAY_BE_OFF, Code
from ..model.measurements import is_gaussian
from .asked import Asked, kept, predicted_reading

__all__ = ["by_family"]

_OF_MISFIT = 0.5  # part of a polynomial's misfit that errors are estimated by


def by_family(
    density: ParticleDensity, asked: Asked, degree: int, n_particles: int, most: float = math.inf
) -> tuple[ParticleDensity, dict[str, Any]]:
    """Prior times likelihood as a family of a degree.

    Raises
    ------
    PropagationError
        No family holds it, or the error of that, in standard deviations, would be above `most`.
    """
    if density.read_out == "cloud" or (density.domain is not None and density.domain.walled.any()):
        raise PropagationError(
            "one family does not hold this density, which has no smooth logarithm; use another scheme"
        )
    domain = density.domain
    weight = asked.log_weight if domain is None else lambda X: asked.log_weight(domain.wrap(X))
    prior, misfit = family_of(density, degree)
    found = family_posterior(prior, weight, _linearised(density, asked))
    if not found.error <= most:
        raise PropagationError(f"one family of degree {degree} is off by {found.error:.2g} after the reading")
    linear = getattr(asked.measurement, "H", None) is not None and not asked.measurement.angles
    new = family_density(density, found.family, capacity=n_particles, gaussian=density.gaussian and linear)
    before = math.hypot(density.error, _OF_MISFIT * misfit)
    error = math.hypot(kept(density, new) * before, found.error)
    code, status = (Code.UNRESOLVED, MAY_BE_OFF.format(3.0 * error)) if error > DOUBTFUL else (Code.OK, "ok")
    return replace(new, error=error), {
        "accepted": True,
        "log_evidence": found.log_evidence,
        "reason": asked.outlying,
        "residual": found.misfit,
        "error": error,
        "evidence_error": found.evidence_error,
        "status": status,
        "code": code,
        "scheme": "family",
    }


def _linearised(density: ParticleDensity, asked: Asked) -> tuple[Floats, Floats] | None:
    """Mean and a factor of the covariance by statistical linearisation; None without a Gaussian sensor."""
    if not is_gaussian(asked.measurement) or asked.innovation is None or asked.S is None:
        return None
    cross = predicted_reading(density, asked.measurement)[2][:, asked.seen]
    gain = np.linalg.solve(asked.S, cross.T).T
    mean, cov = unrolled(density)
    cov = cov - gain @ cross.T
    cov = 0.5 * (cov + cov.T)
    try:
        return mean + gain @ asked.innovation, np.asarray(np.linalg.cholesky(cov), np.float64)
    except np.linalg.LinAlgError:
        return None
