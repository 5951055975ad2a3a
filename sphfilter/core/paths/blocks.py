"""Many paths of a model over an interval: blocks that fit the cache, each with steps and normals of its own.

A block is moved through the whole interval before the next one is touched. Its generator is known by its
number and its steps follow from its own states, so that the result does not depend on how threads share the
blocks. Paths that leave the finite numbers, or a bounded axis, are given up: they stand on another path of
their block from then on, and are marked.
"""

from functools import cache

import numpy as np
from numba import types

from .._addresses import ADDRESS, function_at
from .._jit import MATRIX, VECTOR, jit, jit_for
from ..domain import DOMAIN, REFLECTING, bounce, left_at
from ..sde_steps import platen_steps, shifted_path_steps, split_steps
from .normals import LANES, fill_normals, seed_lanes
from .step_length import SHIFTED_PATH, SPLIT, step_length

__all__ = ["MOST_STEPS", "fill_rows", "move_blocks", "standard_normals"]

#: Steps between two looks at the step length, and the most steps a block may take.
_STEPS_PER_LOOK, MOST_STEPS = 4, 1_000_000
#: Part of the largest speed from which paths are given up where no step is short enough.
_FAST = 0.1
#: Extents of a block that no path crosses within a look; how much shorter steps are then, and how often.
_OUT, _SHORTER, _TRIES = 5.0, 0.1, 4
#: Extents of the start, beyond which a path has run away if the drift would carry it so many times as far.
_OUTSIDE, _MANY = 10.0, 100.0


@jit
def _take(scheme, x, t, dt, functions, constants, domain, xi):
    """Take equal steps of a scheme with the normals xi (steps, k, N); splitting has one row more."""
    drift, noise = functions
    p, _, L = constants
    if scheme == SPLIT:
        split_steps(x, t, dt, drift, noise, p, L, xi)
        return
    ends = np.any(domain.kind >= 2)  # walls are looked at after every step
    at_once = 1 if ends else xi.shape[0]
    before = x.copy() if ends else x
    for s in range(0, xi.shape[0], at_once):
        if ends:
            before[:] = x
        if scheme == SHIFTED_PATH:
            shifted_path_steps(x, t + s * dt, dt, drift, noise, p, L, xi[s : s + at_once])
        else:
            platen_steps(x, t + s * dt, dt, drift, noise, p, L, xi[s : s + at_once])
        if ends:
            _reflect(before, x, t + s * dt, dt, noise, p, L, domain, xi[s])
            bounce(domain, x)


@jit
def _reflect(before, x, t, dt, noise, p, L, domain, xi):
    """Push paths from states `before` (N, n) to x back by as much as they passed reflecting walls on the way.

    How far a path of Brownian motion goes between two states is drawn from two normals an axis, the last rows
    of xi (k, N): exact where noise and drift do not change on the way (Lépingle 1995).
    """
    N, n = x.shape
    m, row = L.shape[0], xi.shape[0]
    g = np.empty((N, n * m))
    noise(before, t, p, g)
    for a in range(n):
        if domain.kind[a] != REFLECTING:
            continue
        row -= 2
        for i in range(N):
            variance = 0.0
            for k in range(m):
                s = 0.0
                for r in range(m):
                    s += g[i, a * m + r] * L[r, k]
                variance += s * s * dt
            one, other = before[i, a], x[i, a]
            spread = variance * (xi[row, i] ** 2 + xi[row + 1, i] ** 2)
            way = np.sqrt((other - one) ** 2 + spread)
            if one - domain.low[a] < domain.high[a] - one:
                x[i, a] += max(0.0, domain.low[a] - 0.5 * (one + other - way))
            else:
                x[i, a] -= max(0.0, 0.5 * (one + other + way) - domain.high[a])


@jit
def _bridged(xi, dt, left, rest):
    """Make the increments in normals xi (steps, k, N), its first rows, those of paths whose ends are known.

    `rest` (m, N) is what is missing of each path's noise over the seconds that are left, and is brought
    forward by the steps of length dt.
    """
    for s in range(xi.shape[0]):
        part = min(dt / left, 1.0)
        pull, own = part / np.sqrt(dt), np.sqrt(1.0 - part)
        for k in range(rest.shape[0]):
            for i in range(rest.shape[1]):
                xi[s, k, i] = pull * rest[k, i] + own * xi[s, k, i]
                rest[k, i] -= np.sqrt(dt) * xi[s, k, i]
        left -= dt


