"""Stone Soup's measurement models and detections as sensors of the filter."""

import datetime
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from stonesoup.models.base import GaussianModel, LinearModel
from stonesoup.models.measurement.base import MeasurementModel
from stonesoup.types.angle import Bearing
from stonesoup.types.array import StateVector, StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.state import State

from ..._types import Bools, Floats
from ...density.moments import cov_of_sum
from ...errors import ModelError
from ...filter.reading_at_prior import predicted_reading
from ...model.measurements import GaussianMeasurement, GaussianSensor, PlainSensor, Sensor, wrapped
from ...validate import covariance, short
from .states import DensityState

#: Radians beyond pi / 2, where elevations fold, and beyond pi, where bearings turn: a type that keeps both
#: but for whole turns is an angle of the whole circle.
_PROBED = 0.6 * np.pi, 1.3 * np.pi


class ModelMeasurement(PlainSensor):
    """A Stone Soup measurement model as a sensor: its `function` and `covar`, and its own `logpdf`.

    It is asked about states of one timestamp. Models that are not Gaussian have no `noise_cov`; `angles` are
    components that are angles of the whole circle, whose differences are wrapped to (−π, π].
    """

    def __init__(self, model: MeasurementModel, timestamp: datetime.datetime | None) -> None:
        self._model, self._timestamp = model, timestamp
        self.dim_z = model.ndim_meas
        self.noise_cov = _noise_cov(model)

    def predict(self, X: Floats, t: float = 0.0) -> Floats:
        """Noise-free reading in each state X (N, n), shape (N, k)."""
        X = np.atleast_2d(X)
        first = np.asarray(self._model.function(self._state(X[:1]), noise=False))
        self.angles = tuple(i for i, value in enumerate(first[:, 0]) if _turns(value))
        known = first.astype(float)
        if len(X) == 1:
            return known.T
        plain = getattr(self._model, "_function", None)  # where `function` makes an object of every angle
        if plain is not None:
            Z = np.asarray(plain(self._state(X), noise=False), dtype=float)
            if np.allclose(Z[:, :1], known, rtol=1e-12, atol=1e-12):
                return Z.T
        return np.asarray(self._model.function(self._state(X), noise=False), dtype=float).T

    def residual(self, z: ArrayLike, zhat: ArrayLike) -> Floats:
        """z − zhat (..., k), angles wrapped."""
        return wrapped(np.asarray(z, dtype=float) - np.asarray(zhat, dtype=float), self.angles)

    def observed(self, z: ArrayLike | None) -> Bools:
        """All components: detections are whole."""
        return np.ones(self.dim_z, dtype=bool)

    def log_likelihood(self, z: Any, X: Floats, t: float = 0.0) -> Floats:
        """log p(z | x) for each state X (N, n), shape (N,)."""
        detection = Detection(StateVector(z), timestamp=self._timestamp)
        values = self._model.logpdf(detection, self._state(X))
        return np.asarray(np.atleast_1d(values), dtype=float)

    def types(self, x: Floats) -> list[type]:
        """Types of the components of a reading of one state (n,), such as Bearing."""
        return [type(value) for value in np.asarray(self._model.function(self._state(x), noise=False)).flat]

    def _state(self, X: Floats) -> State:
        return State(StateVectors(np.atleast_2d(X).T), timestamp=self._timestamp)


def sensor_for(model: MeasurementModel | Sensor, timestamp: datetime.datetime | None) -> Sensor:
    """The sensor of a measurement model: Stone Soup's, or one of the filter's own; others are refused."""
    if hasattr(model, "log_likelihood"):
        return model
    if not isinstance(model, MeasurementModel):
        raise ModelError(
            "a detection or the updater needs a measurement_model, one of Stone Soup's or a "
            f"GaussianMeasurement, got {short(model)}"
        )
    if isinstance(model, LinearModel) and isinstance(model, GaussianModel):
        noise_cov: Any = _noise_cov(model)
        return GaussianMeasurement(h=np.asarray(model.matrix(), dtype=float), noise_cov=noise_cov)
    return ModelMeasurement(model, timestamp)


def reading_of(detection: Detection, sensor: Any) -> Floats:
    """The numbers of a detection, shape (k,): finite, and as many as the sensor gives."""
    z = np.asarray(detection.state_vector, dtype=float).ravel()
    if not np.isfinite(z).all() or len(z) != (sensor.dim_z or len(z)):
        raise ModelError(
            f"a detection must hold {sensor.dim_z} finite numbers, got {z}; take a MissedDetection for none"
        )
    return z


def predicted(state: DensityState, sensor: GaussianSensor) -> tuple[Floats, Floats, Floats]:
    """Mean (k,) and covariance (k, k) of the noise-free reading of a state, and their covariance (n, k)."""
    each = [(np.exp(log_w), p.mean(), *predicted_reading(p, sensor)) for log_w, p in state._some]
    w, means, readings, S, cross = (np.array(part) for part in zip(*each, strict=True))
    about, domain = readings[w.argmax()], state._some[0][1].domain
    off = sensor.residual(readings, about)  # angles are averaged around that of the likeliest mode
    middle, apart = w @ off, means - state._moments[0]
    off, apart = off - middle, apart if domain is None else domain.nearest(apart)
    S = cov_of_sum(w, off, S)
    cross = np.einsum("k,kab->ab", w, cross) + np.einsum("k,ka,kb->ab", w, apart, off)
    return about + middle, S, cross


def typed(reading: Floats, sensor: Sensor, x: Floats) -> StateVector:
    """A reading (k,) as a StateVector with the angle types of the sensor at a state x (n,)."""
    angles = getattr(sensor, "angles", ())
    if not angles:
        return StateVector(reading)
    types = sensor.types(x) if isinstance(sensor, ModelMeasurement) else len(reading) * [Bearing]
    return StateVector([types[i](v) if i in angles else float(v) for i, v in enumerate(reading)])


def _turns(value: object) -> bool:
    """Whether it is an angle of the whole circle; differences of elevations and the like do not wrap."""
    mod = getattr(type(value), "mod_angle", None)
    return mod is not None and all(np.isclose(np.exp(1j * mod(a)), np.exp(1j * a)) for a in _PROBED)


def _noise_cov(model: MeasurementModel) -> Floats | None:
    if not isinstance(model, GaussianModel):
        return None
    try:
        R = model.covar()
    except NotImplementedError:  # Gaussian by its ancestors only
        return None
    if R is None or None in np.asarray(R, dtype=object):
        raise ModelError(f"the {type(model).__name__} has no noise covariance; give it one (noise_covar=)")
    return covariance("the measurement model's covar", np.asarray(R, dtype=float))
