"""`python -m experiments sweep NAME`: where the EKF loses track, and what the other filters do there.

Varies the interval between measurements, the process noise and the measurement noise of a scenario (002,
section 7) and runs a campaign at each combination.
"""

from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from experiments.scene.files import changes_of
from experiments.scene.filters import factories
from experiments.scene.reading import read_settings
from experiments.scene.scenario import load_scenario
from experiments.show.tables import counted, print_table
from experiments.terminal.progress import bar, resumable
from experiments.terminal.running import new_console, tell
from sphfilter.campaign.campaign import run_campaign
from sphfilter.campaign.report import report

from . import plots, tables

#: What is tried unless told otherwise; intervals as factors of the scenario's own.
_INTERVAL_FACTORS, _Q, _R = (0.5, 1.0, 1.5, 2.0), (0.5, 1.0, 2.0), (1.0,)


@dataclass(frozen=True)
class Cell:
    """One combination: interval in seconds, and factors on the scenario's Q and R."""

    interval: float
    q: float
    r: float

    @property
    def name(self):
        """Folder of the cell's runs; different numbers have different names."""
        return f"interval={self.interval!r},q={self.q!r},r={self.r!r}"

    def changes(self, settings):
        """What `load_scenario` is to change in these settings."""
        Q, one = np.array(settings.model.spectral_density), settings.sensor
        sensors = {"sensor": one} if one else {f"sensors.{k}": v for k, v in settings.sensors.items()}
        return {
            "times.interval": self.interval,
            "model.spectral_density": (self.q * Q).tolist(),
            **{f"{key}.noise_cov": _scaled(self.r, s.noise_cov) for key, s in sensors.items()},
        }


def _scaled(factor, rows):
    """A matrix of numbers and texts times a number."""
    return [[f"{factor!r}*({v})" if isinstance(v, str) else factor * v for v in row] for row in rows]


def main(args):
    """Run the command; prints to standard output."""
    console = new_console()
    changes = changes_of(args)
    base = read_settings(args.scenario, changes)
    intervals = args.interval or [factor * base.times.interval for factor in _INTERVAL_FACTORS]
    cells = [Cell(*values) for values in product(intervals, args.q or _Q, args.r or _R)]
    scenarios = [load_scenario(args.scenario, **changes | cell.changes(base)) for cell in cells]
    work = [(cell, s, factories(args.filters, s)) for cell, s in zip(cells, scenarios, strict=True)]
    name, n_runs = scenarios[0].name, base.runs.default if args.runs is None else args.runs
    seed = base.runs.seed if args.seed is None else args.seed
    out = args.out or Path("results") / f"sweep_{name}"

    console.print(f"[bold]{name}[/]: {base.description}")
    effort = f"{len(cells)} combinations, {counted(n_runs, 'run')} each; the filters compile at first use"
    console.print(f"{effort}\n", style="dim")
    rows = _sweep(console, work, n_runs, seed, args.jobs, out)
    print_table(console, tables.table(rows, name))
    tell(console, tables.sentences(rows))
    tables.write(out, rows, name)
    drawn = plots.draw(out, rows, name)
    console.print(
        f"\nNumbers are in {out}/sweep.csv and sweep.md. Pictures: {', '.join(map(str, drawn))}",
        soft_wrap=True,
    )


def _sweep(console, work, n_runs, seed, n_jobs, out):
    """Run the campaign of every cell; finished runs stay in the folder of their cell."""
    rows, kept = [], f"finished runs are kept in {out}/runs. The same command goes on from there."
    with bar(console, "runs", n_runs * len(work)) as move, resumable(lambda: kept):
        for i, (cell, scenario, filters) in enumerate(work):

            def progress(done, total, i=i):
                move(i * total + done)

            folder = out / "runs" / cell.name
            campaign = run_campaign(scenario, filters, n_runs, seed, n_jobs, folder, progress, ranks=False)
            rows += tables.rows_of(cell, report(campaign))
            if not console.is_terminal:
                console.print(f"{cell.name}: {i + 1} of {len(work)} combinations done", style="dim")
    return rows
