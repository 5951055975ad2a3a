"""log p after a step: the expectation over weighted paths of the noise, back to where log p is known.

Each path is a solution of an ordinary equation, displaced on its way by a straight and a bent part of the
noise, which is drawn where it finds the density: see `aim`.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba import prange, types

from .._addresses import ADDRESS, Entry
from .._jit import BATCH_FUNCTION, MATRIX, VECTOR, jit, parallel_jit
from ..field.cells import LOWEST
from ..field.field import FIELD, Field, evaluate, slopes
from ..field.stencils import STENCILS, Stencils
from .aim import AIM, Aim, centred, leg_ends, response, rooted
from .noise_paths import (
    BEGIN,
    NOISE,
    PATHS,
    Begin,
    Noise,
    Paths,
    Pull,
    Span,
    along_at,
    blurring,
    displace,
    pushes,
    unblurred,
)
from .reflection import reflected

_SURE = 1.0  # nats below the last level kept, from which one path will do: exp(-1) = .37 of what is cut off
_ROWS = 2048  # paths that go at once: 8 bytes each = 16 KB a column, half of a first-level cache
_BLOCK = _ROWS // 8  # states that one thread takes at a time: 2,000 nodes = 8 blocks


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
    expected: int  # address of the function of that name
    reflected: int  # the same; nowhere if no axis ends at a wall


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
    along, begin, span = along_at(noise.along), Begin(Y, f1, d1), Span(t1, -h, step.parts)
    step.drift(Y, t1, noise.p, f1)
    step.divergence(Y, t1, noise.p, d1)
    if K > 0:
        along(step.drift, step.drift, noise, begin, span, pull, end, np.empty(0))
        slopes(step.field, step.sten, end, owner, slope)
        centre = centred(aim, owner, slope)
        for i in range(M):
            displace(push, centre[i], pull, i)
    along(step.drift, step.divergence, noise, begin, span, pull, end, action)
    evaluate(step.field, step.sten, end, out)
    if noise.low.size > 0:
        reflected_at(step.reflected)(step, t1 - h, end, out)
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
    high = np.flatnonzero(~(out <= floor - _SURE))
    for i in range(high.size):
        owner[i] = owner[high[i]]
    log_p, begin = np.empty(high.size), Begin(Y[high], f1[high], d1[high])
    expected_at(step.expected)(step, aim, begin, centre[high], owner, log_p)
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
    end = leg_ends(step.drift, step.noise, Y, step.t1, step.h, parts, 2, np.zeros((M, B.shape[1])))
    owner, slope = np.empty(M, np.int64), np.empty((M, n))
    slopes(step.field, step.sten, end, owner, slope)
    tail, f1, d1 = np.empty((M, n, n)), np.empty((M, n)), np.empty((M, 1))
    for i in range(M):
        for a in range(n):
            for b in range(n):
                tail[i, a, b] = step.field.tail[owner[i], a, b]
        owner[i] = i
    aim = rooted(B, tail)
    step.drift(Y, step.t1, step.noise.p, f1)
    step.divergence(Y, step.t1, step.noise.p, d1)
    expected_at(step.expected)(step, aim, Begin(Y, f1, d1), centred(aim, owner, slope), owner, out)


@jit
def _brought(log_p):
    """What a path brings; one that has left the finite numbers nothing: none comes from infinity."""
    return log_p if LOWEST < log_p < np.inf else LOWEST


@jit
def expected(step, aim, begin, centre, owner, out):
    """Logarithm of the expectation over the paths back from a `Begin`, in the legs that an aim is for.

    All paths of some states go at once: calls of the model's functions are few, and long.
    """
    each = step.paths.log_weight.size ** (aim.B.shape[1] // max(step.paths.w.shape[1], 1))
    size = max(1, _ROWS // each)
    for first in range(0, len(begin.x), size):
        some = slice(first, min(first + size, len(begin.x)))
        part = Begin(begin.x[some], begin.f[some], begin.d[some])
        value = _brought_by_legs(step, aim, part, centre[some], owner[some])
        M = value.size // each
        highest, total = np.full(M, -np.inf), np.zeros(M)
        for c in range(each):
            for i in range(M):
                highest[i] = max(highest[i], value[c * M + i])
        for c in range(each):
            for i in range(M):
                total[i] += math.exp(value[c * M + i] - highest[i])
        for i in range(M):
            out[first + i] = highest[i] + math.log(total[i])


@jit
def _brought_by_legs(step, aim, begin, centre, owner):
    """What each path back from M states brings, logarithms: of all states by one path, then the next.

    Of two legs, the first one's noise stands last in the aim: it does not hang on what the second one draws.
    """
    paths, K, (M, n) = step.paths, step.paths.w.shape[1], begin.x.shape
    legs = aim.B.shape[1] // max(K, 1)
    h, parts = step.h / legs, (step.parts + legs - 1) // legs
    push = pushes(step.noise, h)
    drawn, value, (start, f, d) = np.empty((1, 0)), np.empty(M), begin
    for i in range(M):
        value[i] = aim.log_det[owner[i]]
    for leg in range(legs):
        t, low = step.t1 - leg * h, (legs - 1 - leg) * K
        if leg > 0:
            f, d = np.empty(start.shape), np.empty((start.shape[0], 1))
            step.drift(start, t, step.noise.p, f)
            step.divergence(start, t, step.noise.p, d)
        drawn = _drawn(paths, drawn)
        start, f, d = _branched(paths, M, start), _branched(paths, M, f), _branched(paths, M, d)
        value = _branched(paths, M, value.reshape((value.size, 1))).reshape(start.shape[0])
        R = value.size
        pull = unblurred(R, push.shape[1])
        if step.blurred and paths.w[:, K // 2 :].any():  # without bends there is more left than a bridge
            pull = Pull(pull.straight, pull.bend, np.empty((R, push.shape[1])))
        _displaced(step, aim, (centre, owner), drawn, low, push, pull, value)
        end, action, own = np.empty((R, n)), np.empty(R), Begin(start, f, d)
        along_at(step.noise.along)(
            step.drift, step.divergence, step.noise, own, Span(t, -h, parts), pull, end, action
        )
        for r in range(R):
            value[r] += action[r]
        start = end
    log_p = np.empty(value.size)
    evaluate(step.field, step.sten, start, log_p)
    if step.noise.low.size > 0:
        reflected_at(step.reflected)(step, step.t1 - step.h, start, log_p)
    for r in range(value.size):
        value[r] = _brought(value[r] + log_p[r])
    return value


@jit
def _branched(paths, M, rows):
    """Rows (C M, k) of M states on each of C ways, again for every path that goes on from there."""
    Q, (R, k) = paths.log_weight.size, rows.shape
    out = np.empty((R * Q, k))
    for c in range(R // M * Q):
        for i in range(M):
            for a in range(k):
                out[c * M + i, a] = rows[c // Q * M + i, a]
    return out


@jit
def _drawn(paths, before):
    """Standard noises (C Q, K + J) of each way: of a leg's paths, then those (C, J) of the leg before."""
    (Q, K), (C, J) = paths.w.shape, before.shape
    out = np.empty((C * Q, K + J))
    for c in range(C * Q):
        for k in range(K + J):
            out[c, k] = paths.w[c % Q, k] if k < K else before[c // Q, k - K]
    return out


@jit
def _displaced(step, aim, centres, drawn, low, push, pull, value):
    """Displace a leg's paths by noises of an aim from number `low` on; add what drawing them there weighs.

    centres: (M, K), (M,), middles of the noises of each state, and whose spread they have.
    drawn: (C, J), standard noises of each way, those of this leg first.
    """
    noise, paths, (centre, owner) = step.noise, step.paths, centres
    (Q, K), M = paths.w.shape, owner.size
    w, side = np.empty(K), np.empty(pull.blur.shape[1])
    for c in range(drawn.shape[0]):
        blurring(noise, push, drawn[c, :K], paths.twist[c % Q], side)
        for i in range(M):
            r, j0 = c * M + i, owner[i]
            weight = paths.log_weight[c % Q]
            for k in range(K):
                v = centre[i, low + k]
                for j in range(k, drawn.shape[1]):
                    v += aim.root[j0, low + j, low + k] * drawn[c, j]
                w[k] = v
                weight += 0.5 * (drawn[c, k] ** 2 - v**2)
            value[r] += weight
            displace(push, w, pull, r)
            for a in range(side.size if pull.blur.shape[0] > 0 else 0):
                pull.blur[r, a] = side[a]


@jit
def back_in_blocks(step, Y, floor, out):
    """As `back`, blocks of states spread over threads: a state's value does not depend on its block."""
    full = np.zeros((Y.shape[0] + _BLOCK - 1) // _BLOCK, np.int64)
    _blocks(
        step.drift, step.divergence, step.noise, step.field, step.sten, step.paths, step.aim, step.t1, step.h,
        step.parts, step.blurred, step.expected, step.reflected, Y, floor, out, full,
    )  # fmt: skip
    return full.sum()


@parallel_jit
def _blocks(
    drift, divergence, noise, field, sten, paths, aim, t1, h, parts, blurred, expected, reflected, Y, floor,
    out, full,
):  # fmt: skip
    """The loop of `back_in_blocks`; numba hands threads tuples of arrays, but no tuples of tuples."""
    for block in prange(full.size):
        step = Step(
            drift, divergence, noise, field, sten, paths, aim, t1, h, parts, blurred, expected, reflected
        )
        first, last = block * _BLOCK, min((block + 1) * _BLOCK, Y.shape[0])
        full[block] = back(step, Y[first:last], floor, out[first:last])


#: Numba's type of a `Step`.
_NUMBERS = types.float64, types.float64, types.int64, types.boolean
STEP = types.NamedTuple(
    [BATCH_FUNCTION, BATCH_FUNCTION, NOISE, FIELD, STENCILS, PATHS, AIM, *_NUMBERS, ADDRESS, ADDRESS], Step
)
#: What is entered by address in a step: loops of paths, and walls where there are any.
EXPECTED = Entry(expected, (STEP, AIM, BEGIN, MATRIX, types.int64[::1], VECTOR), types.void)
REFLECTED = Entry(reflected, (STEP, types.float64, MATRIX, VECTOR), types.void)
expected_at, reflected_at = EXPECTED.at, REFLECTED.at
#: `back` and `back_in_blocks` by their addresses.
BACK, BACK_IN_BLOCKS = (Entry(f, (STEP, MATRIX, types.float64, VECTOR)) for f in (back, back_in_blocks))
