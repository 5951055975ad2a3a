"""Gaussians and a linear reading of them, all in one call."""

import math

import numpy as np

from ._jit import jit
from .small_matrices import add_squared, cholesky, log_peak, whiten
from .sums import dot


@jit
def log_normal(off, S):
    """Logarithm of N(off; 0, S), off (k,) and S (k, k), and the distance of zero in standard deviations.

    The logarithm is NaN where S has no root.
    """
    y, F = off.copy(), np.empty(S.shape)
    if not cholesky(S, F):
        return np.nan, 0.0
    whiten(F, y)
    squares = dot(y, y)
    return log_peak(F) - 0.5 * squares, math.sqrt(squares)


@jit
def conditioned(mean, cov, off, H, R):
    """Gaussians after a reading of H x (k, n) with a noise of covariance R (k, k): Kalman's rule.

    Before it they have means (K, n) and covariances (K, n, n); what was read is off (K, k) from what each
    would read. Components of the reading, made independent, come one after the other: covariances stay
    definite however sharp a sensor is, and however alike its components. Returns means and covariances, and
    log-densities (K,) of the reading, NaN where R has no root.
    """
    x, P, off, h = mean.copy(), cov.copy(), off.copy(), H.T.copy()
    (K, n), k = mean.shape, len(R)
    log_p, F, room = np.empty(K), np.empty((k, k)), (np.empty(n), np.empty((3, n, n)))
    peak = log_peak(F) if cholesky(R, F) else np.nan
    for b in range(n):
        whiten(F, h[b])
    for j in range(K):
        whiten(F, off[j])
        log_p[j] = peak
        for c in range(k):
            log_p[j] += _read(x[j], P[j], off[j], h, c, room)
    return x, P, log_p


@jit
def _read(x, P, off, h, c, room):
    """Change a Gaussian's mean (n,) and covariance (n, n) by component c of a reading, whose noise is one.

    What is off (k,) of later components of h (n, k) changes with it. Returns the logarithm of the density of
    the component, but for a constant. The covariance is Joseph's.
    """
    gain, (rest, before, half) = room
    s, n, d = 1.0, x.size, off[c]
    for a in range(n):
        gain[a] = 0.0
        for b in range(n):
            gain[a] += P[a, b] * h[b, c]
        s += h[a, c] * gain[a]
    for a in range(n):
        gain[a] /= s
        x[a] += gain[a] * d
        for e in range(c + 1, off.size):
            off[e] -= h[a, e] * gain[a] * d
    for a in range(n):
        for b in range(n):
            rest[a, b] = (1.0 if a == b else 0.0) - gain[a] * h[b, c]
            before[a, b], P[a, b] = P[a, b], gain[a] * gain[b]
    add_squared(rest, before, half, P)
    return -0.5 * (d * d / s + math.log(s))
