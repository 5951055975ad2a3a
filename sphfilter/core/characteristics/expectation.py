"""log p after a step: the expectation over weighted paths of the noise, back to where log p is known.

Each path is a solution of an ordinary equation, displaced on its way by a straight and a bent part of the
noise. Where the paths end is known to first order, and log p there to second: the paths are aimed at where
they find the density, so that a Gaussian and linear paths give the expectation exactly, whatever the step.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba import prange, typeof, types

from .._addresses import Entry
from .._jit import BATCH_FUNCTION, MATRIX, VECTOR, jit, parallel_jit
from ..field.cells import LOWEST, filled
from ..field.field import FIELD, Field, evaluate, slopes
from ..field.stencils import STENCILS, Stencils
from ..small_matrices import cholesky, invert_lower
from .noise_paths import NOISE, PATHS, Noise, Paths, Pull, along, blurring, displace, pushes, unblurred

__all__ = ["AIMED", "BACK", "BACK_IN_BLOCKS", "STEP", "Aim", "Step", "aimed", "back", "back_in_blocks"]

_SURE = 1.0  # nats below the last level kept, from which one path will do
_FAR = 6.0  # standard deviations of the noise
_BLURRED = 2  # noises up to which paths are bent, and leave a bridge
_BLOCK = 256  # states that one thread takes at a time


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
    blurred: bool  # drift and divergence are averaged over what paths leave of the noise


@jit
def aimed(drift, noise, field, y, t1, h, parts):
    """Where the noise of paths back from t1 goes, given where they start: see `Aim`.

    y: (n,) state around which the response of the paths' ends to their noise is measured.
    """
    n, K = field.mu.size, 2 * noise.G.shape[1]
    M = 2 * K
    Y, pull, end = np.empty((M, n)), unblurred(M, n), np.empty((M, n))
    f, w, push = np.empty((M, n)), np.empty(K), pushes(noise.G, h)
    for k in range(M):
        for a in range(n):
            Y[k, a] = y[a]
        for j in range(K):
            w[j] = 0.0
        w[k // 2] = 1.0 if k % 2 else -1.0
        displace(push, w, pull, k)
    drift(Y, t1, noise.p, f)
    along(drift, None, noise, Y, f, f, t1, -h, parts, pull, end, w)
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
            inverse = invert_lower(R)
            for k in range(K):
                for j in range(k + 1):
                    root[i, k, j] = inverse[k, j]
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
    pull, end, action = unblurred(M, n), np.empty((M, n)), np.zeros(M)
    owner, slope, centre = np.empty(M, np.int64), np.empty((M, n)), np.zeros((M, K))
    step.drift(Y, t1, noise.p, f1)
    step.divergence(Y, t1, noise.p, d1)
    if K > 0:
        along(step.drift, None, noise, Y, f1, d1, t1, -h, step.parts, pull, end, action)
        slopes(step.field, step.sten, end, owner, slope)
        _centres(aim, owner, slope, centre)
        push = pushes(noise.G, h)
        for i in range(M):
            displace(push, centre[i], pull, i)
    along(step.drift, step.divergence, noise, Y, f1, d1, t1, -h, step.parts, pull, end, action)
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
    blur = np.empty(n if step.blurred and K // 2 <= _BLURRED else 0)
    pull, end, w = Pull(np.empty((M, n)), np.empty((M, n)), blur), np.empty((M, n)), np.empty(K)
    action, tilt, log_p = np.empty(M), np.empty(M), np.empty(M)
    highest, total, push = filled(M, -np.inf), np.zeros(M), pushes(noise.G, step.h)
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
            displace(push, w, pull, i)
        blurring(push, drawn, blur)
        along(step.drift, step.divergence, noise, Y, f1, d1, step.t1, -step.h, step.parts, pull, end, action)
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
        step.parts, step.blurred, Y, floor, out, full,
    )  # fmt: skip
    return full.sum()


@parallel_jit
def _blocks(drift, divergence, noise, field, sten, paths, aim, t1, h, parts, blurred, Y, floor, out, full):
    """The loop of `back_in_blocks`; numba hands threads tuples of arrays, but no tuples of tuples."""
    for block in prange(full.size):
        step = Step(drift, divergence, noise, field, sten, paths, aim, t1, h, parts, blurred)
        first, last = block * _BLOCK, min((block + 1) * _BLOCK, Y.shape[0])
        full[block] = back(step, Y[first:last], floor, out[first:last])


#: Numba's types of `Aim` and `Step`.
AIM = typeof(Aim(np.empty((1, 1)), np.empty((1, 1, 1)), np.empty(1)))
_NUMBERS = types.float64, types.float64, types.int64, types.boolean
STEP = types.NamedTuple([BATCH_FUNCTION, BATCH_FUNCTION, NOISE, FIELD, STENCILS, PATHS, AIM, *_NUMBERS], Step)
#: `back` and `back_in_blocks`, and `aimed`, by their addresses.
BACK, BACK_IN_BLOCKS = (Entry(f, (STEP, MATRIX, types.float64, VECTOR)) for f in (back, back_in_blocks))
AIMED = Entry(aimed, (BATCH_FUNCTION, NOISE, FIELD, VECTOR, types.float64, types.float64, types.int64))
