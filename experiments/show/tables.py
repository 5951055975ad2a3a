"""Tables for the terminal and for markdown, and numbers as they stand in them."""

import numpy as np
from rich import box
from rich.markup import escape
from rich.measure import Measurement
from rich.table import Table

from sphfilter.campaign.tables import in_markdown as markdown

__all__ = ["UNKNOWN", "counted", "markdown", "number", "percent", "print_table", "table"]

UNKNOWN = "–"


def number(value, form=".3g", unit="", unknown=UNKNOWN):
    """A number in a format of Python's with its unit, or a dash where it is not finite."""
    return format(value, form) + unit if np.isfinite(value) else unknown


def counted(number, what):
    """A number of things: "1 run", "5 runs"."""
    return f"{number} {what}" + "s" * (number != 1)


def percent(value):
    """A part of one in per cent."""
    return number(value, ".0%")


def table(title, headings, rows=(), left=1, frame=box.SIMPLE):
    """A rich table for the terminal, to which more rows can be added; rows are texts, an empty title is none.

    So many columns begin at the `left`, the others end at the right.
    """
    made = Table(box=frame, pad_edge=False, title=escape(title) or None, header_style="bold")
    for k, heading in enumerate(headings):
        made.add_column(escape(heading), justify="left" if k < left else "right", overflow="fold")
    for row in rows:
        made.add_row(*row)
    return made


def print_table(console, made, keep=1):
    """Print a table; one that is too wide for the terminal in pieces, one below the other.

    So many columns at the left as `keep` says are repeated in every piece.
    """
    first, pieces = list(range(keep)), []
    for k in range(keep, len(made.columns)):
        joined = made.columns[k].style == "dim"  # what is beside a column stays there
        if not pieces or (not joined and _width(console, _part(made, [*pieces[-1], k])) > console.width):
            pieces.append(list(first))
        pieces[-1].append(k)
    for number, piece in enumerate(pieces or [first]):
        if number and made.box is None:
            console.print()
        console.print(_part(made, piece))


def _width(console, made):
    """Columns of characters that a table would like to have."""
    return Measurement.get(console, console.options.update(width=10_000), made).maximum


def _part(made, chosen):
    """Some columns of a table."""
    part = Table(box=made.box, pad_edge=False, title=made.title, header_style=made.header_style)
    for k in chosen:
        column = made.columns[k]
        part.add_column(column.header, justify=column.justify, style=column.style, overflow="fold")
    cells = [list(made.columns[k].cells) for k in chosen]
    for i, row in enumerate(made.rows):
        part.add_row(*(column[i] for column in cells), style=row.style, end_section=row.end_section)
    return part
