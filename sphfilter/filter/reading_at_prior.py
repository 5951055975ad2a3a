"""A reading beside a prior: its likelihood, and how far it is from what was predicted."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .._types import Bools, Floats, OfStates
from ..config import FilterConfig
from ..core.limits import TINY
from ..density.as_family import moments_on_line
from ..density.particle_density import ParticleDensity
from ..density.points import moments
from ..errors import ModelError
from ..info import DOUBTFUL, MAY_BE_OFF, Code
from ..lattice.resolved import Search
from ..model.domain import Domain
from ..model.measurements import GaussianSensor, Reading, Sensor, block, is_gaussian
from ..validate import state_rows
from .solutions import solutions

__all__ = [
    "OUTLYING",
    "ReadingAtPrior",
    "amplified_in_tail",
    "error_left_by_update",
    "evidence_error_of",
    "info_fields",
    "predicted_reading",
    "reading_of",
    "shift_left_by_update",
]

_LEFT = 0.25  # least part of an error² left; measured: half: no change, twice: .95, 1.06 times the work
OUTLYING = 5.0  # standard deviations from its prediction: 2 Φ(-5) = 6e-7 of numbers read lie so far out


class ReadingAtPrior(NamedTuple):
    """A reading beside a prior: its likelihood there, and how far it is from what was predicted."""

    measurement: Sensor
    z: Any  # as given
    seen: Bools  # which of its components came
    t: float
    innovation: np.ndarray | None  # of the components that came; None for a sensor that is not Gaussian
    S: Floats | None
    cross: Floats | None  # covariance of the state with the reading predicted, (n, k)

    @classmethod
    def of(cls, density: ParticleDensity, measurement: Sensor, z: ArrayLike | None) -> "ReadingAtPrior":
        """The reading z of a measurement beside a density."""
        seen = measurement.observed(z)
        off = _innovation(density, measurement, z, seen) if seen.any() else (None, None, None)
        return cls(measurement, z, seen, density.t, *off)

    def log_weight(self, X: Floats) -> Floats:
        """Log-likelihood of the states X (M, n), shape (M,)."""
        values = self.measurement.log_likelihood(self.z, X, self.t)
        if np.count_nonzero(np.isnan(values)):
            where = X[np.isnan(values)][0]
            raise ModelError(
                f"the likelihood of z = {self.z} is NaN at the state {where}; check the sensor function"
            )
        return values

    def weight_on(self, domain: Domain | None) -> OfStates:
        """Log-likelihood as a function of states that need not lie in a domain yet."""
        return self.log_weight if domain is None else lambda X: self.log_weight(domain.wrap(X))

    @property
    def numbers(self) -> Floats:
        """z as numbers (k,), NaN where none came."""
        return Reading.of(self.z).z

    @property
    def linear(self) -> bool:
        """Whether the reading is linear in the state."""
        return getattr(self.measurement, "H", None) is not None and not self.measurement.angles

    def search(self, density: ParticleDensity, config: FilterConfig) -> Search:
        """How far the posterior is searched for peaks between the prior's nodes."""
        cell = None if density.field is None else density.field.A
        states = None if cell is None and self.named is None else self.explained(density.x, cell)
        lines = not is_gaussian(self.measurement)
        return Search(config.most_left_out, lines, states, config.time_budget is None)

    @property
    def named(self) -> Any:
        """The function of a sensor that names the states of a reading, if it has one."""
        return getattr(self.measurement, "peaks", None)

    def explained(self, X: Floats, cell: Any) -> Floats | None:
        """States that explain the reading: those that the sensor names, or found from states X (N, n).

        `cell` (n, n) holds in its columns how far apart those are; None where they resolve the likelihood.
        """
        sensor = self.measurement
        if self.named is not None:
            return state_rows("peaks", self.named(self.numbers), X.shape[1])
        if is_gaussian(sensor) and sensor.H is None:
            return solutions(sensor, self.numbers, X, cell, self.t)
        return None

    @property
    def outlying(self) -> str:
        """A sentence where the reading lies far outside of what was predicted; else empty."""
        if self.innovation is None or self.S is None:
            return ""
        distance = np.sqrt(self.innovation @ np.linalg.solve(self.S, self.innovation))
        if not distance > OUTLYING:
            return ""
        return f"outlying measurement: {distance:.1f} sigma from its prediction"

    @property
    def gaussian_evidence(self) -> float:
        """Log-evidence where the particles end and a sum over them knows nothing: by the prior's moments."""
        assert self.innovation is not None and self.S is not None
        squares = self.innovation @ np.linalg.solve(self.S, self.innovation)
        return -0.5 * float(squares + np.linalg.slogdet(2.0 * np.pi * self.S)[1])


def _innovation(
    density: ParticleDensity, measurement: Sensor, z: Any, seen: Bools
) -> tuple[Floats, Floats, Floats] | tuple[None, None, None]:
    """z minus its mean, the covariance of that, and with the state; None each for a general likelihood."""
    if not is_gaussian(measurement):
        return None, None, None
    predicted, S, cross = predicted_reading(density, measurement)
    off = measurement.residual(Reading.of(z).z, predicted)[seen]
    return off, block(S, seen) + block(measurement.noise_cov, seen), cross[:, seen]


