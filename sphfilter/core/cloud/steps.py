"""Steps of points along the paths of a model, a few dozen at a time.

Letters: x (K, n) points of one chunk, σ = g L the noise with L Lᵀ = Q, Z noise.
Noise that does not depend on the state is a simple path beside the drift (Foster, dos Reis & Strange 2024):
of weak order three as measured. Any other is the flow of each noise between two flows of the drift (Strang;
Ninomiya & Victoir 2008): of weak order two.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import types

from .._addresses import ADDRESS, NOWHERE_AT, Entry, function_at
from .._jit import MATRIX, VECTOR, jit
from .._views import lent, rows_at
from ..domain import DOMAIN, REFLECTING, Domain, bounce
from ..limits import TINY
from ..step_control import next_step
from .noise import ADDITIVE, LANES, uniform


class Leg(NamedTuple):
    """A model over an interval, as compiled code takes it.

    Functions are addresses; `drift` is that of Stratonovich, `jacobian` its derivative. What moves points
    along the drift, and along the noise too, is one of the functions below; `linearise` and `move` are those
    of the files of these names.
    """

    drift: int
    jacobian: int
    noise: int
    flow: int
    walk: int
    linearise: int
    move: int
    p: np.ndarray  # data of the model
    root: np.ndarray  # L (m, m)
    domain: Domain
    t: float  # seconds, begin
    h: float  # step, seconds
    steps: int
    kind: int  # of the noise
    constant: bool  # noise depends on neither state nor time
    walls: bool  # some axis reflects


_NUMBERS = [types.float64, types.float64, types.int64, types.int64, types.boolean, types.boolean]
#: Numba's type of `Leg`.
LEG = types.NamedTuple([*[ADDRESS] * 7, VECTOR, MATRIX, DOMAIN, *_NUMBERS], Leg)
_EMPTY = np.empty(0)
_ANYWHERE = Domain(np.empty(0, np.int64), _EMPTY, _EMPTY)
#: Stands for a leg of a linear model, of which nothing is called.
NO_LEG = Leg(*[NOWHERE_AT] * 7, _EMPTY, np.empty((0, 0)), _ANYWHERE, 0.0, 0.0, 0, ADDITIVE, True, False)
CUBE = types.float64[:, :, ::1]
#: The room of a chunk: points, a state between, slopes of the drift and of the noise, the points before.
#: Parts are a constant apart, by which the compiler sees that they do not overlap; no power of two, for the
#: cache. Behind them is what moves the points, of each noise a row.
X, Y, K1, K2, K3, K4, SLOPE, BEFORE, _PARTS = range(9)
_PART = 16 * LANES + 16  # 16 states; 8 * 16 bytes = 2 lines off what would share their places in the cache
_Y, _K1, _K2, _K3, _K4, _SLOPE, _NOISE = (k * _PART for k in (Y, K1, K2, K3, K4, SLOPE, _PARTS))
#: Parts of noise beside walls, by number: how far a path goes down and up within each step, and the step.
#: There are as many as the third's number where two are given, and 3 + 3 = 6 where all are left.
_DOWN, _UP, GIVEN, LEFT = range(3, 7)
#: Parts of a step of a stiff drift at most; and of the extent of points, by how much its slopes may part.
_MOST_PARTS, _STIFF = 100_000, 0.02


@jit
def scaled(leg, x, t, sigma):
    """Fill σ (n, m) at time t, for noise that does not depend on the state."""
    g = np.empty((1, sigma.size))
    function_at(leg.noise)(x[:1], t, leg.p, g)
    times_root(g[0], leg.root, sigma)


@jit
def part(room, k, K, n):
    """Part number k of the room of a chunk as an array (K, n)."""
    return rows_at(room, k * _PART, K, n)


@jit
def new_room(m):
    """Room of a chunk, and of m noises of each of its points."""
    return np.empty(_PARTS * _PART + 3 * m * LANES)


@jit
def _runge_kutta(drift, p, room, K, n, t, dt):
    """Move the points in a room by a step along drift plus slope: Runge and Kutta's method."""
    x, y = part(room, X, K, n), part(room, Y, K, n)
    k1, k2, k3, k4 = part(room, K1, K, n), part(room, K2, K, n), part(room, K3, K, n), part(room, K4, K, n)
    half, sixth, size = 0.5 * dt, dt / 6.0, K * n
    drift(x, t, p, k1)
    for i in range(size):
        room[_Y + i] = room[i] + half * (room[_K1 + i] + room[_SLOPE + i])
    drift(y, t + half, p, k2)
    for i in range(size):
        room[_Y + i] = room[i] + half * (room[_K2 + i] + room[_SLOPE + i])
    drift(y, t + half, p, k3)
    for i in range(size):
        room[_Y + i] = room[i] + dt * (room[_K3 + i] + room[_SLOPE + i])
    drift(y, t + dt, p, k4)
    for i in range(size):
        k = room[_K1 + i] + 2.0 * (room[_K2 + i] + room[_K3 + i]) + room[_K4 + i]
        room[i] += sixth * k + dt * room[_SLOPE + i]


