"""Gaussian kernels about weighted points: what each point sees of the others, and the sum of the kernels."""

import math

import numpy as np

from .._jit import jit
from ..limits import NOTHING


@jit
def seen(w, x, h, shift, cov, number):
    """What a Gaussian of standard deviation h about each point of x (N, n) sees of points of weights w (N,).

    Fill their means from its middle, shift (N, n), their cov (N, n, n) and effective number (N,).
    """
    N, n = x.shape
    d, shift[:], cov[:] = np.empty(n), 0.0, 0.0
    for k in range(N):
        total = squares = 0.0
        for j in range(N):
            r2 = 0.0
            for a in range(n):
                d[a] = x[j, a] - x[k, a]
                r2 += d[a] * d[a] / (h * h)
            if r2 < 2.0 * NOTHING:
                g = w[j] * math.exp(-0.5 * r2)
                total += g
                squares += g * g
                for a in range(n):
                    shift[k, a] += g * d[a]
                    for b in range(a + 1):
                        cov[k, a, b] += g * d[a] * d[b]
        number[k] = total * total / squares if squares > 0.0 else 1.0
        for a in range(n):
            shift[k, a] /= total
            for b in range(a + 1):
                cov[k, a, b] = cov[k, b, a] = cov[k, a, b] / total - shift[k, a] * shift[k, b]


@jit
def _terms(x, log_w, middle, P, q, t):
    """Fill t (n, K) with P x - middle at a point x (n,), and q (K,) with log_w - |t|² / 2."""
    n, K = middle.shape
    for j in range(K):
        q[j] = log_w[j]
    for a in range(n):
        for j in range(K):
            t[a, j] = -middle[a, j]
        for b in range(a + 1):
            for j in range(K):
                t[a, j] += P[a, b, j] * x[b]
        for j in range(K):
            q[j] -= 0.5 * t[a, j] * t[a, j]


@jit
def log_sum(X, log_w, middle, P, out):
    """Fill out (M,) with the logarithm of the sum of exp(log_w - |P x - middle|² / 2) at X (M, n), to 1e-6.

    log_w (K,), middle (n, K) and P (n, n, K), lower triangular, are of kernels. Vector instructions take the
    loops: maxima and sums go by halves, and exp is its series of degree four to the power of 64.
    """
    n, K = middle.shape
    q, t = np.empty(K), np.empty((n, K))
    for k in range(X.shape[0]):
        _terms(X[k], log_w, middle, P, q, t)
        largest, m = t[0], K
        for j in range(K):
            largest[j] = q[j]
        while m > 1:
            for j in range(m // 2):
                other = largest[j + (m + 1) // 2]
                largest[j] = largest[j] if largest[j] > other else other
            m = (m + 1) // 2
        top, m = largest[0], K
        for j in range(K):
            v = (top - q[j]) / 64.0
            v = v if v < 1.0 else 1.0
            e = 1.0 - v * (1.0 - v * (0.5 - v * (1.0 / 6.0 - v / 24.0)))
            e *= e
            e *= e
            e *= e
            e *= e
            e *= e
            q[j] = e * e
        while m > 1:
            for j in range(m // 2):
                q[j] += q[j + (m + 1) // 2]
            m = (m + 1) // 2
        out[k] = top + math.log(q[0])


@jit
def log_sum_gradient(X, log_w, middle, P, out):
    """Fill out (M, n) with the gradient of the sum whose logarithm `log_sum` gives."""
    n, K = middle.shape
    q, t = np.empty(K), np.empty((n, K))
    out[:] = 0.0
    for k in range(X.shape[0]):
        _terms(X[k], log_w, middle, P, q, t)
        for j in range(K):
            p = math.exp(q[j])
            for a in range(n):
                for b in range(a + 1):
                    out[k, b] -= p * t[a, j] * P[a, b, j]
