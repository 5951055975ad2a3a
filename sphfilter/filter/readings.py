"""Which sensor a reading of a filter comes from."""

import numpy as np

from ..errors import ModelError
from ..model.measurements import GaussianMeasurement
from ..validate import short

__all__ = ["checked_sensor", "sensor_of"]


def sensor_of(own, given, H, model):
    """The sensor of a reading: the filter's own, the one given, or the own one with another R or h."""
    if H is None and (given is None or hasattr(given, "log_likelihood") or not _numbers(given)):
        return checked_sensor(own if given is None else given, model)
    if not isinstance(own, GaussianMeasurement):
        raise ModelError("R and H change a filter's own GaussianMeasurement, and this filter has none")
    return checked_sensor(own.changed(given, H), model)


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
