"""The shape of a density within its pieces, from the slopes of its polynomials."""

import math

import numpy as np

from .._jit import jit
from ..limits import ALIKE, TINY
from ..small_matrices import cholesky, eigen, invert_lower


@jit
def nodes_of(field):
    """States (N, n) and masses of a field's nodes."""
    N, n = field.node.shape
    x, m, total = np.empty((N, n)), np.empty(N), 0.0
    for i in range(N):
        m[i] = math.exp(field.log_p[i])
        total += m[i]
        for a in range(n):
            x[i, a] = field.mu[a]
            for c in range(n):
                x[i, a] += field.A[a, c] * field.node[i, c]
    for i in range(N):
        m[i] /= total
    return x, m


@jit
def local_shape(field, m, L, Q):
    """Lower Q with which L Q whitens the density piece by piece, where L whitens it as a whole.

    (L Q)(L Q)^T is the inverse of the Fisher information E[grad log p (grad log p)^T]: the covariance of a
    Gaussian, and that within the pieces of a density in several, or across a bent one. Q is the identity
    unless the two differ by much.
    """
    n = L.shape[0]
    info, R, B = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    w, V, total = np.empty(n), np.empty((n, n)), 0.0
    for i in range(m.size):
        known = False
        for a in range(n):
            known |= field.coefficient[i, a] != 0.0
        if known:  # nodes at the rim have no polynomial
            total += m[i]
            for a in range(n):
                for b in range(n):
                    info[a, b] += m[i] * field.coefficient[i, a] * field.coefficient[i, b]
    inverse = invert_lower(L)
    for a in range(n):
        for b in range(n):
            info[a, b] /= total
            for k in range(n):
                B[a, b] += inverse[a, k] * field.A[k, b]
    eigen(info, w, V)
    for k in range(n):  # R = B info^-1 B^T
        for a in range(n):
            v = 0.0
            for b in range(n):
                v += B[a, b] * V[b, k]
            info[a, k] = v / math.sqrt(max(w[k], TINY))
    for a in range(n):
        for b in range(n):
            for k in range(n):
                R[a, b] += info[a, k] * info[b, k]
            Q[a, b] = 1.0 if a == b else 0.0
    for a in range(n):
        for b in range(n):
            B[a, b] = R[a, b]
    eigen(B, w, V)
    smallest = w[0]
    for k in range(n):
        smallest = min(smallest, w[k])
    if 0.0 < smallest < ALIKE:  # else lattices need not follow the pieces
        cholesky(R, Q)
