"""What a scenario file may say: frozen settings that check themselves; a scenario is data, never code."""

import hashlib
from dataclasses import fields
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from sphfilter.config import FilterConfig
from sphfilter.settings import settings

__all__ = ["Filters", "ModelText", "Published", "Reads", "Runs", "ScenarioSettings", "Sensor", "Start",
           "TableText", "Times"]  # fmt: skip

Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=1)]
Row = tuple[float, ...]
Matrix = tuple[Row, ...]
_End = float | Literal["none"]
#: Names of inputs, or their values where nothing gives others.
_Inputs = tuple[str, ...] | dict[str, float]


def _bounds(axis):
    """An axis of the state, checked: what may be wrong with it is told at once."""
    ends = axis[1:] if isinstance(axis, list | tuple) and len(axis) == 3 else [None]
    if axis == "unbounded" or all(end == "none" or isinstance(end, int | float) for end in ends):
        return axis
    raise ValueError(
        'an axis is "unbounded" or [kind, low, high]: kind "periodic", "bounded" or "reflecting", low and '
        f'high numbers, or "none" where it has no end; got {axis!r}'
    )


#: An axis of the state.
_Axis = Annotated[Literal["unbounded"] | tuple[str, _End, _End], BeforeValidator(_bounds)]


def _told(thing):
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

    def __repr__(self):
        digest = hashlib.sha256(repr((self.at, self.values)).encode()).hexdigest()[:16]
        return f"TableText({len(self.at)} values {digest}, kind={self.kind!r})"

    @model_validator(mode="after")
    def _rises(self):
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
    """The stochastic differential equation, as text (see `SDE.from_expressions`)."""

    states: tuple[str, ...]  # names used in the expressions; `labels` and `units` are for tables and axes
    labels: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    drift: tuple[str, ...]  # length n
    noise: tuple[tuple[float | str, ...], ...] | None = None  # shape (n, m)
    spectral_density: Matrix | None = None  # shape (m, m): Q, dW covariance Q dt: D = g Q gᵀ / 2
    # shape (n, n): D itself, instead of noise and spectral_density
    diffusion: tuple[tuple[float | str, ...], ...] | None = None
    parameters: dict[str, float] = Field(default_factory=dict)
    # periodic axes and walls, see `Domain`; "none" for an end that is not there
    domain: tuple[_Axis, ...] | None = None
    interpretation: Literal["ito", "stratonovich"] = "ito"
    # names of what is held over each interval, and values where nothing gives others (zero)
    inputs: _Inputs = ()
    tables: dict[str, TableText] = Field(default_factory=dict)  # what ``table("name", ...)`` calls

    LATER: ClassVar[tuple[str, ...]] = ("inputs", "tables")
    __repr__ = _told

    @model_validator(mode="after")
    def _one_name_a_state(self):
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
    noise_cov: tuple[tuple[float | str, ...], ...]  # shape (k, k): R: numbers, or expressions
    # components of z that are angles in radians (expressions only)
    angles: tuple[Annotated[int, Field(ge=0)], ...] = ()
    parameters: dict[str, float] = Field(default_factory=dict)
    inputs: _Inputs = ()  # inputs of the model that the sensor's texts name too
    tables: dict[str, TableText] = Field(default_factory=dict)

    LATER: ClassVar[tuple[str, ...]] = ("parameters", "inputs", "tables")
    __repr__ = _told

    @property
    def is_text(self):
        """Whether `h` or `noise_cov` is given as expressions, or they need values by name."""
        noisy = any(isinstance(entry, str) for row in self.noise_cov for entry in row)
        return isinstance(self.h[0], str) or noisy or bool(self.parameters or self.inputs or self.tables)

    def texts(self, states):
        """The expressions of `h`, written for a matrix."""
        if isinstance(self.h[0], str):
            return list(self.h)
        rows = ([f"({c!r})*{name}" for c, name in zip(row, states, strict=False) if c] for row in self.h)
        return [" + ".join(row) or "0" for row in rows]

    @model_validator(mode="after")
    def _one_reading(self):
        if not self.h:
            raise ValueError("h needs at least one row or expression")
        return self


class Reads:
    """What files say of sensors: one, in `sensor`, or several by name, in `sensors`."""

    @property
    def n_readings(self):
        """Numbers that the sensor gives, or by name those that each of several gives."""
        if self.sensor is not None:
            return len(self.sensor.h)
        return {name: len(sensor.h) for name, sensor in self.sensors.items()}

    @model_validator(mode="after")
    def _sensor_or_sensors(self):
        if (self.sensor is None) == (not self.sensors):
            both = "both are there" if self.sensors else "none is there"
            raise ValueError(f"give one [sensor], or several as [sensors.NAME]; {both}")
        return self


