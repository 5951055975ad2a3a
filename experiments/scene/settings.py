"""What a scenario file may say: frozen settings that check themselves; a scenario is data, never code."""

from typing import Annotated, Literal

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from sphfilter.config import FilterConfig
from sphfilter.settings import settings

__all__ = ["Filters", "ModelText", "Published", "Runs", "ScenarioSettings", "Sensor", "Start", "Times"]

Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=1)]
Row = tuple[float, ...]
Matrix = tuple[Row, ...]
_End = float | Literal["none"]


@settings
class ModelText:
    """The stochastic differential equation, as text (see `SDE.from_expressions`).

    Attributes
    ----------
    states : tuple of str
        Names used in the expressions; `labels` and `units` are for tables and axes.
    drift : tuple of str, length n
    noise : nested tuple of str or float, shape (n, m)
    spectral_density : nested tuple, shape (m, m)
        Q, dW covariance Q dt: D = g Q gᵀ / 2.
    diffusion : nested tuple of str or float, shape (n, n)
        D itself, instead of noise and spectral_density.
    parameters : dict of str to float
    domain : tuple, one of "unbounded" or (kind, low, high) a state
        Periodic axes and walls, see `Domain`; "none" for an end that is not there.
    """

    states: tuple[str, ...]
    labels: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    drift: tuple[str, ...]
    noise: tuple[tuple[float | str, ...], ...] | None = None
    spectral_density: Matrix | None = None
    diffusion: tuple[tuple[float | str, ...], ...] | None = None
    parameters: dict[str, float] = Field(default_factory=dict)
    domain: tuple[Literal["unbounded"] | tuple[str, _End, _End], ...] | None = None
    interpretation: Literal["ito", "stratonovich"] = "ito"

    @model_validator(mode="after")
    def _one_name_a_state(self):
        for key in ("labels", "units"):
            if getattr(self, key) and len(getattr(self, key)) != len(self.states):
                raise ValueError(f"{key} must name each of the {len(self.states)} states")
        return self


@settings
class Sensor:
    """z = h(x) + v with v ~ N(0, R).

    Attributes
    ----------
    h : nested tuple of float, shape (k, n), or tuple of str, length k
        A matrix H, or expressions of the states and t.
    noise_cov : nested tuple, shape (k, k)
        R.
    angles : tuple of int
        Components of z that are angles in radians (expressions only).
    """

    h: Matrix | tuple[str, ...]
    noise_cov: Matrix
    angles: tuple[Annotated[int, Field(ge=0)], ...] = ()

    @property
    def is_text(self):
        """Whether `h` is given as expressions."""
        return isinstance(self.h[0], str)

    @model_validator(mode="after")
    def _one_reading(self):
        if not self.h:
            raise ValueError("h needs at least one row or expression")
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
    """How a run starts, at time `Times.start`.

    Attributes
    ----------
    kind : str
        "gaussian": the truth is drawn from N(mean, cov), which the filters are given. "tpd": two-point
        differencing of two measurements (002 6.6); N(mean, cov) is where the truth was `burn_in` seconds
        earlier. "benes": the density cosh(x) N(x; mean, cov) up to a factor, which `BenesFilter` carries.
    mean, cov : tuple, shapes (n,), (n, n)
    burn_in : float
        Seconds the truth runs before the start, to be near its stationary law.
    interval : float
        T0, seconds between the two measurements of "tpd".
    pairs : tuple of (int, int)
        For each component of z the states (position, velocity) that "tpd" starts from it.
    """

    kind: Literal["gaussian", "tpd", "benes"]
    mean: Row
    cov: Matrix
    burn_in: Annotated[float, Field(ge=0)] = 0.0
    interval: Positive = 0.5
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
class ScenarioSettings:
    """One scenario file.

    Attributes
    ----------
    description, source : str
        One line for `list`; where the scenario or its figures come from.
    exact : str or None
        Name of the filter that is exact here, and the reference of the others.
    """

    description: str
    source: str = ""
    exact: str | None = None
    model: ModelText
    sensor: Sensor
    times: Times
    start: Start
    runs: Runs = Field(default_factory=Runs)
    filters: Filters = Field(default_factory=Filters)
    published: dict[str, Published] = Field(default_factory=dict)
