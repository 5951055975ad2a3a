"""Marginals of a log-density on a lattice: sums over the other axes, laid on a lattice of their own."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from scipy.special import logsumexp

from .._types import Floats, Ints, OfStates
from ..core.field import cells
from ..core.field.field import Field
from ..core.field.stencils import stencils
from ..core.field.walls import NO_WALLS, Walls
from ..core.limits import ENTRIES
from ..lattice import field as lattice_field
from ..lattice.level_set import LatticeDensity, flood, lay
from ..lattice.walls import near_walls, node_weights

_FURTHER = 11.0  # nats below a lattice's cut to which tails are summed: exp(-11) = 2e-5 of the density there
_RINGS = 2  # of cells beyond its nodes that a density has in planes through it
#: Nodes of a marginal at least, and so many with more states: √500 = 22 and 1500^⅓ = 11 along each axis.
_FEWEST = {1: 60, 2: 500, 3: 1500}


def around(field: Field, walls: Walls = NO_WALLS) -> Floats:
    """States (M, n) at the middle of all cells of a lattice where its density counts, tails included.

    Those of nodes and, beyond them, down to where what is left counts no more: the cut is for the sake of
    those who carry the nodes along.
    """
    depth, highest, n = np.ptp(field.log_p[: field.kept]) + _FURTHER, field.log_p.max(), len(field.mu)
    low, dims = np.empty(n, np.int64), np.empty(n, np.int64)
    cells.box_of(field.node, cells.MARGIN, low, dims)
    ask = near_walls(partial(lattice_field.log_p_at, field), walls, field.A, 1)
    ball = stencils(n).offsets[: stencils(n).size[0]]
    found = flood(ask, (field.mu, field.A), (field.node, low, dims), ball, depth, highest=highest)
    kept = np.sort(found.asked[found.value[found.asked] > found.highest - depth])
    return cells.states_of(kept, field.mu, field.A, found.low, found.dims)[1]


def marginal_on_lattice(
    field: Field, x: Floats, mass: Floats, axes: Sequence[int], walls: Walls
) -> LatticeDensity:
    """The density of some axes of a field, on a lattice.

    In coordinates that whiten the field's lattice, those axes first, the states with given values there fill
    planes; sums over the points of a lattice in such a plane are spectrally accurate, as those over the
    nodes x (N, n) of mass (N,) are. Walls are where the density ends.
    """
    k, order = len(axes), np.array([*axes, *(axis for axis in range(x.shape[1]) if axis not in axes)])
    factor = np.linalg.cholesky((field.A @ field.A.T)[np.ix_(order, order)])
    z = np.linalg.solve(factor, (x - field.mu)[:, order].T).T
    shadow = len(np.unique(np.floor(z[:, :k] + 0.5), axis=0))
    n_nodes = max(_FEWEST.get(k, _FEWEST[3]), 2**k * shadow)  # twice as fine along each axis
    mean, own = (mass @ x)[axes], np.ascontiguousarray(factor[:k, :k])
    seeds, depth = np.unique(x[:, axes], axis=0), np.ptp(field.log_p[: field.kept])
    first, last = ((end[order[:k]], end[order[k:]]) if end.size else (end, end) for end in walls)
    summed = _summed(field, order, factor, z[:, k:], (first[1], last[1]))
    ends = (first[0], last[0])
    return lay(summed, mean, own, seeds, n_nodes, depth, float(shadow), ends)


def _summed(field: Field, order: Ints, factor: Floats, others: Floats, walls: Walls) -> OfStates:
    """Return log of the integral of a field over its last axes in an order, given the first (M, k).

    others : ndarray, shape (N, n - k)
        Where its nodes lie along them, in units of a lattice with the lower `factor` (n, n).
    walls : tuple of ndarray, shapes (n - k,)
        Where those axes end; empty if none does.
    """
    plane, spacing = _plane(others)
    k = len(order) - others.shape[1]
    log_cell = np.log(spacing * np.diag(factor)[k:]).sum()

    def log_p(Y: Floats) -> Floats:
        here = np.linalg.solve(factor[:k, :k], (Y - field.mu[order[:k]]).T).T
        out = np.empty(len(Y))
        step = max(1, ENTRIES // (len(order) * len(plane)))
        for first in range(0, len(Y), step):
            some = here[first : first + step]
            rows = np.repeat(some, len(plane), axis=0), np.tile(plane, (len(some), 1))
            X = np.empty((len(rows[0]), len(order)))
            X[:, order] = np.concatenate(rows, axis=1) @ factor.T
            X += field.mu
            weight = node_weights(walls, spacing * factor[k:, k:], X[:, order[k:]]).reshape(len(some), -1)
            log_p = lattice_field.log_p_at(field, X).reshape(len(some), -1)
            out[first : first + step] = logsumexp(log_p, axis=1, b=weight)
        return out + log_cell

    return log_p


def _plane(z: Floats) -> tuple[Floats, float]:
    """Points (Q, m) of a lattice that cover nodes z (N, m) and the cells around them, and its spacing."""
    from scipy import ndimage  # on use: import time

    m = z.shape[1]
    if m == 0:
        return np.zeros((1, 0)), 1.0
    whole = np.floor(z + 0.5).astype(np.int64)
    low = whole.min(axis=0) - _RINGS
    mark = np.zeros(whole.max(axis=0) - low + _RINGS + 1, dtype=bool)
    mark[tuple((whole - low).T)] = True
    mark = ndimage.binary_dilation(mark, np.ones([3] * m), _RINGS)
    parts = 2 if m <= 2 else 1  # terms a cell along each axis: two along three make eight
    mark = np.kron(mark, np.ones([parts] * m, dtype=bool))
    return (np.argwhere(mark) + 0.5) / parts - 0.5 + low, 1.0 / parts