@jit
def flow_at_once(drift, p, room, K, n, t, h):
    """Move the K points in a room along drift, by its address, plus slope over h, in one step."""
    _runge_kutta(function_at(drift), p, room, K, n, t, h)


@jit
def flow_in_parts(drift, p, room, K, n, t, h):
    """Move the K points in a room along a stiff drift plus slope, in as many steps as it takes.

    A point that no step is short enough for is given up, as no number; all are, if it takes too many steps.
    """
    x, before = part(room, X, K, n), part(room, BEFORE, K, n)
    went, dt = 0.0, h
    for _ in range(_MOST_PARTS):
        dt = min(dt, h - went)
        _copy(x, before)
        _runge_kutta(function_at(drift), p, room, K, n, t + went, dt)
        off, worst = _off(room, K, n, dt)
        if off <= 1.0:
            went += dt
            if not went < h * (1.0 - 1e-12):
                return
        else:
            _copy(before, x)
        dt = next_step(dt, off, 3.0)
        if not dt > 1e-24 * h:
            x[worst, 0], dt = np.nan, h
    for i in range(K):
        x[i, 0] = np.nan


@jit
def _off(room, K, n, dt):
    """How far two inner slopes of a step lead apart, over what is allowed, or infinite; and of which point.

    Points that have been given up do not count.
    """
    x, k2, k3, k4 = part(room, BEFORE, K, n), part(room, K2, K, n), part(room, K3, K, n), part(room, K4, K, n)
    off, worst = 0.0, 0
    for a in range(n):
        low, high, most, at = np.inf, -np.inf, 0.0, 0
        for i in range(K):
            if x[i, 0] == x[i, 0]:
                low, high = min(low, x[i, a]), max(high, x[i, a])
                d = abs(k3[i, a] - k2[i, a]) + abs(k4[i, a] - k3[i, a])
                if not d < np.inf:
                    return np.inf, i
                if d > most:
                    most, at = d, i
        own = dt * most / (_STIFF * (high - low) + 1e-9 * abs(high) + TINY)
        if own > off:
            off, worst = own, at
    return off, worst


_FLOWS = ADDRESS, VECTOR, VECTOR, types.int64, types.int64, types.float64, types.float64
FLOW, STIFF_FLOW = (Entry(function, _FLOWS, types.void) for function in (flow_at_once, flow_in_parts))
flow_at = FLOW.at


