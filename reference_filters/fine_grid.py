"""A filter of one state on a fine grid: finite differences of order ten, Padé steps of order four."""

import math

import numpy as np
from scipy import sparse
from scipy.sparse import linalg

_ORDER = 10


def difference(order, size, spacing):
    """The matrix of a derivative of values on nodes, zero beyond them."""
    k = np.arange(-_ORDER // 2, _ORDER // 2 + 1)
    right = np.zeros(len(k))
    right[order] = math.factorial(order)
    weights = np.linalg.solve(np.vander(k.astype(float), increasing=True).T, right)
    bands = [np.full(size - abs(j), w) for j, w in zip(k, weights, strict=True)]
    return sparse.diags(bands, k) / spacing**order


def fine_grid_filter(drift, Q, log_likelihood, start, readings, dt, half=9.0, size=1801, step=0.004):
    """Mean, variance and log-evidence so far after every reading, shape (T, 3), readings dt seconds apart.

    start : tuple of float
        Mean and variance of a Gaussian.
    """
    x = np.linspace(-half, half, size)
    d, n = x[1] - x[0], math.ceil(dt / step)
    G = -difference(1, size, d) @ sparse.diags(drift(x)) + 0.5 * Q * difference(2, size, d)
    G = (G * dt / n).tocsc()
    one, square = sparse.identity(size, format="csc"), G @ G
    ahead, back = (one + G / 2 + square / 12).tocsc(), linalg.splu((one - G / 2 + square / 12).tocsc())
    p, told, log_evidence = np.exp(-0.5 * (x - start[0]) ** 2 / start[1]), [], 0.0
    p /= p.sum() * d
    for z in readings:
        for _ in range(n):
            p = back.solve(ahead @ p)
        p = np.maximum(p, 0.0) / (np.maximum(p, 0.0).sum() * d)
        weight = log_likelihood(z, x)
        p = p * np.exp(weight - weight.max())
        evidence = p.sum() * d
        p, log_evidence = p / evidence, log_evidence + np.log(evidence) + weight.max()
        mean = (p @ x) * d
        told.append((mean, (p @ (x - mean) ** 2) * d, log_evidence))
    return np.array(told)
