"""Points in the order of Hilbert's curve, where neighbours lie close together; and points spread evenly."""

import math
from functools import cache

import numpy as np

from .._jit import jit
from ..limits import AROUND, TINY
from ..small_matrices import cholesky, invert_lower
from .weights import weighted_moments

#: Bits of a cell's number along each state: places of 4 bytes in tables of at most 2^20 = 4 MB.
_BITS = {1: 12, 2: 8, 3: 6, 4: 4, 5: 4, 6: 3}
_LEAST = float(np.finfo(float).eps)  # distance of points from the ends of the unit cube


def places(n):
    """Places of all cells of n states on the curve, by number; and bits along each state."""
    bits = _BITS.get(n, 2 if n <= 10 else 1)
    return _table(bits, n), bits


@cache
def _table(bits, n):
    table = np.empty((1 << bits) ** n, np.uint32)
    fill_places(bits, n, table)
    return table


@jit
def spread(step, shift, order, out):
    """Fill out (n, N) with points number order (N,) of a sequence over the open unit cube.

    It adds `step` (n,) again and again, modulo one; all points are shifted by `shift` (n,).
    """
    for a in range(out.shape[0]):
        for i in range(out.shape[1]):
            u = order[i] * step[a]
            u += shift[a] - np.floor(u)
            out[a, i] = min(max(u - np.floor(u), _LEAST), 1.0 - _LEAST)


@jit
def along_curve(x, w, table, bits):
    """Numbers (N,) of points x (n, N), of weights w (N,), in their order on the curve, whitened."""
    n = len(x)
    mean, cov = np.empty(n), np.empty((n, n))
    weighted_moments(x, w, mean, cov)
    return ordered(x, mean, cov, table, bits)


@jit
def ordered(x, mean, cov, table, bits):
    """As `along_curve`, of points of a mean (n,) and covariance (n, n).

    A counting sort, byte by byte: points of one cell stay in the order in which they came.
    """
    (n, N), top, cov, L = x.shape, 1 << bits, cov.copy(), np.empty(cov.shape)
    for a in range(n):  # a state without spread, or none that is a number, has one cell
        cov[a, a] = cov[a, a] if TINY < cov[a, a] < np.inf else 1.0
    if not cholesky(cov, L):
        for a in range(n):
            for b in range(n):
                L[a, b] = math.sqrt(cov[a, a]) if a == b else 0.0
    place, order, other = np.empty(N, np.uint32), np.empty(N, np.int64), np.empty(N, np.int64)
    cell = _cells(x, mean, invert_lower(L), top)
    for i in range(N):
        place[i], order[i] = table[cell[i]], i
    shift = 0
    while shift < bits * n:
        ends = np.zeros(257, np.int64)
        for i in range(N):
            ends[((place[i] >> shift) & 255) + 1] += 1
        for k in range(256):
            ends[k + 1] += ends[k]
        for i in order:
            k = (place[i] >> shift) & 255
            other[ends[k]] = i
            ends[k] += 1
        order, other = other, order
        shift += 8
    return order


@jit
def _cells(x, mean, white, top):
    """Numbers (N,) of the cells, so many along each state, in which points x (n, N) lie, whitened.

    Cells tell apart what lies `AROUND` the mean, and the outermost ones have the rest.
    """
    (n, N), scale = x.shape, 0.5 * top / AROUND
    cell, z = np.zeros(N, np.int32), np.empty(N)
    for a in range(n):
        for i in range(N):
            z[i] = 0.5 * top
        for b in range(a + 1):
            on, about = scale * white[a, b], mean[b]
            for i in range(N):
                z[i] += on * (x[b, i] - about)
        for i in range(N):
            own = z[i] if z[i] > 0.0 else 0.0  # also where it is no number
            own = own if own < top - 1.0 else top - 1.0
            cell[i] = cell[i] * np.int32(top) + np.int32(own)
    return cell


@jit
def fill_places(bits, n, table):
    """Fill the places of all cells of n states, of so many bits along each."""
    X, top = np.empty(n, np.int64), 1 << bits
    for cell in range(table.size):
        left = cell
        for a in range(n - 1, -1, -1):
            X[a] = left % top
            left //= top
        _transposed(X, top)
        found = 0
        for level in range(bits - 1, -1, -1):
            for a in range(n):
                found = (found << 1) | ((X[a] >> level) & 1)
        table[cell] = found


@jit
def _transposed(X, top):
    """Turn a cell's numbers X (n,) into the bits of its place on the curve (Skilling 2004)."""
    n, q = X.size, top >> 1
    while q > 1:
        for a in range(n):
            t = q - 1 if X[a] & q else 0
            swapped = (X[0] ^ X[a]) & (q - 1 - t)
            X[0] ^= t | swapped
            X[a] ^= swapped
        q >>= 1
    for a in range(1, n):
        X[a] ^= X[a - 1]
    t, q = 0, top >> 1
    while q > 1:
        if X[n - 1] & q:
            t ^= q - 1
        q >>= 1
    for a in range(n):
        X[a] ^= t
