"""A density's new lattice: values wherever they lie above a level, found from seeds outwards."""

import math
from typing import NamedTuple

import numpy as np

from ._jit import jit
from .cells import (
    MOST_CELLS,
    UNKNOWN,
    frontier,
    furthest,
    joined,
    marked,
    opened,
    product,
    seeded,
    seeds_in_box,
    states_of,
    widen,
)
from .noise_paths import back, back_in_blocks
from .small_matrices import invert_lower, moments

__all__ = [
    "COUNTERS",
    "EVALUATIONS",
    "MOST_ASKED",
    "REJECTED",
    "RELAID",
    "STEPS",
    "Control",
    "flooded",
    "relaid",
]

MOST_ASKED = 12  # cells asked for, over the number of particles wanted
COUNTERS = ("steps", "rejected", "evaluations", "relaid")
STEPS, REJECTED, EVALUATIONS, RELAID = range(4)


class Control(NamedTuple):
    """What the march aims at."""

    n_particles: int
    depth: float  # Z^2 / 2: log p of the lightest nodes below that of the heaviest
    tolerance: float  # of one step's paths, in standard deviations
    noise_share: float  # largest variance a step's noise may have, in units of the density's own
    bent_share: float  # the same of noise that the drift has sheared
    curved: float  # how far from linear the paths' ends may be in their noise, in standard deviations
    most_lost: float  # sum over steps of |log of the lattice's integral| at which to stop
    pause_after: int  # steps


@jit
def flooded(step, mu, A, points, control, counters, threads):
    """Values on the new lattice wherever they lie above the depth: seeds, then their neighbours,
    until closed.
    """
    n = mu.size
    ball = step.sten.offsets[: step.sten.size[0]]
    low, dims = np.empty(n, np.int64), np.empty(n, np.int64)
    cells = seeds_in_box(points, mu, invert_lower(A), furthest(n), low, dims)
    if product(dims) > MOST_CELLS:
        return np.empty(0), low, dims, 0.0, np.empty(0, np.int64)
    value, asked = np.full(int(product(dims)), UNKNOWN), np.empty(0, np.int64)
    found, highest = seeded(cells, low, dims), -np.inf
    while found.size > 0:
        _, Y = states_of(found, mu, A, low, dims)
        log_p = np.empty(found.size)
        floor = highest - control.depth
        if threads is None:  # noqa: SIM108 by type, so that the branch not taken is not compiled
            full = back(step, Y, floor, log_p)
        else:
            full = back_in_blocks(step, Y, floor, log_p)
        one = 4 * step.parts - 1  # a path's evaluations
        counters[EVALUATIONS] += found.size * (2 * one + 1) + full * one * step.paths.log_weight.size
        for k in range(found.size):
            value[found[k]] = log_p[k]
            highest = max(highest, log_p[k])
        asked = joined(asked, found)
        if asked.size > MOST_ASKED * control.n_particles:
            break  # far too fine a lattice: the caller takes a coarser one
        found, beyond = frontier(value, asked, highest - control.depth, dims, ball)
        if beyond:
            value, low, dims, asked = widen(value, low, dims, asked)
            if value.size == 0:
                break
            found, beyond = frontier(value, asked, highest - control.depth, dims, ball)
    return value, low, dims, highest, asked


@jit
def relaid(value, low, dims, highest, cells, mu, A, sten, depth):
    """The nodes of a flooded box above the depth, normalised.

    Mean, covariance and the integral are sums over all cells that were asked for, the ring just below the
    depth included: what the cut would take away from them is below rounding of what the lattice resolves.

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
