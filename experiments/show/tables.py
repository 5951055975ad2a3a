"""Tables for the terminal and for markdown, and numbers as they stand in them."""

import numpy as np
from rich import box
from rich.markup import escape
from rich.table import Table

__all__ = ["UNKNOWN", "markdown", "number", "percent", "table"]

UNKNOWN = "–"


def number(value, form=".3g", unit="", unknown=UNKNOWN):
    """A number in a format of Python's with its unit, or a dash where it is not finite."""
    return format(value, form) + unit if np.isfinite(value) else unknown


def percent(value):
    """A part of one in per cent."""
    return number(value, ".0%")


def table(title, headings, rows=(), left=1, frame=box.SIMPLE):
    """A table for the terminal.

    Parameters
    ----------
    title : str
        Empty for none.
    headings : sequence of str
    rows : iterable of sequences of str
    left : int
        So many columns begin at the left; the others end at the right.
    frame : rich.box.Box or None

    Returns
    -------
    rich.table.Table
        More rows can be added to it.
    """
    made = Table(box=frame, pad_edge=False, title=escape(title) or None, header_style="bold")
    for k, heading in enumerate(headings):
        made.add_column(escape(heading), justify="left" if k < left else "right")
    for row in rows:
        made.add_row(*row)
    return made


def markdown(headings, rows, left=1):
    """Lines of a markdown table, whose columns stand as those of `table`."""
    rule = ["---" if k < left else "---:" for k in range(len(headings))]
    return [f"| {' | '.join(row)} |" for row in (headings, rule, *rows)]
