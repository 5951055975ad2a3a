"""`python -m experiments benchmark [NAME ...]`: all filters on the same measurements, run time against error.

Every competitor is compared with a converged reference whose own error is bounded and printed.
"""

import os
import platform
from dataclasses import asdict, replace
from datetime import UTC, datetime

import numba

from experiments.arguments.benchmark import EXPENSIVE, SCENARIOS
from experiments.scene.files import changes_of
from experiments.scene.scenario import load_scenario
from experiments.show.tables import counted, print_table
from experiments.terminal.progress import bar, resumable
from experiments.terminal.running import new_console, tell
from sphfilter.campaign.store import versions
from sphfilter.errors import ConfigError, SphfilterError
from sphfilter.files.write import write_json

from . import expensive, frontier, overview, plots, tables
from .campaign import Plan, run_scenario
from .families import FAMILIES
from .methods import default_families, methods
from .reference import Effort
from .store import code_digest

_QUICK = Effort(error=1e-2, first=0, last=1, n_paths=20_000, n_runs=4)
_FULL = Effort(error=2e-5, first=2, last=5, n_runs=50)


def main(args):
    """Run the command; prints to standard output."""
    console = new_console(width=140)
    changes = changes_of(args)
    names = args.scenarios or [*SCENARIOS, EXPENSIVE]
    scenarios = {name: load_scenario(name, **changes) for name in names if name != EXPENSIVE}
    if EXPENSIVE in names:
        scenarios.setdefault(expensive.BASE, load_scenario(expensive.BASE, **changes))
    work = [(scenario, _competitors(scenario, args)) for scenario in scenarios.values()]
    evaluations = tuple(scenarios) if args.full else (expensive.BASE,) * (EXPENSIVE in names)
    plan, machine, outcomes = _plan(args, evaluations), {"start": _machine()}, []
    for scenario, competitors in work:
        try:
            outcomes.append(_measured(console, scenario, competitors, plan))
        except SphfilterError as problem:  # no reference: the other scenarios go on
            console.print(f"{problem}\n", style="red")
            continue
        _tell(console, outcomes[-1])
        # after every scenario, so that an interruption leaves whole files
        drawn = _write(args, plan, outcomes, machine | {"end": _machine()}, work)
    if not outcomes:
        raise ConfigError("nothing was measured: no scenario has a reference")
    if EXPENSIVE in names:
        drawn.append(_expensive(console, expensive.BASE, outcomes, plan))
    console.print(
        f"Numbers are in {args.out}/benchmark.csv and .md, all settings in benchmark.json.", soft_wrap=True
    )
    console.print(f"Pictures: {', '.join(map(str, drawn))}", soft_wrap=True)


def _plan(args, evaluations):
    effort = _QUICK if args.quick else _FULL if args.full else Effort()
    if args.reference_paths:
        effort = replace(effort, n_runs=max(2, round(args.reference_paths / effort.n_paths)))
    runs = args.runs or (2 if args.quick else 5)
    limit = args.limit or (120.0 if args.full else 10.0)
    return Plan(folder=args.out, n_runs=runs, seed=args.seed, limit=limit, effort=effort, counted=evaluations)


def _competitors(scenario, args):
    """Those asked for that fit the scenario; two threads only where numba has them."""
    families = default_families(scenario)
    if args.filters:
        asked = args.filters
        exact = set(families) | {name for name in asked if name.startswith("sph:")}
        families = [name for name in asked if name in exact or name not in FAMILIES]
    made = methods(families, scenario, args.counts, args.full)
    return [m for m in made if m.threads <= numba.config.NUMBA_NUM_THREADS]


def _measured(console, scenario, competitors, plan):
    """Run one scenario with a progress bar."""
    console.print(f"[bold]{scenario.name}[/]: {scenario.settings.description}")
    kept = f"what was measured is kept in {plan.folder}. The same command goes on from there."
    with bar(console, "", plan.n_runs * (len(competitors) + 1)) as move, resumable(lambda: kept):
        return run_scenario(scenario, competitors, plan, lambda text, done: move(done, text=text))


def _tell(console, outcome):
    print_table(console, tables.table(outcome), keep=2)
    tell(console, tables.sentences(outcome))
    console.print()


def _expensive(console, scenario, outcomes, plan):
    """Tell and draw who wins where the drift is expensive."""
    lines = next(o.lines for o in outcomes if o.scenario == scenario)
    title = f"{scenario} with an expensive drift: the fastest to reach an error of the mean"
    print_table(console, expensive.table(lines, title))
    expensive.write(plan.folder, lines)
    return plots.draw_expensive(plan.folder, lines, scenario)


def _write(args, plan, outcomes, machine, work):
    """Write numbers, settings and pictures; returns the pictures."""
    plan.folder.mkdir(parents=True, exist_ok=True)
    tables.write_csv(plan.folder / "benchmark.csv", outcomes)
    title = f"Filters side by side: {counted(plan.n_runs, 'run')}, seed {plan.seed}"
    told = tables.markdown(outcomes, title) + overview.markdown(outcomes) + frontier.markdown(outcomes)
    (plan.folder / "benchmark.md").write_text(told, encoding="utf-8")
    record = {
        "arguments": {key: str(value) for key, value in vars(args).items()},
        "plan": {key: str(value) for key, value in asdict(plan).items()},
        "code": code_digest(),
        "versions": versions(),
        "machine": machine,
        "scenarios": {scenario.name: repr(scenario.settings) for scenario, _ in work},
        "competitors": {s.name: {m.key: repr(m.factory.settings) for m in made} for s, made in work},
    }
    write_json(plan.folder / "benchmark.json", record)
    return plots.draw(plan.folder, outcomes)


def _machine():
    """Processor and load: run times are of this machine, at this time."""
    try:
        with open("/proc/cpuinfo") as file:
            model = next(
                (line.partition(":")[2].strip() for line in file if line.startswith("model name")), ""
            )
    except OSError:
        model = platform.processor()
    return {
        "processor": model,
        "cores": os.cpu_count(),
        "threads": numba.config.NUMBA_NUM_THREADS,
        "load": os.getloadavg(),
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
    }
