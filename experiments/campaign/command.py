"""`python -m experiments campaign NAME`: many runs of all filters, and a page on which can be believed."""

import json
import shlex
import sys
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

import joblib
import tomli_w

from experiments.run import counted, without_nan, without_none
from experiments.scene.files import add_change_option, changes_of
from experiments.scene.filters import FILTERS, factories, name_of, takes_grid
from experiments.scene.scenario import load_scenario, read_settings
from experiments.terminal.running import new_console, run_shown, status, warm_up
from sphfilter.campaign.report import report
from sphfilter.campaign.store import versions
from sphfilter.errors import ConfigError

from . import page, plots

__all__ = ["EPILOG", "add_arguments", "main"]

EPILOG = """\
Runs have seeds of their own: the figures are the same for any number of processes, and run 7 is the same run
however many there are. Every filter sees the same measurements. Each finished run is kept in OUT/runs;
stopped (Ctrl-C, or worse), the same command goes on, and with a larger --runs it adds to what is there.
"""
_RUNS = 100


def add_arguments(parser):
    """Add the options of `campaign`."""
    parser.add_argument("scenario", help="a name from `list`, or the path of a scenario's TOML file")
    parser.add_argument("--runs", type=counted, default=_RUNS, help=f"simulated runs (default: {_RUNS})")
    parser.add_argument("--jobs", type=counted, default=1, help="processes (default: 1)")
    parser.add_argument("--seed", type=int, help="seed of everything random (default: the scenario's)")
    parser.add_argument(
        "--filters",
        help=f"comma-separated, of {', '.join(FILTERS)} (default: the scenario's, and grid if it can)",
    )
    parser.add_argument(
        "--referee", help="the filter that is right, or none (default: the scenario's exact one, else grid)"
    )
    parser.add_argument(
        "--own-prior",
        action="store_true",
        help="draw truths from the filters' own prior, start.mean and start.cov: then a filter that is right "
        "is consistent from the first measurement on",
    )
    parser.add_argument(
        "--dask",
        metavar="ADDRESS",
        help="run on the machines of a dask scheduler (extra: dask), which have sphfilter installed",
    )
    parser.add_argument("--out", type=Path, help="folder (default: results/campaign/NAME)")
    add_change_option(parser)


def main(args):
    """Run the command; prints to standard output. Returns 1 if a filter failed in every run, else 0."""
    console = new_console()
    changes = changes_of(args)
    if args.own_prior and read_settings(args.scenario, changes).start.kind == "tpd":
        changes |= {"start.kind": "gaussian", "start.pairs": (), "start.burn_in": 0.0}
    scenario = load_scenario(args.scenario, **changes)
    filters = factories(_names(args.filters, scenario), scenario)
    referee = _referee(args.referee, scenario, filters)
    seed = scenario.settings.runs.seed if args.seed is None else args.seed
    out = args.out or Path("results") / "campaign" / scenario.name

    console.print(f"[bold]{scenario.name}[/]: {scenario.settings.description}\n")
    if len(list((out / "runs").glob("run_*.npz"))) < args.runs:
        warm_up(console, scenario, filters)
    with _workers(args.dask):
        jobs = None if args.dask else args.jobs
        campaign = run_shown(console, scenario, filters, args.runs, seed, jobs, out / "runs")
    numbers = report(campaign, referee=referee, labels=scenario.labels)
    facts = _write(out, scenario, campaign, numbers, referee)
    with status(console) as say:
        say("drawing")
        pictures = plots.draw(out, scenario, campaign, numbers)
    written = page.write(out, scenario, numbers, facts, campaign.failures, pictures)
    for name, f in numbers.filters.items():
        console.print(f"[bold]{name_of(name)}[/]: {f.verdict}")
    for run, name, message in campaign.failures[:5]:
        console.print(f"run {run}, {name_of(name)}: {message}", style="red")
    console.print(f"\nThe report is {written}; {out}/campaign.npz holds every run's histories.")
    return int(any(f.n_failed == f.n_runs for f in numbers.filters.values()))


def _names(given, scenario):
    """Names asked for, or the scenario's own with the grid, the referee where nothing is exact."""
    if given is not None:
        return [name.strip() for name in given.split(",")]
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


def _write(out, scenario, campaign, numbers, referee):
    """Write numbers, settings and versions; returns the facts that the page tells too."""
    campaign.save(out / "campaign.npz")
    settings = without_none(asdict(scenario.settings))
    (out / "scenario.toml").write_text(tomli_w.dumps(settings), encoding="utf-8")
    facts = {
        "scenario": scenario.name,
        "seed": campaign.seed,
        "runs": numbers.n_runs,
        "filters": list(campaign.results),
        "referee": referee,
        "command": shlex.join(["python", "-m", "experiments", *sys.argv[1:]]),
        "versions": versions(),
    }
    failures = [failure._asdict() for failure in campaign.failures]
    record = facts | {
        "report": numbers.as_dict(),
        "failures": failures,
        "settings": asdict(scenario.settings),
    }
    text = json.dumps(without_nan(record), indent=1, allow_nan=False)
    (out / "report.json").write_text(text, encoding="utf-8")
    return facts
