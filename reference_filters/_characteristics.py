"""Characteristics of a drift through many states: the feet of semi-Lagrangian steps."""

from functools import cache

import numpy as np
from numba import types

from sphfilter.core._addresses import ADDRESS, address_of, function_at
from sphfilter.core._jit import jit_for
from sphfilter.model.compile import surfacing

#: States moved together; their stages fit the first-level cache.
_BLOCK = 256


def _follow(X, dilation, span, p, addresses):
    """Move X (N, n) in place from t over dt by one step of classical Runge-Kutta, with ∫ ∇·f dt beside it."""
    (t, dt), n = span, X.shape[1]
    drift, divergence = function_at(addresses[0]), function_at(addresses[1])
    f, stage, rate = np.empty((_BLOCK, n)), np.empty((_BLOCK, n)), np.empty((_BLOCK, 1))
    F, S, total, r = f.reshape(-1), stage.reshape(-1), np.empty(_BLOCK * n), rate.reshape(-1)
    for begin in range(0, X.shape[0], _BLOCK):
        N = min(_BLOCK, X.shape[0] - begin)
        x, grown = X[begin : begin + N].reshape(-1), dilation[begin : begin + N]
        S[: N * n] = x
        total[:], grown[:] = 0.0, 0.0
        for k in range(4):
            weight = 1.0 if k in (0, 3) else 2.0
            now = t + dt * (0.0 if k == 0 else 1.0 if k == 3 else 0.5)
            drift(stage[:N], now, p, f[:N])
            divergence(stage[:N], now, p, rate[:N])
            ahead = dt if k == 2 else 0.5 * dt
            for i in range(N):
                grown[i] += weight * dt / 6.0 * r[i]
            for i in range(N * n):
                total[i] += weight * F[i]
                S[i] = x[i] + ahead * F[i]
        for i in range(N * n):
            x[i] += dt / 6.0 * total[i]


@cache
def _compiled_follow():
    """`_follow` for any model: compiled (or loaded from the disk cache) at first use."""
    matrix, vector = types.float64[:, ::1], types.float64[::1]
    pair, functions = types.UniTuple(types.float64, 2), types.UniTuple(ADDRESS, 2)
    return jit_for(types.void(matrix, vector, pair, vector, functions), _follow)


def follow(model, X, t, dt):
    """States X (N, n) after dt (negative: before) along the drift, by one Runge-Kutta step of order 4.

    Returns
    -------
    feet : ndarray, shape (N, n)
    dilation : ndarray, shape (N,)
        ∫ ∇·f dt along the way. Neither is finite where the way leads to infinity.
    """
    feet, dilation = np.array(X, dtype=float, order="C"), np.empty(len(X))
    addresses = address_of(model.drift_batch), address_of(model.divergence_batch)
    with surfacing():
        _compiled_follow()(feet, dilation, (float(t), float(dt)), model.p, addresses)
    return feet, dilation
