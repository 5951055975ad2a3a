"""Tables: values of a record, or of a measured curve, between which models interpolate."""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Literal, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from .. import validate
from .._types import Floats
from ..errors import ModelError, nearest

Kind: TypeAlias = Literal["linear", "previous"]


@dataclass(frozen=True, eq=False)
class Table:
    """Values at rising arguments, which text calls ``table("name", t)`` or of any other expression.

    Parameters
    ----------
    at : array_like, shape (K,)
        Arguments, rising: times in seconds, or whatever else the table is of.
    values : array_like, shape (K,)
    kind : {"linear", "previous"}
        Straight lines between the values, or each held until the next. Before the first and after the last
        argument their values hold.

    Examples
    --------
    >>> import sphfilter as sf
    >>> current = sf.Table([0.0, 10.0, 20.0], [0.0, 2.0, 1.0])
    >>> print(current([5.0, 30.0]))
    [1. 1.]
    >>> battery = sf.SDE.from_expressions(["q"], ['-table("i", t)'], [["0.1"]], tables={"i": current})
    >>> print(battery.drift([[1.0]], t=10.0), battery.events)
    [[-2.]] [ 0. 10. 20.]
    """

    at: Floats
    values: Floats
    kind: Kind = "linear"

    def __init__(self, at: ArrayLike, values: ArrayLike, kind: Kind = "linear") -> None:
        at = validate.array("the table's arguments", at, (None,))
        back = np.flatnonzero(np.diff(at) <= 0.0)
        if not at.size or back.size:
            where = f"{at[back[0]]:g} is followed by {at[back[0] + 1]:g}" if at.size else "there are none"
            raise ModelError(f"the arguments of a table must rise; {where}")
        object.__setattr__(self, "at", at)
        object.__setattr__(self, "values", validate.array("the table's values", values, (len(at),)))
        object.__setattr__(self, "kind", validate.choice("kind", kind, ("linear", "previous")))
        for own in (self.at, self.values):
            own.setflags(write=False)

    @classmethod
    def read(
        cls, path: str | PathLike[str], values: str, at: str | None = None, kind: Kind = "linear"
    ) -> Self:
        """Read two columns of a CSV file with a header; `at` is the first column if not named.

        Raises
        ------
        ModelError
            The file has no such column, or a field that is no number.
        """
        try:
            with Path(path).open(newline="", encoding="utf-8-sig") as lines:
                rows = [row for row in csv.reader(lines) if any(field.strip() for field in row)]
        except (OSError, UnicodeDecodeError, csv.Error) as problem:
            raise ModelError(f"cannot read {path}: {problem}") from problem
        if not rows:
            raise ModelError(f"{path} is empty; a header and two columns are needed")
        header = [name.strip() for name in rows[0]]
        at = header[0] if at is None else at
        for name in (at, values):
            if name not in header:
                raise ModelError(
                    f"{path} has no column {name!r}{nearest(str(name), header)}; it has {', '.join(header)}"
                )
        columns = [header.index(str(name)) for name in (at, values)]
        try:
            numbers = np.array([[float(row[k]) for k in columns] for row in rows[1:]]).reshape(-1, 2)
        except (ValueError, IndexError) as problem:
            raise ModelError(f"{path} holds a row that is no row of numbers: {problem}") from problem
        return cls(numbers[:, 0], numbers[:, 1], kind)

    def __call__(self, at: ArrayLike) -> Floats:
        """Return the values at arguments of any shape."""
        at = np.asarray(at, dtype=float)
        if self.kind == "linear":
            return np.interp(at, self.at, self.values)
        return self.values[np.maximum(np.searchsorted(self.at, at, side="right") - 1, 0)]

    def __repr__(self) -> str:
        return f"Table({len(self.at)} values from {self.at[0]:g} to {self.at[-1]:g}, kind={self.kind!r})"


#: Tables by name, each as a `Table` or as its arguments and values.
Tables: TypeAlias = Mapping[str, Table | Sequence[ArrayLike]]


def tables_of(tables: Tables | None) -> dict[str, Table]:
    """Tables by name."""
    if tables is not None and not isinstance(tables, Mapping):
        raise ModelError(
            f"tables= maps names to tables, such as {{'i': table}}, got {validate.short(tables)}"
        )
    return {str(name): _table(str(name), given) for name, given in (tables or {}).items()}


def _table(name: str, given: Any) -> Table:
    if isinstance(given, Table):
        return given
    if not isinstance(given, list | tuple | np.ndarray) or len(given) not in (2, 3):
        raise ModelError(
            f"table {name!r} must be a Table or (arguments, values), got {validate.short(given)}"
        )
    return Table(*given)