@settings
class Times:
    """Measurement times: start + interval, start + 2 interval, ... up to end, seconds."""

    start: float = 0.0
    interval: Positive
    end: float

    @model_validator(mode="after")
    def _one_measurement(self):
        if self.end < self.start + self.interval:
            raise ValueError(f"end = {self.end:g} leaves no measurement after start + interval")
        return self

    def grid(self):
        """Measurement times, shape (T,)."""
        n = int(np.floor((self.end - self.start) / self.interval * (1 + 1e-12)))
        return self.start + self.interval * np.arange(1, n + 1)


@settings
class Start:
    """How a run starts, at time `Times.start`."""

    # "gaussian": the truth is drawn from N(mean, cov), which the filters are given. "tpd": two-point
    # differencing of two measurements (002 6.6); N(mean, cov) is where the truth was `burn_in` seconds
    # earlier. "benes": the density cosh(x) N(x; mean, cov) up to a factor, which `BenesFilter` carries.
    kind: Literal["gaussian", "tpd", "benes"]
    # shapes (n,), (n, n)
    mean: Row
    cov: Matrix
    # seconds the truth runs before the start, to be near its stationary law
    burn_in: Annotated[float, Field(ge=0)] = 0.0
    interval: Positive = 0.5  # T0, seconds between the two measurements of "tpd"
    # for each component of z the states (position, velocity) that "tpd" starts from it
    pairs: tuple[tuple[int, int], ...] = ()

    @model_validator(mode="after")
    def _fits_its_kind(self):
        if self.kind == "tpd" and not (self.pairs and self.burn_in >= self.interval):
            raise ValueError('kind = "tpd" needs pairs, and a burn_in of at least the interval')
        if self.kind != "tpd" and (self.pairs or self.burn_in):
            raise ValueError(f'pairs and burn_in belong to kind = "tpd", not to {self.kind!r}')
        return self


@settings
class MomentFilter:
    """EKF or UKF: error allowed per integration step of the moments, in standard deviations."""

    rtol: Positive = 1e-6


@settings
class Particle:
    """Bootstrap particle filter; `step` is its longest time step in seconds, None for its own choice."""

    n_particles: Count = 1000
    resampling: Literal["always", "ess"] = "ess"
    step: Positive | None = 0.1
    order: Literal[2, 4] = 4
    n_threads: Count = 1


@settings
class Sph:
    """`SPHFilter` with the default scheme: bound of the particles, if any, and configuration."""

    n_particles: Count | Literal["auto"] = "auto"
    config: FilterConfig = Field(default_factory=FilterConfig)


def _published(value):
    """Settings that a table leaves out are those of `FilterConfig.paper`."""
    if not isinstance(value, dict):
        return value
    return {"scheme": {}, **value, "acceptance": {"enabled": True, **value.get("acceptance", {})}}


@settings
class SphPaper:
    """`SPHFilter` with the scheme of 002 and its acceptance test."""

    n_particles: Count = 200
    config: Annotated[FilterConfig, BeforeValidator(_published)] = Field(default_factory=FilterConfig.paper)


@settings
class Grid:
    """Split-step grid filter: nodes an axis, and L1 error allowed per step."""

    size: Count = 128
    tol: Positive = 1e-3


@settings
class Filters:
    """Which filters run if none are asked for, and the settings of those that have any."""

    default: tuple[str, ...] = ("ekf", "ukf", "pf", "sph")
    ekf: MomentFilter = Field(default_factory=MomentFilter)
    ukf: MomentFilter = Field(default_factory=MomentFilter)
    pf: Particle = Field(default_factory=Particle)
    sph: Sph = Field(default_factory=Sph)
    sph_paper: SphPaper = Field(default_factory=SphPaper)
    grid: Grid = Field(default_factory=Grid)


@settings
class Runs:
    """Number of runs if none is asked for, number of the publication, and seed."""

    default: Count = 5
    published: Count | None = None
    seed: Annotated[int, Field(ge=0)] = 1


@settings
class Published:
    """Figures of one filter in the publication, per state where they are rows; run time in seconds."""

    max_peak: Row
    avg_peak: Row
    rms: Row
    run_time: float
    n_diverged: int | None = None


@settings
class ScenarioSettings(Reads):
    """One scenario file."""

    # one line for `list`; where the scenario or its figures come from
    description: str
    source: str = ""
    exact: str | None = None  # name of the filter that is exact here, and the reference of the others
    model: ModelText
    # one sensor, or several by name
    sensor: Sensor | None = None
    times: Times
    start: Start
    runs: Runs = Field(default_factory=Runs)
    filters: Filters = Field(default_factory=Filters)
    published: dict[str, Published] = Field(default_factory=dict)
    sensors: dict[str, Sensor] = Field(default_factory=dict)
    # What the model's inputs are: numbers, expressions of t and the model's parameters, or tables of t. Each
    # interval between measurements holds the value at its start.
    inputs: dict[str, float | str | TableText] = Field(default_factory=dict)

    LATER: ClassVar[tuple[str, ...]] = ("sensors", "inputs")
    __repr__ = _told
