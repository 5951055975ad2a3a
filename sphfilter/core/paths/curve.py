"""Points in the order of Hilbert's curve, on which those that are next to each other lie close together."""

import numpy as np

from .._jit import jit

__all__ = ["along_curve"]

#: Bits of a place on the curve, and standard deviations to either side that are told apart: as far as
#: outlying readings ask.
_BITS, _REACH = 16, 4.0


@jit
def along_curve(x, mean, white, place):
    """Fill the places (N,) of points x (N, n) on the curve, in coordinates white (x - mean)."""
    N, n = x.shape
    bits = max(_BITS // n, 1)
    top, X = 1 << bits, np.empty(n, np.int64)
    scale = 0.5 * top / _REACH
    for i in range(N):
        for a in range(n):
            z = 0.5 * top
            for b in range(a + 1):
                z += scale * white[a, b] * (x[i, b] - mean[b])
            X[a] = int(min(max(z, 0.0), top - 1.0))
        _transposed(X, top)
        found = 0
        for level in range(bits - 1, -1, -1):
            for a in range(n):
                found = (found << 1) | ((X[a] >> level) & 1)
        place[i] = found


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
