"""Records: numbers by name, which compiled code takes as one pointer and writes back into.

A named tuple of twenty numbers is twenty arguments of every compiled function that it passes through, and can
not be changed there. As a record it is one, its fields are read and written by their names on both sides.
"""

from functools import cache
from typing import get_type_hints

import numpy as np
from numba import from_dtype


@cache
def _dtype(kind):
    fields = [(name, np.dtype(type_)) for name, type_ in get_type_hints(kind).items()]
    return np.dtype((np.record, np.dtype(fields, align=True)))


def packed(numbers):
    """Return a named tuple of numbers, each `int`, `float` or `bool`, as a numpy record of its own.

    Compiled code writes into the record that it is given, not into a copy.
    """
    return np.array(tuple(numbers), _dtype(type(numbers)))[()]


def type_of(kind):
    """Numba's type of the records of a class of named tuples."""
    return from_dtype(_dtype(kind))
