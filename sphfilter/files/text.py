"""Models, sensors and tables as files say them: frozen settings that check themselves."""

import hashlib
from collections.abc import Sequence
from dataclasses import fields
from typing import Annotated, Any, ClassVar, Literal, Self, TypeAlias

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from ..settings import settings

Row: TypeAlias = tuple[float, ...]
Matrix: TypeAlias = tuple[Row, ...]
_Texts: TypeAlias = tuple[tuple[float | str, ...], ...]
_End: TypeAlias = float | Literal["none"]
#: Names of inputs, or their values where nothing gives others.
_Inputs: TypeAlias = tuple[str, ...] | dict[str, float]

#: What only models in discrete time have, and only differential equations.
OF_STEPS, OF_RATES = ("covariance", "noises", "period"), ("spectral_density", "diffusion")


def _bounds(axis: Any) -> Any:
    """An axis of the state, checked: what may be wrong with it is told at once."""
    ends = axis[1:] if isinstance(axis, list | tuple) and len(axis) == 3 else [None]
    if axis == "unbounded" or all(end == "none" or isinstance(end, int | float) for end in ends):
        return axis
    raise ValueError(
        'an axis is "unbounded" or [kind, low, high]: kind "periodic", "bounded" or "reflecting", low and '
        f'high numbers, or "none" where it has no end; got {axis!r}'
    )


#: An axis of the state.
_Axis: TypeAlias = Annotated[Literal["unbounded"] | tuple[str, _End, _End], BeforeValidator(_bounds)]


def told(thing: Any) -> str:
    """Text of settings that is silent about keys of `LATER` that are empty.

    Folders of campaigns know their scenario by its text, and are older than these keys.
    """
    found = {f.name: getattr(thing, f.name) for f in fields(thing)}
    shown = (f"{name}={value!r}" for name, value in found.items() if value or name not in thing.LATER)
    return f"{type(thing).__qualname__}({', '.join(shown)})"


@settings
class TableText:
    """A table that texts call, see `Table`; where a file has the columns, they have been read from it."""

    # length K: rising arguments, and the values there
    at: Row
    values: Row
    kind: Literal["linear", "previous"] = "linear"

    def __repr__(self) -> str:
        digest = hashlib.sha256(repr((self.at, self.values)).encode()).hexdigest()[:16]
        return f"TableText({len(self.at)} values {digest}, kind={self.kind!r})"

    @model_validator(mode="after")
    def _rises(self) -> Self:
        if not self.at or len(self.at) != len(self.values):
            raise ValueError(
                f"a table needs as many values as arguments, and some; at has {len(self.at)} and values "
                f"{len(self.values)}"
            )
        back = np.flatnonzero(np.diff(self.at) <= 0.0)
        if back.size:
            first, second = self.at[back[0] : back[0] + 2]
            raise ValueError(f"the arguments of a table must rise, {first:g} is followed by {second:g}")
        return self


@settings
class ModelText:
    """A differential equation, as text, or a model in discrete time, which has a `transition`.

    See `SDE.from_expressions` and `DiscreteModel.from_expressions`.
    """

    states: tuple[str, ...]  # names used in the expressions; `labels` and `units` are for tables and axes
    labels: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    drift: tuple[str, ...] = ()  # length n; empty where there is a transition
    noise: _Texts | None = None  # shape (n, m)
    spectral_density: Matrix | None = None  # shape (m, m): Q, dW covariance Q dt: D = g Q gᵀ / 2
    # shape (n, n): D itself, instead of noise and spectral_density
    diffusion: _Texts | None = None
    parameters: dict[str, float] = Field(default_factory=dict)
    # periodic axes and walls, see `Domain`; "none" for an end that is not there
    domain: tuple[_Axis, ...] | None = None
    interpretation: Literal["ito", "stratonovich"] = "ito"
    # names of what is held over each interval, and values where nothing gives others (zero)
    inputs: _Inputs = ()
    tables: dict[str, TableText] = Field(default_factory=dict)  # what ``table("name", ...)`` calls
    # of a model in discrete time: states after a step, length n, covariance of its noise, names of that where
    # the texts have it, and seconds of a step (one)
    transition: tuple[str, ...] = ()
    covariance: Matrix | None = None
    noises: tuple[str, ...] = ()
    period: Annotated[float, Field(gt=0)] | None = None

    LATER: ClassVar[tuple[str, ...]] = (
        "inputs", "tables", "transition", "covariance", "noises", "period"
    )  # fmt: skip
    __repr__ = told

    @model_validator(mode="after")
    def _drift_or_transition(self) -> Self:
        if bool(self.drift) == bool(self.transition):
            both = "both are there" if self.drift else "none is there"
            raise ValueError(f"give a drift, or a transition of a model in discrete time; {both}")
        own, others = ("drift", OF_STEPS) if self.drift else ("transition", OF_RATES)
        for key in others:
            if getattr(self, key):
                raise ValueError(f"{key} does not go with a {own}")
        return self

    @model_validator(mode="after")
    def _one_name_a_state(self) -> Self:
        for key in ("labels", "units"):
            if getattr(self, key) and len(getattr(self, key)) != len(self.states):
                raise ValueError(f"{key} must name each of the {len(self.states)} states")
        return self


@settings
class Sensor:
    """z = h(x) + v with v ~ N(0, R)."""

    # shape (k, n), or tuple of str, length k: a matrix H, or expressions of the states, t, parameters, inputs
    # and tables
    h: Matrix | tuple[str, ...]
    noise_cov: _Texts  # shape (k, k): R: numbers, or expressions
    # components of z that are angles in radians (expressions only)
    angles: tuple[Annotated[int, Field(ge=0)], ...] = ()
    parameters: dict[str, float] = Field(default_factory=dict)
    inputs: _Inputs = ()  # inputs of the model that the sensor's texts name too
    tables: dict[str, TableText] = Field(default_factory=dict)

    LATER: ClassVar[tuple[str, ...]] = ("parameters", "inputs", "tables")
    __repr__ = told

    @property
    def is_text(self) -> bool:
        """Whether `h` or `noise_cov` is given as expressions, or they need values by name."""
        noisy = any(isinstance(entry, str) for row in self.noise_cov for entry in row)
        return isinstance(self.h[0], str) or noisy or bool(self.parameters or self.inputs or self.tables)

    def texts(self, states: Sequence[str]) -> list[str]:
        """The expressions of `h`, written for a matrix."""
        if isinstance(self.h[0], str):
            return [str(text) for text in self.h]
        rows = ([f"({c!r})*{name}" for c, name in zip(row, states, strict=False) if c] for row in self.h)
        return [" + ".join(row) or "0" for row in rows]

    @model_validator(mode="after")
    def _one_reading(self) -> Self:
        if not self.h:
            raise ValueError("h needs at least one row or expression")
        return self


class Reads:
    """What files say of sensors: one, in `sensor`, or several by name, in `sensors`."""

    sensor: Sensor | None
    sensors: dict[str, Sensor]

    @property
    def n_readings(self) -> int | dict[str, int]:
        """Numbers that the sensor gives, or by name those that each of several gives."""
        if self.sensor is not None:
            return len(self.sensor.h)
        return {name: len(sensor.h) for name, sensor in self.sensors.items()}

    @model_validator(mode="after")
    def _sensor_or_sensors(self) -> Self:
        if (self.sensor is None) == (not self.sensors):
            both = "both are there" if self.sensors else "none is there"
            raise ValueError(f"give one [sensor], or several as [sensors.NAME]; {both}")
        return self
