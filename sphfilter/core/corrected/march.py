"""The time loop of the moment-corrected scheme, in compiled code.

The drift is cheap, the diffusion velocity u a sum over neighbours: each particle is carried along
x' = f(x, t) + u(t) by a Runge-Kutta step of order five (Dormand & Prince 1980), with u extrapolated from the
two sums before (Adams-Bashforth), evaluated once at the end, and its change against the extrapolation put
right (Adams-Moulton). That change, and the embedded error of the Runge-Kutta step, choose the step size.
"""

import math
from typing import NamedTuple

import numpy as np

from .._addresses import addresses, function_at
from .._jit import jit
from ..sph.kernels import RADIUS
from .diffusion import VELOCITY, room_for, stable_steps
from .frame import (
    SEARCH,
    Cloud,
    Options,
    crosses,
    follow_spacing,
    keep_lengths,
    make_frame,
    settle,
    still_valid,
    whiten_frame,
)
from .multistep import History, drift_step, put_right, rms, size, surprise
from .number_density import whiten

__all__ = ["STATUS", "Cloud", "Options", "Progress", "march", "parts", "settle"]

STATUS = ("ok", "not finite", "paused", "stalled", "flat")
OK, NOT_FINITE, PAUSED, STALLED, FLAT = range(5)
_STALLED = 1e-9  # of the time that is left: a step that is no longer

search_at, velocity_at = SEARCH.at, VELOCITY.at


class Parts(NamedTuple):
    """Addresses of the large parts of a march."""

    search: int
    velocity: int  # due to diffusion


def parts():
    """The `Parts` of a march; compiles or loads them."""
    return addresses(Parts, SEARCH, VELOCITY)


class Progress(NamedTuple):
    """Where a march is and what it has counted, and what one step leaves to the next. Passed as a record."""

    t: float  # seconds
    t1: float  # to march to
    planned: float = 0.0  # step to try, zero to choose one
    steps: int = 0
    rejected: int = 0
    evaluations: int = 0  # of the diffusion velocity
    searches: int = 0
    functions: int = 0  # that the last correction used
    culprit: int = 0  # the particle that limits the step
    shortest: float = 0.0  # step that counts as one
    ago: float = 1.0  # seconds between the last two diffusion velocities
    plain: float = math.inf  # largest stable step, see `stable_steps`
    put_right: float = math.inf
    affine: float = math.inf


@jit
def march(parts, equations, cloud, options, powers, progress):
    """Carry the cloud from progress.t to progress.t1, and keep `progress` up to date.

    Parameters
    ----------
    parts : Parts
    equations : Equations
    cloud : Cloud
        Updated in place; on failure as far as it came.
    options, progress : record
        `Options` and `Progress`, packed.
    powers : ndarray, shape (q, n)
        Exponents of the polynomials of the correction.

    Returns
    -------
    int
        Code of `STATUS`. "paused" asks to be called again: between calls Python can be interrupted.
    """
    N, n = cloud.x.shape
    frame, work, steps_before = make_frame(cloud), room_for(equations, powers, N), progress.steps
    u, slope = np.zeros((N, n)), np.zeros((N, n))
    history = History(u, np.zeros((N, n)), slope, np.empty((7, N, n)), np.empty((N, n)))
    progress.shortest = _STALLED * (progress.t1 - progress.t)
    if not whiten_frame(frame):
        return FLAT
    pairs = search_at(parts.search)(frame, options)
    _begin(parts, equations, frame, pairs, work, history, options, progress)
    while progress.t < progress.t1:
        pairs, code = step(parts, equations, frame, pairs, work, history, options, progress)
        if code != OK:
            return code
        if progress.steps - steps_before >= options.pause_after and progress.t < progress.t1:
            break
    keep_lengths(frame)
    return OK if progress.t == progress.t1 else PAUSED


