"""Weighted states, compiled: conditioning, moments in blocks, systematic resampling."""

import numpy as np
from numba import njit

from sphfilter.core._jit import jit

#: States of a block.
LANES = 256
#: Sums may be taken in any order, as vector instructions want it.
ANY_ORDER = {"error_model": "numpy", "fastmath": {"reassoc", "nsz", "contract"}}


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


@jit
def ancestors(w, u, out):
    """Fill `out` (N,) with the numbers of the states that systematic resampling takes, in order.

    One uniform u on [0, 1) shifts all N strata: state j is taken at the places from N times the sum of the
    weights before it, less u, on. Places are counted and then summed, since a loop that looks for the end of
    a state mispredicts it at every one. What rounding may have lost at the end of the weights goes to the
    last state that has any.
    """
    N, last, total = w.size, w.size - 1, 0.0
    while last > 0 and w[last] == 0.0:
        last -= 1
    for i in range(N):
        out[i] = 0
    for j in range(last):
        total += w[j]
        place = int(np.ceil(N * total - u))
        if place < N:
            out[max(place, 0)] += 1
    for i in range(1, N):
        out[i] += out[i - 1]


@jit
def block_moments(x, start, w, out):
    """Fill weight, mean (n,), and weighted squares about it (n n,) of a block of states, with weights w (B,).

    The block are the B states of x (n, N) from number `start` on.
    """
    n, total, rows = x.shape[0], _sum(w), slice(start, start + w.size)
    out[:] = 0.0
    if not total > 0.0:
        return
    out[0] = total
    for a in range(n):
        out[1 + a] = _dot(w, x[a, rows]) / total
    for a in range(n):
        for b in range(a + 1):
            s = _product(w, x[a, rows], x[b, rows], out[1 + a], out[1 + b])
            out[1 + n + a * n + b] = out[1 + n + b * n + a] = s


@njit(**ANY_ORDER)
def _sum(w):
    s = 0.0
    for v in w:
        s += v
    return s


@njit(**ANY_ORDER)
def _dot(w, x):
    s = 0.0
    for i in range(w.size):
        s += w[i] * x[i]
    return s


@njit(**ANY_ORDER)
def _product(w, x, y, c, d):
    s = 0.0
    for i in range(w.size):
        s += w[i] * (x[i] - c) * (y[i] - d)
    return s


@jit
def merged(moments, mean, cov):
    """Fill mean (n,) and covariance (n, n) of all blocks from their moments (blocks, 1 + n + n²)."""
    n, total = mean.size, 0.0
    mean[:], cov[:] = 0.0, 0.0
    for b in range(moments.shape[0]):
        total += moments[b, 0]
    for b in range(moments.shape[0]):
        for a in range(n):
            mean[a] += moments[b, 0] / total * moments[b, 1 + a]
    for b in range(moments.shape[0]):
        for a in range(n):
            for c in range(n):
                off = (moments[b, 1 + a] - mean[a]) * (moments[b, 1 + c] - mean[c])
                cov[a, c] += (moments[b, 1 + n + a * n + c] + moments[b, 0] * off) / total


def moments_of(x, w):
    """Return mean (n,) and covariance (n, n) of states x (n, N) with weights w (N,)."""
    n = len(x)
    moments, mean, cov = np.empty((-(-w.size // LANES), 1 + n + n * n)), np.empty(n), np.empty((n, n))
    all_moments(x, w, moments)
    merged(moments, mean, cov)
    return mean, cov


@jit
def all_moments(x, w, moments):
    """Fill the moments (blocks, 1 + n + n²) of states x (n, N) with weights w (N,)."""
    for b in range(moments.shape[0]):
        start = b * LANES
        block_moments(x, start, w[start : min(start + LANES, w.size)], moments[b])


@njit(cache=True, **ANY_ORDER)
def linear_log_likelihood(x, H, z, constant, out):
    """Fill `out` (N,) with constant − |z − H x|² / 2 of states x (n, N), for z (k,) with unit noise."""
    out[:] = constant
    N = out.size
    for start in range(0, N, LANES):
        end = min(start + LANES, N)
        for k in range(z.size):
            left = np.full(LANES, z[k])
            for a in range(x.shape[0]):
                if H[k, a] != 0.0:
                    for i in range(start, end):
                        left[i - start] -= H[k, a] * x[a, i]
            for i in range(start, end):
                out[i] -= 0.5 * left[i - start] ** 2