def predicted_reading(density: ParticleDensity, measurement: GaussianSensor) -> tuple[Floats, Floats, Floats]:
    """Mean (k,) and covariance (k, k) of the noise-free reading, and its covariance with the state (n, k).

    Angles are averaged around the reading of the mean.
    """
    summed = density.mean(), density.cov()
    return reading_of(measurement, density.t, density.x, density.mass, summed, density.domain)


def reading_of(
    measurement: GaussianSensor,
    t: float,
    x: Floats,
    mass: Floats,
    summed: tuple[Floats, Floats],
    domain: Domain | None = None,
) -> tuple[Floats, Floats, Floats]:
    """Mean, covariance and cross-covariance of the noise-free reading of states x (N, n), mass (N,)."""
    reference = measurement.predict(summed[0], t)[0]
    if measurement.H is not None and not measurement.angles:
        H, cov = measurement.H, summed[1]
        return reference, H @ cov @ H.T, cov @ H.T
    around = np.ascontiguousarray(measurement.residual(measurement.predict(x, t), reference))
    states = x if domain is None else domain.nearest(x - summed[0])
    mean, cov = moments(around, mass)
    return reference + mean, cov, np.einsum("i,ia,ik->ak", mass, states, around - mean)


def info_fields(
    densities: tuple[ParticleDensity, ParticleDensity],
    asked: ReadingAtPrior,
    scheme: str,
    log_evidence: float,
    error: float,
    own: float,
) -> dict[str, Any]:
    """Fields of the info of an update of a prior to a posterior, with a flag where the mean is in doubt.

    Both are families or Gaussians. Of the evidence's error that is `own` which the update makes, beside that
    of the prior.
    """
    code, status = (Code.UNRESOLVED, MAY_BE_OFF.format(3.0 * error)) if error > DOUBTFUL else (Code.OK, "ok")
    return {
        "accepted": True,
        "log_evidence": log_evidence,
        "reason": asked.outlying,
        "error": error,
        "evidence_error": math.hypot(own, evidence_error_of(*densities)),
        "status": status,
        "code": code,
        "scheme": scheme,
    }


def evidence_error_of(prior: ParticleDensity, posterior: ParticleDensity) -> float:
    """Error of the log-evidence, nats, by what the prior's mean and variances may be off by along each axis.

    That is its error, in standard deviations, and √2 of it: what a Hermite polynomial of the second degree in
    log p makes of a variance, where one of the first shifts a mean by as much. A shift of the prior changes
    the evidence by the mean of the posterior, along the prior's axes, and a wider one by its mean square
    less one: that of a Gaussian, whatever the sensor.
    """
    if not prior.error > 0.0:
        return 0.0
    (mean, cov), (own_mean, own_cov) = moments_on_line(prior), moments_on_line(posterior)
    white = np.linalg.inv(np.linalg.cholesky(cov))
    shift, spread = white @ (own_mean - mean), white @ own_cov @ white.T
    wider = np.diag(spread) + shift**2 - 1.0
    return float(prior.error * np.sqrt(np.sum(shift**2 + 0.5 * wider**2)))


def error_left_by_update(prior: ParticleDensity, posterior: ParticleDensity) -> float:
    """Part of an error of the mean, in standard deviations, that an update leaves of it.

    What is wrong with the weights of a density's pieces, or its shape, no reading forgets as fast as a shift.
    """
    left = shift_left_by_update(prior.cov(), posterior.cov(), posterior.gaussian)
    if prior.family is None or prior.gaussian:
        return left
    out = max(left, amplified_in_tail(prior, posterior, prior.family.degree + 1))
    n = prior.dim  # and it is along one direction
    return math.sqrt(((n - 1) * left**2 + out**2) / n)


def shift_left_by_update(prior: Floats, posterior: Floats, gaussian: bool = False) -> float:
    """Part of a shift of the mean that a reading leaves, by covariances (n, n) before and after it."""
    ratio = float(np.linalg.solve(prior, posterior).trace()) / len(prior)
    return math.sqrt(min(max(ratio, 0.0 if gaussian else _LEFT), 1.0))


def amplified_in_tail(prior: ParticleDensity, posterior: ParticleDensity, degree: int) -> float:
    """Part of an error of the mean that a reading makes of what is wrong with a prior's shape, along its way.

    That is taken for Hermite's polynomials of a degree and the next: where a reading leads far out, they are
    steep, and what was wrong with a tail is wrong with the mean.
    """
    (mean, cov), (own_mean, own_cov) = moments_on_line(prior), moments_on_line(posterior)
    way = np.linalg.solve(np.linalg.cholesky(cov), (posterior.x - mean).T)
    shift = posterior.mass @ way.T
    along = (shift / max(float(np.linalg.norm(shift)), TINY)) @ way
    y = np.linalg.solve(np.linalg.cholesky(own_cov), (posterior.x - own_mean).T)
    below, last = np.ones_like(along), along  # of degrees zero and one
    for k in range(1, degree + 1):
        below, last = last, last * along - below * k
    size = [math.sqrt(math.factorial(k)) for k in (degree, degree + 1)]
    out = (y * posterior.mass) @ (np.array([below, last]).T / size)
    return math.sqrt(float((out * out).sum(axis=0).max()))
