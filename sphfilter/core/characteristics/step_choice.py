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
from .control import (
    CONTROL,
    COUNTS,
    EVALUATIONS,
    LATTICE_STEP,
    LONGEST,
    NOT_FINITE,
    OK,
    PATH_STEP,
    REJECTED,
    STALLED,
    STATE,
)
from .noise_paths import NOISE, along_at, freeze, noise_factor_at, pushes, unblurred
from .step_limits import blur_share, driven_ends, noise_limit, path_error, predicted

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
def chosen(drift, diffusion, noise, x, m, L, Q, times, span, control, state, counters):
    """The `Choice` of a step from times[0] towards times[1], of a prediction over a `span`, all in seconds.

    Nodes x (N, n) have masses m (N,); L and Q (n, n) are the lower factor of their covariance, and what
    `local_shape` adds to it. Where noise depends on time, its G is brought up to mid-step; so are the steps
    that come next, and the counters. Functions are of signature `BATCH`.
    """
    n, t, left = x.shape[1], times[0], times[1] - times[0]
    mean, P, own, S = np.empty(n), np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    once, twice = np.empty(x.shape), np.empty(x.shape)
    f, still = np.empty(x.shape), unblurred(x.shape[0], pushes(noise, 1.0).shape[1])
    drift(x, t, noise.p, f)
    along, unasked = along_at(noise.along), np.empty(0)
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
        along(drift, drift, noise, x, f, f, t, h, parts, still, once, unasked)
        along(drift, drift, noise, x, f, f, t, h, 2 * parts, still, twice, unasked)
        counters[EVALUATIONS] += 12 * parts * x.shape[0]
        error = path_error(once, twice, m, S) / control.tolerance
        if noise.state_dependent:
            ends = driven_ends(drift, noise, x, f, t, h, parts)
            error = max(error, path_error(ends[0], ends[1], m, S) / control.tolerance)
            counters[EVALUATIONS] += 12 * parts * x.shape[0]
        state[PATH_STEP] = min(next_step(h / parts, error, 4.0), 1.0 / TINY)
        if error <= 1.0:
            break
        counters[REJECTED] += 1
        if state[PATH_STEP] < ROUNDING * span:
            code = NOT_FINITE if error == np.inf else STALLED
            return Choice(code, h, parts, False, False, twice, mean, S)
    mean, P = predicted(drift, noise, x, f, twice, m, t, h, parts)
    counters[EVALUATIONS] += (16 * parts + 2) * noise.G.shape[1] * x.shape[0]
    if not cholesky(P, own):
        return Choice(NOT_FINITE, h, parts, False, False, twice, mean, S)
    product(own, Q, 1.0, S)
    blurred = (
        noise.state_dependent or not blur_share(drift, noise, x, f, m, t, h, S) < LITTLE * control.tolerance
    )
    fold(noise.low, noise.high, twice)
    return Choice(OK, h, parts, pieces <= 1, blurred, twice, mean, S)


#: `chosen` by its address.
CHOOSE = Entry(
    chosen,
    (
        BATCH_FUNCTION, BATCH_FUNCTION, NOISE, MATRIX, VECTOR, MATRIX, MATRIX, VECTOR, types.float64, CONTROL,
        STATE, COUNTS,
    ),
)  # fmt: skip
