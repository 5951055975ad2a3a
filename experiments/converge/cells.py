"""One run of a study: a transient problem with some keys changed, its errors, its time, or why it failed."""

import time
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property

import numpy as np

import sphfilter as sf
from experiments.transient.problem import Problem, load_problem
from experiments.transient.solution import warm_up
from sphfilter.errors import SphfilterError

from .errors import Errors, errors_of

SCHEME = "solver.config.scheme"
UNKNOWN = Errors(*4 * (np.nan,))


@dataclass(frozen=True)
class Cell:
    """A run of a study."""

    label: dict  # what was varied
    n_particles: float = np.nan  # average over the output times; NaN where it failed
    errors: Errors = UNKNOWN  # against the truth
    # wall time of the propagation, and processor time, which knows nothing of other programs
    seconds: float = np.nan
    cpu_seconds: float = np.nan
    n_steps: int = 0
    n_searches: int = 0
    n_bypassed: int = 0
    failure: str = ""  # why there is no result; empty if there is
    densities: tuple = field(default=(), repr=False)  # at the output times; empty where it failed

    @property
    def bypass_ratio(self):
        """Bypassed steps a search (002 section 4.3); NaN where it failed."""
        return np.nan if self.failure else self.n_bypassed / max(self.n_searches, 1)


@dataclass(frozen=True)
class Setting:
    """A problem that cells change keys of."""

    name: object  # of the transient scenario
    changes: dict  # keys changed in all cells, by dotted key
    limit: float = np.inf  # seconds a cell may take; it is given up at the next output time

    @cached_property
    def problem(self) -> Problem:
        """The problem as all cells have it."""
        return load_problem(self.name, self.changes)

    def check(self):
        """Raise `ConfigError` or `ModelError` where a key is wrong."""
        _ = self.problem

    def with_changes(self, changes):
        """The setting with more keys changed."""
        return replace(self, changes=self.changes | changes)

    def run(self, label, changes, truth):
        """Run a cell with some keys changed and a label; a failure of the solver becomes its sentence.

        Raises `ConfigError` if a key is wrong: that is wrong in all cells.
        """
        problem = self.with_changes(changes).problem
        try:
            way, seconds, cpu_seconds = self._propagated(problem)
        except SphfilterError as problem_met:
            return Cell(label, failure=str(problem_met))
        if len(way.times) < len(problem.times):
            reached = f"given up after {seconds:.0f} s at t = {way.times[-1]:g} of {problem.times[-1]:g}"
            return Cell(
                label,
                seconds=seconds,
                cpu_seconds=cpu_seconds,
                failure=f"{reached}: --limit allows {self.limit:g} s",
            )
        counts = {key: sum(getattr(info, key) for info in way.infos) for key in _COUNTED}
        size = float(np.mean([density.n_particles for density in way.densities]))
        errors = errors_of(way.densities, truth)
        return Cell(label, size, errors, seconds, cpu_seconds, **counts, densities=way.densities)

    def _propagated(self, problem):
        start, solver = warm_up(problem), problem.settings.solver
        began, cpu_began = time.perf_counter(), time.process_time()

        def late(density, info):
            return time.perf_counter() - began > self.limit

        way = sf.propagate(
            start, problem.model, problem.times, solver.config, n_particles=solver.n_particles, callback=late
        )
        return way, time.perf_counter() - began, time.process_time() - cpu_began


_COUNTED = "n_steps", "n_searches", "n_bypassed"


def cut(name, changes, end):
    """Changes that end a problem at `end`, or leave it alone if it ends before; nothing is drawn."""
    problem = load_problem(name, changes)
    changes = changes | {"times.drawn": []}
    if problem.times[-1] <= end:
        return changes
    if problem.settings.times.at is not None:
        kept = [t for t in problem.settings.times.at if t <= end]
        return changes | {"times.at": kept or [end]}
    interval = min(problem.settings.times.interval, end - problem.settings.start.time)
    return changes | {"times.end": end, "times.interval": interval}


def row_of(cell):
    """A cell as a flat dict, for a file."""
    row = dict(cell.label) | {"n_particles": cell.n_particles} | asdict(cell.errors)
    row |= {
        key: getattr(cell, key) for key in ("seconds", "cpu_seconds", *_COUNTED, "bypass_ratio", "failure")
    }
    return row
