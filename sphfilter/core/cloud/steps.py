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

from .._addresses import ADDRESS, Entry, function_at
from .._jit import MATRIX, VECTOR, jit
from ..domain import DOMAIN, REFLECTING, Domain, bounce
from .noise import uniform

__all__ = [
    "BESIDE",
    "BETWEEN",
    "FLOW",
    "LEG",
    "STIFF_FLOW",
    "Leg",
    "flow_at",
    "scaled",
    "times_root",
    "walk_at",
]


class Leg(NamedTuple):
    """A model over an interval, as compiled code takes it.

    Functions are addresses; `drift` is that of Stratonovich, `jacobian` its derivative. What moves points
    along the drift, and along the noise too, is one of the functions below.
    """

    drift: int
    jacobian: int
    noise: int
    flow: int
    walk: int
    p: np.ndarray  # data of the model
    root: np.ndarray  # L (m, m)
    domain: Domain
    t: float  # seconds, begin
    h: float  # step, seconds
    steps: int
    additive: bool  # noise does not depend on the state
    constant: bool  # nor on time
    walls: bool  # some axis reflects


_NUMBERS = [types.float64, types.float64, types.int64, types.boolean, types.boolean, types.boolean]
#: Numba's type of `Leg`.
LEG = types.NamedTuple([*[ADDRESS] * 5, VECTOR, MATRIX, DOMAIN, *_NUMBERS], Leg)
_CUBE = types.float64[:, :, ::1]
#: Parts of a step of a stiff drift at most; and of the extent of points, by how much its slopes may part.
_MOST_PARTS, _STIFF = 100_000, 0.02


@jit
def scaled(leg, x, t, sigma):
    """Fill σ (n, m) at time t, for noise that does not depend on the state."""
    g = np.empty((1, sigma.size))
    function_at(leg.noise)(x[:1], t, leg.p, g)
    times_root(g[0], leg.root, sigma)


@jit
def _add_noise(sigma, w, x):
    """x_i <- x_i + σ w_i, w (m, K), x (K, n): by entries, most of which are zero in most models."""
    for a in range(sigma.shape[0]):
        for k in range(sigma.shape[1]):
            s = sigma[a, k]
            if s != 0.0:
                row = w[k]
                for i in range(x.shape[0]):
                    x[i, a] += s * row[i]


@jit
def _runge_kutta(drift, p, x, t, dt, slope, work, out):
    """Fill out (K, n) with x after a step along drift plus slope (K, n): Runge and Kutta's method."""
    y, k1, k2, k3, k4 = work[0], work[1], work[2], work[3], work[4]
    X, Y, S, new = x.reshape(-1), y.reshape(-1), slope.reshape(-1), out.reshape(-1)
    K1, K2, K3, K4 = k1.reshape(-1), k2.reshape(-1), k3.reshape(-1), k4.reshape(-1)
    half = 0.5 * dt
    drift(x, t, p, k1)
    for i in range(X.size):
        Y[i] = X[i] + half * (K1[i] + S[i])
    drift(y, t + half, p, k2)
    for i in range(X.size):
        Y[i] = X[i] + half * (K2[i] + S[i])
    drift(y, t + half, p, k3)
    for i in range(X.size):
        Y[i] = X[i] + dt * (K3[i] + S[i])
    drift(y, t + dt, p, k4)
    for i in range(X.size):
        new[i] = X[i] + dt / 6.0 * (K1[i] + 2.0 * (K2[i] + K3[i]) + K4[i]) + dt * S[i]


@jit
def flow_at_once(leg, x, t, h, slope, work):
    """Move x (K, n) along drift plus slope (K, n) over h, in one step."""
    _runge_kutta(function_at(leg.drift), leg.p, x, t, h, slope, work, x)


