"""`python -m experiments campaign NAME`: many runs of all filters, and a page on which can be believed."""

import shlex
import sys
from contextlib import contextmanager
from pathlib import Path

import joblib

from experiments.scene.files import changes_of
from experiments.scene.filters import name_of, takes_grid
from experiments.scene.reading import read_settings
from experiments.scene.scenario import load_scenario
from experiments.terminal.running import new_console, status, tell
from sphfilter.campaign.report import report
from sphfilter.errors import ConfigError

from . import page, plots
from .work import exit_code, tell_failures, work_of


def main(args):
    """Run the command; prints to standard output. Returns 1 if a filter failed in every run, else 0."""
    console = new_console()
    changes = changes_of(args)
    if args.own_prior and read_settings(args.scenario, changes).start.kind == "tpd":
        changes |= {"start.kind": "gaussian", "start.pairs": (), "start.burn_in": 0.0}
    scenario = load_scenario(args.scenario, **changes)
    folder = Path("results") / "campaign" / scenario.name
    work = work_of(args, scenario, _names(args.filters, scenario), args.runs, folder)
    referee, out = _referee(args.referee, scenario, work.filters), work.out

    with _workers(args.dask):
        work.prepare(console, out / "runs")
        campaign = work.run(console, None if args.dask else args.jobs, out / "runs")
    numbers = report(campaign, referee=referee, labels=scenario.labels)
    facts = {"runs": numbers.n_runs, "referee": referee}
    facts["command"] = shlex.join(["python", "-m", "experiments", *sys.argv[1:]])
    facts = work.write("report", campaign, numbers, scenario.settings, **facts)
    with status(console) as say:
        say("drawing")
        pictures = plots.draw(out, scenario, campaign, numbers)
    written = page.write(out, scenario, numbers, facts, campaign.failures, pictures)
    for name, f in numbers.filters.items():
        console.print(f"[bold]{name_of(name)}[/]: {f.verdict}")
    tell(console, numbers.verdicts[-1:])
    tell_failures(console, campaign.failures[:5])
    console.print(
        f"\nThe report is {written}; {out}/campaign.npz holds every run's histories.", soft_wrap=True
    )
    return exit_code(numbers)


def _names(given, scenario):
    """Names asked for, or the scenario's own with the grid, the referee where nothing is exact."""
    if given is not None:
        return given
    names = list(scenario.settings.filters.default)
    wanted = takes_grid(scenario.model) and not scenario.settings.exact and "grid" not in names
    return [*names, "grid"] if wanted else names


def _referee(given, scenario, filters):
    if given == "none":
        return None
    if given is None:
        known = (scenario.settings.exact, "grid")
        return next((name for name in known if name in filters), None)
    if given not in filters:
        raise ConfigError(f"--referee {given} is none of the filters of this campaign: {', '.join(filters)}")
    return given


@contextmanager
def _workers(address):
    """The processes of this machine, or those of a dask scheduler."""
    if address is None:
        yield
        return
    try:
        from distributed import Client
    except ImportError:
        raise ConfigError('--dask needs dask: pip install "sphfilter[dask]"') from None
    try:
        client = Client(address, timeout="10s")
    except (OSError, ValueError) as problem:
        raise ConfigError(f"no dask scheduler answers at {address}: {problem}") from None
    with client, joblib.parallel_config(backend="dask", wait_for_workers_timeout=30):
        yield
