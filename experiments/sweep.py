"""`python -m experiments sweep NAME`: where the EKF loses track, and what the other filters do there.

Varies the interval between measurements, the process noise and the measurement noise of a scenario (002,
section 7) and runs a campaign at each combination.
"""

import argparse
import csv
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from sphfilter.campaign import run_campaign
from sphfilter.report import report

from . import sweep_plots
from .filters import FILTERS, factories
from .run import Interrupted
from .scenario import load_scenario, parse_change, read_settings

__all__ = ["Cell", "add_arguments", "main", "sentences"]

#: Intervals tried if none are given, as factors of the scenario's own.
_INTERVAL_FACTORS = (0.5, 1.0, 1.5, 2.0)
#: Filter whose error the others' are compared with, and part of the runs from which on track is "often" lost.
_REFERENCE, _OFTEN = "pf", 0.1

CRITERION = (
    "A run counts as lost if the filter diverged (its NEES averaged over 5 updates exceeds its 99.99 % point, so "
    "that the error is far larger than the filter believes) or failed."
)


@dataclass(frozen=True)
class Cell:
    """One combination: interval in seconds, and factors on the scenario's Q and R."""

    interval: float
    q: float
    r: float

    @property
    def name(self):
        """Folder of the cell's runs; tells apart whatever floats differ."""
        return f"interval={self.interval!r},q={self.q!r},r={self.r!r}"

    def changes(self, settings):
        """What `load_scenario` is to change."""
        Q, R = np.array(settings.model.spectral_density), np.array(settings.sensor.noise_cov)
        return {
            "times.interval": self.interval,
            "model.spectral_density": (self.q * Q).tolist(),
            "sensor.noise_cov": (self.r * R).tolist(),
        }


def add_arguments(parser):
    """Add the options of `sweep`."""
    parser.add_argument("scenario", help="a name from `list`, or the path of a scenario's TOML file")
    parser.add_argument("--interval", type=_positive_list, metavar="S,S,...",
                        help="seconds between measurements (default: 0.5, 1, 1.5, 2 times the scenario's)")  # fmt: skip
    for key, what in (("q", "process noise Q"), ("r", "measurement noise R")):
        default = [0.5, 1.0, 2.0] if key == "q" else [1.0]
        text = f"factors on the scenario's {what} (default: {','.join(f'{v:g}' for v in default)})"
        parser.add_argument(f"--{key}", type=_positive_list, default=default, metavar="F,F,...", help=text)
    parser.add_argument(
        "--filters", default="ekf,ukf,pf,sph", help=f"comma-separated, of {', '.join(FILTERS)}"
    )
    parser.add_argument("--runs", type=int, help="simulated runs at each combination")
    parser.add_argument("--seed", type=int, help="seed of everything random")
    parser.add_argument("--out", type=Path, help="folder for results (default: results/sweep_NAME)")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--set", dest="changes", action="append", default=[], metavar="KEY=VALUE",
                        help="change a key of the scenario or the SPH filter; may be repeated")  # fmt: skip


def _positive_list(text):
    try:
        values = sorted({float(part) for part in text.split(",")})
    except ValueError:
        values = []
    if not values or not all(0 < v < np.inf for v in values):
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of positive numbers like 0.5,1,2")
    return values


def main(args):
    """Run the command; prints to standard output."""
    console = Console(highlight=False)
    console = console if console.is_terminal else Console(highlight=False, width=132)
    changes = dict(parse_change(text) for text in args.changes)
    base = read_settings(args.scenario, changes)
    intervals = args.interval or [factor * base.times.interval for factor in _INTERVAL_FACTORS]
    cells = [Cell(*values) for values in product(intervals, args.q, args.r)]
    scenarios = [load_scenario(args.scenario, **changes | cell.changes(base)) for cell in cells]
    names = [name.strip() for name in args.filters.split(",")]
    campaigns = [
        (cell, scenario, factories(names, scenario)) for cell, scenario in zip(cells, scenarios, strict=True)
    ]
    name = scenarios[0].name
    out = args.out or Path("results") / f"sweep_{name}"
    n_runs = base.runs.default if args.runs is None else args.runs
    seed = base.runs.seed if args.seed is None else args.seed

    console.print(f"[bold]{name}[/]: {base.description}")
    console.print(
        f"{len(cells)} combinations, {n_runs} runs each. The filters compile at first use.\n", style="dim"
    )
    rows = _sweep(console, campaigns, n_runs, seed, args.jobs, out)
    console.print(_table(rows, name))
    for sentence in sentences(rows):
        console.print(f"• {sentence}")
    _write(out, rows, name)
    drawn = sweep_plots.draw(out, rows, name)
    console.print(f"\nNumbers are in {out}/sweep.csv and sweep.md. Pictures: {', '.join(map(str, drawn))}")