@jit
def flow_in_parts(leg, x, t, h, slope, work):
    """Move x (K, n) along a stiff drift plus slope (K, n) over h, in as many steps as it takes; or to NaN."""
    drift = function_at(leg.drift)
    new, went, dt = np.empty_like(x), 0.0, h
    for _ in range(_MOST_PARTS):
        dt = min(dt, h - went)
        _runge_kutta(drift, leg.p, x, t + went, dt, slope, work, new)
        off = _off(x, work, dt)
        if off <= 1.0:
            _copy(new, x)
            went += dt
            if not went < h * (1.0 - 1e-12):
                return
        dt *= min(max(0.8 * off ** (-1.0 / 3.0), 0.1), 4.0) if off > 0.0 else 4.0
        if not dt > 1e-24 * h:
            break
    for i in range(x.shape[0]):
        x[i, 0] = np.nan


@jit
def _off(x, work, dt):
    """How far two inner slopes of a step lead apart, over what is allowed; or infinite."""
    off = 0.0
    for a in range(x.shape[1]):
        low, high, most = np.inf, -np.inf, 0.0
        for i in range(x.shape[0]):
            low, high = min(low, x[i, a]), max(high, x[i, a])
            d = abs(work[3, i, a] - work[2, i, a]) + abs(work[4, i, a] - work[3, i, a])
            if not d < np.inf:
                return np.inf
            most = max(most, d)
        off = max(off, dt * most / (_STIFF * (high - low) + 1e-9 * abs(high) + 1e-300))
    return off


_FLOWS = LEG, MATRIX, types.float64, types.float64, MATRIX, _CUBE
FLOW, STIFF_FLOW = (Entry(function, _FLOWS, types.void) for function in (flow_at_once, flow_in_parts))
flow_at = FLOW.at


@jit
def _reflect(leg, before, x, t):
    """Push points x (K, n) back by as much as their way from `before` has passed reflecting walls.

    How far a path of Brownian motion goes between two states has a known law, exact where noise and drift do
    not change on the way (Lépingle 1995); its uniform number is made of the bits of the two.
    """
    (K, n), m = x.shape, leg.root.shape[0]
    g, sigma = np.empty((K, n * m)), np.empty((n, m))
    function_at(leg.noise)(before, t, leg.p, g)
    for i in range(K):
        times_root(g[i], leg.root, sigma)
        for a in range(n):
            if leg.domain.kind[a] != REFLECTING:
                continue
            variance, one, other = 0.0, before[i, a], x[i, a]
            for k in range(m):
                variance += sigma[a, k] * sigma[a, k] * leg.h
            u = uniform(np.uint64(i), np.uint64(np.int64((other - one) * 2.0**40 / (abs(one) + 1e-300))))
            way = math.sqrt((other - one) ** 2 - 2.0 * variance * math.log(u))
            if one - leg.domain.low[a] < leg.domain.high[a] - one:
                x[i, a] += max(0.0, leg.domain.low[a] - 0.5 * (one + other - way))
            else:
                x[i, a] -= max(0.0, 0.5 * (one + other + way) - leg.domain.high[a])
    bounce(leg.domain, x)


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
def beside_noise(leg, x, Z, odd, work):
    """Walk with noise that does not depend on the state.

    With H the area between a noise's path and its chord, of variance h/12, and c = ±√h/2: the path jumps by
    c + H, rises by the increment less 2c, jumps by c - H. Increment, area and the mean square of the path
    are those of the true one. The jump that ends a step and the one that begins the next are one.
    """
    (K, n), m = x.shape, leg.root.shape[0]
    sigma, jump, rise, slope = np.empty((n, m)), np.zeros((m, K)), np.empty((m, K)), np.zeros((K, n))
    h, flow, before = leg.h, flow_at(leg.flow), np.empty((K if leg.walls else 0, n))
    root, area = math.sqrt(leg.h), math.sqrt(leg.h / 12.0)
    scaled(leg, x, leg.t, sigma)
    for s in range(leg.steps):
        t = leg.t + s * h
        if leg.walls:
            _copy(x, before)
        for k in range(m):
            w, H, c = Z[0, s * m + k], Z[1, s * m + k], Z[2, s * m + k]
            first, up = jump[k], rise[k]
            for i in range(K):
                first[i] += 0.5 * root * c[i] + area * H[i]
                up[i] = (w[i] - c[i]) / root
        _add_noise(sigma, jump, x)
        if not leg.constant:
            scaled(leg, x, t + 0.5 * h, sigma)
        _fill(slope, 0.0)
        _add_noise(sigma, rise, slope)
        flow(leg, x, t, h, slope, work)
        for k in range(m):
            H, c, after = Z[1, s * m + k], Z[2, s * m + k], jump[k]
            for i in range(K):
                after[i] = 0.5 * root * c[i] - area * H[i]
        if not leg.constant:
            scaled(leg, x, t + h, sigma)
        if leg.walls:
            _add_noise(sigma, jump, x)
            _reflect(leg, before, x, t)
            _fill(jump, 0.0)
    _add_noise(sigma, jump, x)


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
    X, Y = x.reshape(-1), y.reshape(-1)
    for i in range(X.size):
        X[i] += Y[i]


