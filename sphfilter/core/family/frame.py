"""Frames: moments of a density by the nodes of its frame, and its polynomial in another."""

import math

import numpy as np

from .._jit import jit
from ..limits import LOG_2_PI
from ..small_matrices import eigen, product
from .basis import values_at


@jit
def inverse(A, out):
    """Inverse of A (n, n) by elimination; returns log |det A|, NaN if there is none."""
    n = A.shape[0]
    B, log_det = A.copy(), 0.0
    for a in range(n):
        for b in range(n):
            out[a, b] = 1.0 if a == b else 0.0
    for k in range(n):
        pivot = k
        for a in range(k + 1, n):
            pivot = a if abs(B[a, k]) > abs(B[pivot, k]) else pivot
        if not abs(B[pivot, k]) > 0.0:
            return np.nan
        log_det += math.log(abs(B[pivot, k]))
        for b in range(n):
            B[k, b], B[pivot, b] = B[pivot, b], B[k, b]
            out[k, b], out[pivot, b] = out[pivot, b], out[k, b]
        scale = 1.0 / B[k, k]
        for b in range(n):
            B[k, b] *= scale
            out[k, b] *= scale
        for a in range(n):
            if a != k:
                factor = B[a, k]
                for b in range(n):
                    B[a, b] -= factor * B[k, b]
                    out[a, b] -= factor * out[k, b]
    return log_det


@jit
def weigh(log_w, n, T, w):
    """Weights w (N,) of sum one for log-densities T (N,) at the nodes of n states, whose own are `log_w`.

    Returns the log of what they sum to.

    That is the integral over the frame's coordinates: with log |det A| it is that over the states.
    """
    N, highest = T.size, -np.inf
    for i in range(N):
        w[i] = T[i] + log_w[i]
        highest = max(highest, w[i])
    total = 0.0
    for i in range(N):
        w[i] = math.exp(w[i] - highest)
        total += w[i]
    for i in range(N):
        w[i] /= total
    return highest + math.log(total) + 0.5 * n * LOG_2_PI


@jit
def moved(b, C):
    """How far mean b and covariance C are from those of the frame: the largest of their differences."""
    n, off = b.size, 0.0
    for a in range(n):
        if not math.isfinite(b[a]):
            return np.inf
        off = max(off, abs(b[a]))
        for c in range(n):
            if not math.isfinite(C[a, c]):
                return np.inf
            off = max(off, abs(C[a, c] - (1.0 if a == c else 0.0)))
    return off


@jit
def root_between(C, low, high, out):
    """Symmetric root of a covariance (n, n), of eigenvalues between `low` and `high`."""
    n = C.shape[0]
    w, V = np.empty(n), np.empty((n, n))
    eigen(C.copy(), w, V)
    for a in range(n):
        for c in range(n):
            out[a, c] = 0.0
            for k in range(n):
                out[a, c] += V[a, k] * math.sqrt(min(max(w[k], low), high)) * V[c, k]


@jit
def reframed(basis, mu, A, c, b, root):
    """Put a family into the frame mu + A b, A root: exactly, as polynomials stay of their degree."""
    n = mu.size
    refitted(basis, c, b, root)
    step, own = np.empty(n), A.copy()
    for a in range(n):
        step[a] = 0.0
        for k in range(n):
            step[a] += own[a, k] * b[k]
    for a in range(n):
        mu[a] += step[a]
    product(own, root, 1.0, A)


@jit
def refitted(basis, c, b, root):
    """Put a polynomial into the frame of mean b and factor `root`, by its values at the nodes there."""
    N, n = basis.xi.shape
    points, values = np.empty((N, n)), np.empty(N)
    for i in range(N):
        for a in range(n):
            points[i, a] = b[a]
            for k in range(n):
                points[i, a] += root[a, k] * basis.xi[i, k]
    values_at(basis.power, c, points, np.inf, values)
    for j in range(c.size):
        c[j] = 0.0
        for i in range(N):
            c[j] += basis.F[i, j] * values[i]
