"""Noise of points that is kept, so that it can be changed a little, and motion along it."""

import numpy as np

from .._jit import jit
from .move import chunk_room, move_chunk
from .noise import LANES, fill_noise, uniform


@jit
def uniforms(key, count):
    """Numbers (count,) of the open unit interval, of a key."""
    out = np.empty(count)
    for i in range(count):
        out[i] = uniform(key, np.uint64(i))
    return out


@jit
def noise_of(key, count, d, kind):
    """Noise (3, d, count) of so many points, as `walk` takes it."""
    out, Z, state = np.empty((3, d, count)), np.zeros((3, d, LANES)), np.empty(LANES, np.uint64)
    for c in range(-(-count // LANES)):
        begin, end = c * LANES, min((c + 1) * LANES, count)
        fill_noise(key, np.uint64(c), kind, state, Z)
        out[:, :, begin:end] = Z[:, :, : end - begin]
    return out


@jit
def renew(noise, fresh, chance, key):
    """Put fresh noise into noise (3, d, N) in place: into every entry of a point with its chance (N,)."""
    _, d, N = noise.shape
    for r in range(d):
        for i in range(N):
            if uniform(key, np.uint64(r * N + i)) < chance[i]:
                for a in range(3):
                    noise[a, r, i] = fresh[a, r, i]


@jit
def move_along(leg, x, u, V, block, noise):
    """Move points x (n, N) over a leg in place, as `move` does, along noise (3, d, N) that is given."""
    (n, N), Z = x.shape, np.zeros((3, V.shape[2], LANES))
    room = chunk_room(n, leg.root.shape[0])
    for c in range(-(-N // LANES)):
        begin, end = c * LANES, min((c + 1) * LANES, N)
        Z[:, :, : end - begin] = noise[:, :, begin:end]
        move_chunk(leg, c, x, u, V, block, Z, room)
