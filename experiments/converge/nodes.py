"""Whether more nodes ever make the SPH filter worse: error of the mean, and what the filter says of it."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from experiments.benchmark import reference
from experiments.benchmark.errors import root_mean_square
from experiments.scene.filters import Factory, takes_grid
from experiments.scene.scenario import load_scenario, read_settings, scenario_names
from experiments.show.comparison import moment_errors
from experiments.show.files import write_rows
from experiments.show.tables import markdown, number, print_table, table
from experiments.terminal.running import tell
from sphfilter.campaign.campaign import draw_case
from sphfilter.campaign.one_run import put_through
from sphfilter.errors import ConfigError, SphfilterError

from .transient import progress

#: Errors of the mean, in standard deviations, below which nothing is asked for, by the number of states.
_FLOORS = {1: 1e-5, 2: 1e-4}
_LIMIT = 1.5  # times that an error may grow from a count to the next


@dataclass(frozen=True)
class Problem:
    """Simulated runs of a sensor or a scenario, and how they are filtered."""

    name: str
    note: str
    cases: list  # list of Case
    # reference(case) → mean (T, n), covariance (T, n, n), a bound of the mean's error in standard deviations
    reference: object
    make: object  # make(case, n_particles) → the filter


@dataclass(frozen=True)
class Row:
    """What was found of a problem on K numbers of nodes."""

    name: str
    note: str
    # errors below it do not count: 1e-5 for one state, 1e-4 for two, or what the reference is good for
    floor: float
    counts: list
    # shape (K,): root mean squares over runs and readings of the error of the mean in posterior standard
    # deviations, and of what the filter said it was
    errors: np.ndarray
    told: np.ndarray
    # shape (K,): readings without an answer, and answers with a flag
    refused: np.ndarray
    flagged: np.ndarray
    said: list  # sentences of what was refused

    @property
    def worst(self):
        """Most that the error grows from a count to the next, from the floor upwards."""
        above = np.maximum(self.errors, self.floor)
        return float(np.nanmax(above[1:] / above[:-1]))


def measured(problem, counts, told):
    """The `Row` of a problem; `told` is called with a label before each piece of work."""
    truths = []
    for case in problem.cases:
        told({"reference of": problem.name})
        truths.append(problem.reference(case))
    found, said = [], []
    for count in counts:
        told({"filter on": problem.name, "particles": count})
        runs = [_run(problem, *pair, count, said) for pair in zip(problem.cases, truths, strict=True)]
        errors, beliefs, refused, flagged = zip(*runs, strict=True)
        rms = (root_mean_square(np.concatenate(parts)) for parts in (errors, beliefs))
        found.append((*rms, sum(refused), sum(flagged)))
    floor = max(_FLOORS[truths[0][0].shape[1]], *(bound for *_, bound in truths))
    columns = (np.array(column) for column in zip(*found, strict=True))
    return Row(problem.name, problem.note, floor, list(counts), *columns, said)


def _run(problem, case, truth, count, said):
    """Errors, what the filter said they were, readings refused and flagged; a refusal is added to `said`."""
    mean, cov, _ = truth
    try:
        result = put_through(problem.make(case, count), case)
    except SphfilterError as refusal:
        said.append(f"{problem.name} ({problem.note}), {count} particles: {refusal}")
        return [np.nan], [np.nan], len(case.times), 0
    error = moment_errors(result.x, result.P, mean, cov)[0]
    return error, result.error, int((~result.accepted).sum()), int(result.flagged.sum())


def scenes(names, n_runs, seed, changes, folder):
    """What builds the `Problem` of each scenario of one or two states: functions without arguments.

    Without names these are all that come with the project. `changes` are keys of the scenarios, `folder`
    keeps references.
    """
    names = names or [name for name in scenario_names() if len(read_settings(name).model.states) <= 2]
    return [partial(_scene, name, n_runs, seed, changes, folder) for name in names]


def _scene(name, n_runs, seed, changes, folder):
    scenario = load_scenario(name, **changes)
    if not takes_grid(scenario.model):
        raise ConfigError(f"{name}: --over nodes needs one or two states with additive noise, for its grid")
    # a fifth of the floor: the change from the next coarser grid bounds the error
    effort = reference.Effort(error=0.2 * _FLOORS[scenario.model.dim], first=2, last=5)

    def converged(case):
        found = reference.find(scenario, case, effort, folder)
        return found.result.x, found.result.P, found.mean

    def make(case, count):
        sized = load_scenario(name, **changes, **{"filters.sph.n_particles": count})
        return Factory("sph", sized, sized.settings.filters.sph)(case, None)

    cases = [draw_case(scenario, seed, run) for run in range(n_runs)]
    return Problem(scenario.name, f"{len(cases[0].times)} readings", cases, converged, make)


def study(args, console, builders, counts, stem):
    """Measure every problem, print the table, and write it as markdown and CSV in files called `stem`.

    The `builders` return a `Problem` each; `args` has runs and out.
    """
    rows = []
    with progress(console, len(builders) * (args.runs + len(counts))) as told:
        for build in builders:
            rows.append(measured(build(), counts, told))
    print_table(console, _table(rows, args.runs))
    tell(console, _sentences(rows))
    out = args.out or Path("results") / f"converge_{stem}"
    write_rows(out / f"{stem}.csv", [line for row in rows for line in _lines(row)])
    headings = ("", *map(str, counts), "worst", "refused", "flagged")
    text = markdown(headings, [(f"{row.name}, {row.note}", *_cells(row, "{} ({})")) for row in rows])
    (out / f"{stem}.md").write_text("\n".join([*text, ""]), encoding="utf-8")
    console.print(f"Tables: {out / stem}.md, {out / stem}.csv")


def _table(rows, n_runs):
    title = f"Error of the mean (std), below it what info.error says; runs of each: {n_runs}"
    made = table(title, ("particles", *map(str, rows[0].counts), "worst", "refused", "flagged"))
    for row in rows:
        made.add_row(f"{row.name}\n{row.note}", *_cells(row, "{}\n{}"), end_section=True)
    return made


def _cells(row, form):
    """Texts of a row: error and what was told of it for each count, the worst growth, and two counts."""
    pairs = zip(row.errors, row.told, strict=True)
    errors = [form.format(*(number(value, ".1e").replace("e-0", "e-") for value in pair)) for pair in pairs]
    return *errors, number(row.worst, ".2f"), str(row.refused.sum()), str(row.flagged.sum())


def _lines(row):
    """A flat dict for each count, for a file."""
    columns = zip(row.counts, row.errors, row.told, row.refused, row.flagged, strict=True)
    for count, error, told, refused, flagged in columns:
        yield {
            "name": row.name, "note": row.note, "particles": count, "mean": error, "told": told,
            "refused": refused, "flagged": flagged, "floor": row.floor,
        }  # fmt: skip


def _sentences(rows):
    """What the table comes to."""
    worse = [row for row in rows if row.worst > _LIMIT]
    names = ", ".join(f"{row.name} ({row.note}) {row.worst:.1f}" for row in worse) or "none"
    yield f"more than {_LIMIT:g} times worse from a count to the next, above the floor: {names}"
    low, high = (pick(row.floor for row in rows) for pick in (min, max))
    yield f"floors, below which nothing is asked for: {low:.1g} to {high:.1g} standard deviations"
    yield from (sentence for row in rows for sentence in row.said)
