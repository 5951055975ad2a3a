"""Filters on fine grids that end at walls: finite volumes, no flux through the ends, exact in time."""

import math

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import expm_multiply

__all__ = ["walled_grid_filter"]


def _generator(drift, D, middles, widths):
    """Generator of the masses of cells: central fluxes between neighbours, none through the grid's ends."""
    shape = tuple(len(m) for m in middles)
    X = np.stack([g.ravel() for g in np.meshgrid(*middles, indexing="ij")], axis=1)
    number, rows, columns, rates = np.arange(len(X)).reshape(shape), [], [], []
    for a, (d, dx) in enumerate(zip(D, widths, strict=True)):
        left = np.delete(number, -1, axis=a).ravel()
        right = np.delete(number, 0, axis=a).ravel()
        half = 0.5 * drift(0.5 * (X[left] + X[right]))[:, a]
        for cell, sign in ((left, -1.0), (right, 1.0)):
            rows += [cell, cell]
            columns += [left, right]
            rates += [sign * (half + d / dx) / dx, sign * (half - d / dx) / dx]
    rows, columns, rates = (np.concatenate(part) for part in (rows, columns, rates))
    return sparse.csr_matrix((rates, (rows, columns)), shape=(len(X), len(X))), X


def walled_grid_filter(drift, D, ends, cells, start, log_likelihood, readings, dt):
    """Mean, variances and log-evidence so far after every reading, shape (T, 2 n + 1), dt seconds apart.

    Parameters
    ----------
    drift : callable
        States (M, n) to velocities (M, n).
    D : sequence of float, length n
        Half the noise's intensity along each axis.
    ends : sequence of tuple, length n
        Where the grid ends: at walls, or where no density is.
    cells : sequence of int, length n
    start : tuple
        Mean (n,) and covariance (n, n) of the Gaussian that the grid cuts.
    log_likelihood : callable
        A reading and states (M, n) to (M,).
    """
    edges = [np.linspace(*end, count + 1) for end, count in zip(ends, cells, strict=True)]
    middles, widths = [0.5 * (e[1:] + e[:-1]) for e in edges], [e[1] - e[0] for e in edges]
    A, X = _generator(drift, D, middles, widths)
    off = X - np.asarray(start[0])
    p = np.exp(-0.5 * np.einsum("ia,ab,ib->i", off, np.linalg.inv(start[1]), off))
    p, told, log_evidence = p / p.sum(), [], 0.0
    for z in readings:
        p = np.maximum(expm_multiply(A * dt, p), 0.0)
        weight = log_likelihood(z, X)
        w = p / p.sum() * np.exp(weight - weight.max())
        log_evidence += math.log(w.sum()) + weight.max()
        p = w / w.sum()
        mean = p @ X
        told.append([*mean, *(p @ (X - mean) ** 2), log_evidence])
    return np.array(told)
