"""Points moved over a leg with noise of which a part is given: what moves their ends."""

import numpy as np
from numba import types

from .._addresses import Entry
from .._jit import MATRIX, jit
from .._views import lent, stretch
from .blocks import add_products, multiplied, steered
from .noise import LANES, fill_noise
from .steps import CUBE, LEG, Leg, new_room, walk
from .weights import taken


@jit
def over(leg, flow, t0, t1, steps):
    """A leg's model over a span of time, along its drift as `flow` follows it."""
    fixed = leg.drift, leg.jacobian, leg.noise, flow, leg.walk, leg.linearise, leg.move
    data, kinds = (leg.p, leg.root, leg.domain), (leg.kind, leg.constant, leg.walls)
    return Leg(*fixed, *data, t0, (t1 - t0) / steps, steps, *kinds)


@jit
def shifted(x, u, block, lower):
    """Points x + L u (n, N) of their blocks."""
    y = x.copy()
    add_products(y, 1.0, lower, u, block)
    return y


@jit
def affine(x, u, block, start, end, flow, lower):
    """Points (n, N) end + Φ (x - start) + L u of their blocks."""
    blocks, n = start.shape
    flowed = multiplied(flow, start.copy().reshape(blocks, n, 1)).reshape(blocks, n)
    y = taken((end - flowed).T.copy(), block)
    add_products(y, 1.0, flow, x, block)
    add_products(y, 1.0, lower, u, block)
    return y


@jit
def move_chunk(leg, c, x, u, V, block, Z, room):
    """Move chunk c of points x (n, N) over a leg in place, along noise Z (3, d, LANES), which is changed.

    `room` is that of `chunk_room`.
    """
    leg, x, u, V, block, Z, room = lent((leg, x, u, V, block, Z, room))
    (n, N), (given, rows, work) = x.shape, room
    begin, end = c * LANES, min((c + 1) * LANES, N)
    K = end - begin
    for a in range(n):
        moving, moved_by = stretch(x, a, begin, K), stretch(u, a, begin, K)
        for i in range(K):
            given[a, i], rows[i, a] = moved_by[i], moving[i]
    steered(V, block[begin:end], given, Z[0])
    walk(leg, rows[:K], Z, c % 2 == 1, work)
    for a in range(n):
        moving = stretch(x, a, begin, K)
        for i in range(K):
            moving[i] = rows[i, a]


@jit
def chunk_room(n, m):
    """Scratch for a chunk of points in n dimensions with m noises."""
    return np.empty((n, LANES)), np.empty((LANES, n)), new_room(m)


@jit
def move(leg, x, u, V, block, key, first, last):
    """Move the chunks first <= c < last of points x (n, N) over a leg, in place.

    `u` (n, N) says what moves each point's end, V (blocks, n, d) how, `block` (N,) whose; blocks never
    decrease. A chunk has generators of its own, so that the bits do not depend on who moves it.
    """
    state, Z = np.empty(LANES, np.uint64), np.empty((3, V.shape[2], LANES))
    room = chunk_room(len(x), leg.root.shape[0])
    for c in range(first, last):
        fill_noise(key, np.uint64(c), leg.kind, leg.walls, state, Z)
        move_chunk(leg, c, x, u, V, block, Z, room)


_MOVES = LEG, MATRIX, MATRIX, CUBE, types.int64[::1], types.uint64, types.int64, types.int64
MOVE = Entry(move, _MOVES, types.void)
move_at = MOVE.at


@jit
def moved_over(leg, x, u, V, block, key):
    """Points moved over a leg, all chunks of x (n, N), as `move` says."""
    y = x.copy()
    move_at(leg.move)(leg, y, u, V, block, key, 0, -(-x.shape[1] // LANES))
    return y


@jit
def move_along(leg, x, u, V, block, noise):
    """Move points x (n, N) over a leg in place, as `move` does, along noise (3, d, N) that is given."""
    (n, N), Z = x.shape, np.zeros((3, V.shape[2], LANES))
    room = chunk_room(n, leg.root.shape[0])
    for c in range(-(-N // LANES)):
        begin, end = c * LANES, min((c + 1) * LANES, N)
        Z[:, :, : end - begin] = noise[:, :, begin:end]
        move_chunk(leg, c, x, u, V, block, Z, room)
