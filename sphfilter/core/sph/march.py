"""The explicit time loop of the paper's scheme (002 sections 2.2 and 4.3): particles move with v = f + u.

One loop is compiled for all models; it runs from t to t1 without returning to Python. Per step: smoothing
lengths, neighbour lists (found anew or bypassed), density and velocity, step size, move.
"""

import math
from typing import NamedTuple

import numpy as np

from .._jit import jit
from ..domain import bounce, go_round, half_period, left_at, refresh, unseen, velocities, view_of, with_images
from .kernels import RADIUS
from .neighbors import build_index, neighbor_lists
from .smoothing import Rule, update_smoothing
from .summation import density_and_gradient, density_and_gradient_parallel

__all__ = [
    "COUNTERS",
    "INTEGRATORS",
    "STATUS",
    "Cloud",
    "Coefficients",
    "Options",
    "march",
]

INTEGRATORS = ("euler", "midpoint", "rk4")
EULER, MIDPOINT, RK4 = range(3)
STATUS = ("ok", "not finite", "paused", "stalled", "left", "unsettled")
OK, NOT_FINITE, PAUSED, STALLED, LEFT, UNSETTLED = range(6)
#: What the loop counts; the last is the particle a failure was seen at.
COUNTERS = ("steps", "evaluations", "searches", "bypassed", "smoothing_failed", "culprit")
STEPS, EVALUATIONS, SEARCHES, BYPASSED, SMOOTHING_FAILED, CULPRIT = range(6)
_EPS = 1e-300


class Cloud(NamedTuple):
    """The particles, updated in place. `invariant` is rho h^n on the last lattice, zero if not known."""

    x: np.ndarray  # (N, n)
    m: np.ndarray  # (N,)
    h: np.ndarray
    invariant: np.ndarray
    rho: np.ndarray


class Coefficients(NamedTuple):
    """Diffusion D = g Q g^T / 2 as far as it is constant, and what has to be asked of the model."""

    p: np.ndarray  # parameters of the model
    D: np.ndarray  # (n, n), used where time_dependent and state_dependent are false
    rows: np.ndarray  # numbers of the rows of D that are not zero
    time_dependent: bool
    state_dependent: bool


class Options(NamedTuple):
    """Numbers of the scheme; names and values of `PaperScheme`, codes instead of words."""

    kernel: int
    normalisation: float
    kernel_variance: float
    smoothing: Rule
    discards: bool  # particles whose smoothing lengths do not settle
    up_to_date: bool  # are the smoothing lengths, at the first step
    integrator: int
    relative_cfl: bool
    c_cfl: float
    dt_max: float
    c_diffusion: float
    search: int
    bypass: bool
    c_nns: float
    k_bypass_max: int
    buffer: int
    buffer_min: int
    looks_ahead: bool
    parallel: bool
    pause_after: int


class Work(NamedTuple):
    grad: np.ndarray
    v: np.ndarray
    D: np.ndarray
    divergence: np.ndarray


@jit
def velocity(drift, diffusion, divergence, coefficients, t, x, rho, work, v):
    """v = f - div D - D grad(rho)/rho: 002 (7) with the factor 1/2 that its D2 terms lack."""
    n = x.shape[1]
    D = work.D
    drift(x, t, coefficients.p, v)
    varies = coefficients.time_dependent or coefficients.state_dependent
    if varies:
        diffusion(x, t, coefficients.p, D)
    if coefficients.state_dependent:
        divergence(x, t, coefficients.p, work.divergence)
    for i in range(x.shape[0]):
        k = i if varies else 0
        for c in coefficients.rows:
            u = 0.0
            for d in range(n):
                u += D[k, c * n + d] * work.grad[i, d]
            v[i, c] -= u / rho[i]
            if coefficients.state_dependent:
                v[i, c] -= work.divergence[i, c]


@jit
def evaluate(model, coefficients, t, cloud, seen, lists, r, work, options, v):
    """Density, gradient and velocity of the particles at time t."""
    drift, diffusion, divergence = model
    kernel = (options.kernel, options.normalisation)
    refresh(seen, cloud.x, cloud.h)
    if options.parallel:
        density_and_gradient_parallel(seen.x, seen.m, seen.h, lists, kernel, cloud.rho, work.grad, r)
    else:
        density_and_gradient(seen.x, seen.m, seen.h, lists, kernel, cloud.rho, work.grad, r)
    velocity(drift, diffusion, divergence, coefficients, t, cloud.x, cloud.rho, work, v)


