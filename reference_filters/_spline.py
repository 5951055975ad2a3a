"""Quintic B-splines on regular grids of one and two dimensions; their coefficients come by Fourier."""

import numpy as np

from sphfilter.core._jit import jit


def spline_symbol(k):
    """Fourier symbol of the quintic B-spline sampled at the nodes (66, 26, 1 over 120), k in radians a node.

    Values divided by it in Fourier space are the coefficients that interpolate them (Unser 1999).
    """
    return (66.0 + 52.0 * np.cos(k) + 2.0 * np.cos(2 * k)) / 120.0


def evaluate_spline(coefficients, X, to_index, origin):
    """Spline at states X, whose fractional node indices are to_index @ x + origin; zero outside the grid.

    Parameters
    ----------
    coefficients : ndarray, shape (M,) or (M, M)
    X : ndarray, shape (N, n)
    to_index, origin : ndarray, shapes (n, n), (n,)

    Returns
    -------
    ndarray, shape (N,)
    """
    out = np.empty(len(X))
    kernel = _evaluate_1d if coefficients.ndim == 1 else _evaluate_2d
    kernel(coefficients, np.ascontiguousarray(X), to_index, origin, out)
    return out


def spline_weights(u):
    """Values of the six splines around positions u (N,) of [0, 1) between two nodes, shape (N, 6)."""
    out = np.empty((len(u), 6))
    _fill_weights(np.ascontiguousarray(u), out)
    return out


@jit
def _fill_weights(u, out):
    for i in range(u.size):
        _weights(u[i], out[i])


@jit
def _weights(u, w):
    """Six values of the quintic B-spline at distances u+2, u+1, u, 1-u, 2-u, 3-u, for u in [0, 1)."""
    for side in range(2):
        q = u if side == 0 else 1.0 - u
        q2 = q * q
        inner = (66.0 + q2 * (-60.0 + q2 * (30.0 - 10.0 * q))) / 120.0
        r = 1.0 + q
        middle = (51.0 + r * (75.0 + r * (-210.0 + r * (150.0 + r * (-45.0 + 5.0 * r))))) / 120.0
        outer = (1.0 - q) ** 5 / 120.0
        if side == 0:
            w[2], w[1], w[0] = inner, middle, outer
        else:
            w[3], w[4], w[5] = inner, middle, outer


@jit
def _evaluate_1d(c, X, to_index, origin, out):
    M = c.size
    w = np.empty(6)
    for i in range(out.size):
        a = to_index[0, 0] * X[i, 0] + origin[0]
        if not 0.0 <= a <= M - 1.0:
            out[i] = 0.0
            continue
        ia = int(a)
        _weights(a - ia, w)
        total = 0.0
        for r in range(6):
            total += w[r] * c[(ia + r - 2) % M]
        out[i] = total


@jit
def _evaluate_2d(c, X, to_index, origin, out):
    M0, M1 = c.shape
    wa, wb = np.empty(6), np.empty(6)
    column = np.empty(6, dtype=np.int64)
    for i in range(out.size):
        a = to_index[0, 0] * X[i, 0] + to_index[0, 1] * X[i, 1] + origin[0]
        b = to_index[1, 0] * X[i, 0] + to_index[1, 1] * X[i, 1] + origin[1]
        if not (0.0 <= a <= M0 - 1.0 and 0.0 <= b <= M1 - 1.0):
            out[i] = 0.0
            continue
        ia, ib = int(a), int(b)
        _weights(a - ia, wa)
        _weights(b - ib, wb)
        for q in range(6):
            column[q] = (ib + q - 2) % M1
        total = 0.0
        for r in range(6):
            row = (ia + r - 2) % M0
            line = 0.0
            for q in range(6):
                line += wb[q] * c[row, column[q]]
            total += wa[r] * line
        out[i] = total
