"""Weighted states, compiled: conditioning, moments, systematic resampling."""

import numpy as np
from numba import njit

from .._jit import jit

__all__ = ["condition", "group_moments", "resample", "weighted_moments"]


@jit
def condition(log_w, log_likelihood, w):
    """Add log-likelihoods to log-weights, in place, and normalise; `w` gets the weights.

    Parameters
    ----------
    log_w, log_likelihood, w : ndarray, shape (N,)

    Returns
    -------
    float
        Logarithm of the sum of weights times likelihoods; if not finite, nothing has been changed.
    """
    top = -np.inf
    for i in range(log_w.size):
        joint = log_w[i] + log_likelihood[i]
        top = joint if joint > top or joint != joint else top
    if not np.isfinite(top):
        return top
    total = 0.0
    for i in range(log_w.size):
        log_w[i] += log_likelihood[i]
        w[i] = np.exp(log_w[i] - top)
        total += w[i]
    log_sum = top + np.log(total)
    for i in range(log_w.size):
        log_w[i] -= log_sum
        w[i] /= total
    return log_sum


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "nsz", "contract"})
def weighted_moments(X, w, mean, cov):
    """Fill mean (n,) and covariance (n, n) of states X (N, n) with weights w (N,) that sum to one.

    Sums may be taken in any order, as vector instructions want it.
    """
    N, n = X.shape
    for a in range(n):
        s = 0.0
        for i in range(N):
            s += w[i] * X[i, a]
        mean[a] = s
    for a in range(n):
        for b in range(a + 1):
            s = 0.0
            for i in range(N):
                s += w[i] * (X[i, a] - mean[a]) * (X[i, b] - mean[b])
            cov[a, b] = cov[b, a] = s


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "nsz", "contract"})
def group_moments(X, w, own, mean, second, fourth):
    """Moments of states X (N, n) with weights w (N,), and of a group of them.

    `own` (N,) are the weights of the group, zero outside. Fills the means (2, n) of the group and of the
    others, and about the others' mean the second and fourth moments (2, n) along each axis; returns the
    group's weight.
    """
    N, n = X.shape
    part = 0.0
    for i in range(N):
        part += own[i]
    rest = 1.0 - part
    for a in range(n):
        first = other = 0.0
        for i in range(N):
            first += own[i] * X[i, a]
            other += (w[i] - own[i]) * X[i, a]
        mean[0, a], mean[1, a] = first / part, other / rest
        middle, s2, s4, r2, r4 = mean[1, a], 0.0, 0.0, 0.0, 0.0
        for i in range(N):
            square = (X[i, a] - middle) ** 2
            s2 += own[i] * square
            s4 += own[i] * square * square
            r2 += (w[i] - own[i]) * square
            r4 += (w[i] - own[i]) * square * square
        second[0, a], second[1, a] = s2 / part, r2 / rest
        fourth[0, a], fourth[1, a] = s4 / part, r4 / rest
    return part


@jit
def resample(X, w, u, out):
    """Fill `out` (N, n) by systematic resampling of X (N, n): one uniform u on [0, 1) shifts all N strata.

    As filterpy's routine, but without its list of indices; what rounding may have lost at the end of the
    weights goes to the last particle that has any.
    """
    N, n = X.shape
    last = N - 1
    while last > 0 and w[last] == 0.0:
        last -= 1
    j, cumulative = 0, w[0]
    for i in range(N):
        position = (i + u) / N
        while position >= cumulative and j < last:
            j += 1
            cumulative += w[j]
        for a in range(n):
            out[i, a] = X[j, a]
