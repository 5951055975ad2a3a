"""Random numbers of a key: three-point and normal noise in lanes, rotations and shifts of a net."""

import math

import numpy as np

from .._jit import jit
from .._views import lent, stretch

#: Points that are moved together: of four states, 8 numbers each in a step, they fill the first-level cache,
#: 128 * 4 * 8 * 8 bytes = 32 KB.
LANES = 128
_PIECE = 4 * LANES  # of a net: of four states, 2 * 4 numbers each, 512 * 2 * 4 * 8 bytes = 32 KB
#: Noise of a leg: it depends on the state, or stands beside the drift; or is that of a map, and normal.
OF_STATE, ADDITIVE, NORMAL = range(3)

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)  # 2^64 / ((1 + √5) / 2), made odd
#: Ends of the sixths of 2^32 at either side, whose numbers become minus and plus the root of three.
_LOW, _HIGH = np.uint64(2**32 // 6), np.uint64(2**32 - 2**32 // 6)
_HALF, _ROOT_3 = np.uint64(2**32 - 1), math.sqrt(3.0)  # lower half of a word; E x² = 1 with (√3)² / 3


@jit
def mixed(key, word):
    """A key of a key and a word, both uint64: splitmix64's finaliser (Steele, Lea & Flood 2014)."""
    z = key + _GOLDEN * (word + np.uint64(1))
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@jit
def stored(key, number):
    """The key of one of the things that a key is for, as a number that signed integers hold."""
    return np.int64(mixed(np.uint64(key), np.uint64(number)) >> np.uint64(1))


@jit
def seed_lanes(key, stream, state):
    """Fill the state (LANES,) of stream number `stream` of a key; no lane is zero."""
    own = mixed(key, stream)
    for i in range(state.size):
        state[i] = mixed(own, np.uint64(i)) | np.uint64(1)


@jit
def _next(state):
    """Move every lane on: xorshift64 (Marsaglia 2003), which is vector code."""
    for i in range(state.size):
        s = state[i]
        s ^= s << np.uint64(13)
        s ^= s >> np.uint64(7)
        state[i] = s ^ (s << np.uint64(17))


@jit
def fill_three_points(state, out):
    """Fill out (K, LANES) with 0, or ±√3 with probability 1/6 each: a normal's moments up to the fifth.

    A word makes two numbers, of its upper and its lower half.
    """
    for r in range(0, out.shape[0], 2):
        _next(state)
        row = out[r]
        for i in range(state.size):
            half = state[i] >> np.uint64(32)
            row[i] = (_ROOT_3 if half >= _HIGH else 0.0) - (_ROOT_3 if half < _LOW else 0.0)
        if r + 1 < out.shape[0]:
            row = out[r + 1]
            for i in range(state.size):
                half = state[i] & _HALF
                row[i] = (_ROOT_3 if half >= _HIGH else 0.0) - (_ROOT_3 if half < _LOW else 0.0)


@jit
def fill_signs(state, out):
    """Fill out (K, LANES) with ±1: a bit each of a word, of which the lower half is not used."""
    for r in range(out.shape[0]):
        if r % 32 == 0:
            _next(state)
        row, bit = out[r], np.uint64(63 - r % 32)
        for i in range(state.size):
            row[i] = 1.0 if (state[i] >> bit) & np.uint64(1) else -1.0


@jit
def fill_normals(state, out):
    """Fill out (K, LANES) with normals, by Box and Muller."""
    low = np.empty(state.size)
    for r in range(0, out.shape[0], 2):
        _next(state)
        for i in range(state.size):
            low[i] = (np.float64(state[i] >> np.uint64(12)) + 0.5) * 2.0**-52
        _next(state)
        for i in range(state.size):
            turn = 2.0 * math.pi * (np.float64(state[i] >> np.uint64(12)) + 0.5) * 2.0**-52
            far = math.sqrt(-2.0 * math.log(low[i]))
            out[r, i] = far * math.cos(turn)
            if r + 1 < out.shape[0]:
                out[r + 1, i] = far * math.sin(turn)


@jit
def fill_noise(key, stream, kind, walls, state, Z):
    """Fill Z (3, d, LANES) for `walk` with stream number `stream` of a key; `state` (LANES,) is scratch.

    Beside walls increments are normal, too: how far a path goes hangs on more than their moments.
    """
    state, Z = lent((state, Z))
    seed_lanes(key, stream, state)
    if kind == NORMAL or walls:
        fill_normals(state, Z[0])
    else:
        fill_three_points(state, Z[0])
    if kind == NORMAL:
        return
    if kind == ADDITIVE:
        fill_three_points(state, Z[1])
    fill_signs(state, Z[2])


@jit
def uniform(key, word):
    """A number of the open unit interval, of a key and a word."""
    return (np.float64(mixed(key, word) >> np.uint64(12)) + 0.5) * 2.0**-52


@jit
def even_normals(z, key):
    """The points of a net z (n, N), turned and shifted cyclically by a key."""
    n, N = z.shape
    turn, shift = rotation(key, n), int(uniform(key, np.uint64(2**40)) * N)
    out = np.empty((n, N))
    for first, last, begin in ((0, N - shift, shift), (N - shift, N, 0)):
        for at in range(first, last, _PIECE):
            size = min(_PIECE, last - at)
            for a in range(n):
                own = stretch(out, a, at, size)
                for e in range(n):
                    given, part = stretch(z, e, begin + at - first, size), turn[a, e]
                    for i in range(size):
                        own[i] = part * given[i] + (own[i] if e > 0 else 0.0)
    return out


@jit
def rotation(key, n):
    """A random rotation (n, n) of a key: Gram and Schmidt on normals (Box & Muller)."""
    Q, word = np.empty((n, n)), 0
    for a in range(n):
        length = 0.0
        while not length > 1e-3:  # else it lies among the rows before, and would be rounding
            for b in range(n):
                r = math.sqrt(-2.0 * math.log(uniform(key, np.uint64(word))))
                Q[a, b] = r * math.cos(2.0 * math.pi * uniform(key, np.uint64(word + 1)))
                word += 2
            for c in range(a):
                along = 0.0
                for b in range(n):
                    along += Q[a, b] * Q[c, b]
                for b in range(n):
                    Q[a, b] -= along * Q[c, b]
            length = 0.0
            for b in range(n):
                length += Q[a, b] * Q[a, b]
        for b in range(n):
            Q[a, b] /= math.sqrt(length)
    return Q


@jit
def uniforms(key, count):
    """Numbers (count,) of the open unit interval, of a key."""
    out = np.empty(count)
    for i in range(count):
        out[i] = uniform(key, np.uint64(i))
    return out


@jit
def noise_of(key, count, d, kind, walls):
    """Noise (3, d, count) of so many points, as `walk` takes it."""
    out, Z, state = np.empty((3, d, count)), np.zeros((3, d, LANES)), np.empty(LANES, np.uint64)
    for c in range(-(-count // LANES)):
        begin, end = c * LANES, min((c + 1) * LANES, count)
        fill_noise(key, np.uint64(c), kind, walls, state, Z)
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
