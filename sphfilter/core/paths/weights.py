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
def group_moments(X, w, first, mass, squares, mean, second, fourth):
    """Moments of two groups of states X (N, n) with weights w (N,): `first` ones (N,), and the others.

    Fills the sums of weights and of their squares (2,), the mean (n,) of the others, and about it the second
    and fourth moments (2, n) along each axis of the two.
    """
    N, n = X.shape
    mass[:] = 0.0
    squares[:] = 0.0
    for i in range(N):
        g = 0 if first[i] else 1
        mass[g] += w[i]
        squares[g] += w[i] * w[i]
    for g in range(2):
        squares[g] /= mass[g] ** 2
    for a in range(n):
        total = 0.0
        for i in range(N):
            total += 0.0 if first[i] else w[i] * X[i, a]
        mean[a] = total / mass[1]
        second[0, a] = second[1, a] = fourth[0, a] = fourth[1, a] = 0.0
        for i in range(N):
            g, square = 0 if first[i] else 1, (X[i, a] - mean[a]) ** 2
            second[g, a] += w[i] * square
            fourth[g, a] += w[i] * square * square
        for g in range(2):
            second[g, a] /= mass[g]
            fourth[g, a] /= mass[g]


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
