"""Densities that end at walls, on lattices that do not: what is asked a few cells beyond, and what counts."""

import numpy as np

from .._types import Bools, Floats, OfStates
from ..core.field.cells import LOWEST
from ..core.field.walls import Walls, parts_inside

#: Values at a wall and one, two and three times the depth before it, to that beyond: of cubics
#: f(-1) - 4 f(0) + 6 f(1) - 4 f(2) + f(3) = 0.
_CUBIC = np.array([4.0, -6.0, 4.0, -1.0])


def inside(walls: Walls, X: Floats) -> Bools:
    """Which states X (M, n) lie between the walls, shape (M,)."""
    low, high = walls
    return np.all((low <= X) & (high >= X), axis=1) if low.size else np.ones(len(X), dtype=bool)


def node_weights(walls: Walls, A: Floats, X: Floats) -> Floats:
    """Weights (M,) of the nodes X (M, n) of a lattice in integrals that end at the walls."""
    return parts_inside(*walls, A, np.ascontiguousarray(X)) if walls[0].size else np.ones(len(X))


def moved_in(walls: Walls, A: Floats, X: Floats) -> Floats:
    """States X (M, n) at least half a lattice's cell before walls, where a node of the inside is nearest."""
    low, high = walls
    if not low.size:
        return X
    half = 0.5 * np.abs(A).sum(axis=1)
    return np.clip(X, np.minimum(low + half, high), np.maximum(high - half, low))


def between(function: OfStates, walls: Walls) -> OfStates:
    """A logarithm of states that is lowest beyond the walls."""
    if not walls[0].size:
        return function

    def cut(X: Floats) -> Floats:
        out = np.full(len(X), LOWEST)
        within = inside(walls, X)
        if within.any():
            out[within] = function(X[within])
        return out

    return cut


def near_walls(function: OfStates, walls: Walls, A: Floats, rings: int) -> OfStates:
    """A logarithm of states that is lowest further beyond the walls than so many cells of a lattice."""
    reach = rings * np.abs(A).sum(axis=1)
    low, high = walls
    return between(function, (low - reach, high + reach)) if low.size else function


def continued(function: OfStates, walls: Walls) -> OfStates:
    """A function that is asked between the walls alone, and goes on beyond them as cubics do."""
    if not walls[0].size:
        return function

    def smooth(X: Floats) -> Floats:
        out, within = np.empty(len(X)), inside(walls, X)
        if within.any():
            out[within] = function(X[within])
        if not within.all():
            nearest = np.clip(X[~within], *walls)
            steps = [nearest + k * (nearest - X[~within]) for k in range(len(_CUBIC))]
            reached = np.all([inside(walls, Y) for Y in steps], axis=0)
            values = np.array([function(np.clip(Y, *walls)) for Y in steps])
            reached &= np.isfinite(values).all(axis=0)
            with np.errstate(invalid="ignore"):
                out[~within] = np.where(reached, _CUBIC @ values, values[0])
        return out

    return smooth