@jit
def _give_up(x, alive, gone):
    """Mark paths and put them on one that goes on; False where there is none."""
    kept = -1
    for i in range(x.shape[0]):
        if gone[i]:
            alive[i] = False
        elif kept < 0:
            kept = i
    if kept >= 0:
        for i in range(x.shape[0]):
            if gone[i]:
                x[i] = x[kept]
    return kept >= 0


@jit
def _calmest(x, before, a):
    """Largest move along an axis in the quarter of a block where that is smallest."""
    N, calm = x.shape[0], np.inf
    for q in range(4):
        most = 0.0
        for i in range(q, N, 4):
            most = max(most, abs(x[i, a] - before[i, a]))
        calm = min(calm, most)
    return calm if np.isfinite(calm) else 0.0


@jit
def _lost(x, before, variance, domain, gone):
    """Find the paths that are not finite, out of all proportion, or beyond an end; how many there are."""
    gone[:] = False
    for a in range(x.shape[1]):
        low, high = before[:, a].min(), before[:, a].max()
        far = _OUT * (high - low + np.sqrt(variance[a]) + _calmest(x, before, a)) + 1e-300
        for i in range(x.shape[0]):
            gone[i] |= not (x[i, a] > low - far and x[i, a] < high + far)
    if np.any(domain.kind == 2):
        for i in range(x.shape[0]):
            gone[i] |= left_at(domain, x[i : i + 1]) >= 0
    return gone.sum()


@jit
def _runs_away(x, extents, t, left, drift, p, gone):
    """Find the paths outside of all others' start whose drift carries them on, many times as far."""
    gone[:] = False
    for i in range(x.shape[0]):
        for a in range(x.shape[1]):
            gone[i] |= abs(x[i, a] - extents[0, a]) > _OUTSIDE * extents[1, a]
    if not gone.any():
        return False
    velocity = np.empty(x.shape)
    drift(x, t, p, velocity)
    for i in range(x.shape[0]):
        outward = distance = 0.0
        for a in range(x.shape[1]):
            if extents[1, a] > 0.0:
                d = (x[i, a] - extents[0, a]) / extents[1, a]
                outward += d * velocity[i, a] / extents[1, a]
                distance += d * d
        gone[i] &= not outward * left <= _MANY * distance
    return gone.any()


@jit
def _fastest(x, t, drift, p, gone):
    """Find the paths whose velocity is not finite, or if there are none those that are nearly the fastest."""
    velocity = np.empty(x.shape)
    drift(x, t, p, velocity)
    speed = np.abs(velocity).sum(axis=1)
    finite = np.isfinite(speed)
    if finite.all():
        gone[:] = speed >= _FAST * speed.max()
    else:
        gone[:] = ~finite


