"""log p after a step: the expectation over weighted paths of the noise, back to where log p is known.

Each path is a solution of an ordinary equation, displaced on its way by a straight and a bent part of the
noise, which is drawn where it finds the density: see `aim`.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba import prange, types

from .._addresses import Entry
from .._jit import BATCH_FUNCTION, MATRIX, VECTOR, jit, parallel_jit
from ..field.cells import LOWEST, filled
from ..field.field import FIELD, Field, evaluate, slopes
from ..field.stencils import STENCILS, Stencils
from .aim import AIM, Aim, centred, leg_ends, response, rooted
from .noise_paths import NOISE, PATHS, Noise, Paths, Pull, along, blurring, displace, pushes, unblurred
from .reflection import reflected

__all__ = ["BACK", "BACK_IN_BLOCKS", "STEP", "Step", "back", "back_in_blocks", "back_in_halves"]

_SURE = 1.0  # nats below the last level kept, from which one path will do
_BLURRED = 2  # noises up to which paths are bent, and leave a bridge
_BLOCK = 256  # states that one thread takes at a time


class Step(NamedTuple):
    """What log p after a step of length h, to t1, is computed from; or, where h is negative, the logarithm of
    what the backward Kolmogorov equation carries from a later time to t1.
    """

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
def back(step, Y, floor, out):
    """log p at the end of a step in the states Y (M, n), into out (M,).

    Where one path to the middle of the noise finds log p well below `floor`, that has to do. Returns for how
    many states it did not.
    """
    noise, aim, t1, h = step.noise, step.aim, step.t1, step.h
    M, n = Y.shape
    K = aim.B.shape[1]
    f1, d1 = np.empty((M, n)), np.empty((M, 1))
    push, end, action = pushes(noise, h), np.empty((M, n)), np.zeros(M)
    pull = unblurred(M, push.shape[1])
    owner, slope, centre = np.empty(M, np.int64), np.empty((M, n)), np.zeros((M, K))
    step.drift(Y, t1, noise.p, f1)
    step.divergence(Y, t1, noise.p, d1)
    if K > 0:
        along(step.drift, None, noise, Y, f1, d1, t1, -h, step.parts, pull, end, action)
        slopes(step.field, step.sten, end, owner, slope)
        centre = centred(aim, owner, slope)
        for i in range(M):
            displace(push, centre[i], pull, i)
    along(step.drift, step.divergence, noise, Y, f1, d1, t1, -h, step.parts, pull, end, action)
    evaluate(step.field, step.sten, end, out)
    if noise.low.size > 0:
        reflected(step, t1 - h, end, out)
    for i in range(M):
        out[i] += action[i]
        if K > 0:
            out[i] += aim.log_det[owner[i]]
        for k in range(K):
            out[i] -= 0.5 * centre[i, k] ** 2
    if K == 0:
        for i in range(M):
            out[i] = _brought(out[i])
        return 0
    high = _above(out, floor - _SURE)
    for i in range(high.size):
        owner[i] = owner[high[i]]
    log_p = np.empty(high.size)
    _expected(step, aim, _rows(Y, high), _rows(f1, high), _rows(d1, high), _rows(centre, high), owner, log_p)
    for i in range(high.size):
        out[high[i]] = log_p[i]
    return high.size


@jit
def back_in_halves(step, around, Y, out):
    """As `back`, each path in two legs that draw noise of their own: as accurate as two steps of half the
    length, without the lattice between them.

    around: (n,) state around which the response of the paths' ends to their noise is measured.
    """
    M, n = Y.shape
    parts = (step.parts + 1) // 2
    B = response(step.drift, step.noise, step.field, around, step.t1, step.h, parts, 2)
    end, owner, slope = np.empty((M, n)), np.empty(M, np.int64), np.empty((M, n))
    leg_ends(step.drift, step.noise, Y, step.t1, step.h, parts, 2, np.zeros((M, B.shape[1])), end)
    slopes(step.field, step.sten, end, owner, slope)
    tail, f1, d1 = np.empty((M, n, n)), np.empty((M, n)), np.empty((M, 1))
    for i in range(M):
        tail[i] = step.field.tail[owner[i]]
        owner[i] = i
    aim = rooted(B, tail)
    step.drift(Y, step.t1, step.noise.p, f1)
    step.divergence(Y, step.t1, step.noise.p, d1)
    _expected(step, aim, Y, f1, d1, centred(aim, owner, slope), owner, out)


@jit
def _brought(log_p):
    """What a path brings; one that has left the finite numbers nothing: none comes from infinity."""
    return log_p if LOWEST < log_p < np.inf else LOWEST


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
def _expected(step, aim, Y, f1, d1, centre, owner, out):
    """Logarithm of the expectation over the paths back from states Y (M, n), in the legs that an aim is for.

    Of two legs, the first one's noise stands last in the aim: it does not hang on what the second one draws.
    """
    paths, K = step.paths, step.paths.w.shape[1]
    M, n = Y.shape
    Q, legs = paths.log_weight.size, aim.B.shape[1] // max(K, 1)
    h, parts = step.h / legs, (step.parts + legs - 1) // legs
    push = pushes(step.noise, h)
    blur = np.empty(push.shape[1] if step.blurred and K // 2 <= _BLURRED else 0)
    start, f, d = Y, f1, d1
    begun, weight, drawn = np.zeros(M), 0.0, np.zeros(legs * K)
    end, action, log_p = np.empty((M, n)), np.empty(M), np.empty(M)
    highest, total = filled(M, -np.inf), np.zeros(M)
    for first in range(Q if legs == 2 else 1):
        if legs == 2:
            start, f, d, begun, weight = _first_leg(step, aim, Y, f1, d1, centre, owner, first, blur, drawn)
        for q in range(Q):
            drawn[:K] = paths.w[q]
            pull, tilt = _drawn(aim, centre, owner, drawn, 0, K, push, blur)
            blurring(step.noise, push, drawn[:K], paths.twist[q], blur)
            t = step.t1 - (legs - 1) * h
            along(step.drift, step.divergence, step.noise, start, f, d, t, -h, parts, pull, end, action)
            evaluate(step.field, step.sten, end, log_p)
            if step.noise.low.size > 0:
                reflected(step, t - h, end, log_p)
            for i in range(M):
                v = log_p[i] + begun[i] + action[i] + tilt[i]
                v += weight + paths.log_weight[q] + aim.log_det[owner[i]]
                v = _brought(v)
                if v > highest[i]:
                    total[i] = total[i] * math.exp(highest[i] - v) + 1.0
                    highest[i] = v
                else:
                    total[i] += math.exp(v - highest[i])
    for i in range(M):
        out[i] = highest[i] + math.log(total[i])


@jit
def _first_leg(step, aim, Y, f1, d1, centre, owner, q, blur, drawn):
    """The first of two legs back from states Y, with the noise of path q.

    Returns
    -------
    tuple
        States (M, n) at its end, drift and divergence there, the logarithm of what each brings so far, and
        that of the path's weight.
    """
    M, n = Y.shape
    h, parts, K = 0.5 * step.h, (step.parts + 1) // 2, drawn.size // 2
    push = pushes(step.noise, h)
    drawn[K:] = step.paths.w[q]
    pull, begun = _drawn(aim, centre, owner, drawn, K, 2 * K, push, blur)
    blurring(step.noise, push, drawn[K:], step.paths.twist[q], blur)
    start, f, d, action = np.empty((M, n)), np.empty((M, n)), np.empty((M, 1)), np.empty(M)
    along(step.drift, step.divergence, step.noise, Y, f1, d1, step.t1, -h, parts, pull, start, action)
    step.drift(start, step.t1 - h, step.noise.p, f)
    step.divergence(start, step.t1 - h, step.noise.p, d)
    for i in range(M):
        begun[i] += action[i]
    return start, f, d, begun, step.paths.log_weight[q]


@jit
def _drawn(aim, centre, owner, drawn, low, high, push, blur):
    """Displacements of paths by the noises low ... high - 1 of an aim, and what drawing them there weighs."""
    M, n = centre.shape[0], push.shape[1]
    pull, w, tilt = Pull(np.empty((M, n)), np.empty((M, n)), blur), np.empty(high - low), np.zeros(M)
    for i in range(M):
        root = aim.root[owner[i]]
        for k in range(low, high):
            v = centre[i, k]
            for j in range(k, drawn.size):
                v += root[j, k] * drawn[j]
            w[k - low] = v
            tilt[i] += 0.5 * (drawn[k] ** 2 - v**2)
        displace(push, w, pull, i)
    return pull, tilt


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


#: Numba's type of a `Step`.
_NUMBERS = types.float64, types.float64, types.int64, types.boolean
STEP = types.NamedTuple([BATCH_FUNCTION, BATCH_FUNCTION, NOISE, FIELD, STENCILS, PATHS, AIM, *_NUMBERS], Step)
#: `back` and `back_in_blocks` by their addresses.
BACK, BACK_IN_BLOCKS = (Entry(f, (STEP, MATRIX, types.float64, VECTOR)) for f in (back, back_in_blocks))
