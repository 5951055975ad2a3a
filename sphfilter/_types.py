"""The types that many signatures share, what values are made of, and how they are told on one line."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from datetime import timedelta
from typing import Any, Literal, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int64]
Bools: TypeAlias = NDArray[np.bool_]
#: A generator, or what numpy makes one of.
Seed: TypeAlias = np.random.Generator | int | None
#: A measurement: numbers, None where none came, or those of several sensors by name.
Reported: TypeAlias = ArrayLike | Mapping[str, ArrayLike | None] | None
#: One measurement for each time; None or NaN where none came.
Readings: TypeAlias = Sequence[Reported] | Floats
#: The same as numbers.
Rows: TypeAlias = Sequence[ArrayLike | None] | Floats
#: Seconds, or as Python and numpy keep them.
Interval: TypeAlias = float | timedelta | np.timedelta64
#: A function of states (M, n), with a number for each, (M,).
OfStates: TypeAlias = Callable[[Floats], Floats]
#: How a density is read between its points.
ReadOut: TypeAlias = Literal["points", "mixture", "log_density", "cloud", "family", "pieces"]
#: fill(x, t, p, out): rows of states in, rows of values out.
BatchFunction: TypeAlias = Callable[[Floats, float, Floats, Floats], None]


class Noted:
    """A frozen dataclass of which others are made that differ in a few fields.

    What it has found from its fields and kept, others have kept too: fields that this hangs on do not differ.
    """

    def noted(self, **known: Any) -> Self:
        """The same with other fields, in a microsecond: nothing is checked or summed again."""
        new = object.__new__(type(self))
        vars(new).update(vars(self) | known)
        return new


def in_a_line(thing: Any) -> str:
    """Return what a dataclass or named tuple holds, on one line: of large arrays their shapes only."""
    names = [f.name for f in fields(thing) if f.repr] if is_dataclass(thing) else thing._fields
    return f"{type(thing).__name__}({', '.join(f'{name}={_brief(getattr(thing, name))}' for name in names)})"


def _brief(value: Any) -> str:
    if not isinstance(value, np.ndarray):
        return " ".join(repr(value).split())
    return repr(value.tolist()) if value.size <= 9 else f"array of shape {value.shape}"  # up to 3 × 3
