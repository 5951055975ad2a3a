"""A density's new lattice: values wherever they lie above a level, found from seeds outwards."""

import math
from typing import NamedTuple

import numpy as np

from .._addresses import Entry
from .._jit import MATRIX, VECTOR, jit
from ..field.cells import (
    LOWEST,
    MOST_CELLS,
    UNKNOWN,
    cells_in,
    frontier,
    furthest,
    seeded,
    seeds_in_box,
    states_of,
    widen,
)
from ..field.nodes import MOST_ASKED, relaid
from ..field.walls import beyond
from ..small_matrices import invert_lower
from .control import EVALUATIONS, NODES, OK, OUTGROWN, RELAID, RUN, TOO_FEW, VOLUME
from .expectation import BACK, STEP

_TRIES = 6
_MANY = 4  # states, of which nodes beside a lattice are most: one path has to do for them
_FILL = 0.85  # nodes aimed at, over those allowed: volumes may be off by 1 / .85 = 1.18
_SOFT = 1.5  # times the nodes asked for, that there may be where an error is aimed at


class Lattice(NamedTuple):
    """A density after a step."""

    code: int  # of `STATUS`
    mu: np.ndarray  # (n,) origin
    A: np.ndarray  # (n, n) lattice vectors in columns
    node: np.ndarray  # (N, n)
    x: np.ndarray  # (N, n)
    log_p: np.ndarray  # (N,)
    mass: np.ndarray  # (N,)
    log_mass: float  # of the integral before it was normalised
    mean: np.ndarray  # (n,)
    cov: np.ndarray  # (n, n)
    volume: float  # of the kept region, in whitened coordinates


@jit
def lattice_after(back, step, mean, shape, seeds, run):
    """Lay the density after a step on a lattice of at most as many nodes as allowed, and at least half.

    back: the function of that name, or `back_in_blocks`.
    mean, shape: (n,), (n, n), origin and lower factor of a covariance: the coordinates that are whitened.
    seeds: (S, n), states of which some lie in every piece of the region.
    """
    control, state, counters = run
    n, most = mean.size, math.ceil(state[NODES])
    limit = most if control.steps == 0.0 else math.ceil(_SOFT * most)
    A = np.empty((n, n))
    for _ in range(_TRIES):
        spacing = (state[VOLUME] / (_FILL * most)) ** (1.0 / n)
        for a in range(n):
            for b in range(n):
                A[a, b] = shape[a, b] * spacing
        box = flooded(back, step, mean, A, seeds, most, run)
        if box[0].size == 0:
            return _no_lattice(OUTGROWN, n)
        walls = step.noise.low, step.noise.high
        new, asked = relaid(box, mean, A, step.sten, control.depth, walls), box[4].size
        count = new[1].shape[0] if asked <= MOST_ASKED * most else asked
        if 0.5 * most <= count <= limit:
            break
        counters[RELAID] += 1
        state[VOLUME] *= max(count, 0.1 * most) / (_FILL * most)
    if count == 0 or count > limit:
        return _no_lattice(TOO_FEW, n)
    node, x, log_p, m, log_mass, own_mean, cov = new
    return Lattice(OK, mean, A, node, x, log_p, m, log_mass, own_mean, cov, count * spacing**n)


@jit
def _no_lattice(code, n):
    none, row = np.empty(0), np.empty((0, n))
    return Lattice(code, none, row, np.empty((0, n), np.int64), row, none, none, 0.0, none, row, 0.0)


@jit
def flooded(back, step, mu, A, points, most, run):
    """Values on the new lattice wherever they lie above the depth: seeds, then their neighbours,
    until closed. `back` is the function of that name, in blocks or not.
    """
    n, (control, _, counters) = mu.size, run
    ball = step.sten.offsets[: step.sten.size[0]]
    low, dims = np.empty(n, np.int64), np.empty(n, np.int64)
    cells = seeds_in_box(points, mu, invert_lower(A), furthest(n), low, dims)
    if cells_in(dims) > MOST_CELLS:
        return np.empty(0), low, dims, 0.0, np.empty(0, np.int64)
    value, asked = np.full(int(cells_in(dims)), UNKNOWN), np.empty(0, np.int64)
    found, highest = seeded(cells, low, dims), -np.inf
    while found.size > 0:
        _, Y = states_of(found, mu, A, low, dims)
        log_p = np.empty(found.size)
        floor = highest - (2.0 if n < _MANY else 1.0) * control.depth
        full = back(step, Y, floor, log_p)
        one = 4 * step.parts - 1  # a path's evaluations
        counters[EVALUATIONS] += found.size * (2 * one + 1) + full * one * step.paths.log_weight.size
        for k in range(found.size if step.noise.low.size > 0 else 0):
            if beyond(step.noise.low, step.noise.high, A, step.sten.widest, Y[k]):
                log_p[k] = LOWEST
        for k in range(found.size):
            value[found[k]] = log_p[k]
            highest = max(highest, log_p[k])
        asked = np.concatenate((asked, found))
        if asked.size > MOST_ASKED * most:
            break  # far too fine a lattice: the caller takes a coarser one
        found, outside = frontier(value, asked, highest - control.depth, dims, ball)
        if outside:
            value, low, dims, asked = widen(value, low, dims, asked)
            if value.size == 0:
                break
            found, outside = frontier(value, asked, highest - control.depth, dims, ball)
    return value, low, dims, highest, asked


#: `lattice_after` by its address.
LAY = Entry(lattice_after, (BACK, STEP, VECTOR, MATRIX, MATRIX, RUN))
