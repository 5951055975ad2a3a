"""Paths of the noise over a step: solutions of an ordinary equation, displaced on their way.

A straight and a bent part displace a path: the noise's integral over the step, and the area under it. Noise
that depends on the state is a velocity instead, times the slope of its own path, in Stratonovich's sense: a
density is transported along each such path, and divided by the volume that the path's flow makes of a volume.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import typeof, types

from .._addresses import NOWHERE_AT, Entry, function_at
from .._jit import BATCH_FUNCTION, MATRIX, VECTOR, jit
from ..field.walls import NOWHERE
from ..small_matrices import eigen

#: A twist c u (1 - 2 u), the opposite in the second half: its mean square 2 c² ∫₀^½ u² (1 - 2 u)² du = c²/120
#: is what a bridge has, 1/6, less what bends have, 36/12 ∫ u² (1 - u)² du = 1/10.
_TWIST = math.sqrt(8.0)


class Noise(NamedTuple):
    """D = G G^T / 2 per second; asked of the model at mid-step where it depends on time or state."""

    G: np.ndarray  # (n, m); where it depends on the state: in the middle of the density
    p: np.ndarray  # parameters of the model
    time_dependent: bool
    constant_divergence: bool
    state_dependent: bool = False
    columns: int = NOWHERE_AT  # address of the batch function of G(x), and its columns' divergences below
    low: np.ndarray = NOWHERE  # (n,) walls, low and high, that no path passes; empty if no axis ends
    high: np.ndarray = NOWHERE
    along: int = NOWHERE_AT  # address of the function of that name


class Paths(NamedTuple):
    """Weighted paths of the noise over a step of length one: straight to dW, bent to enclose the area."""

    log_weight: np.ndarray  # (Q,)
    w: np.ndarray  # (Q, 2 m): dW, then bends
    # (Q,) of noises that depend on the state, in units of `_TWIST` to the side of their bends
    twist: np.ndarray


class Pull(NamedTuple):
    """How noise displaces paths: on their way, and in what they leave of it."""

    straight: np.ndarray  # (M, n); (M, m) of the noises themselves where they depend on the state
    bend: np.ndarray  # the same
    # (M, n) one standard deviation of the noise over the step, (M, m) twists of noises that depend on the
    # state; empty if that does not matter
    blur: np.ndarray


class Begin(NamedTuple):
    """States that paths begin at, and what the model says there."""

    x: np.ndarray  # (M, n)
    f: np.ndarray  # (M, n) drift
    d: np.ndarray  # (M, 1) divergence; anything, where its integral is not asked for


class Span(NamedTuple):
    """Time that paths take, from t to t + h, in Runge-Kutta steps."""

    t: float  # seconds
    h: float  # seconds, of either sign
    parts: int


@jit
def unblurred(M, n):
    """No displacements yet; n: as many as `pushes` has columns."""
    return Pull(np.zeros((M, n)), np.zeros((M, n)), np.empty((0, n)))


@jit
def along(drift, divergence, noise, begin, span, pull, end, action):
    """Paths from a `Begin` over a `Span`.

    Noise displaces them on the way, by u straight + 6 u (1 - u) bend after a part u of the time. Such a path
    leaves a bridge of the noise: drift and divergence are averaged over it, along `blur`. Noise that
    depends on the state has other slopes in the second half of a path, which has twice the parts.

    `pull` says how noise displaces each path. The ends (M, n) are written, and the action (M,), the integral
    of the divergence along each path, unless it is empty. Functions are of signature `BATCH`.
    """
    (M, n), (t, h, parts) = begin.x.shape, span
    parts *= 2 if noise.state_dependent else 1
    y, z, f, step = np.empty((M, n)), begin.x.copy(), begin.f.copy(), h / parts
    E = M * n  # one loop over all numbers runs several at a time
    ends, ys, zs, fs = end.reshape(E), y.reshape(E), z.reshape(E), f.reshape(E)
    straights, bends = pull.straight.reshape(pull.straight.size), pull.bend.reshape(pull.bend.size)
    blur, columns = pull.blur, np.empty((M if noise.state_dependent else 0, (n + 1) * noise.G.shape[1]))
    other = np.empty((M if blur.size > 0 else 0, n))
    for e in range(E):
        ends[e] = zs[e]
    d, integrated = begin.d.copy(), action.size > 0
    action[:] = 0.0
    for stage in range(4 * parts):
        k = stage % 4
        u = (stage // 4 + (0.0 if k == 0 else 1.0 if k == 3 else 0.5)) / parts
        left = u * (1.0 - u) - 3.0 * (u * (1.0 - u)) ** 2  # variance of the bridge
        if noise.state_dependent:
            left = 0.0
        if stage > 0 and (blur.size == 0 or left <= 0.0):
            drift(y, t + u * h, noise.p, f)
            if integrated and not noise.constant_divergence:
                divergence(y, t + u * h, noise.p, d)
        elif stage > 0:
            averaged(drift, y, t + u * h, noise.p, blur, math.sqrt(left), other, f)
            if integrated and not noise.constant_divergence:
                averaged(divergence, y, t + u * h, noise.p, blur, math.sqrt(left), other, d)
        if noise.state_dependent:
            driven(noise, Begin(z if stage == 0 else y, f, d), span, u, stage < 2 * parts, pull, columns)
        c = step / 6.0 if k in (0, 3) else step / 3.0
        ahead, v = (step if k == 2 else 0.5 * step), u + (0.5 / parts if k in (0, 2) else 0.0)
        bent = 6.0 * v * (1.0 - v)
        if integrated:
            for i in range(M):
                action[i] += c * d[i, 0]
        for e in range(E):
            ends[e] += c * fs[e]
        if k == 3:
            ahead = 0.0
            for e in range(E):
                zs[e] = ends[e]
        if noise.state_dependent:
            for e in range(E):
                ys[e] = zs[e] + ahead * fs[e]
        else:
            for e in range(E):
                ys[e] = zs[e] + (v * straights[e] + bent * bends[e]) + ahead * fs[e]
    if not noise.state_dependent:
        for e in range(E):
            ends[e] += straights[e]


@jit
def driven(noise, begin, span, u, early, pull, columns):
    """Add the noise after a part u of the time to velocities and divergences of states.

    early: u is seen from the first half, where both meet.
    """
    (y, f, d), h = begin, span.h
    n, m = y.shape[1], pull.straight.shape[1]
    function_at(noise.columns)(y, span.t + u * h, noise.p, columns)
    for i in range(y.shape[0]):
        for k in range(m):
            rate = (pull.straight[i, k] + 6.0 * (1.0 - 2.0 * u) * pull.bend[i, k]) / h
            if pull.blur.size > 0:
                rate += (1.0 - 4.0 * u if early else 4.0 * u - 3.0) * pull.blur[i, k] / h
            for a in range(n):
                f[i, a] += columns[i, a * m + k] * rate
            if not noise.constant_divergence:
                d[i, 0] += columns[i, n * m + k] * rate


@jit
def averaged(function, y, t, p, blur, scale, other, out):
    """A function's mean over displacements blur (M, n) of states y (M, n) to either side."""
    M, n = y.shape
    beside = np.empty((M, out.shape[1]))
    for i in range(M):
        for a in range(n):
            other[i, a] = y[i, a] + scale * blur[i, a]
    function(other, t, p, out)
    for i in range(M):
        for a in range(n):
            other[i, a] = y[i, a] - scale * blur[i, a]
    function(other, t, p, beside)
    for i in range(M):
        for a in range(out.shape[1]):
            out[i, a] = 0.5 * (out[i, a] + beside[i, a])


