"""One polynomial through all nodes of a lattice, and its coefficients around each of them."""

import math

import numpy as np

from .._jit import jit
from ..small_matrices import extremes

_NODES_A_TERM = 2.5  # nodes there must be for each term


@jit
def value_at(x, sten, c, b):
    """Value of a polynomial of coefficients c at x, and all monomials b."""
    total = 0.0
    for p in range(b.size):
        b[p] = x[sten.axis[p]] * (1.0 if sten.parent[p] < 0 else b[sten.parent[p]])
        total += c[p] * b[p]
    return total


@jit
def recentred(c, x, sten, b, out):
    """Coefficients around x of a polynomial with coefficients c around the origin; its constant left out."""
    value_at(x, sten, c, b)
    for p in range(c.size):
        out[p] = c[p]
    for k in range(sten.binomial.size):
        out[sten.shift[k, 0]] += sten.binomial[k] * c[sten.shift[k, 1]] * b[sten.shift[k, 2]]


@jit
def trend(node, log_p, sten):
    """Coefficients (M,) of the polynomial through all nodes that fits best, weighted by the root of p.

    Its degree is the highest for which there are nodes enough. Empty where lattices do without.
    """
    N, M, terms = log_p.size, sten.parent.size, 0
    for degree in range(sten.trend.size):
        if _NODES_A_TERM * sten.trend[degree] <= N:
            terms = sten.trend[degree]
    if terms == 0:
        return np.empty(0)
    out, scale, highest = np.zeros(M), np.ones(M + 1), extremes(log_p)[1]
    b, K = np.empty(M), terms + 1
    A, right = np.zeros((K, K)), np.zeros(K)
    for i in range(N):
        value_at(node[i], sten, out, b)
        w = math.exp(0.5 * (log_p[i] - highest))
        for p in range(K):
            bp = w * (1.0 if p == 0 else b[p - 1])
            right[p] += bp * log_p[i]
            A[p, 0] += bp
            for q in range(1, p + 1):
                A[p, q] += bp * b[q - 1]
    for p in range(K):
        scale[p] = 1.0 / math.sqrt(A[p, p])
    for p in range(K):
        for q in range(p + 1):
            A[p, q] *= scale[p] * scale[q]
        A[p, p] += 1e-11
        for q in range(p + 1):
            for k in range(q):
                A[p, q] -= A[p, k] * A[q, k]
            A[p, q] = math.sqrt(max(A[p, p], 1e-15)) if p == q else A[p, q] / A[q, q]
    for p in range(K):
        right[p] *= scale[p]
        for q in range(p):
            right[p] -= A[p, q] * right[q]
        right[p] /= A[p, p]
    for p in range(K - 1, -1, -1):
        for q in range(p + 1, K):
            right[p] -= A[q, p] * right[q]
        right[p] /= A[p, p]
        if p > 0:
            out[p - 1] = right[p] * scale[p]
    return out
