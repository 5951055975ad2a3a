"""What a model file may say: model, sensor and start for measurements from outside, and their columns."""

from collections.abc import Iterable, Sequence
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BeforeValidator, Field

from ..config import FilterConfig
from ..errors import ConfigError, nearest
from ..settings import Count, from_table, read_toml, settings
from .csv_data import Measurements, columns_of, read_columns, read_measurements
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


@settings
class TableFile:
    """Where a table's columns are."""

    file: str  # relative to the folder of the file that names it
    # columns; the arguments are the first one if `at` is None
    values: str
    at: str | None = None
    kind: Literal["linear", "previous"] = "linear"


def read_settings(path: str | PathLike[str], kind: type[File]) -> File:
    """Read the settings of a TOML file, `ModelFile` or what has more keys; raises `ConfigError`."""
    return from_table(kind, with_tables(read_toml(path), path), path)


def read_data(settings: ModelFile, path: str | PathLike[str]) -> Measurements:
    """The `Measurements` of a CSV file, with the columns that settings name; raises `ConfigError`.

    An input that the model gives no value of needs a column.
    """
    columns, model = settings.data, settings.model
    check_known("data.inputs", columns.inputs, model.inputs, "input of the model")
    if isinstance(columns.columns, dict):
        check_known("data.columns", columns.columns, settings.sensors, "sensor")
    inputs = columns.inputs | {name: name for name in model.inputs if name not in columns.inputs}
    if isinstance(model.inputs, dict):
        there = set(columns_of(path))
        inputs = {own: name for own, name in inputs.items() if own in columns.inputs or name in there}
    where = columns.time, columns.columns, columns.time_unit
    return read_measurements(path, settings.n_readings, *where, inputs)


def check_known(key: str, given: Iterable[str], known: Iterable[str], kind: str, none: str = "none") -> None:
    """Raise `ConfigError` for a name that a key gives and that is not known; empty ones are `none`."""
    for name in given:
        if name not in known:
            there = ", ".join(known) or none
            raise ConfigError(
                f"{key} names {name!r}, which is no {kind}{nearest(name, known)}; there are {there}"
            )


def with_tables(tree: dict[str, Any], path: str | PathLike[str]) -> dict[str, Any]:
    """A TOML tree in which the numbers of tables stand in the place of the files that have them.

    Files are looked for beside `path`, that of the tree, which is not changed. Raises `ConfigError` for a CSV
    file that cannot be read, or a column that is not there; the nearest is named.
    """
    for place in _places(tree):
        found = _at(tree, place).items()
        tree = _replaced(tree, place, {name: _read(t, path, ".".join([*place, name])) for name, t in found})
    return tree


def _places(tree: dict[str, Any]) -> list[tuple[str, ...]]:
    """Keys under which there are tables by name."""
    sensors = tree.get("sensors")
    names = sensors if isinstance(sensors, dict) else ()
    places: list[tuple[str, ...]] = [("inputs",), ("model", "tables"), ("sensor", "tables")]
    places += [("sensors", name, "tables") for name in names]
    return [place for place in places if isinstance(_at(tree, place), dict)]


def _at(tree: Any, keys: Sequence[str]) -> Any:
    for key in keys:
        tree = tree.get(key) if isinstance(tree, dict) else None
    return tree


def _replaced(tree: Any, keys: Sequence[str], value: Any) -> Any:
    """A tree with another value at some keys."""
    if not keys:
        return value
    return tree | {keys[0]: _replaced(tree[keys[0]], keys[1:], value)}


def _read(table: Any, path: str | PathLike[str], key: str) -> Any:
    """A table with its numbers; anything else as it is."""
    if not isinstance(table, dict) or not ("file" in table or isinstance(table.get("values"), str)):
        return table
    place = from_table(TableFile, table, f"{path}: {key}")
    at, values = read_columns(Path(path).parent / place.file, (place.at, place.values))
    return {"at": at.tolist(), "values": values.tolist(), "kind": place.kind}
