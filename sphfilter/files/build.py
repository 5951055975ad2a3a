"""Models, sensors and tables made of what files say of them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any, TypeAlias

from ..density.distributions import Gaussian
from ..errors import ConfigError, ModelError, nearest
from ..model.discrete import DiscreteModel
from ..model.measurements import GaussianMeasurement
from ..model.sde import SDE
from ..model.sensors import Sensors
from ..model.tables import Table
from .text import OF_RATES, OF_STEPS, ModelText, Reads, Sensor, TableText

AnySensor: TypeAlias = GaussianMeasurement | Sensors


def model_of(text: ModelText) -> SDE | DiscreteModel:
    """The model; raises `ExpressionError` or `ModelError`."""
    own = ("transition", *OF_STEPS) if text.drift else ("drift", "interpretation", *OF_RATES)
    others = {"labels", "units", *own}
    values: dict[str, Any] = {k: v for k, v in asdict(text).items() if k not in others}
    values["tables"] = tables_of(text.tables)
    if text.drift:
        return SDE.from_expressions(**values)
    values |= {"noises": text.noises or None, "period": text.period or 1.0}
    return DiscreteModel.from_expressions(**values)


def sensor_of(states: Sequence[str], given: Reads) -> AnySensor:
    """The sensor of a model's states, or `Sensors` of several; raises `ExpressionError` or `ModelError`."""
    if given.sensor is not None:
        return _sensor(states, given.sensor)
    return Sensors({name: _sensor(states, sensor) for name, sensor in given.sensors.items()})


def _sensor(states: Sequence[str], sensor: Sensor) -> GaussianMeasurement:
    if not sensor.is_text:
        return GaussianMeasurement(h=sensor.h, noise_cov=sensor.noise_cov, angles=sensor.angles)
    named: Any = {"parameters": sensor.parameters, "inputs": sensor.inputs}
    named["tables"] = tables_of(sensor.tables)
    h = sensor.texts(states)
    return GaussianMeasurement.from_expressions(states, h, sensor.noise_cov, sensor.angles, **named)


def tables_of(texts: Mapping[str, TableText]) -> dict[str, Table]:
    """Tables by name."""
    return {name: Table(**asdict(text)) for name, text in texts.items()}


def check_start(model: SDE | DiscreteModel, sensor: AnySensor, mean: Sequence[float], cov: Any) -> None:
    """Raise `ModelError` unless model, sensor and a start N(mean, cov) fit each other."""
    n, H = model.dim, sensor.H
    if (H is not None and H.shape[1] != n) or len(mean) != n:
        columns = "expressions" if H is None else f"{H.shape[1]} columns"
        raise ModelError(
            f"the model has {n} states, but sensor.h has {columns} and start.mean {len(mean)} values"
        )
    Gaussian(mean, cov)  # checks the covariance


def check_inputs(model: SDE | DiscreteModel, sensor: AnySensor, inputs: Iterable[str] = ()) -> None:
    """Raise `ConfigError` for inputs that the model does not have, of a file or of its sensor."""
    for key, names in (("inputs", inputs), ("the sensor's inputs", sensor.inputs)):
        for name in names:
            if name not in model.inputs:
                known = ", ".join(model.inputs) or "none: give model.inputs"
                raise ConfigError(
                    f"{key} names {name!r}, which is no input of the model"
                    f"{nearest(name, model.inputs)}; there are {known}"
                )
