"""A function on the cells of a lattice, asked from some of them outwards until it has fallen far enough."""

import math
from typing import NamedTuple

import numpy as np

from .._types import Floats, Ints, OfStates
from ..core.field import cells


class Flooded(NamedTuple):
    """Cells that have been asked, in a box around them."""

    value: Floats  # of all cells of the box; `cells.UNKNOWN` where none was asked for
    low: Ints  # (n,), corner of the box
    dims: Ints  # (n,)
    asked: Ints  # flat numbers of the cells that were asked
    highest: float  # value
    fits: bool  # the box did not outgrow the memory


def flood(
    ask: OfStates, frame: tuple[Floats, Floats], start: tuple[Ints, Ints, Ints], ball: Ints, depth: float, *,
    most: float = math.inf, at_once: float = 0, highest: float = -math.inf,
) -> Flooded:  # fmt: skip
    """Values on all cells of a lattice that lie within a depth of the largest value, and on those beside.

    `ask` takes states (M, n) to values (M,). The lattice's frame is the middle (n,) of cell zero, and vectors
    (n, n) in columns. It `start`s with cells (S, n), one at least in every piece of the region, and corner
    and size (n,) of a box around them; a `ball` (B, n) are the steps from a cell to those beside it. After
    `most` cells no more are asked; of a box as small as `at_once` all are asked at once. The `highest` value
    is that which is known.
    """
    found, low, dims = start
    if np.prod(dims.astype(float)) > cells.MOST_CELLS:
        return Flooded(np.empty(0), low, dims, np.empty(0, np.int64), highest, False)
    value, asked = np.full(np.prod(dims), cells.UNKNOWN), np.empty(0, np.int64)
    if value.size <= at_once:
        asked, highest, whole = _at_once(ask, frame, (value, low, dims), depth, ball)
        if whole:
            return Flooded(value, low, dims, asked, highest, True)
        grown = cells.grown(value, low, dims, asked, highest - depth, ball)
    else:
        grown = value, low, dims, asked, cells.seeded(found, low, dims)
    while grown is not None and grown[-1].size and grown[-2].size < most:
        value, low, dims, asked, found = grown
        value[found] = ask(cells.states_of(found, *frame, low, dims)[1])
        highest, asked = max(highest, value[found].max()), np.concatenate([asked, found])
        grown = cells.grown(value, low, dims, asked, highest - depth, ball)
    if grown is not None:
        value, low, dims, asked, _ = grown
    return Flooded(value, low, dims, asked, highest, grown is not None)


def _at_once(
    ask: OfStates, frame: tuple[Floats, Floats], box: tuple[Floats, Ints, Ints], depth: float, ball: Ints
) -> tuple[Ints, float, bool]:
    """All cells of a small box: waves would cost more than the cells they save.

    Values of cells above the depth and of those beside go into the box, as if the rest had not been asked.
    Returns the numbers of these cells, the largest value, and whether the box holds them all.
    """
    value, low, dims = box
    everywhere = ask(cells.states_of(np.arange(value.size), *frame, low, dims)[1])
    highest = everywhere.max()
    kept = np.flatnonzero(everywhere > highest - depth)
    value[kept] = everywhere[kept]
    rim, beyond = cells.frontier(value, kept, highest - depth, dims, ball)
    value[rim] = everywhere[rim]
    return np.concatenate([kept, rim]), highest, not beyond
