"""Points of a model in discrete time: a step is one call of its map of state and noise.

Letters: x (K, n) points, w = L ξ noise of a step, L Lᵀ = Q. The leg's `drift` is the address of the map
(x, w) → x', and its `jacobian` that of ∂x'/∂(x, w). Noise is normal, as a map may make of it what it likes.
"""

import numpy as np
from numba import types

from .._addresses import Entry, function_at
from .._jit import MATRIX, VECTOR, jit
from .linearise import backwards
from .steps import CUBE, LEG


@jit
def mapped(leg, x, Z, odd, room):
    """Walk by the map of a model in discrete time."""
    (K, n), m = x.shape, leg.root.shape[0]
    given, step = np.empty((K, n + m)), function_at(leg.drift)
    for s in range(leg.steps):
        for i in range(K):
            for a in range(n):
                given[i, a] = x[i, a]
            for k in range(m):
                given[i, n + k] = 0.0
                for r in range(m):
                    given[i, n + k] += leg.root[k, r] * Z[0, s * m + r, i]
        step(given, leg.t + s * leg.h, leg.p, x)


@jit
def linearise_map(leg, c):
    """Move centres c (blocks, n) to the end of a leg, and return Φ and B, as `linearise` does."""
    (nb, n), m = c.shape, leg.root.shape[0]
    given, J = np.zeros((nb, n + m)), np.empty((nb, n * (n + m)))
    M, A = np.empty((leg.steps, nb, n, n)), np.zeros((leg.steps, nb, n, m))
    for s in range(leg.steps):
        t = leg.t + s * leg.h
        given[:, :n] = c
        function_at(leg.jacobian)(given, t, leg.p, J)
        function_at(leg.drift)(given, t, leg.p, c)
        for b in range(nb):
            for a in range(n):
                row = J[b, a * (n + m) : (a + 1) * (n + m)]
                M[s, b, a] = row[:n]
                for k in range(m):
                    for r in range(m):
                        A[s, b, a, k] += row[n + r] * leg.root[r, k]
    return backwards(M, A)


MAPPED = Entry(mapped, (LEG, MATRIX, CUBE, types.boolean, VECTOR), types.void)
LINEARISE_MAP = Entry(linearise_map, (LEG, MATRIX), types.UniTuple(CUBE, 2))
