"""Prior times likelihood as a cloud of weighted points, which any likelihood leaves."""

from typing import Any

from ..config import CloudScheme, FilterConfig
from ..density.cloud_posterior import cloud_posterior
from ..density.particle_density import ParticleDensity
from ..info import Code
from .asked import Asked

__all__ = ["by_cloud"]


def by_cloud(
    density: ParticleDensity, asked: Asked, n_particles: int, config: FilterConfig, why: str = ""
) -> tuple[ParticleDensity, dict[str, Any]]:
    """Prior times likelihood as a cloud of weighted points, which any likelihood leaves."""
    scheme = config.scheme if isinstance(config.scheme, CloudScheme) else CloudScheme()
    weight = asked.weight_on(density.domain)
    new, log_evidence, evidence_error = cloud_posterior(density, weight, scheme.n_points)
    new = new.noted(capacity=n_particles, lost=density.lost)
    status = f"on a cloud of {new.n_particles} points: the mean is good to {new.error:.2g} standard "
    status += f"deviations; {why}" if why else "deviations"
    return new, {
        "accepted": True,
        "log_evidence": log_evidence,
        "reason": asked.outlying,
        "error": new.error,
        "evidence_error": evidence_error,
        "status": status,
        "code": Code.CLOUD,
        "scheme": "cloud",
    }
