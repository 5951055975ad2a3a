"""The types that many signatures share."""

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["BatchFunction", "Bools", "Floats", "Ints", "Readings", "Seed"]

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int64]
Bools: TypeAlias = NDArray[np.bool_]
#: A generator, or what numpy makes one of.
Seed: TypeAlias = np.random.Generator | int | None
#: One measurement for each time; None or NaN where none came.
Readings: TypeAlias = Sequence[ArrayLike | None] | Floats
#: fill(x, t, p, out): rows of states in, rows of values out.
BatchFunction: TypeAlias = Callable[[Floats, float, Floats, Floats], None]
