"""Gaussians and a linear reading of them, all in one call."""

import math

import numpy as np

from ._jit import jit
from .limits import LOG_2_PI
from .small_matrices import cholesky, solve_factored, whiten


@jit
def log_normal(off, S):
    """Logarithm of N(off; 0, S), off (k,) and S (k, k), and the distance of zero in standard deviations.

    The logarithm is NaN where S has no root.
    """
    y, F = off.copy(), np.empty(S.shape)
    if not cholesky(S, F):
        return np.nan, 0.0
    whiten(F, y)
    squares, log_peak = 0.0, -0.5 * LOG_2_PI * y.size
    for a in range(y.size):
        squares += y[a] * y[a]
        log_peak -= math.log(F[a, a])
    return log_peak - 0.5 * squares, math.sqrt(squares)


@jit
def conditioned(mean, cov, off, H, R):
    """Gaussians after a reading of H x (k, n) with a noise of covariance R (k, k): Kalman's rule.

    Before it they have means (K, n) and covariances (K, n, n); what was read is off (K, k) from what each
    would read. Covariances are Joseph's, which stay definite however sharp the sensor. Returns means and
    covariances, and log-densities (K,) of the reading, NaN of a Gaussian that has no such.
    """
    (K, n), k = mean.shape, len(R)
    x, P, log_p = mean.copy(), np.zeros(cov.shape), np.empty(K)
    S, F, gain = np.empty((k, k)), np.empty((k, k)), np.empty((n, k))
    rest, half = np.empty((n, n)), np.empty((n, n))
    for j in range(K):
        for a in range(n):
            for c in range(k):
                gain[a, c] = 0.0
                for b in range(n):
                    gain[a, c] += cov[j, a, b] * H[c, b]
        for c in range(k):
            for d in range(k):
                S[c, d] = R[c, d]
                for a in range(n):
                    S[c, d] += H[c, a] * gain[a, d]
        log_p[j] = log_normal(off[j], S)[0]
        if not cholesky(S, F):
            continue
        for a in range(n):
            solve_factored(F, gain[a])
            for c in range(k):
                x[j, a] += gain[a, c] * off[j, c]
        for a in range(n):
            for b in range(n):
                rest[a, b] = 1.0 if a == b else 0.0
                for c in range(k):
                    rest[a, b] -= gain[a, c] * H[c, b]
        _add_squared(rest, cov[j], half, P[j])
        _add_squared(gain, R, np.empty((n, k)), P[j])
    return x, P, log_p


@jit
def _add_squared(A, C, half, P):
    """P <- P + A C Aᵀ, A (n, m) and C (m, m), to the bit symmetric; half (n, m) is scratch."""
    n, m = A.shape
    for a in range(n):
        for c in range(m):
            half[a, c] = 0.0
            for b in range(m):
                half[a, c] += A[a, b] * C[b, c]
        for e in range(a + 1):
            s = 0.0
            for c in range(m):
                s += half[a, c] * A[e, c]
            P[a, e] += s
            P[e, a] = P[a, e]