@jit
def stable_step(cloud, v, lists, r, work, coefficients, options):
    """Step size of 002 (18), absolute or relative to the nearest neighbour, within the diffusion limit.

    v are the velocities of the particles and, after them, of their images.

    Returns (dt, the particle that limits it); dt is NaN where a velocity is not finite. The diffusion limit
    is that of an explicit step on kernels of variance c_K h^2 (unstable from about 2.7 c_K h^2 / D on).
    """
    start, neighbors = lists
    N, n = cloud.x.shape
    varies = coefficients.time_dependent or coefficients.state_dependent
    dt, culprit = np.inf, 0
    for i in range(N):
        nearest, at = np.inf, -1
        for s in range(start[i], start[i + 1]):
            if r[s] < nearest:
                nearest, at = r[s], neighbors[s]
        speed2, spread = 0.0, 0.0
        for d in range(n):
            other = v[at, d] if options.relative_cfl and at >= 0 else 0.0
            speed2 += (v[i, d] - other) ** 2
            spread += work.D[i if varies else 0, d * n + d]
        if not math.isfinite(speed2):
            return np.nan, i
        limit = options.c_diffusion * options.kernel_variance * cloud.h[i] ** 2 / max(spread, _EPS)
        if nearest < np.inf:
            limit = min(limit, options.c_cfl * nearest / max(math.sqrt(speed2), _EPS))
        if math.isnan(limit):
            return np.nan, i
        if limit < dt:
            dt, culprit = limit, i
    return dt, culprit


@jit
def bypass_time(cloud, v, h_old, dt_old, reach, lists, r, options):
    """t_NNS of 002 (43) and the smallest number of buffer neighbours; v as in `stable_step`.

    Corrected: the support is K h, so that its rate is K dh/dt, and the distance to cover is that from the
    support to the farthest particle listed within the reach of i (unseen ones were farther when the list was
    made), not the width of the buffer.
    """
    start, neighbors = lists
    N, n = cloud.x.shape
    K = RADIUS[options.kernel]
    t_nns, fewest = np.inf, N
    for i in range(N):
        support, farthest, fastest2, buffer = K * cloud.h[i], 0.0, 0.0, 0
        for s in range(start[i], start[i + 1]):
            if r[s] > support:
                buffer += 1
                farthest = max(farthest, r[s])
                speed2 = 0.0
                for d in range(n):
                    speed2 += (v[i, d] - v[neighbors[s], d]) ** 2
                fastest2 = max(fastest2, speed2)
        if start[i + 1] - start[i] < N - 1:
            fewest = min(fewest, buffer)
            rate = math.sqrt(fastest2) + K * (cloud.h[i] - h_old[i]) / dt_old
            t_nns = min(t_nns, options.c_nns * (min(farthest, reach[i]) - support) / max(rate, _EPS))
    return t_nns, fewest


@jit
def _displace(x, x0, dt, v):
    """x = x0 + dt v, written out: numba compiles an array expression ten times as long."""
    for i in range(x.shape[0]):
        for d in range(x.shape[1]):
            x[i, d] = x0[i, d] + dt * v[i, d]


@jit
def move(model, coefficients, t, dt, cloud, seen, lists, r, work, options):
    """One Euler, midpoint or RK4 step; `work.v` holds the velocity at (t, x). Returns evaluations made.

    Smoothing lengths stay as they are within a step. 001 (29) prints the midpoint rule as "leapfrog".
    """
    x, v = cloud.x, work.v
    if options.integrator == EULER:
        _displace(x, x, dt, v)
        return 0
    x0, k = x.copy(), np.empty_like(x)
    n_stages = 1 if options.integrator == MIDPOINT else 3
    total = v.copy()
    for stage in range(n_stages):
        ahead = dt if stage == 2 else 0.5 * dt
        _displace(x, x0, ahead, v if stage == 0 else k)
        evaluate(model, coefficients, t + ahead, cloud, seen, lists, r, work, options, k)
        _displace(total, total, 1.0 if stage == 2 else 2.0, k)
    if options.integrator == MIDPOINT:
        _displace(x, x0, dt, k)
    else:
        _displace(x, x0, dt / 6.0, total)
    return n_stages


@jit
def _search(cloud, domain, support, reach, options):
    """What the particles see now, and new neighbour lists of it.

    `reach` starts from what sufficed last time, relative to the support: iterated smoothing lengths and the
    stages of a step look a little beyond the support as it is now.
    """
    K, total, N = RADIUS[options.kernel], 0.0, cloud.h.size
    least, farthest = 1.2 if options.looks_ahead else 1.0, 0.0
    go_round(domain, cloud.x)
    for i in range(N):
        reach[i] = K * cloud.h[i] * max(0.99 * reach[i] / support[i], least)
        support[i] = K * cloud.h[i]
        total += support[i]
        farthest = max(farthest, reach[i])
    while True:
        seen = view_of(domain, cloud.x, cloud.m, cloud.h, 1.3 * farthest)
        index = build_index(seen.x, 1.3 * total / N, options.search)
        wanted, needed = with_images(seen, reach), with_images(seen, support)
        lists = neighbor_lists(seen.x, needed, wanted, options.buffer, index)
        before, farthest = 1.3 * farthest, 0.0
        for i in range(N):
            reach[i] = min(wanted[i], before) if seen.owner.size > 0 else wanted[i]
            farthest = max(farthest, wanted[i])
        if seen.owner.size == 0 or farthest <= before or before > half_period(domain):
            return seen, (lists[0][: N + 1], lists[1])


