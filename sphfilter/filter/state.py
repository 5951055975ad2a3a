"""State of a filter between two calls: one value, which predict and update replace as their last act."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from .._types import Floats, Noted
from ..density.modes import ModeDensities
from ..density.particle_density import ParticleDensity
from ..errors import ModelError
from ..info import UpdateInfo, innovation_of
from ..model.measurements import Sensor, has_gaussian_noise
from ..validate import unmasked

#: What a filter carries: a density, or one for each mode.
Carried = TypeVar("Carried", ParticleDensity, ModeDensities)
_READ = "what a density filter has found is read-only; make a new filter with x0 and P0"


@dataclass(frozen=True)
class FilterState(Noted, Generic[Carried]):
    """The state of a filter: its density, where that comes from, and what the last steps said."""

    density: Carried
    origin: Any  # the step that the density comes from: a Prediction, Update, ModesPrediction, or None
    x: Floats  # (n,), mean now; all moments are read-only
    P: Floats  # (n, n), covariance
    x_prior: Floats  # after the last prediction
    P_prior: Floats
    x_post: Floats  # after the last update
    P_post: Floats
    z: Floats | None = None  # last measurement, NaN where no reading came, as in both of the next
    y: Floats | None = None  # its innovation
    S: Floats | None = None  # covariance of that
    log_likelihood: float = 0.0  # log-evidence of the last measurement
    log_evidence: float = 0.0  # and of all
    inputs: Mapping[str, float] = field(default_factory=dict)  # of the model in the last prediction
    #: Upper bound of the number of particles; of modes, those that time has left for each in the last
    #: prediction, zero where it has left all that were asked for.
    n_particles: int = 0

    @classmethod
    def begun(
        cls,
        density: Carried,
        inputs: Mapping[str, float],
        measurement: Sensor | None = None,
        n_particles: int = 0,
    ) -> Self:
        """The state of a filter that starts with a density, and has inputs and a sensor."""
        moments = 3 * _moments(density)
        said = said_of_reading(measurement, None, None)
        return cls(density, None, *moments, **said, inputs=dict(inputs), n_particles=n_particles)

    @property
    def t(self) -> float:
        """Time of the density, seconds."""
        return self.density.heaviest.t if isinstance(self.density, ModeDensities) else self.density.t

    def predicted(self, density: Carried, origin: Any, inputs: Mapping[str, float], **known: Any) -> Self:
        """The state after a prediction; `known` is what else has changed."""
        x, P = _moments(density)
        moments = {"x": x, "P": P, "x_prior": x, "P_prior": P}
        return self.noted(density=density, origin=origin, **moments, inputs=dict(inputs), **known)

    def updated(
        self, step: tuple[Carried, Carried, UpdateInfo], origin: Any, measurement: Sensor, z: ArrayLike | None
    ) -> Self:
        """The state after an update, whose prior may be another than the density now.

        A `step` is its prior, its posterior and what was said. `origin` is where a posterior comes from that
        is not the prior itself.
        """
        prior, density, info = step
        used, same = density is not prior, prior is self.density
        x_prior, P_prior = (self.x, self.P) if same else _moments(prior)
        x, P = _moments(density)
        moments = {"x": x, "P": P, "x_prior": x_prior, "P_prior": P_prior, "x_post": x, "P_post": P}
        return self.noted(
            density=density,
            origin=origin if used else self.origin if same else None,
            **moments,
            **said_of_reading(measurement, z, info),
            log_likelihood=info.log_evidence,
            log_evidence=self.log_evidence + info.log_evidence,
        )


def _moments(density: ParticleDensity | ModeDensities) -> tuple[Floats, Floats]:
    """Mean and covariance of a density, over all modes if it has such."""
    mean, cov = density.moments if isinstance(density, ModeDensities) else (density.mean(), density.cov())
    return read_only(mean), read_only(cov)


def said_of_reading(
    measurement: Sensor | None, z: ArrayLike | None, info: UpdateInfo | None
) -> dict[str, Any]:
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


class _Found(np.ndarray):
    """A read-only array: ``flt.P *= 50`` would change a copy of what the density says, and nothing else.

    What is computed from it is a plain array, and its copies may be changed.
    """

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        """Compute with plain arrays."""
        into = options.get("out", ())
        if any(isinstance(array, _Found) and not array.flags.writeable for array in into):
            raise ModelError(_READ)
        if into:
            options["out"] = tuple(_plain(array) for array in into)
        result = getattr(ufunc, method)(*map(_plain, inputs), **options)
        return into[0] if len(into) == 1 else result

    def __setitem__(self, key: Any, value: Any) -> None:
        if not self.flags.writeable:
            raise ModelError(_READ)
        super().__setitem__(key, value)

    def __repr__(self) -> str:
        return repr(_plain(self))


def _plain(array: Any) -> Any:
    return array.view(np.ndarray) if isinstance(array, _Found) else array


def read_only(array: Floats) -> Floats:
    """A new array of the same numbers, to be read."""
    array = np.array(array).view(_Found)
    array.flags.writeable = False
    return array
