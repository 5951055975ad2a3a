"""How far the next lattice may be: tried on the density's own nodes, without a lattice."""

import math
from typing import NamedTuple

import numpy as np
from numba import types

from .._addresses import Entry
from .._jit import BATCH_FUNCTION, MATRIX, VECTOR, jit
from ..field.walls import fold
from ..limits import LITTLE, ROUNDING, TINY
from ..small_matrices import cholesky, product
from ..step_control import next_step
from .control import EVALUATIONS, LATTICE_STEP, LONGEST, NOT_FINITE, OK, PATH_STEP, REJECTED, RUN, STALLED
from .noise_paths import NOISE, Begin, Span, freeze, noise_factor_at, pushes, unblurred
from .step_limits import blur_share, driven_ends, noise_limit, once_and_twice, path_error, predicted

_MOST_PARTS = 16  # Runge-Kutta steps from lattice to lattice: of errors 16⁻⁴ = 1.5e-5 is left


class Choice(NamedTuple):
    """A step, and where the density's nodes and moments go in it."""

    code: int  # of `STATUS`
    h: float
    parts: int  # Runge-Kutta steps of its paths
    last: bool  # it ends the interval
    blurred: bool  # what paths leave of the noise counts
    ends: np.ndarray  # (N, n) of the nodes' paths, without noise
    mean: np.ndarray  # (n,)
    shape: np.ndarray  # (n, n) lower factor of the covariance within the pieces of the density


@jit
def chosen(drift, diffusion, noise, nodes, shape, times, whole, run):
    """The `Choice` of a step from times[0] towards times[1], of the `whole` of a prediction, all in seconds.

    Nodes are x (N, n) and masses m (N,); their shape L and Q (n, n), the lower factor of their covariance,
    and what `local_shape` adds to it. Where noise depends on time, its G is brought up to mid-step; so are
    the steps that come next, and the counters. Functions are of signature `BATCH`.
    """
    (x, m), (L, Q), (control, state, counters) = nodes, shape, run
    n, t, left = x.shape[1], times[0], times[1] - times[0]
    mean, P, own, S = np.empty(n), np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    once, twice = np.empty(x.shape), np.empty(x.shape)
    f, still = np.empty(x.shape), unblurred(x.shape[0], pushes(noise, 1.0).shape[1])
    drift(x, t, noise.p, f)
    begin = Begin(x, f, f)
    if noise.state_dependent:
        freeze(x, m, t, noise)
    while True:
        product(L, Q, 1.0, S)
        limit = control.noise_share / max(noise_limit(noise.G, S), TINY)
        if state[LATTICE_STEP] == 0.0:
            state[LATTICE_STEP] = 1.0 / max(noise_limit(noise.G, S), TINY)  # whose noise is as wide as p
        h = min(left, state[LONGEST], limit, state[LATTICE_STEP])
        if noise.state_dependent:
            freeze(x, m, t + 0.5 * h, noise)
        elif noise.time_dependent:
            noise_factor_at(diffusion, x, t + 0.5 * h, noise)
        pieces = math.ceil(left / h - 1e-9)
        h = left if pieces <= 1 else (0.5 * left if pieces == 2 else h)
        parts = max(1, math.ceil(h / state[PATH_STEP] - 1e-9))
        if parts > _MOST_PARTS:
            state[LATTICE_STEP] = _MOST_PARTS * state[PATH_STEP]
            continue
        span = Span(t, h, parts)
        once_and_twice(drift, noise, begin, span, still, (once, twice))
        counters[EVALUATIONS] += 12 * parts * x.shape[0]
        error = path_error(once, twice, m, S) / control.tolerance
        if noise.state_dependent:
            ends = driven_ends(drift, noise, begin, span)
            error = max(error, path_error(ends[0], ends[1], m, S) / control.tolerance)
            counters[EVALUATIONS] += 12 * parts * x.shape[0]
        state[PATH_STEP] = min(next_step(h / parts, error, 4.0), 1.0 / TINY)
        if error <= 1.0:
            break
        counters[REJECTED] += 1
        if state[PATH_STEP] < ROUNDING * whole:
            code = NOT_FINITE if error == np.inf else STALLED
            return Choice(code, h, parts, False, False, twice, mean, S)
    mean, P = predicted(drift, noise, begin, twice, m, span)
    counters[EVALUATIONS] += (16 * parts + 2) * noise.G.shape[1] * x.shape[0]
    if not cholesky(P, own):
        return Choice(NOT_FINITE, h, parts, False, False, twice, mean, S)
    product(own, Q, 1.0, S)
    little = LITTLE * control.tolerance
    blurred = noise.state_dependent or not blur_share(drift, noise, begin, m, span, S) < little
    fold(noise.low, noise.high, twice)
    return Choice(OK, h, parts, pieces <= 1, blurred, twice, mean, S)


#: `chosen` by its address.
_DENSITY = types.Tuple([MATRIX, VECTOR]), types.UniTuple(MATRIX, 2)
CHOOSE = Entry(chosen, (BATCH_FUNCTION, BATCH_FUNCTION, NOISE, *_DENSITY, VECTOR, types.float64, RUN))