@jit
def pushes(noise, h):
    """Displacements (2 m, n) by every noise of one standard deviation in h seconds, of either sign: straight
    ones, then bends.

    Noise that depends on the state displaces by itself: m columns, of these noises alone.
    """
    G = np.eye(noise.G.shape[1]) if noise.state_dependent else noise.G
    n, m = G.shape
    out = np.empty((2 * m, n))
    for k in range(m):
        for a in range(n):
            out[k, a] = G[a, k] * math.sqrt(abs(h))
            out[m + k, a] = G[a, k] * math.sqrt(abs(h) / 12.0)
    return out


@jit
def displace(push, w, pull, i):
    """Displace path i as its noise w (2 m,) does."""
    m = w.size // 2
    for a in range(push.shape[1]):
        straight, bend = 0.0, 0.0
        for k in range(m):
            straight += push[k, a] * w[k]
            bend += push[m + k, a] * w[m + k]
        pull.straight[i, a], pull.bend[i, a] = straight, bend


@jit
def blurring(noise, push, w, twist, blur):
    """Where a path's bridge lies, into blur (n,): noises to the sides that its bends take, all pairs of sides
    alike.
    """
    scale = _TWIST * twist if noise.state_dependent else 1.0
    m = w.size // 2
    for a in range(blur.size):
        blur[a] = 0.0
        for k in range(m):
            blur[a] += push[k, a] * math.copysign(1.0, w[m + k]) * scale


@jit
def noise_factor_at(diffusion, x, t, noise):
    """G of D = G G^T / 2 at time t; noise that does not depend on the state.

    Its columns are the axes of D with a unit diagonal: which of them are noise does not hang on units.
    """
    n = x.shape[1]
    row = np.empty((1, n * n))
    diffusion(x[:1], t, noise.p, row)
    D, scale = row.reshape((n, n)), np.ones(n)
    for a in range(n):
        if D[a, a] > 0.0:
            scale[a] = math.sqrt(D[a, a])
    for a in range(n):
        for b in range(n):
            D[a, b] /= scale[a] * scale[b]
    w, V = np.empty(n), np.empty((n, n))
    eigen(D, w, V)
    for k in range(noise.G.shape[1]):
        largest = 0
        for a in range(n):
            largest = a if w[a] > w[largest] else largest
        for a in range(n):
            noise.G[a, k] = scale[a] * V[a, largest] * math.sqrt(2.0 * max(w[largest], 0.0))
        w[largest] = -np.inf


@jit
def freeze(x, m, t, noise):
    """G at time t in the mean of states x (N, n) with masses m."""
    n, k = noise.G.shape
    mean, total, row = np.zeros((1, n)), 0.0, np.empty((1, (n + 1) * k))
    for i in range(m.size):
        total += m[i]
    for i in range(m.size):
        for a in range(n):
            mean[0, a] += m[i] / total * x[i, a]
    function_at(noise.columns)(mean, t, noise.p, row)
    for a in range(n):
        for b in range(k):
            noise.G[a, b] = row[0, a * k + b]


_VECTOR, _MATRIX = np.empty(1), np.empty((1, 1))
#: Numba's types of `Noise` and `Paths`, and of `Begin`.
NOISE, PATHS = typeof(Noise(_MATRIX, _VECTOR, False, False)), typeof(Paths(_VECTOR, _MATRIX, _VECTOR))
BEGIN, _SPAN = typeof(Begin(_MATRIX, _MATRIX, _MATRIX)), typeof(Span(0.0, 0.0, 0))
_PULL = typeof(Pull(_MATRIX, _MATRIX, _MATRIX))
#: `along` by its address.
_GIVEN = BATCH_FUNCTION, BATCH_FUNCTION, NOISE, BEGIN, _SPAN, _PULL, MATRIX, VECTOR
ALONG = Entry(along, _GIVEN, types.void)
along_at = ALONG.at
