"""Prior times likelihood on a regular lattice, if the acceptance test lets it (002 6.1-6.3)."""

import numpy as np

from .._types import Floats, Ints
from ..config import AcceptanceTest, FilterConfig
from ..core.limits import TINY
from ..density.particle_density import ParticleDensity
from ..density.resample import regrid
from ..model.measurements import is_gaussian
from .reading_at_prior import Posterior, ReadingAtPrior


def by_regridding(
    density: ParticleDensity, asked: ReadingAtPrior, n_particles: int, config: FilterConfig
) -> Posterior:
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
    smallest = max(np.linalg.eigvalsh(new.cov())[0], TINY)  # variance along any direction
    return new, {
        "accepted": accepted,
        "log_evidence": log_evidence,
        "reason": reason,
        "error": np.nan,
        "evidence_error": np.nan,
        "kernel_ratio": float(new.kernel_variance * (new.mass @ new.h**2) / smallest),
        "resample": resampled,
        "scheme": getattr(config.scheme, "name", config.scheme),
    }


def _verdict(density: ParticleDensity, asked: ReadingAtPrior, settings: AcceptanceTest) -> tuple[bool, str]:
    """Whether a reading is accepted; and why not, or why it was not tested: states must be read directly."""
    measurement, seen = asked.measurement, asked.seen
    if not settings.enabled:
        return True, "acceptance test off"
    if measurement.directly_observed is None or not is_gaussian(measurement):
        return True, "acceptance test skipped: the sensor does not observe states directly"
    states, scales = measurement.directly_observed
    states, scales = states[seen], scales[seen]
    variance = np.diag(measurement.noise_cov)[seen] / scales**2
    refused = _refused(density, asked.numbers[seen] / scales, variance, states, settings)
    return not refused, refused


def _refused(
    density: ParticleDensity, z: Floats, variance: Floats, states: Ints, settings: AcceptanceTest
) -> str:
    """Sentence on an expected posterior that lies where the prior has no particles (002 (60)-(62)), or none.

    z and variance (k,) are the measured values of the states of these numbers (k,), and their noise
    variances. The posterior is compared with the prior's domain along each of these states.
    """
    mean, prior_variance = density.mean()[states], np.diag(density.cov())[states]
    total = prior_variance + variance
    mu = (z * prior_variance + mean * variance) / total  # (60)
    half = settings.z_pi * np.sqrt(prior_variance * variance / total)
    low, high = density.x[:, states].min(axis=0), density.x[:, states].max(axis=0)
    above, below = mu + half - high, low - (mu - half)
    outside = np.where(mu >= mean, above, below) > density.mean_support  # (61)
    edge = np.maximum(above, 0.0) + np.maximum(below, 0.0)
    on_edge = edge > settings.f_edge * 2.0 * half  # (62)
    for which, where in ((outside, "outside the particles"), (on_edge, "on the edge kernels")):
        for d in np.flatnonzero(which):
            return (
                f"the posterior expected for state {states[d]}, {mu[d]:.4g} ± {half[d]:.3g}, lies too far "
                f"{where}, which span {low[d]:.4g} to {high[d]:.4g}"
            )
    return ""
