"""Weighted points: moments, effective numbers, systematic resampling."""

import numpy as np
from numba import njit

from .._jit import jit
from ..small_matrices import cholesky, whiten

__all__ = ["carried", "compared", "effective", "finite_rows", "normalise", "systematic", "weighted_moments"]


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


@jit
def compared(mean, cov, other, own):
    """Squared errors that two clouds show of a mean (n,) and a covariance (n, n), in units of the first's.

    Of the mean on average over the states, in standard deviations; of the covariance relative, over n.
    """
    n = mean.size
    L, off, wider = np.empty((n, n)), np.empty(n), np.empty((n, n))
    if not cholesky(cov, L):
        return np.nan, np.nan
    for a in range(n):
        off[a] = other[a] - mean[a]
        for b in range(n):
            wider[b, a] = own[a, b] - cov[a, b]
    whiten(L, off)
    for a in range(n):
        whiten(L, wider[a])
    wider = wider.T.copy()
    first = second = 0.0
    for a in range(n):
        whiten(L, wider[a])
        first += off[a] * off[a] / n
        for b in range(n):
            second += wider[a, b] * wider[a, b] / n
    return first, second


@jit
def finite_rows(x):
    """Which rows of x (N, n) are numbers, (N,), and whether all are."""
    N, n = x.shape
    fine, every = np.ones(N, np.bool_), True
    for i in range(N):
        for a in range(n):
            if not abs(x[i, a]) < np.inf:
                fine[i] = every = False
    return fine, every


@jit
def carried(x, w, family, count):
    """Squares of what families, (N,) of numbers below `count`, add: of their weights, and to the mean.

    The latter over the variances of one point, on average over the states.

    Parameters
    ----------
    x, w, family : ndarray, shapes (N, n), (N,), (N,)

    Returns
    -------
    float, float
        NaN where a covariance is none.
    """
    N, n = x.shape
    mean, cov, L = np.empty(n), np.empty((n, n)), np.empty((n, n))
    weighted_moments(x, w, mean, cov)
    added, squares, part = np.zeros((count, n + 1)), 0.0, 0.0
    for i in range(N):
        f = family[i]
        added[f, n] += w[i]
        for a in range(n):
            added[f, a] += w[i] * (x[i, a] - mean[a])
    for f in range(count):
        squares += added[f, n] * added[f, n]
    if not cholesky(cov, L):
        return squares, np.nan
    v = np.empty(n)
    for f in range(count):
        for a in range(n):
            v[a] = added[f, a]
        whiten(L, v)
        for a in range(n):
            part += v[a] * v[a] / n
    return squares, part


@jit
def effective(w):
    """Effective number of points of weights (N,), (Σ w)² / Σ w²."""
    total = squares = 0.0
    for i in range(w.size):
        total += w[i]
        squares += w[i] * w[i]
    return total * total / squares if squares > 0.0 else 0.0


@jit
def normalise(log_w, w):
    """Fill weights w (N,) of sum one from their logarithms; return the logarithm of what the sum was.

    Without a weight above zero the sum's logarithm is -inf, and the weights are nothing.
    """
    top = -np.inf
    for i in range(log_w.size):
        if log_w[i] > top:
            top = log_w[i]
    if not np.isfinite(top):
        return -np.inf
    total = 0.0
    for i in range(log_w.size):
        w[i] = np.exp(log_w[i] - top) if log_w[i] > -np.inf else 0.0
        total += w[i]
    for i in range(log_w.size):
        w[i] /= total
    return top + np.log(total)


@jit
def systematic(w, count, shift):
    """Numbers (count,) of points of weights w (N,), each as often as its weight says but for rounding.

    One shift on [0, 1) moves all strata; what rounding may have lost at the end of the weights goes to the
    last point that has any.
    """
    N, last = w.size, w.size - 1
    while last > 0 and w[last] == 0.0:
        last -= 1
    total = 0.0
    for i in range(N):
        total += w[i]
    out, j, passed = np.empty(count, np.int64), 0, w[0]
    for i in range(count):
        position = (i + shift) / count * total
        while position >= passed and j < last:
            j += 1
            passed += w[j]
        out[i] = j
    return out
