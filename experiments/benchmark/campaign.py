"""A benchmark of one scenario: all competitors on the same cases, kept row by row."""

from dataclasses import dataclass
from itertools import count, pairwise
from pathlib import Path

import numpy as np

from experiments.show.files import digest
from sphfilter.campaign.campaign import draw_case

from . import reference
from .counting import drift_evaluations
from .measure import measure, warm_up
from .store import Rows, code_digest
from .summary import ReferenceError, summarise


@dataclass(frozen=True)
class Plan:
    """What is asked of a benchmark."""

    folder: Path  # of rows and references
    n_runs: int
    seed: int
    limit: float  # seconds of a run; sizes that would take longer are left out, runs that do are given up
    effort: reference.Effort
    counted: tuple = ()  # scenarios whose drift evaluations are counted, which takes minutes each


@dataclass(frozen=True)
class Outcome:
    """A scenario's lines, its reference, and the keys of competitors left out as too slow."""

    scenario: str
    lines: list
    reference: ReferenceError
    left_out: list


def run_scenario(scenario, competitors, plan, say):
    """Measure what is not on disk yet, and put everything together, as an `Outcome`.

    Of the competitors smaller sizes of a family come first. `say(text, done)` is called for each piece of
    work begun, with how many are done.
    """
    cases = [draw_case(scenario, plan.seed, run) for run in range(plan.n_runs)]
    references, done = [], count()
    for run, case in enumerate(cases):
        say(f"reference of run {run + 1}", next(done))
        references.append(reference.find(scenario, case, plan.effort, plan.folder / "references"))
    work = _Work(scenario, competitors, plan, cases, references)
    for run in range(plan.n_runs):  # a busy spell of the machine meets all competitors alike
        for method in competitors:
            say(f"run {run + 1}, {method.key}", next(done))
            if not work.left_out(method):
                work.row(method, run)
    together, n_done = ReferenceError.of(references), next(done)
    lines = []
    for method in competitors:
        if not work.left_out(method):
            if scenario.name in plan.counted:
                say(f"drift evaluations of {method.key}", n_done)
            rows = [work.row(method, run) for run in range(plan.n_runs)]
            lines.append(summarise(scenario, method, rows, work.drift(method), together))
    return Outcome(scenario.name, lines, together, [m.key for m in competitors if work.left_out(m)])


class _Work:
    """Rows of one scenario, measured when they are first asked for."""

    def __init__(self, scenario, competitors, plan, cases, references):
        self._scenario, self._plan, self._cases, self._references = scenario, plan, cases, references
        self._rows, self._known, self._warm = Rows(plan.folder / "rows"), {}, set()
        self._smaller = {}
        for series in {m.series for m in competitors}:
            for smaller, method in pairwise(m for m in competitors if m.series == series):
                self._smaller[method.key] = smaller

    def left_out(self, method):
        """Whether a method is too slow, going by the next smaller size of its series in the first run."""
        smaller = self._smaller.get(method.key)
        if smaller is None:
            return False
        if self.left_out(smaller):
            return True
        row = self.row(smaller, 0)
        if "failure" in row:
            return _gave_up(row)
        return row["seconds"][0] * method.size / smaller.size > self._plan.limit

    def row(self, method, run):
        """The row of a run; where the first run was given up, so are the others."""
        if run > 0 and _gave_up(self.row(method, 0)):
            return self.row(method, 0)
        return self._kept(method, run, lambda: self._measured(method, run))

    def drift(self, method):
        """Evaluations of the drift in the first run; NaN where they are not counted."""
        counted = self._scenario.name in self._plan.counted and method.family not in ("kf", "benes")
        if not counted or "failure" in self.row(method, 0):
            return np.nan
        n_steps = self.row(method, 0)["steps"]
        limit = 60.0 + 3 * self._plan.limit  # black boxes are slow, and compile anew

        def evaluations():
            return {"drift": drift_evaluations(method, self._scenario, self._cases[0], n_steps, limit)}

        return self._kept(method, "-drift", evaluations)["drift"]

    def _measured(self, method, run):
        if method.key not in self._warm:
            warm_up(method, self._cases[0])
            self._warm.add(method.key)
        seed = [self._plan.seed, run]
        return measure(method, self._cases[run], self._references[run], seed, self._plan.limit)

    def _kept(self, method, run, make):
        """A row in memory or on disk; else a new one."""
        if (method.key, run) not in self._known:
            plan, name = self._plan, self._scenario.name
            asked = self._scenario.settings, method, plan.seed, plan.limit, plan.effort, code_digest()
            made_of = digest(repr(asked))
            row = self._rows.read(name, method.key, run, made_of)
            if row is None:
                row = make()
                self._rows.write(name, method.key, run, made_of, row)
            self._known[method.key, run] = row
        return self._known[method.key, run]


def _gave_up(row):
    return row.get("failure", "").startswith("stopped")
