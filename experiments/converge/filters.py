"""The SPH filter against an exact filter as particles grow."""

from dataclasses import asdict
from functools import partial

import numpy as np

from experiments.scene.files import changes_of
from experiments.scene.filters import factories, name_of
from experiments.scene.scenario import load_scenario
from experiments.show.comparison import distances
from experiments.show.tables import print_table, table
from experiments.terminal.progress import bar
from experiments.terminal.running import tell
from sphfilter.campaign.campaign import run_campaign
from sphfilter.errors import ConfigError

from .plots import draw_filter
from .tables import end, fitted_order

MEASURES = ("mean", "cov", "evidence")


#: Orders below this are none, and why they are.
_NO_ORDER = 0.5
_FLAT = (
    "Orders near zero, or below: these errors are small on the fewest particles already, and do not fall "
    "with more. What is left does not come from the spacing, but from the tails where lattices end. Where "
    "the spacing counts orders are seen: converge van_der_pol --over scheme."
)


def convergence(name, counts, n_runs, seed, which="sph", progress=lambda *numbers: None, **changes):
    """Distance of the SPH filter from the scenario's exact filter, for each number of particles.

    Rows are particles at most, `Distance` from the exact filter, median seconds of a run, and refused
    measurements. The filter is "sph" or "sph_paper"; `progress` is called with particles, runs done and runs
    in all; `changes` are keys of the scenario.
    """
    rows = []
    for count in counts:
        scenario = load_scenario(name, **changes, **{f"filters.{which}.n_particles": count})
        exact = scenario.settings.exact
        if exact is None:
            raise ConfigError(
                f"no exact filter is known for {name}: take a linear scenario or benes, or look at a density "
                f"without measurements with --over particles"
            )
        filters = factories([exact, which], scenario)
        campaign = run_campaign(
            scenario, filters, n_runs, seed, progress=partial(progress, count), ranks=False
        )
        if campaign.failures:
            raise ConfigError(f"{count} particles: {campaign.failures[0].message}")
        seconds = float(np.median(campaign.run_time[which]))
        refused = int((~campaign.results[which].accepted).sum())
        rows.append((count, distances(campaign.results, exact)[which], seconds, refused))
    return rows


def orders(rows, dim):
    """Order of each error in the particle spacing, dx ~ N^(-1/n): slope of a line through all rows."""
    spacing = np.array([count for count, *_ in rows]) ** (-1.0 / dim)
    errors = {measure: [getattr(distance, measure) for _, distance, *_ in rows] for measure in MEASURES}
    return {measure: fitted_order(spacing, e).slope for measure, e in errors.items()}


def study(args, console, name, counts):
    """Run the study of a filter scenario and print it; `args` has filter, runs, seed, changes and out."""
    rows = _shown(console, args, name, counts)
    slopes = orders(rows, load_scenario(name).model.dim)
    print_table(console, _table(name, name_of(args.filter), rows, slopes))
    if min(slopes.values()) < _NO_ORDER:
        tell(console, [_FLAT])
    lines = [
        {"particles": count} | asdict(distance) | {"seconds": seconds, "refused": refused}
        for count, distance, seconds, refused in rows
    ]
    draw = partial(draw_filter, rows=rows, slopes=slopes)
    end(console, args, name, "convergence", (), lines, draw)


def _shown(console, args, name, counts):
    """Run `convergence` with a progress bar, or a line for each run where there is no terminal."""
    console.print("running (the first time compiles, for a minute)", style="dim")
    with bar(console, "", len(counts) * args.runs) as move:

        def progress(count, done, n_runs):
            move(counts.index(count) * n_runs + done, text=f"{count} particles")
            if not console.is_terminal and done:
                console.print(f"{count} particles: run {done} of {n_runs} done", style="dim")

        return convergence(
            name, counts, args.runs, args.seed, args.filter, progress=progress, **changes_of(args)
        )


def _table(name, who, rows, slopes):
    headings = ("particles", "mean (std)", "covariance", "evidence (nat)", "seconds", "refused")
    made = table(f"{name}: {who} against the exact filter", headings, left=0)
    for count, distance, seconds, refused in rows:
        errors = (f"{getattr(distance, m):.2e}" for m in MEASURES)
        made.add_row(str(count), *errors, f"{seconds:.2f}", str(refused))
    made.add_section()
    made.add_row("order in dx", *(f"{slopes[m]:.2f}" for m in MEASURES), "", "")
    return made
