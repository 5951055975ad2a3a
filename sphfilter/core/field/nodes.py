"""The nodes of a flooded box, normalised."""

import math

import numpy as np

from .._jit import jit
from ..small_matrices import moments
from .cells import UNKNOWN, marked, opened, states_of

__all__ = ["MOST_ASKED", "relaid"]

MOST_ASKED = 12  # cells asked for, over the number of particles wanted


@jit
def relaid(value, low, dims, highest, cells, mu, A, sten, depth):
    """The nodes of a flooded box above the depth, normalised.

    Mean, covariance and the integral are sums over all cells that were asked for, the ring just below the
    depth included: what the cut would take away from them is below rounding of what the lattice resolves.

    Parameters
    ----------
    value : ndarray, shape (cells,)
        log p of the box's cells, `UNKNOWN` where it was not asked for.
    low, dims : ndarray of int, shape (n,)
        Lowest cell of the box, and its size along every axis.
    highest : float
        Largest value.
    cells : ndarray of int
        Flat numbers of the cells that were asked for.
    mu, A : ndarray, shapes (n,) and (n, n)
        Origin and vectors of the lattice.
    sten : Stencils
    depth : float
        log p of the lightest nodes below the highest.

    Returns
    -------
    node (N, n), x (N, n), log_p (N,), m (N,), log of the integral, mean (n,), covariance (n, n)
    """
    n = mu.size
    found = opened(value, cells, highest - depth, dims, sten.offsets[: sten.size[0]])
    node, x = states_of(found, mu, A, low, dims)
    known = np.empty(value.size, np.bool_)
    for flat in range(value.size):
        known[flat] = value[flat] != UNKNOWN
    asked = marked(known)  # sums do not depend on the order in which the cells were found
    _, everywhere = states_of(asked, mu, A, low, dims)
    weight, total, cell = np.empty(asked.size), 0.0, 1.0
    for k in range(asked.size):
        weight[k] = math.exp(value[asked[k]] - highest)
        total += weight[k]
    for k in range(asked.size):
        weight[k] /= total
    for a in range(n):
        cell *= A[a, a]
    log_mass = highest + math.log(total * cell)
    mean, cov = np.empty(n), np.empty((n, n))
    moments(everywhere, weight, mean, cov)
    log_p, m, inside = np.empty(found.size), np.empty(found.size), 0.0
    for k in range(found.size):
        log_p[k] = value[found[k]] - log_mass
        m[k] = math.exp(value[found[k]] - highest)
        inside += m[k]
    for k in range(found.size):
        m[k] /= inside
    return node, x, log_p, m, log_mass, mean, cov
