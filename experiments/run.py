"""`python -m experiments run NAME`: simulate a scenario, run filters on it, tell and draw the results."""

import shutil
from dataclasses import asdict, replace
from pathlib import Path

from sphfilter.campaign.report import report

from .campaign.work import exit_code, tell_failures, work_of
from .scene.files import changes_of
from .scene.scenario import load_scenario
from .show import plots
from .show.campaign_tables import distance_table, result_table, sentences
from .show.comparison import distances, reference_name
from .show.files import unfinished
from .show.tables import print_table
from .terminal.running import new_console, status, tell


def main(args):
    """Run the command; prints to standard output. Returns 1 if a filter failed in every run, else 0."""
    console = new_console()
    changes = changes_of(args)
    if args.n_particles is not None:
        changes |= {f"filters.{name}.n_particles": args.n_particles for name in ("sph", "sph_paper")}
    scenario = load_scenario(args.scenario, **changes)
    n_runs = args.runs or scenario.settings.runs.default
    work = work_of(args, scenario, args.filters, n_runs, Path("results") / scenario.name)

    campaign = _campaign(console, work, args.jobs)
    numbers = report(campaign)
    reference = reference_name(scenario, work.filters)
    distance = distances(campaign.results, reference) if reference else {}
    _tell(console, scenario, campaign, numbers, distance, reference)
    _write(work, campaign, numbers, distance)
    with status(console) as say:
        drawn = plots.draw(work.out, scenario, work.filters, campaign, say)
    kept = f"{work.out}/campaign.npz and run.json, the scenario as run in scenario.toml"
    console.print(f"Numbers are in {kept}.", soft_wrap=True)
    console.print(f"Pictures: {', '.join(str(path) for path in drawn)}", soft_wrap=True)
    _mention_unfinished(console, work.out)
    return exit_code(numbers)


def _campaign(console, work, n_jobs):
    """Run the campaign. Finished runs wait in a folder of its own until all are done."""
    folder = unfinished(work.out, f"{work.scenario} {work.filters} {work.seed}")
    work.prepare(console, folder)
    campaign = work.run(console, n_jobs, folder)
    shutil.rmtree(folder)
    return campaign


def _mention_unfinished(console, out):
    left = ", ".join(str(folder) for folder in sorted(out.glob("unfinished-*")))
    if left:
        text = "Interrupted runs of other settings wait to be gone on with, or to be deleted, in"
        console.print(f"{text} {left}", style="dim", soft_wrap=True)


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
