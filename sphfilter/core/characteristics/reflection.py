"""log p beyond a wall, for paths that have passed it: of a density that evolves without the wall.

No flux passes a wall at s = 0 while f p = D p' there. The density that keeps it so without a wall, the drift
going on smoothly, is the given one inside, and outside

    p(-s) = exp(-g(s)) (p(s) - int_0^s g'(r) p(r) exp(e(s) - e(r)) dr),

g and e the odd and even parts of Phi, Phi' = f / D: so the derivative of p exp(-Phi), times exp(g), is odd.
It holds for any p inside, whatever its slope at the wall, to the order s^5. What happens along the wall adds
a term of the order s^3 (`_turned`): log p has the slope f / D there, which changes as the density moves on.
Noise that moves a state along the wall as it crosses mirrors it obliquely.
"""

import math

import numpy as np

from .._jit import jit
from ..field.field import evaluate, gradient
from ..field.walls import fold, is_inside
from ..limits import NOTHING

_LEAST = 1e-2  # of p before the wall, that is left beyond it: log p falls by log(100) = 4.6 nats at most
_TURNED = 0.5  # nats at most, by what happens along a wall: exp(.5) = 1.6 times p


@jit
def reflected(step, t, Y, out):
    """Replace log p before a step, out (M,), at those of the states Y (M, n) at time t beyond walls."""
    low, high = step.noise.low, step.noise.high
    row, count = np.empty(Y.shape[0], np.int64), 0
    for i in range(Y.shape[0]):
        if not is_inside(low, high, Y[i]):
            row[count] = i
            count += 1
    X, log_p = np.empty((count, Y.shape[1])), np.zeros(count)
    for k in range(count):
        X[k] = Y[row[k]]
    for d in range(low.size if count > 0 else 0):
        _mirrored(step, t, d, low[d], 1.0, X, log_p)
        _mirrored(step, t, d, high[d], -1.0, X, log_p)
    fold(low, high, X)
    inside = np.empty(count)
    evaluate(step.field, step.sten, X, inside)
    for k in range(count):
        out[row[k]] = inside[k] + log_p[k]


@jit
def _mirrored(step, t, d, wall, side, X, log_p):
    """Mirror those of the states X (K, n) beyond one wall of axis d; add to log_p (K,) how p differs there.

    side: one if the inside is above the wall, minus one if below.
    """
    K, n = X.shape
    row, depth, count = np.empty(K, np.int64), np.empty(K), 0
    for k in range(K):
        if side * (X[k, d] - wall) < 0.0:
            row[count], depth[count] = k, side * (wall - X[k, d])
            count += 1
    if count == 0:
        return
    along, D = _conormal(step.noise.G, d)
    depth = depth[:count]
    at, f, p = np.empty((4 * count, n)), np.empty((4 * count, n)), np.empty(4 * count)
    for k in range(count):
        at[k] = X[row[k]]
    fold(step.noise.low, step.noise.high, at[:count])  # in a corner: beyond the other wall p is no guide
    for k in range(count):
        at[k, d] = X[row[k], d]
        for a in range(n):
            move = side * depth[k] * along[a]
            at[count + k, a] = at[k, a] + move
            at[2 * count + k, a] = at[k, a] + 1.5 * move
            at[3 * count + k, a] = at[k, a] + 2.0 * move
    step.drift(at, t, step.noise.p, f)
    evaluate(step.field, step.sten, at, p)
    turns = _turned(step, t, d, along, D, depth, at, f)
    for k in range(count):
        i, s, half, top = row[k], depth[k], 2 * count + k, 3 * count + k
        if D > 0.0:
            f0, f1, f2 = side * f[count + k, d] / D, side * f[top, d] / D, side * f[k, d] / D
            even, bent = 0.25 * (f1 - f2) * s, 0.5 * (f1 + f2) - f0
            ahead = f0 * math.exp(min(p[count + k] - p[top] + even, NOTHING))
            ahead += 4.0 * (f0 + 0.25 * bent) * math.exp(min(p[half] - p[top] + 0.75 * even, NOTHING))
            left = 1.0 - s / 6.0 * (ahead + f0 + bent)
            log_p[i] += math.log(max(left, _LEAST)) - s * (f0 + bent / 3.0)
            turn = side * turns[k] * s**3 / (3.0 * D) * math.exp(min(0.375 * f0 * s, 1.0))
            log_p[i] -= turn / (1.0 + abs(turn) / _TURNED)
        for a in range(n):
            X[i, a] += 2.0 * side * s * along[a]


