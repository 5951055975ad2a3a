"""What a transient scenario file may say, read without its model; all files have one form."""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from experiments.scene.files import change, file_names, find_file
from sphfilter.config import SolverConfig
from sphfilter.files.model_file import with_tables
from sphfilter.files.text import Matrix, ModelText, Row
from sphfilter.settings import Count, Positive, from_table, read_toml, settings

from .grids import Lattice, Probe, Written

_FOLDER = Path(__file__).parents[1] / "scenarios" / "transient"


@settings
class Begin:
    """The density at `time`."""

    # "gaussian" with mean and cov, "uniform" on a box, or "expression" with a pdf of the states on a box
    # (zero outside, normalised here; nodes where it is zero carry no particle)
    kind: Literal["gaussian", "uniform", "expression"] = "gaussian"
    mean: Row | None = None
    cov: Matrix | None = None
    box: tuple[tuple[float, float], ...] | None = None
    pdf: str | None = None
    # nodes that carry a particle each where the density is not zero, instead of a box
    lattice: Lattice | None = None
    time: float = 0.0
    # standard deviations out to which particles of a Gaussian lie; the scheme's own if None
    reach: Annotated[float, Field(ge=2.5, le=12)] | None = None

    @model_validator(mode="after")
    def _fits_its_kind(self):
        if self.lattice is not None and (self.box is not None or self.reach is not None):
            raise ValueError("a lattice has a box of its own: leave out box and reach")
        boxed = () if self.lattice is not None else ("box",)
        needed = {"gaussian": ("mean", "cov"), "uniform": boxed, "expression": (*boxed, "pdf")}[self.kind]
        for key in ("mean", "cov", "box", "pdf"):
            if (getattr(self, key) is None) == (key in needed):
                verb = "needs" if key in needed else "has no"
                raise ValueError(f'kind = "{self.kind}" {verb} {key}')
        return self

    @property
    def sides(self):
        """The box, shape (n, 2), also that of a lattice; None for a Gaussian that has neither."""
        return self.box if self.lattice is None else self.lattice.box


@settings
class Output:
    """Times of output, seconds: as given, or every `interval` up to `end`; densities are drawn at `drawn`."""

    at: Row | None = None
    end: float | None = None
    interval: Positive | None = None
    drawn: Row = ()

    @model_validator(mode="after")
    def _one_way(self):
        if (self.at is None) == (self.end is None) or (self.end is None) != (self.interval is None):
            raise ValueError("give either at, or end and interval")
        return self

    def times(self, start):
        """Times of output, shape (T,)."""
        if self.at is not None:
            return np.array(self.at)
        n = int(np.floor((self.end - start) / self.interval * (1 + 1e-12)))
        return start + self.interval * np.arange(1, n + 1)


@settings
class Solver:
    """Upper bound of the number of particles (400, or as many as a lattice has), and the configuration."""

    n_particles: Count | None = None
    config: SolverConfig = Field(default_factory=SolverConfig)


@settings
class Statistics:
    """What is reported besides mean and covariance."""

    moments: tuple[tuple[Annotated[int, Field(ge=0)], ...], ...] = ()  # length n each: powers of raw moments
    exceedance: tuple[str, ...] = ()  # conditions on the states, such as "abs(q) > 0.5"
    # orders of cumulant equations to solve beside (polynomial models, 000 4.1.3)
    cumulants: tuple[Annotated[int, Field(ge=2, le=10)], ...] = ()


@settings
class Reference:
    """What the solution is compared with."""

    # "linear" (closed form of a linear model from a Gaussian), "drifted_uniform" (000 (58)), "grid" (one or
    # two states), "monte_carlo", or "none"
    kind: Literal["linear", "drifted_uniform", "grid", "monte_carlo", "none"] = "none"
    size: Count = 128  # nodes an axis of the grid; half as many bound its error
    n_paths: Annotated[int, Field(ge=20)] = 1_000_000  # of Monte Carlo
    step: Positive | None = None  # time step of Monte Carlo, seconds; by the model's rates if None


@settings
class Steady:
    """A raw moment of the steady state, in closed form."""

    powers: tuple[Annotated[int, Field(ge=0)], ...]
    value: float


@settings
class TransientSettings:
    """One file."""

    # one line for `list`; where system and figures come from, and what was left open there
    description: str = ""
    source: str = ""
    model: ModelText
    start: Begin
    times: Output
    solver: Solver = Field(default_factory=Solver)
    statistics: Statistics = Field(default_factory=Statistics)
    output: Written = Field(default_factory=Written)
    probe: Probe | None = None
    reference: Reference = Field(default_factory=Reference)
    steady: tuple[Steady, ...] = ()
    # what the publication says of accuracy and run time, a sentence each; printed beside ours
    published: tuple[str, ...] = ()
    axes: tuple[int, ...] = ()  # states drawn against each other, two or three

    @model_validator(mode="after")
    def _in_continuous_time(self):
        if self.model.transition:
            raise ValueError("a transient scenario needs a drift: its equation is solved in continuous time")
        return self


def problem_names():
    """Names of the transient scenarios that come with the project."""
    return file_names(_FOLDER)


def read_problem(name, changes=None):
    """Path and `TransientSettings` of a scenario by name, or of a TOML file's path; `changes` by dotted key.

    Raises `ConfigError`.
    """
    path = find_file(name, _FOLDER, "transient scenario")
    tree = read_toml(path)
    for key, value in (changes or {}).items():
        change(tree, key, value)
    return path, from_table(TransientSettings, with_tables(tree, path), path)
