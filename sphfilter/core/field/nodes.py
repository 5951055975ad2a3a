"""The nodes of a flooded box, normalised."""

import math

import numpy as np

from .._jit import jit
from ..small_matrices import moments
from .cells import UNKNOWN, opened, states_of
from .walls import is_inside, part_inside, share

MOST_ASKED = 12  # cells asked for, over the number of particles wanted


@jit
def relaid(box, mu, A, sten, depth, walls):
    """The nodes of a flooded box above the depth, normalised, and those beside them.

    The box has values (cells,), `UNKNOWN` where none was asked for; the lowest cell (n,), and cells (n,)
    along every axis; the largest value; and flat numbers of the cells that were asked for. The lattice has
    origin mu (n,) and vectors A (n, n), the depth is log p of the lightest nodes below the highest, and walls
    (n,), low and high, are where axes end; empty if none does.

    Returns node (M, n), x (N, n), log_p (M,), m (N,), log of the integral, mean (n,), covariance (n, n). The
    first N of the M nodes lie above the depth. The others were asked beside them: polynomials are fitted to
    them too, where log p does not fall there by more than the depth once more. So do those beyond a wall. The
    last three are sums over all cells that were asked for, the ring just below the depth included: what the
    cut would take away from them is below rounding of what the lattice resolves.
    """
    (value, low, dims, highest, cells), n = box, mu.size
    found = opened(value, cells, highest - depth, dims, sten.offsets[: sten.size[0]])
    if walls[0].size > 0:
        found = _inside(found, mu, A, low, dims, walls)
    known = np.empty(value.size, np.bool_)
    for flat in range(value.size):
        known[flat] = value[flat] != UNKNOWN
    asked = np.flatnonzero(known)  # sums do not depend on the order in which the cells were found
    _, everywhere = states_of(asked, mu, A, low, dims)
    weight, total, cell = np.empty(asked.size), 0.0, 1.0
    for k in range(asked.size):
        weight[k] = math.exp(value[asked[k]] - highest)
        if walls[0].size > 0:
            weight[k] *= part_inside(walls[0], walls[1], A, everywhere[k])
        total += weight[k]
    for k in range(asked.size):
        weight[k] /= total
    for a in range(n):
        cell *= A[a, a]
    log_mass = highest + math.log(total * cell)
    mean, cov = np.empty(n), np.empty((n, n))
    moments(everywhere, weight, mean, cov)
    both = np.concatenate((found, _beside(value, asked, found, highest - 2.0 * depth)))
    node, x = states_of(both, mu, A, low, dims)
    log_p, m, inside = np.empty(both.size), np.empty(found.size), 0.0
    for k in range(both.size):
        log_p[k] = value[both[k]] - log_mass
    for k in range(found.size):
        m[k] = math.exp(value[found[k]] - highest)
        if walls[0].size > 0:
            m[k] *= share(walls[0], walls[1], A, x[k])
        inside += m[k]
    for k in range(found.size):
        m[k] /= inside
    return node, x[: found.size], log_p, m, log_mass, mean, cov


@jit
def _inside(found, mu, A, low, dims, walls):
    """Cells of some whose nodes lie between the walls."""
    _, x = states_of(found, mu, A, low, dims)
    mark = np.empty(found.size, np.bool_)
    for k in range(found.size):
        mark[k] = is_inside(walls[0], walls[1], x[k])
    return found[mark]


@jit
def _beside(value, asked, found, level):
    """Cells that were asked, are not among those found, and lie above a level."""
    kept = np.zeros(value.size, np.bool_)
    for k in range(found.size):
        kept[found[k]] = True
    mark = np.zeros(value.size, np.bool_)
    for k in range(asked.size):
        mark[asked[k]] = not kept[asked[k]] and value[asked[k]] > level
    return np.flatnonzero(mark)