@jit
def step(parts, equations, frame, pairs, work, history, options, progress):
    """Try one step from progress.t; the cloud and the time stay where they are if it is rejected.

    Parameters
    ----------
    parts, equations, options, progress
        As `march` takes them.
    frame : Frame
    pairs : tuple
        Every pair of neighbours once, of `search`.
    work : Work
    history : History

    Returns
    -------
    pairs : tuple
        Those of the end of the step.
    code : int
        OK, NOT_FINITE, STALLED or FLAT.
    """
    x, m, interacting = frame.cloud.x, frame.cloud.m, equations.rows.size > 0
    dt = _next_step(progress, options)
    if not dt > progress.shortest:
        return pairs, STALLED if dt > 0.0 else NOT_FINITE
    drift_step(equations, progress.t, dt, x, history)
    error = size(history.K[6], frame, work.z) / options.tol
    way, progress.culprit = crosses(history.x0, frame)
    way = way if interacting or not math.isfinite(way) else 0.0
    factor = min(0.9 * max(error, 1e-6) ** -0.2, 0.45 / max(way, 0.01))
    accepted = error <= 1.0 and way <= 0.5
    if accepted and interacting:
        whiten(x, m, frame.inverse, work.z)
        if not still_valid(work.z, frame, RADIUS[options.kernel]):
            keep_lengths(frame)
            if not whiten_frame(frame):
                return pairs, FLAT
            pairs = search_at(parts.search)(frame, options)
            progress.searches += 1
        end = progress.t + dt
        progress.functions = velocity_at(parts.velocity)(
            equations, end, x, frame, pairs, work, options, history.new
        )
        progress.evaluations += 1
        error = surprise(dt, progress.ago, history, frame, work.z) / options.tol
        factor = min(factor, 0.9 * max(error, 1e-6) ** (-1 / 3))
        accepted = error <= 1.0
    if accepted:
        if interacting:
            put_right(dt, frame, work.polynomials, history, progress)
            follow_spacing(frame, work.sums.number, options)
            progress.ago = dt
            progress.plain, progress.put_right, progress.affine = stable_steps(frame, work.D, options)
        _advance(dt, factor, progress)
    else:
        _reject(x, dt, factor, history, progress)
    return pairs, OK


@jit
def _next_step(progress, options):
    """The step that is wanted, or all that is left, or half of it where two steps will do."""
    dt, left = min(progress.planned, progress.plain, options.dt_max), progress.t1 - progress.t
    if dt > 0.999 * left:
        return left
    return min(dt, 0.5 * left)


@jit
def _advance(dt, factor, progress):
    """Move on in time, and plan the next step."""
    progress.steps += 1
    # A step cut short by the end or a limit says nothing against the longer one that was planned.
    planned = progress.planned if dt < progress.planned and factor > 1.0 else 0.0
    progress.planned = max(planned, dt * min(factor, 5.0))
    progress.t = progress.t1 if dt == progress.t1 - progress.t else progress.t + dt


@jit
def _reject(x, dt, factor, history, progress):
    """Go back to where the step began, and plan a shorter one."""
    for i in range(x.shape[0]):
        for d in range(x.shape[1]):
            x[i, d] = history.x0[i, d]
    progress.rejected += 1
    progress.planned = dt * (min(max(factor, 0.2), 0.9) if math.isfinite(factor) else 0.2)


@jit
def _begin(parts, equations, frame, pairs, work, history, options, progress):
    """u and its rate of change at the start, the step to try, and the largest stable steps.

    The rate comes from a look a little ahead, which counts as a point of the past of negative age.
    """
    x, m, K, t = frame.cloud.x, frame.cloud.m, history.K, progress.t
    N, n = x.shape
    interacting = equations.rows.size > 0
    progress.ago, progress.plain, progress.put_right, progress.affine = 1.0, np.inf, np.inf, np.inf
    if interacting:
        velocity_at(parts.velocity)(equations, t, x, frame, pairs, work, options, history.u)
        progress.plain, progress.put_right, progress.affine = stable_steps(frame, work.D, options)
    function_at(equations.drift)(x, t, equations.p, K[0])
    for i in range(N):
        for d in range(n):
            K[0, i, d] += history.u[i, d]
    whiten(K[0], m, frame.inverse, work.z)
    first = 0.1 / max(rms(work.z, m), 1e-300)  # a tenth of the time in which the cloud deforms by its size
    if progress.planned == 0.0:
        progress.planned = first
    if interacting:
        progress.ago = ago = -min(0.1 * first, 0.1 * progress.plain, 0.1 * (progress.t1 - t), options.dt_max)
        for i in range(N):
            for d in range(n):
                K[1, i, d] = x[i, d] - ago * K[0, i, d]
        velocity_at(parts.velocity)(equations, t - ago, K[1], frame, pairs, work, options, history.new)
        for i in range(N):
            for d in range(n):
                history.slope[i, d] = (history.u[i, d] - history.new[i, d]) / ago
        progress.searches += 1
        progress.evaluations += 2
