"""A sensor as compiled code reads by it, and a way of points as it sees that."""

from typing import NamedTuple

import numpy as np
from numba import types

from .._addresses import ADDRESS, NOWHERE_AT, function_at
from .._jit import MATRIX, VECTOR, jit
from ..limits import DIFFERENCE
from .blocks import products
from .guide import Ahead, joined, linear_reading, log_normals, residuals, without_noise, wrapped
from .linearise import lower_and_rows
from .move import affine, moved_over
from .steps import CUBE, LEG
from .weights import finite_rows, taken

#: What numbers of a reading's key are for: its guide, and passages k = 0, 1 at PARTS + k.
GUIDE, PARTS = 11, 20


class Reader(NamedTuple):
    """A reading z (k,) and its sensor: h by address and data, or nowhere and H; angles; R and root."""

    h: int
    p: np.ndarray
    H: np.ndarray  # (k, n)
    z: np.ndarray
    angle: np.ndarray  # bool (k,)
    R: np.ndarray  # (k, k)
    root: np.ndarray
    t: float


#: Numba's type of `Reader`.
READER = types.NamedTuple(
    [ADDRESS, VECTOR, MATRIX, VECTOR, types.boolean[::1], MATRIX, MATRIX, types.float64], Reader
)


class Part(NamedTuple):
    """A passage of a way, linearised in blocks; see `density.points.Passage`."""

    start: np.ndarray
    end: np.ndarray
    flow: np.ndarray
    lower: np.ndarray
    rows: np.ndarray


_MOVED = types.NamedTuple([MATRIX, MATRIX, CUBE, CUBE, CUBE], Part)
_PREDICTED = LEG, types.boolean, types.int64, MATRIX, MATRIX, VECTOR, types.int64[::1], _MOVED, _MOVED
NET = types.Array(types.float64, 2, "C", readonly=True)  # standard normals (n, N)
#: Type of a reading and the way of points to it, as `weigh` says.
WAY = types.Tuple([READER, *_PREDICTED, MATRIX, MATRIX])


@jit
def gone(leg, linear, x, u, block, part, key):
    """Points (n, N) at the end of a passage, from x, with ends moved by u; a key is of other noise."""
    if linear:
        return affine(x, u, block, part.start, part.end, part.flow, part.lower)
    return moved_over(leg, x, u, part.rows, block, key)


@jit
def read(reader, x):
    """Readings (k, N) of states (n, N); h is asked where the state is a number, and NaN elsewhere."""
    (n, N), k = x.shape, reader.z.size
    if reader.h == NOWHERE_AT:
        return products(reader.H.copy().reshape(1, k, n), x, np.zeros(N, np.int64))
    fine, every = finite_rows(x)
    rows = np.full((N, k), np.nan)
    if every:
        function_at(reader.h)(np.ascontiguousarray(x.T), reader.t, reader.p, rows)
    elif fine.any():
        asked, some = np.flatnonzero(fine), np.empty((np.count_nonzero(fine), k))
        function_at(reader.h)(np.ascontiguousarray(taken(x, asked).T), reader.t, reader.p, some)
        for i in range(asked.size):
            rows[asked[i]] = some[i]
    return np.ascontiguousarray(rows.T)


@jit
def likelihoods(reader, x, h):
    """Log-likelihoods (N,) of states x (n, N) of readings h; and how many are no number where a state is."""
    fine, every = finite_rows(x)
    log_l, wrong = log_normals(reader.z, h, reader.angle, reader.root)
    for i in range(0 if every else log_l.size):
        if not fine[i]:
            wrong -= log_l[i] != log_l[i]
            log_l[i] = -np.inf
    return log_l, wrong


@jit
def _slopes(reader, c):
    """∂h/∂x at states c (blocks, n), (blocks, k, n), or (1, k, n) where it is a matrix."""
    (nb, n), k = c.shape, reader.z.size
    if reader.h == NOWHERE_AT:
        return reader.H.copy().reshape((1, k, n))
    x, J = np.empty((n, nb * 2 * n)), np.empty((nb, k, n))
    for e in range(n):
        for i in range(x.shape[1]):
            x[e, i] = c[i // (2 * n), e]
        for b in range(nb):
            step = DIFFERENCE * max(1.0, abs(c[b, e]))
            x[e, 2 * (b * n + e)] += step
            x[e, 2 * (b * n + e) + 1] -= step
    h = read(reader, x)
    for b in range(nb):
        for e in range(n):
            i, step = 2 * (b * n + e), DIFFERENCE * max(1.0, abs(c[b, e]))
            for a in range(k):
                J[b, a, e] = wrapped(h[a, i] - h[a, i + 1], reader.angle[a]) / (2.0 * step)
    return J


@jit
def as_one(part, later, u, v, block):
    """Two parts of a way as one: Φ, L, rows of what moves the end; and that, of points moved by u and v."""
    flow, G = joined(part.flow, part.lower, later.flow, later.lower)
    lower, rows = lower_and_rows(G)
    return flow, lower, rows, products(rows, np.concatenate((u, v)), block)


@jit
def as_seen(reader, moved, h, end, misses, near):
    """Points that have `Moved` as a sensor sees them, of readings h (k, N) and ends (blocks, n) of blocks.

    A guide takes `misses` times what linearity misses; as many neighbours as `near` to either side tell where
    a point would come without noise. Returns what they are `Ahead`.
    """
    y, k = without_noise(moved, near), reader.z.size
    r = residuals(reader.z, read(reader, y), reader.angle)
    H, R = _slopes(reader, end), reader.R.copy().reshape((1, k, k))
    return Ahead(r, y, moved.lower, *linear_reading(moved, h, H, R, reader.angle, misses))