@jit
def _move_block(scheme, x, alive, ends, span, limits, functions, constants, domain, state):
    """Move one block x in place over the span; return (steps taken, length of the first).

    Noise sums up to that of `ends` (m, N), in units of its own standard deviation; to anything where that
    has no rows. No steps taken means that they were too many.
    """
    (t0, t1), (longest, h, tolerance, most) = span, limits
    (N, n), m = x.shape, constants[2].shape[0]
    n_normals = m if scheme == SPLIT else 3 * m if scheme == SHIFTED_PATH else m + m * (m - 1) // 2
    n_normals += 2 * np.sum(domain.kind == REFLECTING)
    normals, gone = np.empty(((_STEPS_PER_LOOK + 1) * n_normals, N)), np.zeros(N, np.bool_)
    before, tries, extents = np.empty_like(x), 0, np.empty((2, n))
    rest = np.sqrt(t1 - t0) * ends
    rest_before = rest.copy()
    for a in range(n):
        low, high = x[:, a].min(), x[:, a].max()
        extents[0, a] = 0.5 * (low + high)
        extents[1, a] = high - low + np.sqrt(constants[1][a])
    elapsed, whole, taken, first = 0.0, t1 - t0, 0, 0.0  # from t0, where time is resolved best
    while elapsed < whole:
        t = t0 + elapsed
        h = min(h, longest, whole - elapsed)
        if tolerance < np.inf and not tries:
            h = min(step_length(scheme, x, t, h, functions, constants, tolerance), longest)
        if taken >= most:
            return 0, t
        if not elapsed + h > elapsed:
            _fastest(x, t, functions[0], constants[0], gone)
            if not _give_up(x, alive, gone):
                return max(taken, 1), first
            h, tries = whole - elapsed, 0
            continue
        left = max(1, int(np.ceil((whole - elapsed) / h * (1 - 1e-12))))
        n_steps, dt = min(left, _STEPS_PER_LOOK), (whole - elapsed) / left
        drawn = n_steps + 1 if scheme == SPLIT else n_steps
        fill_normals(state, normals[: drawn * n_normals])
        xi = normals[: drawn * n_normals].reshape((drawn, n_normals, N))
        before[:] = x
        rest_before[:] = rest
        _bridged(xi, dt, whole - elapsed, rest)
        _take(scheme, x, t, dt, functions, constants, domain, xi)
        lost = _lost(x, before, constants[1], domain, gone)
        if tolerance == np.inf:  # steps of given length are left as they are, as long as they are finite
            for i in range(N):
                gone[i] = not np.isfinite(x[i]).all()
            lost = gone.sum()
        if lost:
            if tries < _TRIES:  # a stiff drift throws states about where steps are too long for it
                x[:], rest[:], h, tries = before, rest_before, _SHORTER * dt, tries + 1
                continue
            if not _give_up(x, alive, gone):
                return max(taken, 1), first
        ran = tolerance < np.inf and _runs_away(
            x, extents, t0 + elapsed, whole - elapsed, functions[0], constants[0], gone
        )
        if ran and not _give_up(x, alive, gone):
            return max(taken, 1), first
        tries = 0
        first = first if taken else dt
        taken += n_steps
        elapsed = whole if n_steps == left else elapsed + n_steps * dt
    return taken, first


def _move_blocks(x, alive, ends, report, which, span, limits, addresses, constants, domain, stream):
    """Move some blocks of x (N, n), by number; `report` (blocks, 2) gets what `_move_block` returns."""
    scheme, seed = stream
    state = np.empty((6, LANES), dtype=np.uint64)
    functions = (function_at(addresses[0]), function_at(addresses[1]))
    for b in which:
        seed_lanes(np.uint64(seed), np.uint64(b), state)
        rows = slice(b * LANES, min((b + 1) * LANES, x.shape[0]))
        report[b, 0], report[b, 1] = _move_block(
            scheme, x[rows], alive[rows], ends[:, rows], span, limits, functions, constants, domain, state
        )


@cache
def move_blocks():
    """The compiled loop over blocks, for any model; compiled (or loaded from the disk cache) at first use.

    Its arguments are the states x (N, n), moved in place; `alive` (N,), where paths given up are marked;
    `ends` (m, N), standard normals that say where noise ends, or (0, N);
    `report` (blocks, 2), which gets the steps taken and the first of them; the numbers of the blocks; the
    span (t0, t1); the longest step, the one to try first, the tolerance in standard deviations and the most
    steps; addresses of drift and noise; p, the variance (n,) of all states, and L with L Lᵀ = Q; the domain;
    and scheme and seed.
    """
    constants = types.Tuple((VECTOR, VECTOR, MATRIX))
    numbers = types.UniTuple(types.float64, 2), types.UniTuple(types.float64, 4)
    functions, stream = types.UniTuple(ADDRESS, 2), types.UniTuple(types.int64, 2)
    alive, which = types.boolean[::1], types.int64[::1]
    arrays = MATRIX, alive, MATRIX, MATRIX, which
    signature = types.void(*arrays, *numbers, functions, constants, DOMAIN, stream)
    return jit_for(signature, _move_blocks)


def standard_normals(seed, N, k):
    """Return independent standard normals, shape (N, k)."""
    out = np.empty((N, k))
    fill_rows(seed, out)
    return out


@jit
def fill_rows(seed, out):
    """Fill out (N, k) with independent standard normals."""
    state, rows = np.empty((6, LANES), dtype=np.uint64), np.empty((out.shape[1], LANES))
    for b in range(-(-out.shape[0] // LANES)):
        seed_lanes(np.uint64(seed), np.uint64(b), state)
        fill_normals(state, rows)
        block = out[b * LANES : (b + 1) * LANES]
        block[:] = rows[:, : block.shape[0]].T
