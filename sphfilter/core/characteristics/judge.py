"""What a step would get wrong, known before a lattice is laid for it.

On a few states that stand for the density after the step, log p by one step is compared with that by two
halves of it, which draw noise of their own: they differ by what the paths' quadrature and their bends miss.
"""

import math

import numpy as np
from numba import types

from .._addresses import Entry
from .._jit import MATRIX, VECTOR, jit
from ..field.field import FIELD, evaluate
from ..field.walls import fold, is_inside
from ..limits import GOLDEN, NOTHING
from .expectation import BACK, STEP, back_in_halves

_WITNESSES = 12  # of as many drawn at random a mean would be known to 1 / √12 = .29 of their deviation


@jit
def witnesses(m, ends, G, h):
    """States (M, n) that stand for a density after a step: ends of its nodes' paths, pushed by the noise.

    Nodes are taken evenly over the sum of the roots of their masses: tails are seen too.
    """
    N, n = ends.shape
    M = min(_WITNESSES, N)
    out, total, k, passed = np.empty((M, n)), 0.0, 0, 0.0
    for i in range(N):
        total += math.sqrt(m[i])
    for i in range(N):
        passed += math.sqrt(m[i])
        while k < M and passed >= (k + 0.5) / M * total * (1.0 - 1e-12):
            for a in range(n):
                out[k, a] = ends[i, a]
            for j in range(G.shape[1]):
                side = 2.0 * math.sqrt(3.0 * h) * (((k + 1) * (j + 1) * GOLDEN) % 1.0 - 0.5)
                for a in range(n):
                    out[k, a] += side * G[a, j]
            k += 1
    return out[:k]


@jit
def judged(back, step, around, m, ends):
    """Error of a step: the mean of |p / p' - 1| over states that stand for p', which is that of two halves.

    `back` is that of this name in `expectation`; `around` (n,) the state around which the response of the
    paths' ends to their noise is measured. Nodes of masses m (N,) go to `ends` (N, n) without noise.
    """
    if step.noise.G.shape[1] == 0:
        return 0.0
    Y = witnesses(m, ends, step.noise.G, step.h)
    fold(step.noise.low, step.noise.high, Y)
    once, twice = np.empty(Y.shape[0]), np.empty(Y.shape[0])
    back(step, Y, -np.inf, once)
    back_in_halves(step, around, Y, twice)
    return mean_ratio(once, twice)


@jit
def between(back, step, field, log_mass):
    """Residual of the lattice laid after a step: the mean of |p / p' - 1| over states in the middle of cells,
    p of its polynomials and p' asked anew.

    field : Field
        log p on the new lattice.
    log_mass : float
        Log of the integral by which it was normalised.
    """
    N, n = field.node.shape
    m, x = np.empty(N), np.empty((N, n))
    for i in range(N):
        m[i] = math.exp(field.log_p[i])
        for a in range(n):
            x[i, a] = field.mu[a]
            for c in range(n):
                side = 0.5 if (i >> c) % 2 else -0.5
                x[i, a] += field.A[a, c] * (field.node[i, c] + side)
    for i in range(N if step.noise.low.size > 0 else 0):
        if not is_inside(step.noise.low, step.noise.high, x[i]):
            m[i] = 0.0
    Y = witnesses(m, x, np.empty((n, 0)), 0.0)
    asked, fitted = np.empty(Y.shape[0]), np.empty(Y.shape[0])
    back(step, Y, -np.inf, asked)
    evaluate(field, step.sten, Y, fitted)
    for i in range(Y.shape[0]):
        asked[i] -= log_mass
    return mean_ratio(fitted, asked)


@jit
def mean_ratio(log_p, other):
    """Mean of |p / p' - 1|, at most one each, of values log_p (M,) and other (M,)."""
    error = 0.0
    for i in range(other.size):
        error += min(abs(math.expm1(min(log_p[i] - other[i], NOTHING))), 1.0)
    return error / max(other.size, 1) if math.isfinite(error) else np.inf


#: `judged` and `between` by their addresses.
JUDGE = Entry(judged, (BACK, STEP, VECTOR, VECTOR, MATRIX))
BETWEEN = Entry(between, (BACK, STEP, FIELD, types.float64))
