"""What a model file may say: model, sensor and start for measurements from outside."""

from typing import Literal

from pydantic import Field

from experiments.scene.files import read_toml
from experiments.scene.settings import Filters, ModelText, Reads, Sensor
from experiments.scene.tables import with_tables
from sphfilter.errors import ConfigError, nearest
from sphfilter.settings import from_table, settings

from .csv_data import columns_of, read_measurements

__all__ = ["Belief", "Columns", "ModelFile", "read_data", "read_model"]


@settings
class Belief:
    """What is believed before the first measurement: N(mean, cov) at `time`."""

    kind: Literal["gaussian"] = "gaussian"
    mean: tuple[float, ...]  # length n
    cov: tuple[tuple[float, ...], ...]  # shape (n, n)
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
class ModelFile(Reads):
    """The file. Model, sensor and filters are those of a scenario; times and measurements come from data."""

    description: str = ""
    model: ModelText
    sensor: Sensor | None = None
    sensors: dict[str, Sensor] = Field(default_factory=dict)
    start: Belief
    data: Columns = Field(default_factory=Columns)
    filters: Filters = Field(default_factory=Filters)


def read_model(path):
    """The `ModelFile` settings of a TOML file; raises `ConfigError`."""
    return from_table(ModelFile, with_tables(read_toml(path), path), path)


def read_data(settings, path):
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


def _check_known(key, given, known, kind):
    for name in given:
        if name not in known:
            there = ", ".join(known) or "none"
            raise ConfigError(
                f"{key} names {name!r}, which is no {kind}{nearest(name, known)}; there are {there}"
            )
