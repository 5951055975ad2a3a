"""The measurement update: prior times likelihood, on a new lattice, with its evidence."""

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .._types import Bools, Floats
from ..config import (
    AcceptanceTest,
    CloudScheme,
    FamilyScheme,
    FilterConfig,
    PaperScheme,
    checked_filter_config,
)
from ..density.as_family import family_density, family_of, on_lattice, unrolled
from ..density.cloud_posterior import cloud_posterior
from ..density.family_posterior import family_posterior
from ..density.particle_density import ParticleDensity
from ..density.resample import particle_bound, regrid, times_likelihood
from ..errors import ModelError, PropagationError
from ..info import DOUBTFUL, MAY_BE_OFF, NOTHING_CAME, Code, UpdateInfo
from ..lattice.check import Remote, beside, remote
from ..lattice.field import extrapolated_mass, held
from ..lattice.resolved import TOLERATED, Resolved, Search
from ..lattice.walls import moved_in
from ..model.measurements import GaussianSensor, Reading, Sensor, is_gaussian
from ..prediction.family import degree_of
from ..validate import state_rows
from .acceptance import Acceptance, test_measurement
from .solutions import solutions

__all__ = ["predicted_reading", "update"]

_LEFT = 0.25  # of the square of an error of a density that is no Gaussian
_WIDER = 0.1  # of its variance, that a posterior may lack
_OUTLYING = 5.0  # standard deviations of the prediction, from which a measurement is called so
#: Standard deviations beyond the particles to which the tail of a density is trusted, and that of a Gaussian.
_TRUSTED_TAIL, _TRUSTED_GAUSSIAN = 5.0, 20.0


def update(
    density: ParticleDensity,
    measurement: Sensor,
    z: ArrayLike | None,
    config: FilterConfig | None = None,
    *,
    n_particles: int | None = None,
) -> tuple[ParticleDensity, UpdateInfo]:
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
        Upper bound of the number of particles afterwards; the density's own if not given.

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
    config, n_particles = checked_filter_config(config), particle_bound(density, n_particles)
    asked = _Asked.of(density, measurement, z)
    if not asked.seen.any():
        said: dict[str, Any] = {"accepted": True, "log_evidence": 0.0, "reason": NOTHING_CAME}
        return density, UpdateInfo(n_particles=density.n_particles, **said)
    as_family = isinstance(config.scheme, FamilyScheme)
    if density.family is not None and not as_family:
        density = on_lattice(density, n_particles)
    regrids = isinstance(config.scheme, PaperScheme) or config.acceptance.enabled
    as_cloud = density.read_out == "cloud" or isinstance(config.scheme, CloudScheme)
    by = _by_cloud if as_cloud else _by_regridding if regrids else _by_product
    by = _by_family if as_family else by
    posterior, said = by(density, asked, n_particles, config)
    return posterior, UpdateInfo(
        n_particles=posterior.n_particles, innovation=asked.innovation, innovation_cov=asked.S, **said
    )


class _Asked(NamedTuple):
    """What a reading asks of a prior: its likelihood there, and how far it is from what was predicted."""

    measurement: Sensor
    z: Any  # as given
    seen: Bools  # which of its components came
    t: float
    innovation: np.ndarray | None  # of the components that came; None for a sensor that is not Gaussian
    S: Floats | None

    @classmethod
    def of(cls, density: ParticleDensity, measurement: Sensor, z: ArrayLike | None) -> "_Asked":
        """A measurement z asked of a density."""
        seen = measurement.observed(z)
        off = _innovation(density, measurement, z, seen) if seen.any() else (None, None)
        return cls(measurement, z, seen, density.t, *off)

    def log_weight(self, X: Floats) -> Floats:
        """Log-likelihood of the states X (M, n), shape (M,)."""
        values = self.measurement.log_likelihood(self.z, X, self.t)
        if np.isnan(values).any():
            where = X[np.isnan(values)][0]
            raise ModelError(
                f"the likelihood of z = {self.z} is NaN at the state {where}; check the sensor function"
            )
        return values

    def search(self, density: ParticleDensity, config: FilterConfig) -> Search:
        """How far the posterior is searched for peaks between the prior's nodes."""
        sensor, named, states = self.measurement, getattr(self.measurement, "peaks", None), None
        if named is not None:
            states = state_rows("peaks", named(Reading.of(self.z).z), density.dim)
        elif is_gaussian(sensor) and sensor.H is None and density.field is not None:
            states = solutions(sensor, Reading.of(self.z).z, density.x, density.field.A, density.t)
        lines = not is_gaussian(sensor)
        return Search(config.most_left_out, lines, states, config.time_budget is None)

    @property
    def outlying(self) -> str:
        """A sentence where the reading lies far outside of what was predicted; else empty."""
        if self.innovation is None or self.S is None:
            return ""
        distance = np.sqrt(self.innovation @ np.linalg.solve(self.S, self.innovation))
        if not distance > _OUTLYING:
            return ""
        return f"outlying measurement: {distance:.1f} sigma from its prediction"

    @property
    def gaussian_evidence(self) -> float:
        """Log-evidence where the particles end and a sum over them knows nothing: by the prior's moments."""
        assert self.innovation is not None and self.S is not None
        squares = self.innovation @ np.linalg.solve(self.S, self.innovation)
        return -0.5 * float(squares + np.linalg.slogdet(2.0 * np.pi * self.S)[1])


