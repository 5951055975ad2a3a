"""Many paths of any model over an interval: blocks in the cache, each with steps and normals of its own.

The general way, for noise that depends on the state and for drifts that are Python code; others go by
`_lanes`. A block is moved through the whole interval before the next one is touched. Its generator is known
by its number and its steps follow from its own states, so that the result does not depend on how threads
share the blocks.
"""

from functools import cache

import numpy as np
from numba import types

from sphfilter.core._addresses import ADDRESS, function_at
from sphfilter.core._jit import MATRIX, VECTOR, jit, jit_for
from sphfilter.core.sde_steps import jump, platen_steps, root_now, runge_kutta, shifted_path_steps

from ._normals import LANES, fill_normals, seed_lanes
from ._step_length import MOST_STEPS, SHIFTED_PATH, SPLIT, step_length

#: Steps between two looks at the step length.
_STEPS_PER_LOOK = 4
#: Moves within a look, over standard deviation and mean move, from which steps were too long; how much
#: shorter ones are tried then, and how often.
_OUT, _SHORTER, _TRIES = 25.0, 0.1, 4


@jit
def split_steps(x, t0, dt, drift, noise, p, L, normals):
    """Strang splitting: noise in jumps, drift by RK4 between them; of weak order 2.

    The jump that ends a step and the one that begins the next are one: there is one row of normals more than
    there are steps, normals (steps + 1, m, N), and the first and the last row make half a jump.
    """
    N, n, m = x.shape[0], x.shape[1], L.shape[0]
    nothing, work = np.zeros((N, n)), np.empty((5, N, n))
    g, sigma = np.empty((1, n * m)), np.empty((n, m))
    last = normals.shape[0] - 1
    for s in range(last + 1):
        t = t0 + s * dt
        root_now(noise, x, t, p, L, g, sigma)
        sigma *= np.sqrt(0.5 * dt if s == 0 or s == last else dt)
        jump(sigma, normals[s], work, x)
        if s < last:
            runge_kutta(x, t, dt, drift, p, (nothing, nothing, nothing), work)


@jit
def _take(scheme, x, t, dt, functions, constants, xi):
    """Take equal steps of a scheme with the normals xi (steps, k, N); splitting has one row more."""
    drift, noise = functions
    p, _, L = constants
    if scheme == SPLIT:
        split_steps(x, t, dt, drift, noise, p, L, xi)
    elif scheme == SHIFTED_PATH:
        shifted_path_steps(x, t, dt, drift, noise, p, L, xi)
    else:
        platen_steps(x, t, dt, drift, noise, p, L, xi)


@jit
def _lost(x, before, variance):
    """Whether a state is not finite, or has moved out of all proportion: steps were too long for it."""
    for a in range(x.shape[1]):
        move = np.abs(x[:, a] - before[:, a])
        bound = _OUT * (np.sqrt(variance[a]) + move.mean()) + 1e-300
        if not (move.max() <= bound and bound < np.inf):
            return True
    return False


@jit
def _move_block(scheme, x, span, limits, functions, constants, state):
    """Move one block x in place over the span; return (steps taken, length of the first).

    No steps taken means that none were short enough, or too many needed.
    """
    (t0, t1), (longest, h, tolerance) = span, limits
    N, m = x.shape[0], constants[2].shape[0]
    n_normals = m if scheme == SPLIT else 3 * m if scheme == SHIFTED_PATH else m + m * (m - 1) // 2
    normals, before = np.empty(((_STEPS_PER_LOOK + 1) * n_normals, N)), np.empty_like(x)
    elapsed, whole, taken, first, tries = 0.0, t1 - t0, 0, 0.0, 0  # from t0, where time is resolved best
    while elapsed < whole:
        h, t = min(h, longest, whole - elapsed), t0 + elapsed
        if tolerance < np.inf and not tries:
            h = min(step_length(scheme, x, t, h, functions, constants, tolerance), longest)
        if taken >= MOST_STEPS or not elapsed + h > elapsed:
            return 0, t
        left = max(1, int(np.ceil((whole - elapsed) / h * (1 - 1e-12))))
        n_steps, dt = min(left, _STEPS_PER_LOOK), (whole - elapsed) / left
        drawn = n_steps + 1 if scheme == SPLIT else n_steps
        fill_normals(state, normals[: drawn * n_normals])
        before[:] = x
        xi = normals[: drawn * n_normals].reshape((drawn, n_normals, N))
        _take(scheme, x, t, dt, functions, constants, xi)
        if _lost(x, before, constants[1]):
            if tries == _TRIES or (tolerance == np.inf and not np.isfinite(x).all()):
                return 0, t
            if tolerance < np.inf:  # steps of given length are left as they are
                x[:], h, tries = before, _SHORTER * dt, tries + 1
                continue
        first, tries = first if taken else dt, 0
        taken += n_steps
        elapsed = whole if n_steps == left else elapsed + n_steps * dt
    return taken, first


def _move_blocks(x, report, which, span, limits, addresses, constants, stream):
    """Move some blocks of x (N, n), by number; `report` (blocks, 2) gets what `_move_block` returns."""
    scheme, seed = stream
    state = np.empty((6, LANES), dtype=np.uint64)
    functions = (function_at(addresses[0]), function_at(addresses[1]))
    for b in which:
        seed_lanes(np.uint64(seed), np.uint64(b), state)
        rows = slice(b * LANES, min((b + 1) * LANES, x.shape[0]))
        report[b, 0], report[b, 1] = _move_block(scheme, x[rows], span, limits, functions, constants, state)


@cache
def move_blocks():
    """The compiled loop over blocks, for any model; compiled (or loaded from the disk cache) at first use.

    Its arguments are the states x (N, n), moved in place; `report` (blocks, 2), which gets the steps taken,
    zero for a failure, and the first of them; the numbers of the blocks; the span (t0, t1); the longest step,
    the one to try first and the tolerance in standard deviations; addresses of drift and noise; p, the
    variance (n,) of all states, and L with L Lᵀ = Q; and scheme and seed.
    """
    numbers = types.UniTuple(types.float64, 2), types.UniTuple(types.float64, 3), types.UniTuple(ADDRESS, 2)
    constants, stream = types.Tuple((VECTOR, VECTOR, MATRIX)), types.UniTuple(types.int64, 2)
    return jit_for(types.void(MATRIX, MATRIX, types.int64[::1], *numbers, constants, stream), _move_blocks)


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
