"""Points in the order of Hilbert's curve, where neighbours lie close together; and points spread evenly."""

from functools import cache

import numpy as np

from .._jit import jit

__all__ = ["along_curve", "fill_places", "look_up", "spread"]

#: Bits of a place on the curve, and standard deviations to either side that are told apart: as far as
#: outlying readings ask.
_BITS, _REACH = 16, 4.0
_LEAST = 1e-12  # distance of points from the ends of the unit cube


def along_curve(x, mean, white):
    """Places (N,) of points x (N, n) on the curve, in coordinates white (x - mean)."""
    place = np.empty(len(x), np.uint16)
    look_up(x, mean, white, _places(x.shape[1]), place)
    return place


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


@cache
def _places(n):
    """Places of all cells of n states on the curve, by number."""
    bits = max(_BITS // n, 1)
    table = np.empty((1 << bits) ** n, np.uint16)
    fill_places(bits, n, table)
    return table


@jit
def look_up(x, mean, white, table, place):
    """Fill the places (N,) of points x (N, n) from a table of the cells' places."""
    N, n = x.shape
    top = 1 << max(_BITS // n, 1)
    scale = 0.5 * top / _REACH
    for i in range(N):
        cell = 0
        for a in range(n):
            z = 0.5 * top
            for b in range(a + 1):
                z += scale * white[a, b] * (x[i, b] - mean[b])
            cell = cell * top + int(min(max(z, 0.0), top - 1.0))
        place[i] = table[cell]


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
