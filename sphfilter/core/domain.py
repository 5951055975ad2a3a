"""Domains of the state: periodic axes, walls, and the images of particles that are seen beyond their ends.

A kernel sum near the end of a periodic axis needs the particles of the other end, one at a reflecting wall
the mirrored particles (their sum has no slope at the wall: no flux). Both are put beside the real ones as
images, so that searches and sums need not know of domains. An image x_g = sign x_owner + shift moves with
its owner.
"""

from typing import NamedTuple

import numpy as np
from numba import types

from ._jit import MATRIX, VECTOR, jit

KINDS = ("unbounded", "periodic", "bounded", "reflecting")
UNBOUNDED, PERIODIC, BOUNDED, REFLECTING = range(4)


class Domain(NamedTuple):
    """What the ends of each axis are, as codes of `KINDS`, and where."""

    kind: np.ndarray  # (n,) int64
    low: np.ndarray  # (n,)
    high: np.ndarray


class View(NamedTuple):
    """N particles and G images of them as sums and searches see them; without images their own arrays."""

    x: np.ndarray  # (N + G, n)
    m: np.ndarray  # (N + G,)
    h: np.ndarray
    owner: np.ndarray  # (G,)
    sign: np.ndarray  # (G, n)
    shift: np.ndarray


_INTEGERS = types.int64[::1]
#: Numba's types of `Domain` and `View`.
DOMAIN = types.NamedTuple([_INTEGERS, VECTOR, VECTOR], Domain)
VIEW = types.NamedTuple([MATRIX, VECTOR, VECTOR, _INTEGERS, MATRIX, MATRIX], View)


@jit
def half_period(domain):
    """Half the shortest period: a longer support would see a particle from both sides (000 3.9.4)."""
    half = np.inf
    for d in range(domain.kind.size):
        if domain.kind[d] == PERIODIC:
            half = min(half, 0.5 * (domain.high[d] - domain.low[d]))
    return half


@jit
def go_round(domain, x):
    """Put particles x (N, n) that have passed the end of a periodic axis at its other end."""
    for d in range(domain.kind.size):
        if domain.kind[d] == PERIODIC:
            low, period = domain.low[d], domain.high[d] - domain.low[d]
            for i in range(x.shape[0]):
                x[i, d] -= period * np.floor((x[i, d] - low) / period)


@jit
def bounce(domain, x):
    """Mirror particles x (N, n) that have passed a reflecting wall."""
    for d in range(domain.kind.size):
        if domain.kind[d] == REFLECTING:
            low, high = domain.low[d], domain.high[d]
            for i in range(x.shape[0]):
                if x[i, d] < low:
                    x[i, d] = min(2.0 * low - x[i, d], high)
                elif x[i, d] > high:
                    x[i, d] = max(2.0 * high - x[i, d], low)


@jit
def left_at(domain, x):
    """Number of a particle beyond the end of a bounded axis, or -1."""
    for d in range(domain.kind.size):
        if domain.kind[d] == BOUNDED:
            for i in range(x.shape[0]):
                if x[i, d] < domain.low[d] or x[i, d] > domain.high[d]:
                    return i
    return -1


@jit
def view_of(domain, x, m, h, reach):
    """Particles and the images of those that lie within `reach` of an end."""
    N, n = x.shape
    rows = 2 * N + 16
    at, sign, shift = np.empty((rows, n)), np.empty((rows, n)), np.empty((rows, n))
    owner, total = np.empty(rows, np.int64), N
    for i in range(N):
        owner[i] = i
        for d in range(n):
            at[i, d], sign[i, d], shift[i, d] = x[i, d], 1.0, 0.0
    for d in range(n):
        if domain.kind[d] != PERIODIC and domain.kind[d] != REFLECTING:
            continue
        low, high, mirror = domain.low[d], domain.high[d], domain.kind[d] == REFLECTING
        for e in range(total):  # images in this axis of the images in the axes before: corners are seen too
            for end in range(2):
                gap = at[e, d] - low if end == 0 else high - at[e, d]
                if gap >= reach or gap < 0.0:
                    continue
                if total == rows:
                    at, sign, shift, owner = _grown(at), _grown(sign), _grown(shift), _grown(owner)
                    rows = owner.size
                for c in range(n):
                    at[total, c], sign[total, c], shift[total, c] = at[e, c], sign[e, c], shift[e, c]
                owner[total] = owner[e]
                if mirror:
                    twice = 2.0 * (low if end == 0 else high)
                    at[total, d], sign[total, d], shift[total, d] = (
                        twice - at[e, d],
                        -sign[e, d],
                        twice - shift[e, d],
                    )
                else:
                    move = high - low if end == 0 else low - high
                    at[total, d], shift[total, d] = at[e, d] + move, shift[e, d] + move
                total += 1
    if total == N:
        return unseen(x, m, h)
    mass, length = np.empty(total), np.empty(total)
    for e in range(total):
        mass[e], length[e] = m[owner[e]], h[owner[e]]
    images = owner[N:total].copy(), sign[N:total].copy(), shift[N:total].copy()
    return View(at[:total].copy(), mass, length, *images)


@jit
def unseen(x, m, h):
    """The particles themselves, without images."""
    n = x.shape[1]
    return View(x, m, h, np.empty(0, np.int64), np.empty((0, n)), np.empty((0, n)))


@jit
def refresh(view, x, h):
    """Bring a view up to date with the particles' positions and smoothing lengths."""
    N, n = x.shape
    if view.owner.size == 0:
        return  # it shares their arrays
    for i in range(N):
        view.h[i] = h[i]
        for d in range(n):
            view.x[i, d] = x[i, d]
    for g in range(view.owner.size):
        i = view.owner[g]
        view.h[N + g] = h[i]
        for d in range(n):
            view.x[N + g, d] = view.sign[g, d] * x[i, d] + view.shift[g, d]


@jit
def with_images(view, values):
    """Values (N,) of the particles, and of their images after them, shape (N + G,)."""
    return np.concatenate((values, values[view.owner]))


@jit
def velocities(view, v):
    """Velocities v (N, n) of the particles, and of their images after them; v itself without images."""
    if view.owner.size == 0:
        return v
    N, n = v.shape
    out = np.empty((N + view.owner.size, n))
    for i in range(N):
        for d in range(n):
            out[i, d] = v[i, d]
    for g in range(view.owner.size):
        for d in range(n):
            out[N + g, d] = view.sign[g, d] * v[view.owner[g], d]
    return out


@jit
def _grown(a):
    """A copy with twice the rows."""
    return np.concatenate((a, np.empty_like(a)))
