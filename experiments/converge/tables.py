"""Orders of convergence, and tables and files of the studies of transient solutions."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments.show.files import write_rows
from experiments.show.tables import number, table
from experiments.terminal.running import tell

from .errors import MEASURES
from .studies import RULES

_ROUNDING = 1e-12  # errors of which nothing can be said


class Order(NamedTuple):
    """Slope of log(error) over log(size) and its standard error; NaN where too few errors are known."""

    slope: float
    spread: float

    def __str__(self):
        if not np.isfinite(self.slope):
            return "-"
        return f"{self.slope:.2f}" + (f" ± {self.spread:.2f}" if np.isfinite(self.spread) else "")


def fitted_order(sizes, errors):
    """Fit errors (K,) ~ sizes (K,) ** order by least squares of the logarithms.

    The spread is the standard error of the slope from the residuals; it takes three errors, and is large
    where the errors bend, for instance towards a floor. Rounding errors are left out.
    """
    sizes, errors = np.asarray(sizes, dtype=float), np.asarray(errors, dtype=float)
    known = np.isfinite(errors) & (errors > _ROUNDING) & (sizes > 0)
    x, y = np.log(sizes[known]), np.log(errors[known])
    if len(np.unique(x)) < 2:
        return Order(np.nan, np.nan)
    off = x - x.mean()
    slope = float(off @ y / (off @ off))
    if len(x) < 3:
        return Order(slope, np.nan)
    residuals = y - y.mean() - slope * off
    return Order(slope, float(np.sqrt(residuals @ residuals / (len(x) - 2) / (off @ off))))


def orders_of(group, size, dim=None):
    """`Order` of each measure over the cells of a group, a list of (size, `Errors`).

    Sizes are numbers of "particles", whose orders are those in the spacing, N^(-1/n) of n = `dim` states, or
    time steps, "step".
    """
    sizes = np.array([size for size, _ in group], dtype=float)
    sizes = sizes ** (-1.0 / dim) if size == "particles" else sizes
    return {m: fitted_order(sizes, [getattr(errors, m) for _, errors in group]) for m in MEASURES}


def scheme_table(title, cells, dim):
    """Errors, steps and time of every scheme and number of particles, and the orders in the spacing."""
    made = table(title, ("scheme", "particles", *MEASURES.values(), "steps", "seconds"))
    for name, group in groups(cells, "scheme").items():
        for cell in group:
            count = str(cell.label["particles"]) if cell.failure else f"{cell.n_particles:.0f}"
            errors = (number(getattr(cell.errors, m), ".2g") for m in MEASURES)
            made.add_row(name, count, *errors, *_cost(cell))
        found = orders_of([(cell.n_particles, cell.errors) for cell in group], "particles", dim)
        made.add_row("", "order", *map(str, found.values()), "", "", style="bold", end_section=True)
    return made


def step_table(title, rows, rule):
    """Errors of every integrator and step: against the truth, and of the step alone with its orders."""
    alone = [f"step's {MEASURES[m]}" for m in ("mean", "cov", "l2")]
    errors = ("covariance", "density, L2", *alone)
    made = table(title, ("integrator", RULES[rule][0], *errors, "steps", "seconds"))
    for name, group in groups(rows, "integrator").items():
        for cell, own in group:
            values = (cell.errors.cov, cell.errors.l2, own.mean, own.cov, own.l2)
            numbers = (number(value, ".2g") for value in values)
            made.add_row(name, f"{cell.label[rule]:.4g}", *numbers, *_cost(cell))
        found = orders_of([(cell.label[rule], own) for cell, own in group], "step")
        slopes = (str(found[m]) for m in ("mean", "cov", "l2"))
        made.add_row("", "order", "", "", *slopes, "", "", style="bold", end_section=True)
    return made


def groups(rows, key):
    """Cells, or tuples that begin with one, by what one key of their labels says, in order."""
    found = {}
    for row in rows:
        cell = row[0] if isinstance(row, tuple) else row
        found.setdefault(cell.label[key], []).append(row)
    return found


def _cost(cell):
    return ("", "failed") if cell.failure else (str(cell.n_steps), f"{cell.seconds:.3g}")


def end(console, args, name, stem, cells, rows, draw):
    """Tell which cells failed, write the rows, draw, and say where both are.

    Files are called `stem`, in the folder that `args.out` asks for, or in `name` of the results; `draw(path)`
    draws the picture.
    """
    for cell in cells:
        if cell.failure:
            label = ", ".join(f"{key} {value}" for key, value in cell.label.items())
            tell(console, [f"{label}: {cell.failure}"])
    out = args.out or Path("results") / name
    write_rows(out / f"{stem}.csv", rows)
    console.print(f"Table and picture: {out / stem}.csv, {draw(out / f'{stem}.png')}", soft_wrap=True)
