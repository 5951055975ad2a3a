"""Small dense matrices in compiled code, where a call to a library would cost more than the work; moments."""

import math

import numpy as np

from ._jit import jit
from .limits import LOG_2_PI


@jit
def moments(x, m, mean, cov):
    """Fill mean (n,) and covariance (n, n) of points x (N, n) of masses m (N,) of sum one."""
    N, n = x.shape
    for a in range(n):
        mean[a] = 0.0
        for i in range(N):
            mean[a] += m[i] * x[i, a]
    for a in range(n):
        for b in range(a + 1):
            c = 0.0
            for i in range(N):
                c += m[i] * (x[i, a] - mean[a]) * (x[i, b] - mean[b])
            cov[a, b] = cov[b, a] = c


@jit
def extremes(values):
    """Smallest and largest of some numbers."""
    low, high = values[0], values[0]
    for k in range(values.size):
        low, high = min(low, values[k]), max(high, values[k])
    return low, high


@jit
def cholesky(P, L):
    """Lower factor; semi-definite directions get a spread of 1e-12 of the largest. False if not finite."""
    n = P.shape[0]
    for a in range(n):
        for b in range(n):
            L[a, b] = 0.0
    for a in range(n):
        for b in range(a + 1):
            c = P[a, b]
            for k in range(b):
                c -= L[a, k] * L[b, k]
            if a == b:
                if not math.isfinite(c) or P[a, a] <= 0.0:
                    return False
                L[a, a] = math.sqrt(max(c, 1e-24 * P[a, a]))
            else:
                L[a, b] = c / L[b, b]
    return True


@jit
def whiten(L, v):
    """v <- L^-1 v."""
    for a in range(v.size):
        for b in range(a):
            v[a] -= L[a, b] * v[b]
        v[a] /= L[a, a]


@jit
def solve_factored(L, v):
    """v <- (L Lᵀ)^-1 v."""
    whiten(L, v)
    for a in range(v.size - 1, -1, -1):
        for b in range(a + 1, v.size):
            v[a] -= L[b, a] * v[b]
        v[a] /= L[a, a]


@jit
def log_peak(F):
    """Logarithm of N(0; 0, F Fᵀ), F (k, k) lower."""
    s = -0.5 * LOG_2_PI * len(F)
    for a in range(len(F)):
        s -= math.log(F[a, a])
    return s


@jit
def invert_lower(A):
    """Inverse of a lower triangular matrix."""
    n = A.shape[0]
    out = np.zeros((n, n))
    for c in range(n):
        for a in range(c, n):
            total = 1.0 if a == c else 0.0
            for b in range(c, a):
                total -= A[a, b] * out[b, c]
            out[a, c] = total / A[a, a]
    return out


@jit
def eigen(h, w, V):
    """Eigenvalues and vectors (columns) of a small symmetric matrix, by Jacobi's rotations; h is used up."""
    n = h.shape[0]
    for a in range(n):
        for b in range(n):
            V[a, b] = 1.0 if a == b else 0.0
    for _ in range(30):
        off, size = 0.0, 0.0
        for a in range(n):
            size += h[a, a] ** 2
            for b in range(a):
                off += h[a, b] ** 2
        if not off > 1e-30 * size:
            break
        for a in range(n):
            for b in range(a):
                if h[a, b] != 0.0:
                    _rotate(h, V, a, b)
    for a in range(n):
        w[a] = h[a, a]


@jit
def _rotate(h, V, a, b):
    """Make h[a, b] zero."""
    theta = 0.5 * (h[b, b] - h[a, a]) / h[a, b]
    t = (1.0 if theta >= 0.0 else -1.0) / (abs(theta) + math.sqrt(theta * theta + 1.0))
    c = 1.0 / math.sqrt(t * t + 1.0)
    s = t * c
    for k in range(h.shape[0]):
        x, y = h[k, a], h[k, b]
        h[k, a], h[k, b] = c * x - s * y, s * x + c * y
    for k in range(h.shape[0]):
        x, y = h[a, k], h[b, k]
        h[a, k], h[b, k] = c * x - s * y, s * x + c * y
        x, y = V[k, a], V[k, b]
        V[k, a], V[k, b] = c * x - s * y, s * x + c * y


@jit
def product(A, B, factor, out):
    """out = factor A B, all (n, n)."""
    n = A.shape[0]
    for a in range(n):
        for b in range(n):
            s = 0.0
            for c in range(n):
                s += A[a, c] * B[c, b]
            out[a, b] = factor * s


@jit
def add_squared(M, C, scratch, P):
    """P <- P + M C Mᵀ, all (n, n), to the bit symmetric if P is."""
    n = P.shape[0]
    product(M, C, 1.0, scratch)
    for a in range(n):
        for b in range(a + 1):
            s = 0.0
            for c in range(n):
                s += scratch[a, c] * M[b, c]
            P[a, b] += s
            P[b, a] = P[a, b]
