"""Which sensor a reading of a filter comes from, and what it said."""

import numpy as np

from ..errors import ModelError
from ..info import innovation_of
from ..model.measurements import GaussianMeasurement
from ..validate import short

__all__ = ["checked_sensor", "read", "sensor_of"]


def sensor_of(own, given, H, model):
    """The sensor of a reading: the filter's own, the one given, or the own one with another R or h."""
    if H is None and (given is None or hasattr(given, "log_likelihood") or not _numbers(given)):
        return checked_sensor(own if given is None else given, model)
    if not isinstance(own, GaussianMeasurement):
        raise ModelError("R and H change a filter's own GaussianMeasurement, and this filter has none")
    return checked_sensor(own.changed(given, H), model)


def read(measurement, z, info):
    """Reading, innovation and its covariance in shapes of the sensor, NaN where nothing came."""
    if not isinstance(measurement, GaussianMeasurement):
        return None if z is None else np.atleast_1d(np.array(z, dtype=float)), None, None
    seen = measurement.observed(z)
    reading = np.full(measurement.dim_z, np.nan)
    if z is not None:
        reading[seen] = np.atleast_1d(np.array(z, dtype=float))[seen]
    return reading, *innovation_of(info, seen, measurement.dim_z)


def _numbers(given):
    return np.asarray(given).dtype.kind in "iuf"


def checked_sensor(measurement, model):
    """Return a measurement that fits the model, or raise `ModelError`."""
    if not hasattr(measurement, "log_likelihood"):
        raise ModelError(
            f"measurement must be a GaussianMeasurement or LikelihoodMeasurement, got {short(measurement)}"
        )
    if isinstance(measurement, GaussianMeasurement):
        measurement.check_dim(model.dim)
    return measurement
