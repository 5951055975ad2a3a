"""What a filter is between two calls: one value, which predict and update replace as their last act."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._types import Floats, Noted
from ..density.particle_density import ParticleDensity
from ..info import PredictInfo, UpdateInfo, innovation_of
from ..model.measurements import Sensor, has_gaussian_noise
from ..model.sde import SDE
from ..prediction.again import Outcome
from ..prediction.predict import Prediction
from ..validate import unmasked
from .found import found
from .update_again import Update

__all__ = ["FilterState", "Shown", "said_of_reading"]


@dataclass(frozen=True)
class FilterState(Noted):
    """The state of a filter: its density, where that comes from, and what the last steps said.

    Attributes
    ----------
    density : ParticleDensity
    n_particles : int
        Upper bound of the number of particles.
    origin : Prediction, Update or None
        The step that the density comes from.
    x, P, x_prior, P_prior, x_post, P_post : ndarray, shapes (n,), (n, n)
        Mean and covariance now, after the last prediction and after the last update; read-only.
    z, y, S : ndarray or None
        Last measurement, its innovation and the covariance of that, NaN where no reading came.
    log_likelihood, log_evidence : float
        Log-evidence of the last measurement, and of all.
    inputs : mapping of str to float
        What the model's inputs were in the last prediction.
    """

    density: ParticleDensity
    n_particles: int
    origin: Prediction | Update | None
    x: Floats
    P: Floats
    x_prior: Floats
    P_prior: Floats
    x_post: Floats
    P_post: Floats
    z: Floats | None = None
    y: Floats | None = None
    S: Floats | None = None
    log_likelihood: float = 0.0
    log_evidence: float = 0.0
    inputs: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def begun(
        cls,
        density: ParticleDensity,
        n_particles: int,
        measurement: Sensor | None,
        inputs: Mapping[str, float],
    ) -> "FilterState":
        """The state of a filter that starts with a density, and has a sensor and inputs."""
        moments = 3 * _moments(density)
        said = said_of_reading(measurement, None, None) if has_gaussian_noise(measurement) else {}
        return cls(density, n_particles, None, *moments, **said, inputs=dict(inputs))

    def predicted(self, outcome: Outcome[PredictInfo], model: SDE) -> "FilterState":
        """The state after a prediction."""
        x, P = _moments(outcome.density)
        origin: Prediction | Update | None = self.origin
        if outcome.density.t > self.density.t:
            origin = Prediction(outcome.before, outcome.info.mass_error, model, outcome.density.t)
        return self.noted(
            density=outcome.density,
            n_particles=outcome.bound,
            origin=origin,
            x=x,
            P=P,
            x_prior=x,
            P_prior=P,
            inputs=dict(model.inputs),
        )

    def updated(
        self,
        outcome: Outcome[UpdateInfo],
        asked: tuple[Sensor, ArrayLike | None, bool],
        measurement: Sensor,
        z: ArrayLike | None,
    ) -> "FilterState":
        """The state after an update, whose prior may be another than the density now.

        `asked` are the sensor and the numbers that were used, perhaps a part of what the filter was given,
        and whether it is the filter's own sensor.
        """
        prior, density, info, _ = outcome
        used, same = density is not prior, prior is self.density
        x_prior, P_prior = (self.x, self.P) if same else _moments(prior)
        x, P = _moments(density)
        return self.noted(
            density=density,
            origin=Update.after(self.origin, prior, *asked) if used else self.origin if same else None,
            x=x,
            P=P,
            x_prior=x_prior,
            P_prior=P_prior,
            x_post=x,
            P_post=P,
            **said_of_reading(measurement, z, info),
            log_likelihood=info.log_evidence,
            log_evidence=self.log_evidence + info.log_evidence,
        )


class Shown:
    """What a filter shows of its state: properties to be read."""

    _state: FilterState

    @property
    def x(self) -> Floats:
        """Mean, shape (n,)."""
        return self._state.x

    @property
    def dim_x(self) -> int:
        """Number of states n."""
        return len(self._state.x)

    @property
    def P(self) -> Floats:
        """Covariance, shape (n, n)."""
        return self._state.P

    @property
    def x_prior(self) -> Floats:
        """Mean after the last prediction, shape (n,)."""
        return self._state.x_prior

    @property
    def P_prior(self) -> Floats:
        """Covariance after the last prediction, shape (n, n)."""
        return self._state.P_prior

    @property
    def x_post(self) -> Floats:
        """Mean after the last update, shape (n,)."""
        return self._state.x_post

    @property
    def P_post(self) -> Floats:
        """Covariance after the last update, shape (n, n)."""
        return self._state.P_post

    @property
    def z(self) -> Floats | None:
        """Last measurement, shape (k,), NaN where no reading came and before the first; or None."""
        return self._state.z

    @property
    def y(self) -> Floats | None:
        """Innovation of the last measurement, shape (k,), or None."""
        return self._state.y

    @property
    def S(self) -> Floats | None:
        """Covariance of the innovation, shape (k, k), or None."""
        return self._state.S

    @property
    def SI(self) -> Floats | None:
        """Inverse of S, that of the components that came; NaN where none did, or None."""
        if self.S is None:
            return None
        came = np.isfinite(np.diag(self.S))
        both, inverse = np.ix_(came, came), np.full_like(self.S, np.nan)
        inverse[both] = np.linalg.inv(self.S[both])
        return inverse

    @property
    def mahalanobis(self) -> float:
        """Length of the last innovation in standard deviations of its prediction; NaN where none came."""
        y, inverse = self.y, self.SI
        if y is None or inverse is None or np.isnan(y).all():
            return math.nan
        return math.sqrt(np.nansum(y[:, None] * inverse * y))

    @property
    def log_likelihood(self) -> float:
        """Log-evidence of the last measurement, zero where none came."""
        return self._state.log_likelihood

    @property
    def log_evidence(self) -> float:
        """Log-evidence of all measurements."""
        return self._state.log_evidence

    @log_evidence.setter
    def log_evidence(self, value: float) -> None:
        self._state = replace(self._state, log_evidence=float(value))

    @property
    def density(self) -> ParticleDensity:
        """The density now."""
        return self._state.density

    @property
    def t(self) -> float:
        """Time of the density, seconds."""
        return self._state.density.t

    @property
    def inputs(self) -> Mapping[str, float]:
        """What the model's inputs were in the last prediction, by name."""
        return self._state.inputs

    @property
    def likelihood(self) -> float:
        """Evidence of the last measurement."""
        return float(np.exp(self._state.log_likelihood))


def _moments(density: ParticleDensity) -> tuple[Floats, Floats]:
    return found(density.mean()), found(density.cov())


def said_of_reading(measurement: Sensor, z: ArrayLike | None, info: UpdateInfo | None) -> dict[str, Any]:
    """A measurement, its innovation and the covariance of that, in shapes of the sensor, by name.

    Without an info there was no measurement yet.
    """
    if not has_gaussian_noise(measurement):
        return {
            "z": None if z is None else np.atleast_1d(np.array(unmasked(z), dtype=float)),
            "y": None,
            "S": None,
        }
    numbers, seen = measurement.reading(z)
    y, S = innovation_of(info or UpdateInfo(accepted=True, log_evidence=0.0), seen, measurement.dim_z)
    return {"z": numbers, "y": y, "S": S}