@jit
def _turned(step, t, d, along, D, depth, at, f):
    """How fast the slope of log p that lets no flux pass a wall changes, for what happens along the wall.

    In coordinates in which noise crosses the wall straight. along, D: of `_conormal`; at, f: (4 K, n), states
    beyond the wall, on it, half and all as far before it, and the drift there. Returns the slope (K,) towards
    higher x_d, per second, of what moves with the tangential drift.
    """
    K, n, h, G = depth.size, at.shape[1], step.h, step.noise.G
    m, out = G.shape[1], np.zeros(depth.size)
    if D == 0.0:
        return out
    wall, later, slope, div = at[K : 2 * K], np.empty((K, n)), np.empty((K, n)), np.empty((4 * K, 1))
    step.drift(wall, t + h, step.noise.p, later)
    for k in range(K):
        out[k] = (later[k, d] - f[K + k, d]) / (h * D)
    if n == 1:
        return out
    gradient(step.field, step.sten, wall, slope)
    step.divergence(at, t, step.noise.p, div)
    move, unit = np.empty((K, n)), np.empty(n)
    ahead, behind = np.empty((K, n)), np.empty((K, n))
    for j in range(m + 1):  # along the drift, then along every noise
        for k in range(K):
            for a in range(n):
                move[k, a] = G[a, j - 1] * math.sqrt(h) if j > 0 else f[K + k, a] * h
            across = move[k, d]
            for a in range(n):
                move[k, a] -= across * along[a]
        step.drift(wall + move, t, step.noise.p, ahead)
        step.drift(wall - move, t, step.noise.p, behind)
        for k in range(K):
            first = (ahead[k, d] - behind[k, d]) / (2.0 * D * h)
            if j == 0:
                out[k] += first
                continue
            second = (ahead[k, d] + behind[k, d] - 2.0 * f[K + k, d]) / (2.0 * D * h)
            out[k] -= second + first * _directional(step.field, slope[k], move[k], unit)
    for k in range(K):
        s = at[3 * K + k, d] - wall[k, d]
        bent = (f[3 * K + k, d] + f[k, d] - 2.0 * f[K + k, d]) / s**2
        out[k] += (div[3 * K + k, 0] - div[k, 0]) / (2.0 * s) - bent
        across = f[3 * K + k, d] - f[k, d]
        for a in range(n):
            move[k, a] = (f[3 * K + k, a] - f[k, a] - across * along[a]) / (2.0 * s)
        out[k] += _directional(step.field, slope[k], move[k], unit)
    return out


@jit
def _directional(field, slope, move, unit):
    """Change of log p along a move (n,), of its slope (n,) in units of the lattice."""
    total = 0.0
    for a in range(unit.size):
        unit[a] = 0.0
        for c in range(unit.size):
            unit[a] += field.inverse[a, c] * move[c]
        total += slope[a] * unit[a]
    return total


@jit
def _conormal(G, d):
    """Direction (n,) in which noise crosses a wall of axis d, one along that axis; and D there."""
    n, m = G.shape
    along, variance = np.zeros(n), 0.0
    for k in range(m):
        variance += G[d, k] ** 2
        for a in range(n):
            along[a] += G[a, k] * G[d, k]
    for a in range(n):
        along[a] = along[a] / variance if variance > 0.0 else 0.0
    along[d] = 1.0
    return along, 0.5 * variance
