"""Smoothing on a grid of one or two states, by the matrix of the FPK equation and by its transpose."""

from functools import reduce

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import expm_multiply

from reference_filters.fine_grid import difference

__all__ = ["smoothed_by_matrix"]


def _along(axis, order, axes):
    """The derivative along one axis, for values on all nodes."""
    parts = [sparse.identity(len(x)) for x in axes]
    parts[axis] = difference(order, len(axes[axis]), axes[axis][1] - axes[axis][0])
    return reduce(sparse.kron, parts)


def _matrix(drift, diffusion, axes, X):
    f, D, n = drift(X), diffusion(X), len(axes)
    L = sum(-_along(a, 1, axes) @ sparse.diags(f[:, a]) for a in range(n))
    for a in range(n):
        L = L + _along(a, 2, axes) @ sparse.diags(D[:, a, a])
        for b in range(a):
            if D[:, a, b].any():
                L = L + 2.0 * _along(a, 1, axes) @ _along(b, 1, axes) @ sparse.diags(D[:, a, b])
    return L.tocsc()


def smoothed_by_matrix(drift, diffusion, axes, start, log_likelihood, times, readings):
    """Means (T, n), covariances (T, n, n) and log-evidence; nothing may depend on time.

    drift, diffusion : callables of states (N, n) that return (N, n), and D (N, n, n), of Itô
    axes : nodes of each state
    start : mean (n,) and covariance (n, n) of a Gaussian
    log_likelihood : callable of a reading and states (N, n)
    """
    X = np.stack([x.ravel() for x in np.meshgrid(*axes, indexing="ij")], axis=1)
    L, off = _matrix(drift, diffusion, axes, X), X - start[0]
    p = np.exp(-0.5 * np.sum(off @ np.linalg.inv(start[1]) * off, 1))
    log_evidence, before, filtered = 0.0, 0.0, []
    weights = [np.exp(log_likelihood(z, X)) for z in readings]
    p /= p.sum()
    for t, weight in zip(times, weights, strict=True):
        p, before = expm_multiply(L * (t - before), p) * weight, t
        log_evidence += np.log(p.sum())
        p /= p.sum()
        filtered.append(p)
    beta, x, P = np.ones(len(X)), [], []
    for k in range(len(times) - 1, -1, -1):
        p = filtered[k] * beta / (filtered[k] @ beta)
        x.append(p @ X)
        P.append((X - x[-1]).T @ (p[:, None] * (X - x[-1])))
        if k:
            beta = expm_multiply(L.T * (times[k] - times[k - 1]), beta * weights[k])
            beta /= beta.max()
    return np.array(x[::-1]), np.array(P[::-1]), log_evidence
