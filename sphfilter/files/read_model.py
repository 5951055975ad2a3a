"""Models with sensor and start from TOML files: all that a filter of one's own data needs."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from .._types import Floats
from ..density.distributions import Gaussian
from ..errors import ModelError, SphfilterError
from ..filter.sph_filter import SPHFilter
from ..model.discrete import DiscreteModel
from ..model.measurements import GaussianMeasurement
from ..model.sde import SDE
from ..model.sensors import Sensors
from ..model.tables import Table
from .csv_data import Measurements
from .model_file import ModelFile, check_known, read_data, read_settings
from .text import OF_RATES, OF_STEPS, ModelText, Reads, Sensor, TableText

AnySensor: TypeAlias = GaussianMeasurement | Sensors


@dataclass(frozen=True, repr=False)
class ModelOfFile:
    """A model file, its model and sensor made, and the start; `read_model` reads one.

    Attributes
    ----------
    path : Path
    settings : ModelFile
        What the file says.
    model : SDE or DiscreteModel
    sensor : GaussianMeasurement, or Sensors of several

    Examples
    --------
    >>> import sphfilter as sf
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> folder = Path(mkdtemp())
    >>> _ = (folder / "level.toml").write_text('''
    ... [model]
    ... states = ["x"]
    ... drift = ["-a*x"]
    ... noise = [["1"]]
    ... parameters = { a = 0.4 }
    ... [sensor]
    ... h = [[1.0]]
    ... noise_cov = [[0.3]]
    ... [start]
    ... mean = [1.0]
    ... cov = [[2.0]]
    ... [data]
    ... time_unit = "d"
    ... ''')
    >>> _ = (folder / "level.csv").write_text("day,level\\n2024-05-01,1.2\\n2024-05-02,\\n2024-05-04,-0.3\\n")
    >>> file = sf.read_model(folder / "level.toml")
    >>> data = file.read(folder / "level.csv")
    >>> result = file.filter(data).run(data.times, data.z)
    >>> for date, x in zip(data.stamps, result.x[:, 0]):
    ...     print(f"{date} {x:.3f}")
    2024-05-01 1.174
    2024-05-02 0.787
    2024-05-04 -0.166
    """

    path: Path
    settings: ModelFile
    model: SDE | DiscreteModel
    sensor: AnySensor

    @property
    def x0(self) -> Floats:
        """Mean of the start, shape (n,)."""
        return np.array(self.settings.start.mean)

    @property
    def P0(self) -> Floats:
        """Covariance of the start, shape (n, n)."""
        return np.array(self.settings.start.cov)

    @property
    def t0(self) -> float | None:
        """Time of the start; None where it is that of the first measurement."""
        return self.settings.start.time

    @property
    def labels(self) -> list[str]:
        """Names of the n states for people, with units where there are some."""
        text = self.settings.model
        units = text.units or ("",) * len(text.states)
        pairs = zip(text.labels or text.states, units, strict=True)
        return [f"{label} ({unit})" if unit else label for label, unit in pairs]

    def read(self, path: str | PathLike[str]) -> Measurements:
        """Read times, measurements and inputs from a CSV file, by the columns that the model file names.

        Raises `ConfigError`, which names file, line and column.
        """
        return read_data(self.settings, path)

    def filter(self, data: Measurements | None = None, **options: Any) -> SPHFilter:
        """Make the filter at the start, at the first time of the `data` unless the file says another.

        The options are those of `SPHFilter`; bound of the particles and configuration are the file's if they
        are not given. Raises `ModelError` where nothing says the time.
        """
        if "t0" not in options:
            t0 = data.times[0] if self.t0 is None and data is not None else self.t0
            if t0 is None:
                raise ModelError(f"{self.path}: give start.time, or filter(data) or filter(t0=)")
            options["t0"] = float(t0)
        own = self.settings.filters.sph
        options = {"n_particles": own.n_particles, "config": own.config} | options
        return SPHFilter(self.model, self.sensor, self.x0, self.P0, **options)

    def __repr__(self) -> str:
        return f"ModelOfFile({self.path}: {', '.join(self.model.states)})"


def read_model(path: str | PathLike[str]) -> ModelOfFile:
    """Read a model file: TOML with model, sensor and start, as ``sphfilter filter --help`` shows it.

    Parameters
    ----------
    path : path of the file

    Returns
    -------
    ModelOfFile

    Raises
    ------
    ConfigError
        A file that cannot be read, a key that is unknown (the nearest is named), missing or not valid.
    ExpressionError, ModelError
        A text with an unknown name, or parts that do not fit each other; the sentence begins with the file.

    Examples
    --------
    >>> import sphfilter as sf
    >>> sf.read_model("none.toml")
    Traceback (most recent call last):
        ...
    sphfilter.errors.ConfigError: cannot read none.toml: No such file or directory
    """
    settings = read_settings(path, ModelFile)
    try:
        model = model_of(settings.model)
        sensor = sensor_of(settings.model.states, settings)
        check_start(model, sensor, settings.start.mean, settings.start.cov)
        check_inputs(model, sensor)
    except SphfilterError as problem:
        raise type(problem)(f"{path}: {problem}") from problem
    return ModelOfFile(Path(path), settings, model, sensor)


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
        check_known(key, names, model.inputs, "input of the model", "none: give model.inputs")
