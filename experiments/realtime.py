"""`python -m experiments realtime`: steps within a time budget, and the error that is left."""

import time
from dataclasses import dataclass

import numpy as np

import sphfilter as sf
from sphfilter.campaign.campaign import draw_case
from sphfilter.campaign.one_run import put_through
from sphfilter.errors import SphfilterError
from sphfilter.filter import budget as timing

from .arguments.realtime import budgets_of
from .benchmark import reference
from .benchmark.errors import errors, root_mean_square
from .benchmark.watch import Watched
from .scene.scenario import load_scenario
from .show.tables import number, print_table, table
from .terminal.running import new_console, status, tell

_CLOCKS = {"wall": time.perf_counter, "processor": time.process_time}
_MOST = 20_000  # particles
_HEADINGS = (
    "scenario",
    "budget",
    "steps within",
    "median step",
    "particles",
    "error of the mean",
    "steps repeated",
    "runs refused",
)


@dataclass(frozen=True)
class Outcome:
    """Runs of a scenario under one budget."""

    seconds: np.ndarray  # shape (K,): of each step: a prediction and the update after it
    n_particles: np.ndarray  # shape (K,): after each update
    # of the posterior mean against the reference, posterior standard deviations, rms over the runs
    error: float
    repeated: int  # steps that had to be repeated on more particles
    failures: list  # sentences of the runs that ended early

    def within(self, budget):
        """Share of the steps that ended within a budget, seconds."""
        return float(np.mean(self.seconds <= budget)) if len(self.seconds) else np.nan


def main(args):
    """Run the command; prints to standard output."""
    console = new_console()
    timing.clock = _CLOCKS[args.clock]
    budgets = budgets_of(args)
    scenarios = [load_scenario(name) for name in args.scenarios]
    rows, told = [], []
    with status(console) as say:
        for scenario in scenarios:
            say(f"{scenario.name}: references")
            pairs = _cases(scenario, args)
            for budget in budgets:
                say(f"{scenario.name}: {budget:g} ms")
                outcome = _outcome(scenario, pairs, 1e-3 * budget)
                rows.append((scenario.name, f"{budget:g} ms", *_cells(outcome, 1e-3 * budget, args.runs)))
                told += [f"{scenario.name}, {budget:g} ms: {text}" for text in outcome.failures]
    print_table(console, table("", _HEADINGS, rows), keep=2)
    tell(console, told)


def _cases(scenario, args):
    cases = [draw_case(scenario, args.seed, run) for run in range(args.runs)]
    folder = args.out / "references"
    return [(case, reference.find(scenario, case, reference.Effort(), folder).result) for case in cases]


def _outcome(scenario, pairs, budget):
    """All runs under one budget."""
    seconds, particles, found, failures, repeated = [], [], [], [], 0
    for case, exact in pairs:
        watched = Watched(_prepared(scenario, case, budget))
        try:
            found.append(errors(put_through(watched, case), exact).mean)
        except SphfilterError as problem:
            failures.append(str(problem))
        steps = list(zip(watched.predictions, watched.updates, strict=False))
        seconds += [p.seconds + u.seconds for p, u in steps]
        particles += [u.n_particles for _, u in steps]
        repeated += sum("times the particles" in p.status for p, _ in steps)
    return Outcome(np.array(seconds), np.array(particles), root_mean_square(found), repeated, failures)


def _prepared(scenario, case, budget):
    config = sf.FilterConfig(time_budget=budget)
    shape = {"n_particles": _MOST, "config": config}
    flt = sf.SPHFilter(scenario.model, scenario.measurement, case.x0, case.P0, t0=case.t0, **shape)
    flt.prepare(case.times[0] - case.t0)
    return flt


def _cells(outcome, budget, n_runs):
    if not len(outcome.seconds):
        return ["", "", "", "", "", f"{len(outcome.failures)} of {n_runs}"]
    return [
        f"{100 * outcome.within(budget):.0f} % of {len(outcome.seconds)}",
        f"{1e3 * np.median(outcome.seconds):.1f} ms",
        f"{np.median(outcome.n_particles):.0f}",
        number(outcome.error, ".2g", unknown=""),
        str(outcome.repeated),
        f"{len(outcome.failures)} of {n_runs}",
    ]
