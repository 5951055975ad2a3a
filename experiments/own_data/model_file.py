"""A model with a sensor and a start, read from TOML: what filters need for measurements from outside."""

from pathlib import Path
from typing import Literal

from pydantic import Field

from experiments.scene.files import read_toml
from experiments.scene.scenario import Scenario, check_parts
from experiments.scene.settings import Filters, ModelText, Sensor
from sphfilter.settings import from_table, settings

__all__ = ["Belief", "Columns", "ModelFile", "load_model"]


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

    `time_unit` is for the axes of pictures: seconds or years, whatever the rates of the model are in.
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


def load_model(path):
    """Read a model file and check that its parts fit each other.

    Returns
    -------
    Scenario
        With `ModelFile` settings: nothing can be drawn from it, but filters can be made for it.

    Raises
    ------
    ConfigError, ExpressionError, ModelError
    """
    path = Path(path)
    scenario = Scenario(path.stem, from_table(ModelFile, read_toml(path), path))
    check_parts(scenario, path)
    return scenario
