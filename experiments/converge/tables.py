"""Tables and files of the studies of transient solutions."""

import csv

import numpy as np
from rich.markup import escape
from rich.table import Table

from sphfilter.errors import ConfigError

from .cells import row_of
from .errors import MEASURES
from .fits import fitted_order
from .studies import RULES

__all__ = ["failures", "groups", "number", "numbers", "orders_of", "scheme_table", "step_table", "write_rows"]


def orders_of(group, size, dim=None):
    """`Order` of each measure over the cells of a group.

    Parameters
    ----------
    group : list of (size, Errors)
        Number of particles, or time step.
    size : str
        "particles" (orders in the spacing, N^(-1/n)) or "step".
    dim : int
        Number of states n, for particles.
    """
    sizes = np.array([size for size, _ in group], dtype=float)
    sizes = sizes ** (-1.0 / dim) if size == "particles" else sizes
    return {m: fitted_order(sizes, [getattr(errors, m) for _, errors in group]) for m in MEASURES}


def scheme_table(title, cells, dim):
    """Errors, steps and time of every scheme and number of particles, and the orders in the spacing."""
    made = Table(title=escape(title))
    for head in ("scheme", "particles", *MEASURES.values(), "steps", "seconds"):
        made.add_column(head, justify="left" if head == "scheme" else "right")
    for name, group in groups(cells, "scheme").items():
        for cell in group:
            if not cell.failure:
                made.add_row(name, f"{cell.n_particles:.0f}", *_numbers(cell.errors), *_cost(cell))
            else:
                made.add_row(name, str(cell.label["particles"]), *4 * ("-",), "", "failed")
        found = orders_of([(cell.n_particles, cell.errors) for cell in group], "particles", dim)
        made.add_row("", "order", *map(str, found.values()), "", "", style="bold", end_section=True)
    return made


def step_table(title, rows, rule):
    """Errors of every integrator and step: against the truth, and of the step alone with its orders."""
    made = Table(title=escape(title))
    alone = [f"step's {MEASURES[m]}" for m in ("mean", "cov", "l2")]
    for head in ("integrator", RULES[rule][0], "covariance", "density, L2", *alone, "steps", "seconds"):
        made.add_column(head, justify="left" if head == "integrator" else "right")
    for name, group in groups(rows, "integrator").items():
        for cell, own in group:
            numbers = [cell.errors.cov, cell.errors.l2, own.mean, own.cov, own.l2]
            cost = ("", "failed") if cell.failure else _cost(cell)
            made.add_row(name, f"{cell.label[rule]:.4g}", *map(number, numbers), *cost)
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


def failures(cells):
    """A sentence for each cell without result."""
    for cell in cells:
        if cell.failure:
            yield f"{', '.join(f'{key} {value}' for key, value in cell.label.items())}: {cell.failure}"


def number(value):
    """A small number for a table, - where there is none."""
    return f"{value:.2g}" if np.isfinite(value) else "-"


def _numbers(errors):
    return [number(getattr(errors, m)) for m in MEASURES]


def _cost(cell):
    return str(cell.n_steps), f"{cell.seconds:.3g}"


def write_rows(path, rows):
    """Write flat dicts, or cells, as CSV; the columns are those of the first."""
    rows = [row if isinstance(row, dict) else row_of(row) for row in rows]
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def numbers(option, text, kind, example=None):
    """Different numbers from a comma-separated list, rising; errors show an `example`."""
    try:
        numbers = sorted({kind(part) for part in text.split(",")})
    except ValueError:
        example = example or ("100,200,400" if kind is int else "0.1,0.05,0.025")
        raise ConfigError(f"{option} takes numbers such as {example}, not {text!r}") from None
    if numbers[0] <= 0:
        raise ConfigError(f"{option} takes numbers above zero, not {numbers[0]:g}")
    return numbers
