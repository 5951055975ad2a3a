"""Which sensor a reading of a filter comes from, and over which interval it is predicted."""

from collections.abc import Iterable, Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from .._types import Floats, Interval, Readings, Reported, Rows
from ..errors import ModelError
from ..model.compile import StateFunction
from ..model.dynamics import Dynamics
from ..model.jump_markov import JumpMarkovModel
from ..model.measurements import GaussianMeasurement, Sensor
from ..model.named import InputValues
from ..model.sensors import Sensors
from ..validate import short


def sensor_of(
    own: Any,
    given: Sensor | ArrayLike | str | None,
    H: ArrayLike | StateFunction | None,
    model: Dynamics | JumpMarkovModel,
) -> Sensor:
    """The sensor of a reading: the filter's own, with another R or h, one of it by name, or one given."""
    if isinstance(given, str) and H is None and isinstance(own, Sensors):
        return checked_sensor(own[given], model)
    if callable(given) and not hasattr(given, "log_likelihood"):
        raise ModelError(
            "a function stands in the place of the sensor, as in the update(z, HJacobian, Hx) of an EKF; "
            "nothing is linearised: give h alone, update(z, R, h), or a measurement=GaussianMeasurement(h, R)"
        )
    if H is None and (
        given is None or hasattr(given, "log_likelihood") or np.asarray(given).dtype.kind not in "iuf"
    ):
        return checked_sensor(own if given is None else given, model)
    if not isinstance(own, GaussianMeasurement):
        more = ": give update(z, sensors[name].changed(R, H))" if isinstance(own, Sensors) else ""
        raise ModelError(f"R and H change a filter's own GaussianMeasurement, and this filter has none{more}")
    noise_cov: Any = given
    return checked_sensor(own.changed(noise_cov, H), model)


def checked_sensor(measurement: Any, model: Dynamics | JumpMarkovModel) -> Sensor:
    """Return a measurement that fits the model, or raise `ModelError`."""
    if not hasattr(measurement, "log_likelihood"):
        raise ModelError(
            f"measurement must be a GaussianMeasurement or LikelihoodMeasurement, got {short(measurement)}"
        )
    if hasattr(measurement, "check_dim"):
        measurement.check_dim(model.dim)
    return measurement


def numbers_of(sensor: Any, z: Reported) -> ArrayLike | None:
    """A reading as numbers; of several sensors, theirs one after the other, NaN where none came."""
    if not isinstance(z, Mapping):
        return z
    if not isinstance(sensor, Sensors):
        raise ModelError(
            f"the measurement {short(dict(z))} names sensors: give it alone, to a filter whose measurement "
            "is Sensors({name: sensor, ...})"
        )
    return sensor.vector(z)


def rows_of(sensor: Any, measurements: Readings) -> Rows:
    """A record of readings, each as `numbers_of` has it."""
    if any(isinstance(z, Mapping) for z in measurements):
        return [numbers_of(sensor, z) for z in measurements]
    return cast(Rows, measurements)


def parted(sensor: Sensor, z: ArrayLike | None) -> tuple[Sensor, ArrayLike | None]:
    """The sensor that a reading came from and its numbers: of several, those that have one."""
    return sensor.came(z) if isinstance(sensor, Sensors) else (sensor, z)


def interval_of(
    dt: Interval | Floats | None,
    t: float | None,
    u: InputValues | None,
    own: float | None,
    inputs: Iterable[str],
) -> tuple[Any, float | None, InputValues | None]:
    """Seconds dt or time t to predict by or to, and values u of inputs of these names.

    A filter with a dt of its own is asked as filterpy's are: ``predict()``, ``predict(0)`` for no control, or
    ``predict(u)`` with an array, which is no interval; zeros control nothing where there are no inputs.
    """
    if t is not None:
        return dt, t, u
    if np.ndim(dt) > 0:  # type: ignore[arg-type]
        array = np.asarray(dt)
        if own is None or u is not None:
            raise ModelError(f"dt is a number of seconds, got {short(array)}; inputs are given by u=")
        nothing = not list(inputs) and array.dtype.kind in "iuf" and not array.any()
        return own, None, None if nothing else array
    if own is not None and isinstance(dt, int | float | np.number) and dt == 0:
        dt = None
    if dt is None and own is None:
        raise ModelError("predict needs dt or t=, or a filter made with dt=")
    return own if dt is None else dt, None, u
