"""What a model file may say: model, sensor and start for measurements from outside, and their columns."""

from collections.abc import Iterable
from os import PathLike
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BeforeValidator, Field

from ..config import FilterConfig
from ..errors import ConfigError, nearest
from ..settings import Count, from_table, read_toml, settings
from .csv_data import Measurements, columns_of, read_measurements
from .tables import with_tables
from .text import Matrix, ModelText, Reads, Row, Sensor

#: Keys of [filters] by which the experiments set other filters than this one.
_OTHERS = frozenset({"default", "kf", "ekf", "ukf", "pf", "sph_paper", "grid"})

File = TypeVar("File", bound="ModelFile")


@settings
class Belief:
    """What is believed before the first measurement: N(mean, cov) at `time`."""

    kind: Literal["gaussian"] = "gaussian"
    mean: Row  # length n
    cov: Matrix  # shape (n, n)
    time: float | None = None  # the time of the first measurement if None


@settings
class Columns:
    """Names of columns: the time (the first if None) and the measurements (all others if empty).

    Several sensors have their columns by name, or those that are called as they are. `inputs` are columns of
    inputs, by the inputs' names, where they are called otherwise.

    `time_unit` is for the axes of pictures: seconds or years, whatever the rates of the model are in; and for
    dates, which are counted in it (s, min, h, d or a; seconds if it is empty).
    """

    time: str | None = None
    time_unit: str = ""
    columns: tuple[str, ...] | dict[str, tuple[str, ...]] = ()
    inputs: dict[str, str] = Field(default_factory=dict)


@settings
class Sph:
    """`SPHFilter` with the default scheme: bound of the particles, if any, and configuration."""

    n_particles: Count | Literal["auto"] = "auto"
    config: FilterConfig = Field(default_factory=FilterConfig)


@settings
class Filters:
    """Settings of the SPH filter."""

    sph: Sph = Field(default_factory=Sph)


def _without_others(value: Any) -> Any:
    return {k: v for k, v in value.items() if k not in _OTHERS} if isinstance(value, dict) else value


@settings
class ModelFile(Reads):
    """The file; times and measurements come from data."""

    description: str = ""
    model: ModelText
    sensor: Sensor | None = None
    sensors: dict[str, Sensor] = Field(default_factory=dict)
    start: Belief
    data: Columns = Field(default_factory=Columns)
    filters: Annotated[Filters, BeforeValidator(_without_others)] = Field(default_factory=Filters)


def read_settings(path: str | PathLike[str], kind: type[File]) -> File:
    """Read the settings of a TOML file, `ModelFile` or what has more keys; raises `ConfigError`."""
    return from_table(kind, with_tables(read_toml(path), path), path)


def read_data(settings: ModelFile, path: str | PathLike[str]) -> Measurements:
    """The `Measurements` of a CSV file, with the columns that settings name; raises `ConfigError`.

    An input that the model gives no value of needs a column.
    """
    columns, model = settings.data, settings.model
    _check_known("data.inputs", columns.inputs, model.inputs, "input of the model")
    if isinstance(columns.columns, dict):
        _check_known("data.columns", columns.columns, settings.sensors, "sensor")
    inputs = columns.inputs | {name: name for name in model.inputs if name not in columns.inputs}
    if isinstance(model.inputs, dict):
        there = set(columns_of(path))
        inputs = {own: name for own, name in inputs.items() if own in columns.inputs or name in there}
    where = columns.time, columns.columns, columns.time_unit
    return read_measurements(path, settings.n_readings, *where, inputs)


def _check_known(key: str, given: Iterable[str], known: Iterable[str], kind: str) -> None:
    for name in given:
        if name not in known:
            there = ", ".join(known) or "none"
            raise ConfigError(
                f"{key} names {name!r}, which is no {kind}{nearest(name, known)}; there are {there}"
            )
