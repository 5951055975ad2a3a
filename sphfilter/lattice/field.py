"""The log-density between the nodes of a lattice, asked at any states."""

import numpy as np
from numpy.typing import ArrayLike

from .._types import Bools, Floats, Ints
from ..core.field.field import Field, evaluate
from ..core.field.field import gradient as field_gradient
from ..core.field.stencils import stencils
from ..core.field.walls import NO_WALLS, Walls
from .walls import moved_in


def log_p_at(field: Field, X: ArrayLike) -> Floats:
    """log p of a field at the states X (M, n)."""
    states = np.ascontiguousarray(X, dtype=float)
    out = np.empty(len(states))
    evaluate(field, stencils(field.mu.size), states, out)
    return out


def gradient(field: Field, X: Floats) -> Floats:
    """Gradient of `at` at the states X (M, n), shape (M, n)."""
    out = np.empty(X.shape)
    field_gradient(field, stencils(field.mu.size), np.ascontiguousarray(X, dtype=float), out)
    return out @ field.inverse


def nodes(field: Field) -> Floats:
    """States (M, n) of a field's nodes, those beside the density's included."""
    return np.asarray(field.mu + field.node @ field.A.T)


def inside_lattice(field: Field, x: Floats) -> Bools:
    """Which states (N, n) lie in cells where a field keeps a node."""
    cell = np.floor((x - field.mu) @ field.inverse.T + 0.5) - field.low
    boxed = ((cell >= 0) & (cell < field.dims)).all(axis=1)
    flat = np.ravel_multi_index(tuple(cell[boxed].astype(np.int64).T), tuple(field.dims))
    owner = field.owner[flat]
    boxed[boxed] = (owner >= 0) & (owner < field.kept)
    return np.asarray(boxed)


def extrapolated_mass(field: Field | None, x: Floats, mass: Floats, walls: Walls = NO_WALLS) -> float:
    """Probability of weighted states x (N, n) where a field keeps no node: its values there are a guess."""
    if field is None:
        return 0.0
    return max(0.0, 1.0 - float(mass[inside_lattice(field, moved_in(walls, field.A, x))].sum()))


def modes(field: Field, x: Floats, p: Floats) -> Ints:
    """Numbers (M,) of the cells that are the modes of those at x (M, n), of probabilities p (M,).

    From a cell one goes to the highest of those that touch it, until none is higher.
    """
    from scipy.spatial import cKDTree  # on use: import time

    pairs = cKDTree((x - field.mu) @ field.inverse.T).query_pairs(1.5, p=np.inf, output_type="ndarray")
    low, high = np.take_along_axis(pairs, np.argsort(p[pairs], axis=1), axis=1).T
    order, up = np.argsort(p[high], kind="stable"), np.arange(len(p))
    up[low[order]] = high[order]  # the last, the highest, stays
    while (up[up] != up).any():
        up = up[up]
    return up
