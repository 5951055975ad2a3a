"""A cloud's move over an interval: blocks of states stored axis by axis, steps with the drift compiled in.

A block of `LANES` states is read (resampled on the way), moved through the whole interval while it lies in
the first-level cache, and written together with its moments. Its noise follows from seed and block number,
and its steps from its own states, so that the result does not depend on how threads share the blocks. The
loop is compiled once for all models, whose steps it gets by address.
"""

from functools import cache

import numpy as np
from numba import njit, types

from sphfilter.core._addresses import ADDRESS, function_at
from sphfilter.core._jit import MATRIX, VECTOR, jit, jit_for
from sphfilter.core.sde_steps import root_now

from ._inlined import NEW_STEP, NEW_TRIAL
from ._lane_noise import fill_noise
from ._step_length import MOST_STEPS, better_length
from ._weights import ANY_ORDER, LANES, block_moments

#: Steps between two looks at the step length.
_STEPS_PER_LOOK = 8
#: Moves within a look, over standard deviation and mean move, from which steps were too long; how much
#: shorter ones are tried then, and how often.
_OUT, _SHORTER, _TRIES = 25.0, 0.1, 4
_WITHOUT_SIGN = np.int64(2**63 - 1)


@jit
def _seed(seed, block, lanes):
    """Fill the generators lanes[:2] of a block by splitmix64, the numbers of all blocks being in one row."""
    for r in range(2):
        for i in range(lanes.shape[1]):
            place = (block * np.uint64(2) + np.uint64(r)) * np.uint64(lanes.shape[1]) + np.uint64(i)
            z = seed + (place + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
            z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            lanes[r, i] = z ^ (z >> np.uint64(31))


@jit
def _top(row, one):
    """Largest size of a row, not finite if one is not; as whole numbers, which order alike and need no flags.

    `one` (1,) is scratch.
    """
    top = np.int64(0)
    for bits in row.view(np.int64):
        top = max(top, bits & _WITHOUT_SIGN)
    one.view(np.int64)[0] = top
    return one[0]


@njit(**ANY_ORDER)
def _three_sums(moved, change):
    """Sums of a row, of its squares, and of the squares of another one."""
    mean = square = total = 0.0
    for i in range(moved.size):
        mean += moved[i]
        square += moved[i] * moved[i]
        total += change[i] * change[i]
    return mean, square, total


@jit
def _spread(work, variance, unit, room):
    """Fill each axis' standard deviation (n,), of all states and of the moves; errors in it: rms, largest."""
    N, worst_rms, worst = work.shape[2], 0.0, 0.0
    for a in range(variance.size):
        mean, square, total = _three_sums(work[1, a], work[0, a])
        if not total + square < np.inf:
            return np.inf, np.inf
        unit[a] = np.sqrt(variance[a] + max(square / N - (mean / N) ** 2, 0.0))
        if total > 0.0:
            worst_rms = max(worst_rms, np.sqrt(total / N) / unit[a])
            worst = max(worst, _top(work[0, a], room[0]) / unit[a])
    return worst_rms, worst


@jit
def _rate(work, unit, room):
    """Largest |change| / |bend| of a state, in standard deviations: half its rate times the step."""
    above, below = room[1], room[2]
    above[:] = below[:] = 0.0
    for a in range(unit.size):
        if unit[a] > 0.0:
            _add_squares(work[0, a], work[2, a], unit[a], above, below)
    for i in range(below.size):
        above[i] = above[i] / below[i] if below[i] > 1e-24 else 0.0  # not rounding alone
    return np.sqrt(_top(above, room[0]))


@njit(**ANY_ORDER)
def _add_squares(change, bend, unit, above, below):
    """Add the squares of two rows, in units, to other two."""
    scale = 1.0 / unit**2
    for i in range(change.size):
        above[i] += scale * change[i] * change[i]
        below[i] += scale * bend[i] * bend[i]


@jit
def _length(scheme, x, t, h, trial, noise, constants, room, tolerance):
    """Step, at most twice h, whose bias is about the tolerance; zero when there is none."""
    (p, variance, L), (_, sigma, work, rows) = constants, room
    unit, state, g = np.empty(x.shape[0]), np.empty((1, x.shape[0])), np.empty((1, x.shape[0] * L.shape[0]))
    root_now(noise, state, t, p, L, g, sigma[0])
    for _ in range(60):
        trial(x, sigma, t, h, p, work)
        rms, largest = _spread(work, variance, unit, rows)
        rate = 2.0 * _rate(work, unit, rows) if rms < np.inf else np.inf
        h, enough = better_length(scheme, h, rms, largest, rate, tolerance)
        if enough:
            return h
    return 0.0


@jit
def _steps(x, lanes, given, t, h, n_steps, step, noise, constants, sigma):
    """Take equal steps of a block; given (2, 2 m, LANES) is scratch, with zeros first.

    The first and the last step have normals, which make the density smooth.
    """
    p, _, L = constants
    state, g = np.empty((1, x.shape[0])), np.empty((1, x.shape[0] * L.shape[0]))
    for s in range(n_steps):
        for j in range(3):
            root_now(noise, state, t + (s + 0.5 * j) * h, p, L, g, sigma[j])
        outer = s == 0 or s == n_steps - 1
        if outer:
            fill_noise(lanes, given[1])
        step(x, lanes, given[1] if outer else given[0], 0.0 if outer else 1.0, sigma, t + s * h, h, p)


@njit(**ANY_ORDER)
def _moves(x, before, move):
    """Fill the moves of a row; their mean size."""
    total = 0.0
    for i in range(x.size):
        move[i] = x[i] - before[i]
        total += abs(move[i])
    return total / x.size


@jit
def _lost(x, before, variance, room):
    """Whether a state is not finite, or has moved out of all proportion: steps were too long for it."""
    for a in range(x.shape[0]):
        mean = _moves(x[a], before[a], room[1])
        bound = _OUT * (np.sqrt(variance[a]) + mean) + 1e-300
        if not (_top(room[1], room[0]) <= bound and bound < np.inf):
            return True
    return False


@jit
def _through(scheme, x, lanes, given, span, limits, step, trial, noise, constants, room):
    """Move one block x (n, LANES) in place over the span; return (steps taken, length of the first).

    No steps taken means that none were short enough, or too many needed. `room` is scratch: a block, σ at
    three times, what a trial fills, and rows; `given` is that of `_steps`.
    """
    (t0, t1), (longest, h, tolerance) = span, limits
    elapsed, whole, taken, first, tries = 0.0, t1 - t0, 0, 0.0, 0  # from t0, where time is resolved best
    while elapsed < whole:
        h, t = min(h, longest, whole - elapsed), t0 + elapsed
        if tolerance < np.inf and not tries:
            h = min(_length(scheme, x, t, h, trial, noise, constants, room, tolerance), longest)
        if taken >= MOST_STEPS or not elapsed + h > elapsed:
            return 0, t
        left = max(1, int(np.ceil((whole - elapsed) / h * (1 - 1e-12))))
        n_steps, dt = min(left, _STEPS_PER_LOOK), (whole - elapsed) / left
        room[0][:] = x
        _steps(x, lanes, given, t, dt, n_steps, step, noise, constants, room[1])
        if _lost(x, room[0], constants[1], room[3]):
            if tries == _TRIES or (tolerance == np.inf and not np.isfinite(x).all()):
                return 0, t
            if tolerance < np.inf:  # steps of given length are left as they are
                x[:], h, tries = room[0], _SHORTER * dt, tries + 1
                continue
        first, tries = first if taken else dt, 0
        taken += n_steps
        elapsed = whole if n_steps == left else elapsed + n_steps * dt
    return taken, first


def _move_lanes(old, taken, new, w, report, moments, which, span, limits, addresses, constants, stream):
    """Move some blocks, by number; see `move_lanes`."""
    n, N = old.shape
    scheme, seed = stream
    step, trial, noise = NEW_STEP(addresses[0]), NEW_TRIAL(addresses[1]), function_at(addresses[2])
    x, lanes = np.empty((n, LANES)), np.empty((3, LANES), dtype=np.uint64)
    sigma, work, rows = np.empty((3, n, constants[2].shape[0])), np.empty((3, n, LANES)), np.empty((3, LANES))
    room = np.empty((n, LANES)), sigma, work, rows
    given = np.zeros((2, 2 * constants[2].shape[0], LANES), dtype=np.float32)
    for b in which:
        start, end = b * LANES, min((b + 1) * LANES, N)
        _seed(np.uint64(seed), np.uint64(b), lanes)
        for a in range(n):
            for i in range(LANES):
                at = min(start + i, N - 1)  # lanes to spare follow the last state
                x[a, i] = old[a, taken[at] if taken.size else at]
        found = _through(scheme, x, lanes, given, span, limits, step, trial, noise, constants, room)
        report[b, 0], report[b, 1] = found
        new[:, start:end] = x[:, : end - start]
        block_moments(x, 0, w[start:end], moments[b])


@cache
def move_lanes():
    """The compiled loop over blocks, for any model; compiled (or loaded from the disk cache) at first use.

    Its arguments are the states old (n, N); for each new state the number of the old one that it starts at,
    (N,), or none if they are the same; the new states (n, N), filled; their weights (N,); `report`
    (blocks, 2), which gets the steps taken, zero for a failure, and the first of them; `moments`
    (blocks, 1 + n + n²), which gets what `merged` takes; the numbers of the blocks; the span (t0, t1); the
    longest step, the one to try first and the tolerance in standard deviations; addresses of step, trial step
    and noise; p, the variance (n,) of all states, and L with L Lᵀ = Q; and scheme and seed.
    """
    integers, stream = types.int64[::1], types.UniTuple(types.int64, 2)
    arrays = MATRIX, integers, MATRIX, VECTOR, MATRIX, MATRIX, integers
    numbers = types.UniTuple(types.float64, 2), types.UniTuple(types.float64, 3), types.UniTuple(ADDRESS, 3)
    signature = types.void(*arrays, *numbers, types.Tuple((VECTOR, VECTOR, MATRIX)), stream)
    return jit_for(signature, _move_lanes)
