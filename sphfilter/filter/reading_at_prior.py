"""A reading beside a prior: its likelihood, and how far it is from what was predicted."""

from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from .._types import Bools, Floats, OfStates
from ..config import FilterConfig
from ..core.kalman import log_normal
from ..core.limits import OUTLYING, STEP, TINY
from ..density.moments import moments
from ..density.particle_density import ParticleDensity
from ..errors import ModelError
from ..info import DOUBTFUL, Code, may_be_off
from ..lattice.resolved import Search
from ..model.domain import Domain
from ..model.measurements import GaussianSensor, Reading, Sensor, block, is_gaussian
from ..validate import state_rows

#: A density after a reading, and fields of the info of that.
Posterior: TypeAlias = tuple[ParticleDensity, dict[str, Any]]
#: Standard deviations of noise that some readings of nodes are bent by in a cell, where they are outlying
#: for each other. Measured: half changes no run, twice errors by .8.
_BENT = 1.0
_ITERATIONS = 8  # measured: half and twice change errors of four sharp readings by .6 to 1.4 times
_DAMPED = 1e-6  # of the largest curvature; measured: with 1e-8, 1e-4 errors are .7 to 1.4 times as large


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
        found = cls(measurement, z, seen, density.t, *off)
        if off[0] is not None and np.isnan(off[0]).any():
            found.log_weight(density.x)  # says where h has no value, before something is aimed at a NaN
        return found

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
        form: Any = density.form.bare
        cell = form.cell
        states = None if cell is None and self.named is None else self.explained(density.x, cell)
        lines = not is_gaussian(self.measurement)
        sharp = states is not None and cell is not None  # else nodes and lines see all that there is
        surveyed = form.survey() if sharp else None
        return Search(config.most_left_out, lines, states, surveyed, config.time_budget is None)

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
        distance = log_normal(self.innovation, self.S)[1]
        if not distance > OUTLYING:
            return ""
        return f"outlying measurement: {distance:.1f} sigma from its prediction"

    @property
    def gaussian_evidence(self) -> float:
        """Log-evidence where the particles end and a sum over them knows nothing: by the prior's moments."""
        assert self.innovation is not None and self.S is not None
        return log_normal(self.innovation, self.S)[0]


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
    middle, t, domain = density.mean(), density.t, density.domain
    if measurement.H is not None and not measurement.angles:
        return linear_reading(measurement, t, middle, density.cov())
    reference, x, mass = measurement.predict(middle, t)[0], density.x, density.mass
    around = np.ascontiguousarray(measurement.residual(measurement.predict(x, t), reference))
    states = x if domain is None else domain.nearest(x - middle)
    mean, cov = moments(around, mass)
    return reference + mean, cov, np.einsum("i,ia,ik->ak", mass, states, around - mean)


def linear_reading(sensor: Any, t: float, mean: Floats, cov: Floats) -> tuple[Floats, Floats, Floats]:
    """As `predicted_reading`, of a linear sensor, by a mean (n,) and covariance (n, n) alone."""
    return sensor.predict(mean, t)[0], sensor.H @ cov @ sensor.H.T, cov @ sensor.H.T


def info_fields(
    asked: ReadingAtPrior, scheme: str, log_evidence: float, error: float, evidence_error: float
) -> dict[str, Any]:
    """Fields of the info of an update to families or Gaussians, with a flag where the mean is in doubt."""
    code, status = (Code.UNRESOLVED, may_be_off(error)) if error > DOUBTFUL else (Code.OK, "ok")
    return {
        "accepted": True,
        "log_evidence": log_evidence,
        "reason": asked.outlying,
        "error": error,
        "evidence_error": evidence_error,
        "status": status,
        "code": code,
        "scheme": scheme,
    }


def solutions(sensor: GaussianSensor, z: Floats, x: Floats, cell: Floats, t: float) -> Floats | None:
    """States of a reading, by Gauss-Newton from every node; None where the nodes resolve the likelihood.

    The reading z (k,) is NaN where nothing came, the nodes are x (N, n), the columns of `cell` (n, n) the
    vectors of their lattice. Returns where the iteration ended, shape (N, n), whether or not the reading is
    explained there.
    """
    seen, n = np.isfinite(z), x.shape[1]
    whiten = np.linalg.inv(np.linalg.cholesky(block(sensor.noise_cov, seen))).T

    def off(X: Floats) -> Floats:
        return np.asarray(sensor.residual(z, sensor.predict(X, t))[:, seen] @ whiten)

    here = off(x)
    diagonal = cell.sum(axis=1)
    between, ahead = off(x + 0.5 * diagonal), off(x + diagonal)
    apart, bent = np.abs(ahead - here).sum(axis=1), np.abs(ahead - 2.0 * between + here).sum(axis=1)
    if not (np.nanmedian(apart) > OUTLYING and np.nanmax(bent) > _BENT):
        return None
    x = x.copy()
    for _ in range(_ITERATIONS):
        moved = off((x + STEP * cell.T[:, None]).reshape(-1, n)).reshape(n, len(x), -1)
        slope = np.nan_to_num(np.moveaxis((moved - here) / STEP, 0, 2))  # (N, k, n), by cells
        normal = np.swapaxes(slope, 1, 2) @ slope
        normal += (TINY + _DAMPED * np.trace(normal, axis1=1, axis2=2))[:, None, None] * np.eye(n)
        step = -np.linalg.solve(normal, np.swapaxes(slope, 1, 2) @ np.nan_to_num(here)[..., None])[..., 0]
        step /= np.maximum(1.0, np.linalg.norm(step, axis=1))[:, None]  # a cell at most
        x += step @ cell.T
        here = off(x)
    return x[np.isfinite(here).all(axis=1)]
