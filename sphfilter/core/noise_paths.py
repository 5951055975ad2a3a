"""log p after a step: the expectation over weighted paths of the noise, back to where log p is known.

Each path is a solution of an ordinary equation, displaced on its way by a straight and a bent part of the
noise. Where the paths end is known to first order, and log p there to second: the paths are aimed at where
they find the density, so that a Gaussian and linear paths give the expectation exactly, whatever the step.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba import prange

from ._jit import jit, parallel_jit
from .cells import LOWEST
from .field import Field, evaluate, slopes
from .small_matrices import cholesky, eigen, invert_lower
from .stencils import Stencils

__all__ = [
    "Aim",
    "Noise",
    "Paths",
    "Step",
    "aimed",
    "along",
    "back",
    "back_in_blocks",
    "displace",
    "noise_factor_at",
    "pushes",
]

_SURE = 1.0  # nats below the last level kept, from which one path will do
_FAR = 6.0  # standard deviations of the noise
_BLOCK = 256  # states that one thread takes at a time


class Noise(NamedTuple):
    """D = G G^T / 2 per second; asked of the model at mid-step where it depends on time."""

    G: np.ndarray  # (n, m)
    p: np.ndarray  # parameters of the model
    time_dependent: bool
    constant_divergence: bool


class Paths(NamedTuple):
    """Weighted paths of the noise over a step of length one: straight to dW, bent to enclose the area."""

    log_weight: np.ndarray  # (Q,)
    w: np.ndarray  # (Q, 2 m): dW, then bends


class Aim(NamedTuple):
    """Noise of a path back given where it starts: exact for Gaussian densities, linear paths."""

    B: np.ndarray  # (n, 2 m) response of a path's end to its noise, in units of the lattice
    root: np.ndarray  # (N, 2 m, 2 m) lower; its transpose times standard normals has the Gaussian's spread
    log_det: np.ndarray  # (N,)


class Step(NamedTuple):
    """What log p after a step of length h, to t1, is computed from."""

    drift: Callable
    divergence: Callable
    noise: Noise
    field: Field  # at t1 - h
    sten: Stencils
    paths: Paths
    aim: Aim
    t1: float
    h: float
    parts: int  # Runge-Kutta steps of a path


@jit
def along(drift, divergence, noise, x, f1, d1, t, h, parts, straight, bend, end, action):
    """Paths from states x (M, n) at time t to t + h, h of either sign, by `parts` Runge-Kutta steps.

    Noise displaces them on the way, by u straight + 6 u (1 - u) bend after a part u of the time, both (M, n).
    `f1` and `d1` are drift and divergence at the start; `action`, shape (M,), takes the integral of the
    divergence unless that is None.
    """
    M, n = x.shape
    y, z, f, step = np.empty((M, n)), x.copy(), f1.copy(), h / parts
    end[:] = x
    ends, ys, zs, fs = end.ravel(), y.ravel(), z.ravel(), f.ravel()  # one loop over all, in SIMD
    straights, bends = straight.ravel(), bend.ravel()
    if divergence is not None:
        action[:] = 0.0
        d = d1.copy()
    for stage in range(4 * parts):
        k = stage % 4
        u = (stage // 4 + (0.0 if k == 0 else 1.0 if k == 3 else 0.5)) / parts
        if stage > 0:
            drift(y, t + u * h, noise.p, f)
            if divergence is not None and not noise.constant_divergence:
                divergence(y, t + u * h, noise.p, d)
        c = step / 6.0 if k in (0, 3) else step / 3.0
        ahead, v = (step if k == 2 else 0.5 * step), u + (0.5 / parts if k in (0, 2) else 0.0)
        bent = 6.0 * v * (1.0 - v)
        if divergence is not None:
            for i in range(M):
                action[i] += c * d[i, 0]
        for e in range(M * n):
            ends[e] += c * fs[e]
        if k == 3:
            zs[:] = ends
            ahead = 0.0
        for e in range(M * n):
            ys[e] = zs[e] + (v * straights[e] + bent * bends[e]) + ahead * fs[e]
    for e in range(M * n):
        ends[e] += straights[e]


@jit
def pushes(G, h):
    """Displacements (2 m, n) by every noise of one standard deviation: straight ones, then bends."""
    n, m = G.shape
    out = np.empty((2 * m, n))
    for k in range(m):
        for a in range(n):
            out[k, a] = G[a, k] * math.sqrt(h)
            out[m + k, a] = G[a, k] * math.sqrt(h / 12.0)
    return out


@jit
def displace(push, w, straight, bend):
    """Displacements (n,) of a path whose noise is w (2 m,)."""
    m = w.size // 2
    for a in range(straight.size):
        straight[a], bend[a] = 0.0, 0.0
    for k in range(m):
        for a in range(straight.size):
            straight[a] += push[k, a] * w[k]
            bend[a] += push[m + k, a] * w[m + k]


@jit
def aimed(drift, noise, field, y, t1, h, parts):
    """Where the noise of paths back from t1 goes, given where they start: see `Aim`.

    y: (n,) state around which the response of the paths' ends to their noise is measured.
    """
    n, K = field.mu.size, 2 * noise.G.shape[1]
    M = 2 * K
    Y, straight, bend, end = np.empty((M, n)), np.empty((M, n)), np.empty((M, n)), np.empty((M, n))
    f, w, push = np.empty((M, n)), np.empty(K), pushes(noise.G, h)
    for k in range(M):
        for a in range(n):
            Y[k, a] = y[a]
        for j in range(K):
            w[j] = 0.0
        w[k // 2] = 1.0 if k % 2 else -1.0
        displace(push, w, straight[k], bend[k])
    drift(Y, t1, noise.p, f)
    along(drift, None, noise, Y, f, f, t1, -h, parts, straight, bend, end, w)
    B = np.zeros((n, K))
    for a in range(n):
        for k in range(K):
            for c in range(n):
                B[a, k] += field.inverse[a, c] * 0.5 * (end[2 * k + 1, c] - end[2 * k, c])
    N = field.node.shape[0]
    root, log_det = np.zeros((N, K, K)), np.zeros(N)
    R = np.empty((K, K))
    HB = np.empty((n, K))
    precision = np.empty((K, K))
    for i in range(N):
        if field.tail[i, 0, 0] != 0.0:  # a complete node: no other's polynomial is ever used
            for a in range(n):
                for k in range(K):
                    HB[a, k] = 0.0
                    for c in range(n):
                        HB[a, k] += field.tail[i, a, c] * B[c, k]
            for k in range(K):
                for j in range(K):
                    v = 1.0 if j == k else 0.0
                    for a in range(n):
                        v -= B[a, j] * HB[a, k]
                    precision[j, k] = v
            cholesky(precision, R)
            root[i] = invert_lower(R)
            for k in range(K):
                log_det[i] -= math.log(R[k, k])
    return Aim(B, root, log_det)


@jit
def back(step, Y, floor, out):
    """log p at the end of a step in the states Y (M, n), into out (M,).

    Where one path to the middle of the noise finds log p well below `floor`, that has to do. Returns for how
    many states it did not.
    """
    noise, aim, t1, h = step.noise, step.aim, step.t1, step.h
    M, n = Y.shape
    K = aim.B.shape[1]
    f1, d1 = np.empty((M, n)), np.empty((M, 1))
    straight, bend, end, action = np.zeros((M, n)), np.zeros((M, n)), np.empty((M, n)), np.zeros(M)
    owner, slope, centre = np.empty(M, np.int64), np.empty((M, n)), np.zeros((M, K))
    step.drift(Y, t1, noise.p, f1)
    step.divergence(Y, t1, noise.p, d1)
    if K > 0:
        along(step.drift, None, noise, Y, f1, d1, t1, -h, step.parts, straight, bend, end, action)
        slopes(step.field, step.sten, end, owner, slope)
        _centres(aim, owner, slope, centre)
        push = pushes(noise.G, h)
        for i in range(M):
            displace(push, centre[i], straight[i], bend[i])
    along(step.drift, step.divergence, noise, Y, f1, d1, t1, -h, step.parts, straight, bend, end, action)
    evaluate(step.field, step.sten, end, out)
    for i in range(M):
        out[i] += action[i]
        if K > 0:
            out[i] += aim.log_det[owner[i]]
        for k in range(K):
            out[i] -= 0.5 * centre[i, k] ** 2
    if K == 0:
        return 0
    high = _above(out, floor - _SURE)
    for i in range(high.size):
        owner[i] = owner[high[i]]
    log_p = np.empty(high.size)
    _expected(step, _rows(Y, high), _rows(f1, high), _rows(d1, high), _rows(centre, high), owner, log_p)
    for i in range(high.size):
        out[high[i]] = log_p[i]
    return high.size


@jit
def _above(values, level):
    """Numbers of the values above a level."""
    found, count = np.empty(values.size, np.int64), 0
    for i in range(values.size):
        if not values[i] <= level:
            found[count] = i
            count += 1
    return found[:count]


@jit
def _rows(values, which):
    """Some rows of a matrix."""
    out = np.empty((which.size, values.shape[1]))
    for i in range(which.size):
        for a in range(values.shape[1]):
            out[i, a] = values[which[i], a]
    return out


@jit
def _expected(step, Y, f1, d1, centre, owner, out):
    """Logarithm of the expectation over the paths back from states Y (M, n)."""
    noise, paths, aim = step.noise, step.paths, step.aim
    M, n = Y.shape
    K = centre.shape[1]
    straight, bend, end, w = np.empty((M, n)), np.empty((M, n)), np.empty((M, n)), np.empty(K)
    action, tilt, log_p = np.empty(M), np.empty(M), np.empty(M)
    highest, total, push = np.full(M, -np.inf), np.zeros(M), pushes(noise.G, step.h)
    for q in range(paths.log_weight.size):
        drawn = paths.w[q]
        for i in range(M):
            root, v = aim.root[owner[i]], aim.log_det[owner[i]]
            for k in range(K):
                w[k] = centre[i, k]
                for j in range(k, K):
                    w[k] += root[j, k] * drawn[j]
                v += 0.5 * (drawn[k] ** 2 - w[k] ** 2)
            tilt[i] = v
            displace(push, w, straight[i], bend[i])
        along(
            step.drift, step.divergence, noise, Y, f1, d1, step.t1, -step.h, step.parts,
            straight, bend, end, action,
        )  # fmt: skip
        evaluate(step.field, step.sten, end, log_p)
        for i in range(M):
            v = log_p[i] + action[i] + paths.log_weight[q] + tilt[i]
            if not v > LOWEST:
                v = LOWEST
            if v > highest[i]:
                total[i] = total[i] * math.exp(highest[i] - v) + 1.0
                highest[i] = v
            else:
                total[i] += math.exp(v - highest[i])
    for i in range(M):
        out[i] = highest[i] + math.log(total[i])


@jit
def _centres(aim, owner, slope, centre):
    """The noise that leads to where the density is, as far as a quadratic knows; at most _FAR from zero."""
    n, K = aim.B.shape
    g, r = np.empty(K), np.empty(K)
    for i in range(owner.size):
        size = 0.0
        for k in range(K):
            g[k] = 0.0
            for a in range(n):
                g[k] += aim.B[a, k] * slope[i, a]
        for k in range(K):
            r[k] = 0.0
            for j in range(k + 1):
                r[k] += aim.root[owner[i], k, j] * g[j]
        for k in range(K):
            for j in range(k, K):
                centre[i, k] += aim.root[owner[i], j, k] * r[j]
            size += centre[i, k] ** 2
        if not size <= _FAR**2:
            for k in range(K):
                centre[i, k] = centre[i, k] * _FAR / math.sqrt(size) if math.isfinite(size) else 0.0


@jit
def back_in_blocks(step, Y, floor, out):
    """As `back`, blocks of states spread over threads: a state's value does not depend on its block."""
    full = np.zeros((Y.shape[0] + _BLOCK - 1) // _BLOCK, np.int64)
    _blocks(
        step.drift, step.divergence, step.noise, step.field, step.sten, step.paths, step.aim, step.t1, step.h,
        step.parts, Y, floor, out, full,
    )  # fmt: skip
    return full.sum()


@parallel_jit
def _blocks(drift, divergence, noise, field, sten, paths, aim, t1, h, parts, Y, floor, out, full):
    """The loop of `back_in_blocks`; numba hands threads tuples of arrays, but no tuples of tuples."""
    for block in prange(full.size):
        step = Step(drift, divergence, noise, field, sten, paths, aim, t1, h, parts)
        first, last = block * _BLOCK, min((block + 1) * _BLOCK, Y.shape[0])
        full[block] = back(step, Y[first:last], floor, out[first:last])


@jit
def noise_factor_at(diffusion, x, t, noise):
    """G of D = G G^T / 2 at time t, its columns the axes of D; noise that does not depend on the state."""
    n = x.shape[1]
    D = np.empty((1, n * n))
    diffusion(x[:1], t, noise.p, D)
    w, V = np.empty(n), np.empty((n, n))
    eigen(D.reshape((n, n)), w, V)
    for k in range(noise.G.shape[1]):
        largest = 0
        for a in range(n):
            largest = a if w[a] > w[largest] else largest
        for a in range(n):
            noise.G[a, k] = V[a, largest] * math.sqrt(2.0 * max(w[largest], 0.0))
        w[largest] = -np.inf
