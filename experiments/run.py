"""`python -m experiments run NAME`: simulate a scenario, run filters on it, tell and draw what came out."""

import argparse
import hashlib
import json
import shutil
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import tomli_w

from sphfilter.campaign.report import report
from sphfilter.campaign.store import versions
from sphfilter.errors import SphfilterError

from . import pictures
from .scene.files import add_change_option, changes_of
from .scene.filters import FILTERS, factories, name_of
from .scene.scenario import load_scenario
from .show import plots
from .show.comparison import distances, reference_name
from .show.tables import distance_table, result_table, sentences
from .terminal.running import new_console, run_shown, status, warm_up

__all__ = ["add_arguments", "counted", "main", "without_nan", "without_none"]


def add_arguments(parser):
    """Add the options of `run`."""
    parser.add_argument("scenario", help="a name from `list`, or the path of a scenario's TOML file")
    parser.add_argument("--filters", help=f"comma-separated, of {', '.join(FILTERS)}")
    parser.add_argument("--runs", type=counted, help="number of simulated runs")
    parser.add_argument("--seed", type=int, help="seed of everything random")
    parser.add_argument("--out", type=Path, help="folder for results (default: results/NAME)")
    parser.add_argument("--jobs", type=counted, default=1, help="processes")
    parser.add_argument("--n-particles", type=int, help="particles of the SPH filters, at most")
    parser.add_argument(
        "--pictures",
        metavar="NAMES",
        help="comma-separated pictures of the paper to draw besides the histories, or none "
        "(default: all the scenario has, if sph_paper runs)",
    )
    add_change_option(parser)


def counted(text):
    if not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"a whole number of at least 1 is needed, not {text!r}")
    return int(text)


def main(args):
    """Run the command; prints to standard output. Returns 1 if a filter failed in every run, else 0."""
    console = new_console()
    changes = changes_of(args)
    if args.n_particles is not None:
        changes |= {f"filters.{name}.n_particles": args.n_particles for name in ("sph", "sph_paper")}
    scenario = load_scenario(args.scenario, **changes)
    names = None if args.filters is None else [name.strip() for name in args.filters.split(",")]
    filters = factories(names, scenario)
    n_runs = scenario.settings.runs.default if args.runs is None else args.runs
    seed = scenario.settings.runs.seed if args.seed is None else args.seed
    wanted = pictures.chosen(scenario, args.pictures if "sph_paper" in filters else args.pictures or "none")
    out = args.out or Path("results") / scenario.name

    console.print(f"[bold]{scenario.name}[/]: {scenario.settings.description}")
    console.print(f"{scenario.settings.source}\n", style="dim")
    warm_up(console, scenario, filters)
    campaign = _campaign(console, scenario, filters, n_runs, seed, args.jobs, out)
    numbers = report(campaign)
    reference = reference_name(scenario, filters)
    distance = distances(campaign.results, reference) if reference else {}
    _tell(console, scenario, campaign, numbers, distance, reference)
    _write(out, scenario, campaign, numbers, distance)
    with status(console) as say:
        drawn = plots.draw(out, scenario, filters, campaign, say)
    console.print(f"Numbers are in {out}/campaign.npz and run.json, the scenario as run in scenario.toml.")
    for name in wanted:
        drawn += _picture(console, name, scenario, out, seed, n_runs)
    console.print(f"Pictures: {', '.join(str(path) for path in drawn)}")
    _mention_unfinished(console, out)
    return int(any(f.n_failed == f.n_runs for f in numbers.filters.values()))


def _mention_unfinished(console, out):
    left = ", ".join(str(folder) for folder in sorted(out.glob("unfinished-*")))
    if left:
        text = "Interrupted runs of other settings wait to be gone on with, or to be deleted, in"
        console.print(f"{text} {left}", style="dim")


def _picture(console, name, scenario, out, seed, n_runs):
    """Draw a picture of the paper; one that cannot be drawn costs none of the results."""
    with status(console) as say:
        say(f"drawing {name} (up to half a minute; the numbers are safe)")
        try:
            return pictures.draw(name, scenario, out, seed, n_runs, lambda text: console.print(f"• {text}"))
        except SphfilterError as problem:
            console.print(f"picture {name}: {problem}", style="red")
            return []


def _campaign(console, scenario, filters, n_runs, seed, n_jobs, out):
    """Run the campaign with a progress bar. Finished runs wait in a folder of its own until all are done."""
    which = hashlib.sha256(f"{scenario} {filters} {seed}".encode()).hexdigest()[:8]
    folder = out / f"unfinished-{which}"
    campaign = run_shown(console, scenario, filters, n_runs, seed, n_jobs, folder)
    shutil.rmtree(folder)
    return campaign


def _tell(console, scenario, campaign, numbers, distance, reference):
    console.print(result_table(numbers, scenario))
    if distance:
        console.print(distance_table(distance, reference))
    for sentence in sentences(numbers, scenario):
        console.print(f"• {sentence}")
    for run, name, message in campaign.failures:
        console.print(f"run {run}, {name_of(name)}: {message}", style="red")
    console.print()


def _write(out, scenario, campaign, numbers, distance):
    """Write numbers, settings and versions."""
    out.mkdir(parents=True, exist_ok=True)
    campaign.save(out / "campaign.npz")
    runs = replace(scenario.settings.runs, default=numbers.n_runs, seed=campaign.seed)
    filters = replace(scenario.settings.filters, default=tuple(campaign.results))
    settings = replace(scenario.settings, runs=runs, filters=filters)
    text = tomli_w.dumps(without_none(asdict(settings)))
    (out / "scenario.toml").write_text(text, encoding="utf-8")
    record = {
        "scenario": scenario.name,
        "seed": campaign.seed,
        "n_runs": numbers.n_runs,
        "filters": list(campaign.results),
        "versions": versions(),
        "report": numbers.as_dict(),
        "distance": {name: asdict(d) for name, d in distance.items()},
        "failures": [failure._asdict() for failure in campaign.failures],
        "settings": asdict(settings),
    }
    text = json.dumps(without_nan(record), indent=1, allow_nan=False)
    (out / "run.json").write_text(text, encoding="utf-8")


def without_none(tree):
    return {k: without_none(v) if isinstance(v, dict) else v for k, v in tree.items() if v is not None}


def without_nan(tree):
    if isinstance(tree, dict):
        return {k: without_nan(v) for k, v in tree.items()}
    if isinstance(tree, list | tuple):
        return [without_nan(v) for v in tree]
    return None if isinstance(tree, float) and not np.isfinite(tree) else tree