@jit
def _kick(leg, x, t, w, first, last, work, raw):
    """Move x along the noises first <= k < last for as long as w (m, K) says: Runge and Kutta's method."""
    noise, p, root = function_at(leg.noise), leg.p, leg.root
    (K, n), m = x.shape, root.shape[0]
    y, total, k1 = work[0], work[1], work[2]
    _copy(x, y)
    _fill(total, 0.0)
    for stage in range(4):
        noise(y, t, p, raw)
        for i in range(K):
            for a in range(n):
                s = 0.0
                for k in range(first, last):
                    c = 0.0
                    for r in range(m):
                        c += raw[i, a * m + r] * root[r, k]
                    s += c * w[k, i]
                k1[i, a] = s
        part = 1.0 / 6.0 if stage == 0 or stage == 3 else 1.0 / 3.0
        ahead = 0.5 if stage < 2 else 1.0
        for i in range(K):
            for a in range(n):
                total[i, a] += part * k1[i, a]
                y[i, a] = x[i, a] + ahead * k1[i, a]
    _add(x, total)


@jit
def between_noise(leg, x, Z, odd, work):
    """Walk with noise that depends on the state.

    Several noises act one after the other; a coin says in which order, and odd chunks do the opposite.
    """
    (K, n), m = x.shape, leg.root.shape[0]
    nothing, raw, w = np.zeros((K, n)), np.empty((K, n * m)), np.empty((m, K))
    h, flow, before = leg.h, flow_at(leg.flow), np.empty((K if leg.walls else 0, n))
    flow(leg, x, leg.t, 0.5 * h, nothing, work)
    for s in range(leg.steps):
        if leg.walls:
            _copy(x, before)
        middle = leg.t + (s + 0.5) * h
        for k in range(m):
            for i in range(K):
                w[k, i] = math.sqrt(h) * Z[0, s * m + k, i]
        forward = (Z[2, s * m, 0] > 0.0) != odd
        for j in range(m):
            k = j if forward else m - 1 - j
            _kick(leg, x, middle, w, k, k + 1, work, raw)
        flow(leg, x, middle, h if s + 1 < leg.steps else 0.5 * h, nothing, work)
        if leg.walls:
            _reflect(leg, before, x, middle)


_WALKS = LEG, MATRIX, _CUBE, types.boolean, _CUBE
#: Move points x (K, n) over a leg; the last argument (5, K, n) is scratch. Z (3, steps m, K or more) holds
#: for each step and noise its increment over √h and its area over √(h/12), like normals, and a sign.
BESIDE, BETWEEN = (Entry(function, _WALKS, types.void) for function in (beside_noise, between_noise))
walk_at = BESIDE.at
