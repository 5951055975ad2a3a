"""`python -m experiments converge NAME`: error of the SPH filter against an exact one as particles grow."""

import csv
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from sphfilter.campaign import run_campaign
from sphfilter.errors import ConfigError

from . import plots
from .comparison import distances
from .files import add_change_option, changes_of
from .filters import factories, name_of
from .scenario import load_scenario

__all__ = ["add_arguments", "convergence", "main", "orders"]

MEASURES = ("mean", "cov", "evidence")


def add_arguments(parser):
    """Add the options of `converge`."""
    parser.add_argument(
        "scenario",
        nargs="?",
        default="linear_underdamped",
        help="a scenario with an exact filter: a linear one, or benes (default: linear_underdamped)",
    )
    parser.add_argument("--filter", choices=("sph", "sph_paper"), default="sph", help="default: sph")
    parser.add_argument("--counts", default="100,200,400,800,1600", help="particles, comma-separated")
    parser.add_argument("--runs", type=int, default=3, help="simulated runs for each count")
    parser.add_argument("--seed", type=int, default=0, help="seed of everything random")
    parser.add_argument("--out", type=Path, help="folder for table and picture (default: results/NAME)")
    add_change_option(parser)


def convergence(name, counts, n_runs, seed, which="sph", progress=lambda *numbers: None, **changes):
    """Distance of the SPH filter from the scenario's exact filter, for each number of particles.

    Parameters
    ----------
    name : str
        A scenario whose exact filter is known.
    counts : sequence of int
    n_runs, seed : int
    which : str
        "sph" or "sph_paper".
    progress : callable
        Called with (particles, runs done, runs in all).
    **changes
        Keys of the scenario, as `load_scenario` takes them.

    Returns
    -------
    list of (int, Distance, float, int)
        Particles at most, distance from the exact filter, median seconds of a run, refused measurements.
    """
    rows = []
    for count in counts:
        scenario = load_scenario(name, **changes, **{f"filters.{which}.n_particles": count})
        exact = scenario.settings.exact
        if exact is None:
            raise ConfigError(f"no exact filter is known for {name}: take a linear scenario or benes")
        filters = factories([exact, which], scenario)
        campaign = run_campaign(scenario, filters, n_runs, seed, progress=partial(progress, count))
        if campaign.failures:
            raise ConfigError(f"{count} particles: {campaign.failures[0].message}")
        seconds = float(np.median(campaign.run_time[which]))
        refused = int((~campaign.results[which].accepted).sum())
        rows.append((count, distances(campaign.results, exact)[which], seconds, refused))
    return rows


def orders(rows, dim):
    """Order of each error in the particle spacing, dx ~ N^(-1/n): slope of a line through all rows."""
    counts = np.array([count for count, *_ in rows], dtype=float)
    errors = {measure: [getattr(distance, measure) for _, distance, *_ in rows] for measure in MEASURES}
    return {m: float(-dim * np.polyfit(np.log(counts), np.log(e), 1)[0]) for m, e in errors.items()}


def main(args):
    """Run the command; prints to standard output."""
    console = Console(highlight=False)
    try:
        counts = sorted({int(text) for text in args.counts.split(",")})
    except ValueError:
        raise ConfigError(f"--counts takes numbers such as 100,200,400, not {args.counts!r}") from None
    if len(counts) < 2 or args.runs < 1:
        raise ConfigError("converge needs two different counts at least, and one run")
    changes = changes_of(args)
    rows = _shown(console, args, counts, changes)
    dim = load_scenario(args.scenario).model.dim
    slopes = orders(rows, dim)
    console.print(_table(args.scenario, name_of(args.filter), rows, slopes))
    out = args.out or Path("results") / args.scenario
    out.mkdir(parents=True, exist_ok=True)
    _write(out / "convergence.csv", rows)
    console.print(f"Table and picture: {out}/convergence.csv, {plots.draw_convergence(out, rows, slopes)}")


def _shown(console, args, counts, changes):
    """Run `convergence` with a progress bar, or a line for each run where there is no terminal."""
    console.print("running (the first time compiles, for a minute)", style="dim")
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=len(counts) * args.runs)

        def progress(count, done, n_runs):
            bar.update(task, completed=counts.index(count) * n_runs + done, description=f"{count} particles")
            if not console.is_terminal and done:
                console.print(f"{count} particles: run {done} of {n_runs} done", style="dim")

        return convergence(
            args.scenario, counts, args.runs, args.seed, args.filter, progress=progress, **changes
        )


def _table(name, who, rows, slopes):
    table = Table(title=f"{name}: {who} against the exact filter")
    for head in ("particles", "mean (std)", "covariance", "evidence (nat)", "seconds", "refused"):
        table.add_column(head, justify="right")
    for count, distance, seconds, refused in rows:
        errors = (f"{getattr(distance, m):.2e}" for m in MEASURES)
        table.add_row(str(count), *errors, f"{seconds:.2f}", str(refused))
    table.add_section()
    table.add_row("order in dx", *(f"{slopes[m]:.2f}" for m in MEASURES), "", "")
    return table


def _write(path, rows):
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["particles", *MEASURES, "seconds", "refused"])
        writer.writerows([count, *asdict(distance).values(), *rest] for count, distance, *rest in rows)
