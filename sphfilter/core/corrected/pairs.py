"""Every pair of particles within reach, once, by sorting and sweeping along the first axis."""

import math
from typing import NamedTuple

import numpy as np
from numba import prange, types

from .._jit import jit, parallel_jit
from .blocks import PARALLEL_FROM, even

__all__ = ["PAIRS", "pair_lists", "pairs_expected"]

#: Numba's type of the pairs that `pair_lists` returns.
PAIRS = types.Tuple([types.int64[::1], types.int64[::1], types.int32[::1]])
_SPARE = 1.5  # times the pairs that are expected of a block: some are denser than others


class _Found(NamedTuple):
    """What blocks of rows have found; rows and particles as they are sorted along the first axis."""

    pairs: np.ndarray  # (blocks, room + N) partners, row after row
    number: np.ndarray  # (blocks,) of pairs, those that found no room too
    counts: np.ndarray  # (N,) partners of each row
    partner: np.ndarray  # (blocks, N) the nearest, of what a block has seen
    best: np.ndarray  # (blocks, N) squared distance from it


@jit
def pairs_expected(spacings, n):
    """Pairs a particle inside a lattice has, each counted once, up to a distance of so many spacings."""
    return 0.5 * math.pi ** (0.5 * n) / math.gamma(0.5 * n + 1.0) * spacings**n


@jit
def pair_lists(z, reach, expected):
    """Every pair closer than the larger reach of the two, once.

    Parameters
    ----------
    z : ndarray, shape (N, n)
    reach : ndarray, shape (N,)
    expected : float
        Pairs of a particle, about; where there are more, the search is done twice.

    Returns
    -------
    (order, start, neighbors), nearest
        Row s holds partners of particle ``order[s]``, ``neighbors[start[s]:start[s + 1]]``; and the nearest
        neighbour of each particle.
    """
    N, n = z.shape
    order = np.argsort(z[:, 0])
    y, R2 = np.empty((n, N)), np.empty(N)
    for s in range(N):
        R2[s] = reach[order[s]] ** 2
        for d in range(n):
            y[d, s] = z[order[s], d]
    edges = even(N) if N >= PARALLEL_FROM else np.array([0, N])
    blocks = edges.size - 1
    counts, number = np.zeros(N, np.int64), np.zeros(blocks, np.int64)
    partner, best = np.empty((blocks, N), np.int64), np.empty((blocks, N))
    room = int(_SPARE * min(expected, 1.0 * N) * (N / blocks))
    while True:
        found = _Found(np.empty((blocks, room + N), np.int32), number, counts, partner, best)
        if blocks == 1:
            _block(0, y, R2, reach.max(), edges, found)
        else:
            _all_blocks(y, R2, reach.max(), edges, found)
        if number.max() <= room:
            break
        room = number.max()
    start = np.zeros(N + 1, np.int64)
    for s in range(N):
        start[s + 1] = start[s] + counts[s]
    return (order, start, _joined(order, found)), _nearest(order, partner, best)


@jit
def _block(b, y, R2, widest, edges, found):
    """Rows edges[b] to edges[b + 1]: partners by row, how many each row has, and the nearest of all rows.

    Pairs that find no room, beyond which there are N places left, are only counted.
    """
    n_pairs, last, N = 0, edges[b], R2.size
    pairs, counts, partner, best = found.pairs, found.counts, found.partner, found.best
    r2, room = np.empty(N), pairs.shape[1] - N
    best[b] = np.inf
    for s in range(edges[b], edges[b + 1]):
        last = max(last, s + 1)
        while last < N and y[0, last] - y[0, s] < widest:
            last += 1
        gap2, theirs = r2[s + 1 : last], R2[s + 1 : last]
        _squares(y, s, last, gap2)
        first, kept = n_pairs, min(n_pairs, room)
        row = pairs[b, kept:]
        count = 0
        for c in range(gap2.size):
            row[count] = s + 1 + c  # the count is advanced only for a pair: no branch to mispredict
            count += gap2[c] < max(R2[s], theirs[c])
        counts[s], n_pairs = count, first + count
        for c in row[:count]:
            if r2[c] < best[b, s]:
                best[b, s], partner[b, s] = r2[c], c
            if r2[c] < best[b, c]:
                best[b, c], partner[b, c] = r2[c], s
    found.number[b] = n_pairs


@parallel_jit
def _all_blocks(y, R2, widest, edges, found):
    """The blocks, spread over threads."""
    for b in prange(edges.size - 1):
        _block(b, y, R2, widest, edges, found)


@jit
def _squares(y, s, last, gap2):
    """Squared distances of the points y[:, s+1:last] from y[:, s]; slices let the loops be vectorised."""
    along = y[0, s + 1 : last]
    for c in range(gap2.size):
        gap2[c] = (along[c] - y[0, s]) ** 2
    for d in range(1, y.shape[0]):
        along = y[d, s + 1 : last]
        for c in range(gap2.size):
            gap2[c] += (along[c] - y[d, s]) ** 2


@jit
def _joined(order, found):
    """The partners of all rows one after the other, as numbers of particles."""
    joined, k = np.empty(found.number.sum(), np.int32), 0
    for b in range(found.number.size):
        for s in found.pairs[b, : found.number[b]]:
            joined[k] = order[s]
            k += 1
    return joined


@jit
def _nearest(order, partner, best):
    """The nearest neighbour of each particle; itself, where it has none within reach."""
    nearest = np.empty(order.size, np.int64)
    for s in range(order.size):
        closest, at = np.inf, s
        for b in range(best.shape[0]):
            if best[b, s] < closest:
                closest, at = best[b, s], partner[b, s]
        nearest[order[s]] = order[at]
    return nearest