@jit
def flow(leg, x, t, h, room):
    """Move points x (K, n), however many, along the drift over h."""
    leg, x, room = lent((leg, x, room))
    (K, n), at = x.shape, 0
    while at < K:
        many = min(K - at, _PART // n)
        own = part(room, X, many, n)
        _copy(x[at : at + many], own)
        _fill(part(room, SLOPE, many, n), 0.0)
        flow_at(leg.flow)(leg.drift, leg.p, room, many, n, t, h)
        _copy(own, x[at : at + many])
        at += many


@jit
def _reflect(leg, before, x, t, Z, s):
    """Push points x (K, n) back by as much as their way from `before` has passed reflecting walls.

    How far a path of Brownian motion goes between two states has a known law, exact where noise and drift do
    not change on the way (Lépingle 1995); its uniform number is made of the bits of the two. Where noise Z
    has the parts for it, how far step s of a path goes, down and up, is given there, or left there, with the
    step itself: so a path in longer steps is the same path.
    """
    (K, n), m, parts = x.shape, leg.root.shape[0], len(Z)
    g, sigma = np.empty((K, n * m)), np.empty((n, m))
    function_at(leg.noise)(before, t, leg.p, g)
    for i in range(K):
        times_root(g[i], leg.root, sigma)
        for a in range(n):
            if leg.domain.kind[a] != REFLECTING:
                continue
            one, step, r = before[i, a], x[i, a] - before[i, a], s * n + a
            if parts == GIVEN:
                down, up = min(Z[_DOWN, r, i], 0.0, step), max(Z[_UP, r, i], 0.0, step)
            else:
                variance = 0.0
                for k in range(m):
                    variance += sigma[a, k] * sigma[a, k] * leg.h
                u = uniform(np.uint64(i), np.uint64(np.int64(step * 2.0**40 / (abs(one) + TINY))))
                way = math.sqrt(step * step - 2.0 * variance * math.log(u))
                down, up = 0.5 * (step - way), 0.5 * (step + way)
            if parts == LEFT:
                Z[_DOWN, r, i], Z[_UP, r, i], Z[GIVEN, r, i] = down, up, step
            if one - leg.domain.low[a] < leg.domain.high[a] - one:
                x[i, a] += max(0.0, leg.domain.low[a] - (one + down))
            else:
                x[i, a] -= max(0.0, one + up - leg.domain.high[a])
    bounce(leg.domain, x)


@jit
def same_path(fine, n, Z):
    """Give noise Z of steps how far paths of n states go, as `fine`, of half as long steps, has left it."""
    for r in range(Z.shape[1] // n * n):
        one = 2 * (r // n) * n + r % n
        for i in range(Z.shape[2]):
            between = fine[GIVEN, one, i]
            Z[_DOWN, r, i] = min(fine[_DOWN, one, i], between + fine[_DOWN, one + n, i])
            Z[_UP, r, i] = max(fine[_UP, one, i], between + fine[_UP, one + n, i])


@jit
def times_root(g, root, sigma):
    """Fill σ = g L (n, m) from a row of g."""
    n, m = sigma.shape
    for a in range(n):
        for k in range(m):
            sigma[a, k] = 0.0
            for r in range(m):
                sigma[a, k] += g[a * m + r] * root[r, k]


@jit
def beside_noise(leg, x, Z, odd, room):
    """Walk with noise that does not depend on the state.

    With H the area between a noise's path and its chord, of variance h/12, and c = ±√h/2: the path jumps by
    c + H, rises by the increment less 2c, jumps by c - H. Increment, area and the mean square of the path
    are those of the true one. The jump that ends a step and the one that begins the next are one.
    """
    (K, n), m = x.shape, leg.root.shape[0]
    own, slope, sigma = part(room, X, K, n), part(room, SLOPE, K, n), np.empty((n, m))
    first, rise, last = (
        rows_at(room, _NOISE, m, K),
        rows_at(room, _NOISE + m * LANES, m, K),
        rows_at(room, _NOISE + 2 * m * LANES, m, K),
    )
    h, flow, before = leg.h, flow_at(leg.flow), np.empty((K if leg.walls else 0, n))
    drift, p = leg.drift, leg.p
    half, area, per = 0.5 * math.sqrt(leg.h), math.sqrt(leg.h / 12.0), 1.0 / math.sqrt(leg.h)
    _copy(x, own)
    _fill(last, 0.0)
    scaled(leg, x, leg.t, sigma)
    for s in range(leg.steps):
        t = leg.t + s * h
        if leg.walls:
            _copy(own, before)
        for k in range(m):
            r = s * m + k
            for i in range(K):
                c, H = half * Z[2, r, i], area * Z[1, r, i]
                first[k, i] = last[k, i] + (c + H)
                rise[k, i] = per * (Z[0, r, i] - Z[2, r, i])
                last[k, i] = c - H
        _add_noise(sigma, first, own)
        if not leg.constant:
            scaled(leg, own, t + 0.5 * h, sigma)
        _set_noise(sigma, rise, slope)
        flow(drift, p, room, K, n, t, h)
        if not leg.constant:
            scaled(leg, own, t + h, sigma)
        if leg.walls:
            _add_noise(sigma, last, own)
            _reflect(leg, before, own, t, Z, s)
            _fill(last, 0.0)
    _add_noise(sigma, last, own)
    _copy(own, x)


@jit
def _add_noise(sigma, w, x):
    """x_i <- x_i + σ w_i, w (m, K), x (K, n): by entries, most of which are zero in most models."""
    for a in range(sigma.shape[0]):
        for k in range(sigma.shape[1]):
            s = sigma[a, k]
            if s != 0.0:
                for i in range(x.shape[0]):
                    x[i, a] += s * w[k, i]


@jit
def _set_noise(sigma, w, x):
    """x_i <- σ w_i, w (m, K), x (K, n)."""
    for a in range(sigma.shape[0]):
        new = True
        for k in range(sigma.shape[1]):
            s = sigma[a, k]
            if s != 0.0 and new:
                new = False
                for i in range(x.shape[0]):
                    x[i, a] = s * w[k, i]
            elif s != 0.0:
                for i in range(x.shape[0]):
                    x[i, a] += s * w[k, i]
        if new:
            for i in range(x.shape[0]):
                x[i, a] = 0.0


@jit
def _fill(x, value):
    """x <- value."""
    for i in range(x.shape[0]):
        for a in range(x.shape[1]):
            x[i, a] = value


@jit
def _copy(x, y):
    """y <- x."""
    for i in range(x.shape[0]):
        for a in range(x.shape[1]):
            y[i, a] = x[i, a]


@jit
def _add(x, y):
    """x <- x + y."""
    for i in range(x.shape[0]):
        for a in range(x.shape[1]):
            x[i, a] += y[i, a]


@jit
def _kick(leg, x, t, w, first, last, room, raw):
    """Move x along the noises first <= k < last for as long as w (m, K) says: Runge and Kutta's method.

    Beyond a wall that reflects noise is that of the mirrored state: a root of the distance has none there.
    """
    noise, p, root = function_at(leg.noise), leg.p, leg.root
    (K, n), m = x.shape, root.shape[0]
    y, total, k1 = part(room, Y, K, n), part(room, K2, K, n), part(room, K1, K, n)
    seen = part(room, K3, K, n) if leg.walls else y
    _copy(x, y)
    _fill(total, 0.0)
    for stage in range(4):
        if leg.walls:
            _copy(y, seen)
            bounce(leg.domain, seen)
        noise(seen, t, p, raw)
        for i in range(K):
            for a in range(n):
                s = 0.0
                for k in range(first, last):
                    c = 0.0
                    for r in range(m):
                        c += raw[i, a * m + r] * root[r, k]
                    s += c * w[k, i]
                k1[i, a] = s
        share = 1.0 / 6.0 if stage == 0 or stage == 3 else 1.0 / 3.0
        ahead = 0.5 if stage < 2 else 1.0
        for i in range(K):
            for a in range(n):
                total[i, a] += share * k1[i, a]
                y[i, a] = x[i, a] + ahead * k1[i, a]
    _add(x, total)


@jit
def between_noise(leg, x, Z, odd, room):
    """Walk with noise that depends on the state.

    Several noises act one after the other; a coin says in which order, and odd chunks do the opposite.
    """
    (K, n), m = x.shape, leg.root.shape[0]
    own, raw, w = part(room, X, K, n), np.empty((K, n * m)), np.empty((m, K))
    h, flow, before = leg.h, flow_at(leg.flow), np.empty((K if leg.walls else 0, n))
    drift, p = leg.drift, leg.p
    _copy(x, own)
    _fill(part(room, SLOPE, K, n), 0.0)
    flow(drift, p, room, K, n, leg.t, 0.5 * h)
    for s in range(leg.steps):
        if leg.walls:
            _copy(own, before)
        middle = leg.t + (s + 0.5) * h
        for k in range(m):
            for i in range(K):
                w[k, i] = math.sqrt(h) * Z[0, s * m + k, i]
        forward = (Z[2, s * m, 0] > 0.0) != odd
        for j in range(m):
            k = j if forward else m - 1 - j
            _kick(leg, own, middle, w, k, k + 1, room, raw)
        flow(drift, p, room, K, n, middle, h if s + 1 < leg.steps else 0.5 * h)
        if leg.walls:
            _reflect(leg, before, own, middle, Z, s)
    _copy(own, x)


_WALKS = LEG, MATRIX, CUBE, types.boolean, VECTOR
#: Move points x (K, n) over a leg. Z (3, steps m, K or more) holds for each step and noise its increment over
#: √h and its area over √(h/12), like normals, and a sign; beside walls `GIVEN` or `LEFT` parts, steps n rows,
#: hold how far paths go. Then whether noises act in the opposite order, and a room.
BESIDE, BETWEEN = (Entry(function, _WALKS, types.void) for function in (beside_noise, between_noise))
_walk_at = BESIDE.at


@jit
def walk(leg, x, Z, odd, room):
    """Move points x (K, n), at most `LANES`, over a leg along noise Z."""
    leg, x, Z, room = lent((leg, x, Z, room))
    (K, n), at = x.shape, 0
    while at < K:
        many = min(K - at, _PART // n)
        own = Z if many == K else Z[:, :, at:].copy()
        _walk_at(leg.walk)(leg, x[at : at + many], own, odd, room)
        at += many
