"""What a model file may say: model, sensor and start for measurements from outside."""

from typing import Literal

from pydantic import Field

from experiments.scene.files import read_toml
from experiments.scene.settings import Filters, ModelText, Sensor
from sphfilter.settings import from_table, settings

__all__ = ["Belief", "Columns", "ModelFile", "read_model"]


@settings
class Belief:
    """What is believed before the first measurement: N(mean, cov) at `time`.

    Attributes
    ----------
    mean : tuple, length n
    cov : nested tuple, shape (n, n)
    time : float or None
        The time of the first measurement if None.
    """

    kind: Literal["gaussian"] = "gaussian"
    mean: tuple[float, ...]
    cov: tuple[tuple[float, ...], ...]
    time: float | None = None


@settings
class Columns:
    """Names of columns: the time (the first if None) and the measurements (all others if empty).

    `time_unit` is for the axes of pictures: seconds or years, whatever the rates of the model are in; and for
    dates, which are counted in it (s, min, h, d or a; seconds if it is empty).
    """

    time: str | None = None
    time_unit: str = ""
    columns: tuple[str, ...] = ()


@settings
class ModelFile:
    """The file. Model, sensor and filters are those of a scenario; times and measurements come from data."""

    description: str = ""
    model: ModelText
    sensor: Sensor
    start: Belief
    data: Columns = Field(default_factory=Columns)
    filters: Filters = Field(default_factory=Filters)


def read_model(path):
    """The `ModelFile` settings of a TOML file.

    Raises
    ------
    ConfigError
    """
    return from_table(ModelFile, read_toml(path), path)
