"""Walls beside a lattice: a density ends there, its polynomials go on for a few cells.

Nodes a few cells beyond a wall carry the smooth continuation of log p, so that fits near the wall are as
complete as elsewhere. They hold no probability: integrals end at the wall, wherever it cuts a cell.
"""

from typing import TypeAlias

import numpy as np

from .._jit import jit

#: Low and high ends (n,) of the axes; empty where none ends.
Walls: TypeAlias = tuple[np.ndarray, np.ndarray]
NOWHERE = np.empty(0)
NO_WALLS: Walls = (NOWHERE, NOWHERE)


@jit
def is_inside(low, high, x):
    """Does a state x (n,) lie between the walls? low, high: (n,), or empty."""
    inside = True
    for a in range(low.size):
        inside &= low[a] <= x[a] <= high[a]
    return inside


@jit
def beyond(low, high, A, rings, x):
    """Does a state x (n,) lie further beyond a wall than a neighbourhood of so many cells reaches?"""
    for a in range(low.size):
        reach = 0.0
        for c in range(low.size):
            reach += rings * abs(A[a, c])
        if x[a] < low[a] - reach or x[a] > high[a] + reach:
            return True
    return False


@jit
def fold(low, high, X):
    """Mirror states X (M, n) that lie beyond walls, in place."""
    for a in range(low.size):
        for i in range(X.shape[0]):
            if X[i, a] < low[a]:
                X[i, a] = min(2.0 * low[a] - X[i, a], high[a])
            elif X[i, a] > high[a]:
                X[i, a] = max(2.0 * high[a] - X[i, a], low[a])


@jit
def part_inside(low, high, A, x):
    """Weight of a lattice's node x (n,) in integrals that end at the walls.

    Along each row of nodes it is the integral inside of the cubic that interpolates this node's one: of order
    four wherever the wall lies between two nodes. A is lower triangular.
    """
    part = 1.0
    for a in range(low.size):
        part *= _cubic((x[a] - low[a]) / A[a, a]) * _cubic((high[a] - x[a]) / A[a, a])
    return part


@jit
def parts_inside(low, high, A, X):
    """`part_inside` of nodes X (M, n), shape (M,)."""
    out = np.empty(X.shape[0])
    for i in range(out.size):
        out[i] = part_inside(low, high, A, X[i])
    return out


@jit
def share(low, high, A, x):
    """Part of a cell, in units of its own, that a node x (n,) inside of the walls stands for.

    A positive weight, of second order: the node next to a wall has all that is left up to it.
    """
    part = 1.0
    for a in range(low.size):
        for u in ((x[a] - low[a]) / A[a, a], (high[a] - x[a]) / A[a, a]):
            part *= u + 0.5 if u < 1.0 else 1.0
    return part


@jit
def _cubic(u):
    """Integral of the cardinal function of cubic interpolation from minus infinity to u nodes."""
    v = min(abs(u), 2.0)
    if v < 1.0:
        half = v - 0.25 * v**2 - v**3 / 3.0 + 0.125 * v**4
    else:
        w = v - 1.0
        half = 13.0 / 24.0 - (w**2 / 6.0 - w**3 / 6.0 + w**4 / 24.0)
    return 0.5 + half if u >= 0.0 else 0.5 - half