def _sweep(console, campaigns, n_runs, seed, n_jobs, out):
    """Run the campaign of every cell; finished runs stay in the folder of their cell."""
    rows, columns = [], (TextColumn("runs"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=n_runs * len(campaigns))
        for i, (cell, scenario, filters) in enumerate(campaigns):

            def progress(done, total, i=i):
                bar.update(task, completed=i * total + done)

            folder = out / "runs" / cell.name
            try:
                campaign = run_campaign(scenario, filters, n_runs, seed, n_jobs, folder, progress)
            except KeyboardInterrupt:
                raise Interrupted(
                    f"Stopped; finished runs are kept in {out}/runs. The same command goes on from there."
                ) from None
            rows += _rows(cell, report(campaign))
            if not console.is_terminal:
                console.print(f"{cell.name}: {i + 1} of {len(campaigns)} combinations done", style="dim")
    return rows


def _rows(cell, numbers):
    """Return a flat row for each filter of a cell."""
    reference = numbers.filters.get(_REFERENCE)
    rows = []
    for name, f in numbers.filters.items():
        row = {"interval": cell.interval, "q": cell.q, "r": cell.r, "filter": name, "runs": f.n_runs,
               "diverged": f.n_diverged, "failed": f.n_failed, "lost": (f.n_diverged + f.n_failed) / f.n_runs,
               "rejected": f.n_rejected, "nees": f.nees, "nees_inside": f.nees_inside,
               "rms_ratio": _rms_ratio(f, reference), "run_time": f.run_time}  # fmt: skip
        for d in range(numbers.dim):
            row |= {f"rms_{d + 1}": f.rms_error[d], f"rms_std_{d + 1}": f.rms_error_std[d]}
        rows.append(row)
    return rows


def _rms_ratio(f, reference):
    """Return RMS error over the reference's, geometric mean over the states; NaN without a reference."""
    if reference is None:
        return np.nan
    return float(np.exp(np.mean(np.log(f.rms_error / reference.rms_error))))


def _cells_of(rows):
    """Group rows by cell: {(interval, q, r): {filter: row}}."""
    cells = {}
    for row in rows:
        cells.setdefault((row["interval"], row["q"], row["r"]), {})[row["filter"]] = row
    return cells


def _cell_texts(values):
    """Return the columns of the table for one cell: runs lost, and RMS error over the reference's."""
    for row in values.values():
        yield f"{row['diverged'] + row['failed']} of {row['runs']}"
        yield f"{row['rms_ratio']:.2f}"


def _headings(rows):
    names = dict.fromkeys(row["filter"] for row in rows)
    columns = [f"{name.upper()} {what}" for name in names for what in ("lost", f"RMS/{_REFERENCE.upper()}")]
    return ["Interval (s)", "Q ×", "R ×", *columns]


def _table(rows, name):
    table = Table(box=box.SIMPLE, pad_edge=False, title=f"{name}: runs lost, and RMS error over the PF's")
    for heading in _headings(rows):
        table.add_column(heading, justify="right")
    for cell, values in _cells_of(rows).items():
        table.add_row(*(f"{v:g}" for v in cell), *_cell_texts(values))
    return table


def sentences(rows):
    """What the sweep found, as a list of sentences."""
    cells = _cells_of(rows)
    said = [CRITERION, "RMS errors are at the updates; their ratio is a geometric mean over the states."]
    names = list(next(iter(cells.values())))
    if "ekf" not in names:
        return said
    hard = {cell: values for cell, values in cells.items() if values["ekf"]["lost"] >= _OFTEN}
    if not hard:
        return [*said, f"The EKF keeps track here: it loses less than {_OFTEN:.0%} of the runs everywhere."]
    where = "; ".join(
        f"{t:g} s, Q × {q:g}, R × {r:g} ({v['ekf']['lost']:.0%})" for (t, q, r), v in hard.items()
    )
    said.append(f"The EKF loses {_OFTEN:.0%} of the runs or more at {len(hard)} of {len(cells)}: {where}.")
    for name in names[:]:
        if name != "ekf":
            lost = np.mean([values[name]["lost"] for values in hard.values()])
            ratio = np.mean(
                [values["ekf"]["rms_ratio"] / values[name]["rms_ratio"] for values in hard.values()]
            )
            versus = f", and the EKF's RMS error is {ratio:.1f} times its own" if np.isfinite(ratio) else ""
            said.append(f"There the {name.upper()} loses {lost:.0%}{versus}.")
    return said


def _write(out, rows, name):
    """Write the rows as CSV, and table and sentences as Markdown."""
    out.mkdir(parents=True, exist_ok=True)
    with open(out / "sweep.csv", "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    headings = _headings(rows)
    lines = [f"# Sweep of {name}", "", f"| {' | '.join(headings)} |", "|" + " ---: |" * len(headings)]
    for cell, values in _cells_of(rows).items():
        lines.append(f"| {' | '.join([*(f'{v:g}' for v in cell), *_cell_texts(values)])} |")
    lines += ["", *(f"- {sentence}" for sentence in sentences(rows)), ""]
    (out / "sweep.md").write_text("\n".join(lines), encoding="utf-8")
