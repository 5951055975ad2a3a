"""A reading of a cloud in one call: weighted, and once more from ancestors that the reading chooses.

That is what `filter.guided` does of any sensor and any way, for one prediction since the last reading and
noise that is the same in all states.
"""

from typing import NamedTuple

import numpy as np
from numba import types

from .._addresses import ADDRESS, NOWHERE_AT, function_at
from .._jit import MATRIX, VECTOR, jit
from ..limits import ALIKE, DIFFERENCE
from .blocks import products, steered
from .guide import (
    NEAR,
    joined,
    linear_reading,
    log_normals,
    look_ahead,
    over_both,
    residuals,
    without_noise,
    wrapped,
)
from .linearise import lower_and_rows
from .move import affine, move_at
from .noise import LANES, even_normals, mixed, stored
from .steps import CUBE, LEG
from .way import AGAIN
from .weights import (
    beside,
    effective,
    finite_rows,
    normalise,
    prior_times,
    taken,
    turned,
    weighted_moments,
)

#: Times the reading's own noise that the guide sees: 1.2 has heavy weights on two wells, 2 is as good.
WIDER = 1.5
#: Variance of a point's own rest about the mean of its neighbours', over that of one: OWN = 1 + 1 / (2 NEAR).
OWN = 1.0 + 0.5 / NEAR
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
#: Type of a reading and the way of points to it, as `weigh` says.
WAY = types.Tuple([READER, *_PREDICTED, MATRIX, MATRIX])


@jit
def gone(leg, linear, x, u, block, part, key):
    """Points (n, N) at the end of a passage, from x, with ends moved by u; a key is of other noise."""
    if linear:
        return affine(x, u, block, part.start, part.end, part.flow, part.lower)
    y = x.copy()
    move_at(leg.move)(leg, y, u, part.rows, block, key, 0, -(-x.shape[1] // LANES))
    return y


@jit
def read(reader, x):
    """Readings (k, N) of states (n, N); h is asked where the state is a number, and NaN elsewhere."""
    (n, N), k = x.shape, reader.z.size
    if reader.h == NOWHERE_AT:
        return products(reader.H.copy().reshape(1, k, n), x, np.zeros(N, np.int64))
    fine, every = finite_rows(x)
    rows = np.full((N, k), np.nan)
    if every:
        function_at(reader.h)(turned(x), reader.t, reader.p, rows)
    elif fine.any():
        asked, some = np.flatnonzero(fine), np.empty((np.count_nonzero(fine), k))
        function_at(reader.h)(turned(taken(x, asked)), reader.t, reader.p, some)
        for i in range(asked.size):
            rows[asked[i]] = some[i]
    return turned(rows)


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
def as_seen(reader, flow, lower, end, points, misses):
    """A way of points as a sensor sees it, of Φ, L and ends of blocks.

    Of the points: x and y (n, N), where they begin and end, readings h (k, N) there, what moves them, u
    (n, N), weights and blocks (N,). A guide takes `misses` times what linearity misses. Returns residuals
    (k, N) of what each would read without its noise, HL (blocks, k, n) and R (blocks, k, k).
    """
    (x, y, h, u, w, block), k = points, reader.z.size
    r = residuals(reader.z, read(reader, without_noise(y, x, u, lower, flow, block)), reader.angle)
    H, R = _slopes(reader, end), reader.R.copy().reshape((1, k, k))
    HL, R = linear_reading(h, x, u, w, block, flow, lower, H, R, reader.angle, WIDER, misses)
    return r, HL, R


@jit
def foreseen(reader, x, w, mean):
    """Innovation (k,) of a reading by a function h, and its covariance (k, k).

    Of points x (n, N) of weights w (N,) and a mean. Angles are averaged around the reading of the mean.
    """
    k = reader.z.size
    off, S = np.zeros(k), np.empty((k, k))
    expected, h = read(reader, mean.copy().reshape((-1, 1))), read(reader, x)
    for a in range(k):
        for i in range(w.size):
            h[a, i] = wrapped(h[a, i] - expected[a, 0], reader.angle[a])
    weighted_moments(h, w, off, S)
    for a in range(k):
        off[a] = wrapped(reader.z[a] - (expected[a, 0] + off[a]), reader.angle[a])
        for b in range(k):
            S[a, b] += reader.R[a, b]
    return off, S


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
def weigh(way, nets, key):
    """Prior times likelihood, of both passes.

    Parameters
    ----------
    way : tuple
        A `Reader`; the prediction as a `Leg`, whether its change is linear, and its key; points where they
        began and where they are, (n, N), their weights and blocks (N,); the noise that begins the way and
        the prediction, each a `Part`; and what moved the points in each, (n, N).
    nets : tuple of ndarray, shape (n, N)
        Standard normals of the guide and of both passages.
    key : int

    Returns
    -------
    x, log_w, lineage : ndarray, shapes (n, M), (M,), (M,)
        States, logarithms of weights whose sum is the evidence, and ancestors.
    wrong : int
        How many likelihoods are no number: then the rest is of no worth.
    """
    reader, leg, linear, passage, x, y, w, block, kernel, moved, u, v = way
    n, N = x.shape
    own = mixed(np.uint64(key), np.uint64(GUIDE))
    h = read(reader, y)
    log_l, wrong = likelihoods(reader, y, h)
    log_w, alone = prior_times(w, log_l), np.arange(N)
    first = np.zeros(N)
    if wrong or not abs(normalise(log_w, first)) < np.inf or effective(first) >= ALIKE * effective(w):
        return y, log_w, alone, wrong
    flow, G = joined(kernel.flow, kernel.lower, moved.flow, moved.lower)
    lower, rows = lower_and_rows(G)
    whole = products(rows, np.concatenate((u, v)), block)
    r, HL, R = as_seen(reader, flow, lower, moved.end, (x, y, h, whole, w, block), WIDER * OWN)
    ancestor, new, log_ratio = look_ahead(r, whole, w, block, HL, R, nets[0], own)
    if ancestor.size == 0:
        return y, log_w, alone, wrong
    end, block = taken(x, ancestor), block[ancestor]
    u = even_normals(nets[1], np.uint64(stored(own, PARTS)))
    v = even_normals(nets[2], np.uint64(stored(own, PARTS + 1)))
    U = np.concatenate((u, v))
    steered(rows, block, new, U)
    end = gone(leg, True, end, U[:n], block, kernel, np.uint64(0))
    end = gone(leg, linear, end, U[n:], block, moved, mixed(np.uint64(passage), np.uint64(AGAIN)))
    more, wrong = likelihoods(reader, end, read(reader, end))
    both = over_both(np.concatenate((log_l, more)), log_ratio, w)
    return beside(y, end), both, np.concatenate((alone, ancestor)), wrong
