"""What a scenario file may say: frozen settings that check themselves; a scenario is data, never code."""

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from sphfilter.config import FilterConfig
from sphfilter.files.model_file import Sph
from sphfilter.files.text import Matrix, ModelText, Reads, Row, Sensor, TableText, told
from sphfilter.settings import Count, Positive, settings


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
    __repr__ = told
