"""Which sensor a reading of a filter comes from."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import ModelError
from ..model.compile import StateFunction
from ..model.measurements import GaussianMeasurement, Sensor
from ..model.sde import SDE
from ..validate import short

__all__ = ["checked_sensor", "sensor_of"]


def sensor_of(
    own: Sensor | None, given: Sensor | ArrayLike | None, H: ArrayLike | StateFunction | None, model: SDE
) -> Sensor:
    """The sensor of a reading: the filter's own, the one given, or the own one with another R or h."""
    if callable(given) and not hasattr(given, "log_likelihood"):
        raise ModelError(
            "a function stands in the place of the sensor, as in the update(z, HJacobian, Hx) of an EKF; "
            "nothing is linearised: give h alone, update(z, R, h), or a measurement=GaussianMeasurement(h, R)"
        )
    if H is None and (given is None or hasattr(given, "log_likelihood") or not _numbers(given)):
        return checked_sensor(own if given is None else given, model)
    if not isinstance(own, GaussianMeasurement):
        raise ModelError("R and H change a filter's own GaussianMeasurement, and this filter has none")
    noise_cov: Any = given
    return checked_sensor(own.changed(noise_cov, H), model)


def _numbers(given: Any) -> bool:
    return np.asarray(given).dtype.kind in "iuf"


def checked_sensor(measurement: Any, model: SDE) -> Sensor:
    """Return a measurement that fits the model, or raise `ModelError`."""
    if not hasattr(measurement, "log_likelihood"):
        raise ModelError(
            f"measurement must be a GaussianMeasurement or LikelihoodMeasurement, got {short(measurement)}"
        )
    if hasattr(measurement, "check_dim"):
        measurement.check_dim(model.dim)
    return measurement