def _by_product(
    density: ParticleDensity, asked: _Asked, n_particles: int, config: FilterConfig
) -> tuple[ParticleDensity, dict[str, Any]]:
    """Prior times likelihood on a lattice that follows its level set; the prior where that is a guess."""
    linear = getattr(asked.measurement, "H", None) is not None and not asked.measurement.angles
    gaussian, flag = density.gaussian and linear, asked.outlying
    found, evidence_error, error, kept = None, 0.0, 0.0, 1.0
    try:
        new, log_evidence, found = times_likelihood(
            density,
            asked.log_weight,
            n_particles,
            config.scheme,
            gaussian,
            None if linear and density.gaussian else asked.search(density, config),
        )
        evidence_error = found.off.log_mass
        if gaussian:  # a closed form knows better than a sum over nodes
            summed, log_evidence = log_evidence, asked.gaussian_evidence
            evidence_error = abs(summed - log_evidence)
        unsure = 0.0 if density.gaussian else _extrapolated(density, new)
        kept = _kept(density, new)
        error = math.hypot(kept * density.error, found.off.mean, unsure)
        unknown = _beyond(density, new)
    except PropagationError as problem:
        if not flag and config.scheme == "auto":
            why = f"no lattice holds the posterior: {problem}"
            return _by_cloud(density, asked, n_particles, config, why)
        if not flag:
            raise
        new, unknown = density, f"not used: {flag}, where no lattice holds a posterior"
        log_evidence = asked.gaussian_evidence
    far = Remote()
    if unknown:
        new = density
    else:
        far = far if gaussian else _remote(density, new, asked, log_evidence)
        new = replace(new, error=math.hypot(error, far.mean), lost=kept * density.lost)
    cut = beside(new.field, new.mean(), new.cov(), new.walls)
    left_out = cut.mass if found is None else max(cut.mass, found.left_out)
    return new, {
        "residual": new.residual or 0.0,
        "error": float(np.hypot(new.error, cut.mean)),
        "evidence_error": evidence_error if gaussian else math.hypot(evidence_error, left_out),
        "mass_left_out": left_out,
        "accepted": not unknown,
        "log_evidence": log_evidence,
        "reason": unknown or flag,
        "extrapolated": _extrapolated(density, new),
    } | ({} if unknown or found is None else _told(found, new.error, config.most_left_out, far.variance))


def _by_cloud(
    density: ParticleDensity, asked: _Asked, n_particles: int, config: FilterConfig, why: str = ""
) -> tuple[ParticleDensity, dict[str, Any]]:
    """Prior times likelihood as a cloud of weighted points, which any likelihood leaves."""
    scheme = config.scheme if isinstance(config.scheme, CloudScheme) else CloudScheme()
    domain = density.domain
    weight = asked.log_weight if domain is None else lambda X: asked.log_weight(domain.wrap(X))
    new, log_evidence, evidence_error = cloud_posterior(density, weight, scheme.n_points)
    new = replace(new, capacity=n_particles, lost=density.lost)
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
    }


def _by_family(
    density: ParticleDensity, asked: _Asked, n_particles: int, config: FilterConfig
) -> tuple[ParticleDensity, dict[str, Any]]:
    """Prior times likelihood as one exponential family, in a frame of its own."""
    if density.read_out == "cloud" or (density.domain is not None and density.domain.walled.any()):
        raise PropagationError(
            "one family does not hold this density, which has no smooth logarithm; use another scheme"
        )
    domain = density.domain
    weight = asked.log_weight if domain is None else lambda X: asked.log_weight(domain.wrap(X))
    prior, misfit = family_of(density, degree_of(config.scheme, density.dim))
    found = family_posterior(prior, weight, _linearised(density, asked))
    linear = getattr(asked.measurement, "H", None) is not None and not asked.measurement.angles
    new = family_density(density, found.family, capacity=n_particles, gaussian=density.gaussian and linear)
    error = float(np.hypot(_kept(density, new) * np.hypot(density.error, 0.5 * misfit), found.error))
    new = replace(new, error=error)
    code, status = (Code.UNRESOLVED, MAY_BE_OFF.format(3.0 * error)) if error > DOUBTFUL else (Code.OK, "ok")
    return new, {
        "accepted": True,
        "log_evidence": found.log_evidence,
        "reason": asked.outlying,
        "residual": found.misfit,
        "error": error,
        "evidence_error": found.evidence_error,
        "status": status,
        "code": code,
    }


