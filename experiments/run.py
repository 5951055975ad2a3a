"""`python -m experiments run NAME`: simulate a scenario, run filters on it, tell and draw the results."""

import hashlib
import shutil
from dataclasses import asdict, replace
from pathlib import Path

from sphfilter.campaign.report import report
from sphfilter.errors import SphfilterError

from .campaign.work import exit_code, tell_failures, work_of
from .pictures import drawing
from .pictures.names import chosen
from .scene.files import changes_of
from .scene.scenario import load_scenario
from .show import plots
from .show.campaign_tables import distance_table, result_table, sentences
from .show.comparison import distances, reference_name
from .show.tables import print_table
from .terminal.beside import Second
from .terminal.running import new_console, status, tell

__all__ = ["main"]


def main(args):
    """Run the command; prints to standard output. Returns 1 if a filter failed in every run, else 0."""
    console = new_console()
    changes = changes_of(args)
    if args.n_particles is not None:
        changes |= {f"filters.{name}.n_particles": args.n_particles for name in ("sph", "sph_paper")}
    scenario = load_scenario(args.scenario, **changes)
    n_runs = args.runs or scenario.settings.runs.default
    work = work_of(args, scenario, args.filters, n_runs, Path("results") / scenario.name)
    asked = args.pictures if "sph_paper" in work.filters else args.pictures or "none"
    wanted = chosen(scenario.name, asked)

    with Second() as second:
        campaign = _campaign(console, work, args.jobs, second, wanted)
        numbers = report(campaign)
        reference = reference_name(scenario, work.filters)
        distance = distances(campaign.results, reference) if reference else {}
        _tell(console, scenario, campaign, numbers, distance, reference)
        _write(work, campaign, numbers, distance)
        _ask(second, work, [name for name in wanted if name in drawing.OF_RUNS], work.out / "campaign.npz")
        with status(console) as say:
            drawn = plots.draw(work.out, scenario, work.filters, campaign, say)
        kept = f"{work.out}/campaign.npz and run.json, the scenario as run in scenario.toml"
        console.print(f"Numbers are in {kept}.", soft_wrap=True)
        for name in sorted(wanted, key=drawing.OF_RUNS.__contains__):
            drawn += _picture(console, name, second)
    console.print(f"Pictures: {', '.join(str(path) for path in drawn)}", soft_wrap=True)
    _mention_unfinished(console, work.out)
    return exit_code(numbers)


def _campaign(console, work, n_jobs, second, wanted):
    """Run the campaign. Finished runs wait in a folder of its own until all are done.

    Pictures that need no runs are drawn beside it, in the second process.
    """
    which = hashlib.sha256(f"{work.scenario} {work.filters} {work.seed}".encode()).hexdigest()[:8]
    folder = work.out / f"unfinished-{which}"
    work.prepare(console, folder, second)
    _ask(second, work, [name for name in wanted if name not in drawing.OF_RUNS])
    campaign = work.run(console, n_jobs, folder)
    shutil.rmtree(folder)
    return campaign


def _ask(second, work, names, campaign=None):
    for name in names:
        second.ask(drawing.draw, name, work.scenario, work.out, work.seed, work.n_runs, campaign)


def _mention_unfinished(console, out):
    left = ", ".join(str(folder) for folder in sorted(out.glob("unfinished-*")))
    if left:
        text = "Interrupted runs of other settings wait to be gone on with, or to be deleted, in"
        console.print(f"{text} {left}", style="dim", soft_wrap=True)


def _picture(console, name, second):
    """Wait for a picture of the paper; one that cannot be drawn costs none of the results."""
    with status(console) as say:
        say(f"drawing {name} (up to half a minute; the numbers are safe)")
        try:
            paths, sentences = second.answer()
        except SphfilterError as problem:
            console.print(f"picture {name}: {problem}", style="red")
            return []
    tell(console, sentences)
    return paths


def _tell(console, scenario, campaign, numbers, distance, reference):
    print_table(console, result_table(numbers, scenario))
    if distance:
        print_table(console, distance_table(distance, reference))
    tell(console, sentences(numbers, scenario))
    tell_failures(console, campaign.failures)
    console.print()


def _write(work, campaign, numbers, distance):
    """Write numbers, settings and versions."""
    settings = work.scenario.settings
    runs = replace(settings.runs, default=numbers.n_runs, seed=campaign.seed)
    filters = replace(settings.filters, default=tuple(campaign.results))
    settings = replace(settings, runs=runs, filters=filters)
    apart = {name: asdict(d) for name, d in distance.items()}
    work.write("run", campaign, numbers, settings, n_runs=numbers.n_runs, distance=apart)
