"""Points moved over a leg with noise of which a part is given: what moves their ends."""

import numpy as np
from numba import types

from .._addresses import Entry
from .._jit import MATRIX, jit
from .._views import rows_at
from .linearise import end_of_block
from .noise import LANES, fill_noise
from .steps import CUBE, LEG, new_room, walk


@jit
def steer(V, block, u, W, along):
    """Make increments W (d, LANES) such that V W is u (n, K), and the rest of it what it was.

    V is (blocks, n, d). Points of a chunk are in the order of their blocks, `block` (K,).
    """
    (_, n, d), K, begin = V.shape, u.shape[1], 0
    flat = W.reshape(-1)
    while begin < K:
        b, end = block[begin], end_of_block(block[:K], begin)
        size = end - begin
        for a in range(n):
            for i in range(size):
                along[a, i] = u[a, begin + i]
        for k in range(d):
            w = rows_at(flat, k * LANES + begin, 1, size)
            for a in range(n):
                v = V[b, a, k]
                if v != 0.0:
                    for i in range(size):
                        along[a, i] -= v * w[0, i]
        for k in range(d):
            w = rows_at(flat, k * LANES + begin, 1, size)
            for a in range(n):
                v = V[b, a, k]
                if v != 0.0:
                    for i in range(size):
                        w[0, i] += v * along[a, i]
        begin = end


@jit
def affine(x, u, block, start, end, flow, lower):
    """Points (N, n) end + Φ (x - start) + L u of their blocks."""
    (N, n), first = x.shape, 0
    y = np.empty((N, n))
    while first < N:
        b, last = block[first], end_of_block(block, first)
        for a in range(n):
            for i in range(first, last):
                y[i, a] = end[b, a]
            for e in range(n):
                on, drawn, about = flow[b, a, e], lower[b, a, e], start[b, e]
                for i in range(first, last):
                    y[i, a] += on * (x[i, e] - about) + drawn * u[i, e]
        first = last
    return y


@jit
def move_chunk(leg, c, x, u, V, block, Z, room):
    """Move chunk c of points x (N, n) over a leg in place, along noise Z (3, d, LANES), which is changed.

    `room` is that of `chunk_room`.
    """
    (N, n), (given, along, work) = x.shape, room
    begin, end = c * LANES, min((c + 1) * LANES, N)
    K = end - begin
    for i in range(K):
        for a in range(n):
            given[a, i] = u[begin + i, a]
    steer(V, block[begin:end], given[:, :K], Z[0], along)
    walk(leg, x[begin:end], Z, c % 2 == 1, work)


@jit
def chunk_room(n, m):
    """Scratch for a chunk of points in n dimensions with m noises."""
    return np.empty((n, LANES)), np.empty((n, LANES)), new_room(m)


@jit
def move(leg, x, u, V, block, key, first, last):
    """Move the chunks first <= c < last of points x (N, n) over a leg, in place.

    `u` (N, n) says what moves each point's end, V (blocks, n, d) how, `block` (N,) whose; blocks never
    decrease. A chunk has generators of its own, so that the bits do not depend on who moves it.
    """
    state, Z = np.empty(LANES, np.uint64), np.empty((3, V.shape[2], LANES))
    room = chunk_room(x.shape[1], leg.root.shape[0])
    for c in range(first, last):
        fill_noise(key, np.uint64(c), leg.kind, state, Z)
        move_chunk(leg, c, x, u, V, block, Z, room)


_MOVES = LEG, MATRIX, MATRIX, CUBE, types.int64[::1], types.uint64, types.int64, types.int64
MOVE = Entry(move, _MOVES, types.void)
move_at = MOVE.at
