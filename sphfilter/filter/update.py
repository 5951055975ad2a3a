"""The measurement update: prior times likelihood, on a new lattice, with its evidence."""

import numpy as np

from ..config import PaperScheme, checked_filter_config
from ..density.resample import particle_bound, regrid, times_likelihood
from ..errors import ModelError, PropagationError
from ..info import UpdateInfo
from ..lattice.field import extrapolated_mass
from .acceptance import test_measurement

__all__ = ["predicted_reading", "update"]

_OUTLYING = 5.0  # standard deviations of the prediction, from which a measurement is called so
#: Standard deviations beyond the particles to which the tail of a density is trusted, and that of a Gaussian.
_TRUSTED_TAIL, _TRUSTED_GAUSSIAN = 5.0, 20.0


def update(density, measurement, z, config=None, *, n_particles=None):
    """Multiply a density by the likelihood of z and put it on a new lattice (002 6.1-6.3).

    Parameters
    ----------
    density : ParticleDensity
        The prior at the time of the measurement.
    measurement : GaussianMeasurement or LikelihoodMeasurement
    z : array_like, shape (k,), or None
        NaN components are missing; None or all NaN leaves the density as it is.
    config : FilterConfig, optional
    n_particles : int, optional
        Upper bound of the number of particles afterwards; that of the density if not given.

    Returns
    -------
    ParticleDensity, UpdateInfo

    Raises
    ------
    ModelError
        z of the wrong length, or a likelihood that is NaN.
    PropagationError
        The likelihood is zero wherever the prior has particles, or no lattice holds the posterior of a
        measurement that is not outlying.

    Examples
    --------
    >>> import sphfilter as sf
    >>> prior = sf.initialize(sf.Gaussian([0.0], [[1.0]]), n_particles=100)
    >>> posterior, info = sf.update(prior, sf.GaussianMeasurement([[1.0]], [[1.0]]), [2.0])
    >>> print(f"{posterior.mean()[0]:.4f} {posterior.cov()[0, 0]:.4f} {info.log_evidence:.4f}")
    1.0000 0.5000 -2.2655
    """
    config = checked_filter_config(config)
    n_particles = particle_bound(density, n_particles)
    seen = measurement.observed(z)
    if not seen.any():
        info = UpdateInfo(
            accepted=True, log_evidence=0.0, reason="no measurement came", n_particles=density.n_particles
        )
        return density, info

    def log_weight(X):
        values = measurement.log_likelihood(z, X, density.t)
        if np.isnan(values).any():
            where = X[np.isnan(values)][0]
            raise ModelError(
                f"the likelihood of z = {z} is NaN at the state {where}; check the sensor function"
            )
        return values

    innovation, S = _innovation(density, measurement, z, seen)
    if not isinstance(config.scheme, PaperScheme) and not config.acceptance.enabled:
        linear = getattr(measurement, "H", None) is not None and not measurement.angles
        flag = _flag(innovation, S)
        try:
            new, log_evidence = times_likelihood(
                density, log_weight, n_particles, config.scheme, density.gaussian and linear
            )
            unknown = _beyond(density, new)
        except PropagationError:
            if not flag:
                raise
            new, unknown = density, f"not used: {flag}, where no lattice holds a posterior"
            log_evidence = _gaussian_evidence(innovation, S)
        info = UpdateInfo(
            accepted=not unknown,
            log_evidence=log_evidence,
            innovation=innovation,
            innovation_cov=S,
            reason=unknown or flag,
            n_particles=density.n_particles if unknown else new.n_particles,
            extrapolated=0.0 if density.field is None else extrapolated_mass(density.field, new.x, new.mass),
        )
        return (density if unknown else new), info
    accepted, reason = _verdict(density, measurement, z, seen, config.acceptance)
    if accepted:
        new, resampled = regrid(density, n_particles, config.scheme, log_weight)
        log_evidence = resampled.log_evidence
    else:
        new, resampled = density, None
        log_evidence = _gaussian_evidence(innovation, S)
        if config.acceptance.on_reject == "resample":
            new, resampled = regrid(density, n_particles, config.scheme)
    info = UpdateInfo(
        accepted=accepted,
        log_evidence=log_evidence,
        innovation=innovation,
        innovation_cov=S,
        reason=reason,
        n_particles=new.n_particles,
        kernel_ratio=_kernel_ratio(new),
        resample=resampled,
    )
    return new, info


