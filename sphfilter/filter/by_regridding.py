"""Prior times likelihood on a regular lattice, if the acceptance test lets it (002 6.1-6.3)."""

from typing import Any

import numpy as np

from ..config import AcceptanceTest, FilterConfig
from ..core.limits import TINY
from ..density.particle_density import ParticleDensity
from ..density.resample import regrid
from ..model.measurements import Reading, is_gaussian
from .acceptance import Acceptance, test_measurement
from .reading_at_prior import ReadingAtPrior


def by_regridding(
    density: ParticleDensity, asked: ReadingAtPrior, n_particles: int, config: FilterConfig
) -> tuple[ParticleDensity, dict[str, Any]]:
    """Prior times likelihood on a regular lattice, if the acceptance test lets it (002 6.1-6.3)."""
    accepted, reason = _verdict(density, asked, config.acceptance)
    new, resampled = density, None
    if accepted:
        new, resampled = regrid(density, n_particles, config.scheme, asked.log_weight)
        log_evidence = resampled.log_evidence
    else:
        log_evidence = asked.gaussian_evidence
        if config.acceptance.on_reject == "resample":
            new, resampled = regrid(density, n_particles, config.scheme)
    return new, {
        "accepted": accepted,
        "log_evidence": log_evidence,
        "reason": reason,
        "error": np.nan,
        "evidence_error": np.nan,
        "kernel_ratio": _kernel_ratio(new),
        "resample": resampled,
        "scheme": getattr(config.scheme, "name", config.scheme),
    }


def _kernel_ratio(density: ParticleDensity) -> float:
    """Variance of the kernels over the smallest variance of the density along any direction."""
    smallest = max(np.linalg.eigvalsh(density.cov())[0], TINY)
    return float(density.kernel_variance * (density.mass @ density.h**2) / smallest)


def _verdict(density: ParticleDensity, asked: ReadingAtPrior, settings: AcceptanceTest) -> Acceptance:
    """The `Acceptance` of a reading; the test of 002 is defined for directly observed states only."""
    measurement, seen = asked.measurement, asked.seen
    if not settings.enabled:
        return Acceptance(True, "acceptance test off")
    if measurement.directly_observed is None or not is_gaussian(measurement):
        return Acceptance(True, "acceptance test skipped: the sensor does not observe states directly")
    states, scales = measurement.directly_observed
    states, scales = states[seen], scales[seen]
    variance = np.diag(measurement.noise_cov)[seen] / scales**2
    z = Reading.of(asked.z).z[seen]
    return test_measurement(density, z / scales, variance, states, settings)