def _linearised(density: ParticleDensity, asked: _Asked) -> tuple[Floats, Floats] | None:
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


def _remote(prior: ParticleDensity, posterior: ParticleDensity, asked: _Asked, log_evidence: float) -> Remote:
    """What the prior's nodes beyond a posterior's lattice would add to it."""
    if posterior.field is None:
        return Remote()
    beyond = ~held(posterior.field, moved_in(posterior.walls, posterior.field.A, prior.x))
    if not beyond.any():
        return Remote()
    X = prior.x[beyond]
    mass = prior.mass[beyond] * np.exp(np.clip(asked.log_weight(X) - log_evidence, -700.0, 700.0))
    return remote(posterior.mean(), posterior.cov(), X, mass)


def _told(found: Resolved, error: float, most_left_out: float, wider: float) -> dict[str, Any]:
    """Code and status of an update whose lattice is finer than usual, or not fine or wide enough."""
    code, said = Code.OK, []
    if found.times > 1:
        code, said = Code.FINER, [f"the posterior is on {found.times} times the particles"]
    wrong = max(found.off.residual, found.off.log_mass)
    if wrong > TOLERATED:
        said.append(f"the lattice does not resolve the posterior: its density is off by {wrong:.2g}")
    if found.left_out > most_left_out:
        said.append(f"the lattice leaves out a probability of {found.left_out:.2g} that was found elsewhere")
    if wider > _WIDER:
        said.append(f"what little is left out far away would widen the density: its variance by {wider:.0%}")
    if error > DOUBTFUL:
        said.append(MAY_BE_OFF.format(3.0 * error))
    if wrong > TOLERATED or found.left_out > most_left_out or wider > _WIDER or error > DOUBTFUL:
        code |= Code.UNRESOLVED
    return {"code": code, "status": "; ".join(said) or "ok"}


def _by_regridding(
    density: ParticleDensity, asked: _Asked, n_particles: int, config: FilterConfig
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
        "kernel_ratio": _kernel_ratio(new),
        "resample": resampled,
    }


def _extrapolated(prior: ParticleDensity, posterior: ParticleDensity) -> float:
    """Probability of a posterior where its prior has no particles."""
    if prior.field is None:
        return 0.0
    return extrapolated_mass(prior.field, posterior.x, posterior.mass, prior.walls)


def _kept(prior: ParticleDensity, posterior: ParticleDensity) -> float:
    """Part of an error of the mean, in standard deviations, that an update leaves of it.

    What is wrong with the weights of a density's pieces, or its shape, no reading forgets as fast as a shift.
    """
    ratio = np.trace(np.linalg.solve(prior.cov(), posterior.cov())) / prior.dim
    return float(np.sqrt(np.clip(ratio, 0.0 if posterior.gaussian else _LEFT, 1.0)))


def _beyond(prior: ParticleDensity, posterior: ParticleDensity) -> str:
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


def _kernel_ratio(density: ParticleDensity) -> float:
    """Variance of the kernels over the smallest variance of the density along any direction."""
    smallest = max(np.linalg.eigvalsh(density.cov())[0], 1e-300)
    return float(density.kernel_variance * (density.mass @ density.h**2) / smallest)


def _verdict(density: ParticleDensity, asked: _Asked, settings: AcceptanceTest) -> Acceptance:
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


def _innovation(
    density: ParticleDensity, measurement: Sensor, z: Any, seen: Bools
) -> tuple[Floats, Floats] | tuple[None, None]:
    """z minus its predicted mean, and the predicted covariance plus R; None for a general likelihood."""
    if not is_gaussian(measurement):
        return None, None
    predicted, S, _ = predicted_reading(density, measurement)
    both = np.ix_(seen, seen)
    return measurement.residual(Reading.of(z).z, predicted)[seen], S[both] + measurement.noise_cov[both]


def predicted_reading(density: ParticleDensity, measurement: GaussianSensor) -> tuple[Floats, Floats, Floats]:
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