@jit
def _outgrown(cloud, reach, K):
    """Has a support grown past the radius its list was made for?"""
    for i in range(reach.size):  # noqa: SIM110 - numba compiles no generator
        if K * cloud.h[i] > reach[i]:
            return True
    return False


@jit
def _cap(h, longest):
    for i in range(h.size):
        h[i] = min(h[i], longest)


@jit
def _discard(cloud, settled):
    """Take the mass of the particles that are not settled (000 Algorithm 3)."""
    for i in range(settled.size):
        if not settled[i]:
            cloud.m[i] = 0.0


@jit
def march(drift, diffusion, divergence, coefficients, cloud, domain, options, times, counters):
    """Carry the cloud from times[0] to times[1]; times[0] and the counters are kept up to date.

    Returns a code of `STATUS`. "paused" asks to be called again: between calls Python can be interrupted.
    "unsettled" asks so without the particles that it leaves without mass. On failure the cloud is as far as
    it came, and counters[CULPRIT] the particle.
    """
    N, n = cloud.x.shape
    model, kernel = (drift, diffusion, divergence), (options.kernel, options.normalisation)
    varies = coefficients.time_dependent or coefficients.state_dependent
    work = Work(np.empty((N, n)), np.empty((N, n)), np.empty((N if varies else 1, n * n)), np.empty((N, n)))
    if not varies:
        work.D[0] = coefficients.D.ravel()
    K = RADIUS[options.kernel]
    longest = half_period(domain) / K
    _cap(cloud.h, longest)
    support, reach, h_old = K * cloud.h, 1.3 * K * cloud.h, cloud.h.copy()
    lists, r, seen = (
        (np.zeros(N + 1, np.int64), np.empty(0, np.int32)),
        np.empty(0),
        unseen(cloud.x, cloud.m, cloud.h),
    )
    must_search, elapsed, k_bypass, t_ref, dt = True, 0.0, 0, np.inf, 1.0
    settled, up_to_date = np.ones(N, np.bool_), options.up_to_date
    span, first = times[1] - times[0], counters[STEPS]
    known = cloud.invariant[0] > 0.0
    if known:  # h follows from the density here and now, however an interval is cut into calls
        (seen, lists), must_search = _search(cloud, domain, support, reach, options), False
        r = np.empty(lists[1].size)
        density_and_gradient(seen.x, seen.m, seen.h, lists, kernel, cloud.rho, work.grad, r)
        counters[SEARCHES] += 1
    while times[0] < times[1]:
        if known and not up_to_date:
            h_old[:] = cloud.h
            failed = update_smoothing(
                options.smoothing, cloud, seen, reach, lists, kernel, work.grad, r, settled
            )
            counters[SMOOTHING_FAILED] += failed
            _cap(cloud.h, longest)
            if failed > 0 and options.discards:
                _discard(cloud, settled)
                return UNSETTLED
        up_to_date = False
        searched = must_search or _outgrown(cloud, reach, K)
        if searched:
            seen, lists = _search(cloud, domain, support, reach, options)
            r = np.empty(lists[1].size)
            elapsed, k_bypass = 0.0, 0
        k_bypass += not searched
        counters[SEARCHES if searched else BYPASSED] += 1
        evaluate(model, coefficients, times[0], cloud, seen, lists, r, work, options, work.v)
        counters[EVALUATIONS] += 1
        if not known:
            for i in range(N):
                cloud.invariant[i] = cloud.rho[i] * cloud.h[i] ** n
            known = True
        dt_old = dt
        v = velocities(seen, work.v)
        dt, counters[CULPRIT] = stable_step(cloud, v, lists, r, work, coefficients, options)
        if math.isnan(dt):
            return NOT_FINITE
        if dt < 1e-9 * span:
            return STALLED
        dt = min(dt, options.dt_max, times[1] - times[0])
        must_search = not options.bypass
        if options.bypass:
            t_nns, fewest = bypass_time(cloud, v, h_old, dt_old, reach, lists, r, options)
            t_ref = t_nns if searched else t_ref
            must_search = elapsed + dt >= min(t_ref, t_nns)
            must_search |= fewest <= options.buffer_min or k_bypass >= options.k_bypass_max
        counters[EVALUATIONS] += move(model, coefficients, times[0], dt, cloud, seen, lists, r, work, options)
        counters[STEPS] += 1
        elapsed += dt
        # what rounding leaves of an interval is no step
        times[0] = times[1] if times[1] - times[0] <= dt * (1.0 + 1e-12) else times[0] + dt
        bounce(domain, cloud.x)
        left = left_at(domain, cloud.x)
        if left >= 0:
            counters[CULPRIT] = left
            return LEFT
        if counters[STEPS] - first >= options.pause_after and times[0] < times[1]:
            return PAUSED
    go_round(domain, cloud.x)
    return OK