def _gaussian_evidence(innovation, S):
    """Log-evidence where the particles end and a sum over them knows nothing: by the prior's moments."""
    from scipy.stats import multivariate_normal  # on use: import time

    return float(multivariate_normal.logpdf(innovation, cov=S))


def _beyond(prior, posterior):
    """Say so where the posterior lies so far outside of the prior's particles that its shape is a guess."""
    L = np.linalg.cholesky(prior.cov())
    away = np.linalg.norm(np.linalg.solve(L, posterior.mean() - prior.mean()))
    if away < _TRUSTED_TAIL:
        return ""
    edge = np.linalg.norm(np.linalg.solve(L, (prior.x - prior.mean()).T), axis=0).max()
    if away - edge < (_TRUSTED_GAUSSIAN if prior.gaussian else _TRUSTED_TAIL):
        return ""
    return (
        f"not used: the posterior would lie {away - edge:.0f} standard deviations outside of the prior's "
        f"particles, where its density is a guess"
    )


def _flag(innovation, S):
    """Say so where a reading lies far outside of what was predicted."""
    if innovation is None:
        return ""
    distance = np.sqrt(innovation @ np.linalg.solve(S, innovation))
    return f"outlying measurement: {distance:.1f} sigma from its prediction" if distance > _OUTLYING else ""


def _kernel_ratio(density):
    """Variance of the kernels over the smallest variance of the density along any direction."""
    smallest = max(np.linalg.eigvalsh(density.cov())[0], 1e-300)
    return float(density.kernel_variance * (density.mass @ density.h**2) / smallest)


def _verdict(density, measurement, z, seen, settings):
    """(accepted, reason); the test of 002 is defined for directly observed states only."""
    if not settings.enabled:
        return True, "acceptance test off"
    direct = measurement.directly_observed
    if direct is None:
        return True, "acceptance test skipped: the sensor does not observe states directly"
    states, scales = (part[seen] for part in direct)
    values = np.atleast_1d(np.asarray(z, dtype=float))[seen] / scales
    variance = np.diag(measurement.noise_cov)[seen] / scales**2
    return test_measurement(density, values, variance, states, settings)


def _innovation(density, measurement, z, seen):
    """z minus its predicted mean, and the predicted covariance plus R; None for a general likelihood."""
    if measurement.noise_cov is None:
        return None, None
    reading, S, _ = predicted_reading(density, measurement)
    z = np.atleast_1d(np.asarray(z, dtype=float))
    both = np.ix_(seen, seen)
    return measurement.residual(z, reading)[seen], S[both] + measurement.noise_cov[both]


def predicted_reading(density, measurement):
    """Mean (k,) and covariance (k, k) of the noise-free reading, and its covariance with the state (n, k).

    Angles are averaged around the reading of the mean.
    """
    reference = measurement.predict(density.mean(), density.t)[0]
    if measurement.H is not None and not measurement.angles:
        H, cov = measurement.H, density.cov()
        return reference, H @ cov @ H.T, cov @ H.T
    around = measurement.residual(measurement.predict(density.x, density.t), reference)
    mean = density.mass @ around
    weighted = (around - mean) * density.mass[:, None]
    from_mean = density.x - density.mean()
    if density.domain is not None:
        from_mean = density.domain.nearest(from_mean)
    return reference + mean, weighted.T @ (around - mean), from_mean.T @ weighted
