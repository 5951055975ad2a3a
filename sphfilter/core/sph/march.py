"""The explicit time loop of the paper's scheme (002 sections 2.2 and 4.3): particles move with v = f + u.

One loop is compiled for all models; it runs from t to t1 without returning to Python. Per step: smoothing
lengths, neighbour lists (found anew or bypassed), density and velocity, step size, move.
"""

import math
from typing import NamedTuple

import numpy as np

from .._addresses import addresses
from .._jit import jit
from ..domain import bounce, go_round, half_period, left_at, unseen, velocities
from ..limits import ROUNDING
from .kernels import RADIUS
from .motion import evaluate, move, stable_step
from .search import SEARCH, outgrown, search_is_due
from .smoothing import UPDATE
from .state import Near, room_for
from .summation import DENSITY

STATUS = ("ok", "not finite", "paused", "stalled", "left", "unsettled")
OK, NOT_FINITE, PAUSED, STALLED, LEFT, UNSETTLED = range(6)

search_at, density_at, smoothing_at = SEARCH.at, DENSITY.at, UPDATE.at


class Parts(NamedTuple):
    """Addresses of the large parts of a march: each is compiled once, not at every level that calls it."""

    search: int
    density: int
    smoothing: int


def parts():
    """The `Parts` of a march; compiles or loads them."""
    return addresses(Parts, SEARCH, DENSITY, UPDATE)


@jit
def march(parts, equations, cloud, domain, options, progress):
    """Code of `STATUS` of carrying the cloud, in place, from progress.t to progress.t1.

    `Options` and `Progress` are packed, and progress is kept up to date; on failure the cloud is as far as it
    came, and ``progress.culprit`` is the particle. "paused" asks to be called again: between calls Python can
    be interrupted. "unsettled" asks so without the particles that it leaves without mass.
    """
    near, work = _begin(parts, equations, cloud, domain, options, progress)
    first = progress.steps
    while progress.t < progress.t1:
        near, code = step(parts, equations, cloud, domain, near, work, options, progress)
        if code != OK:
            return code
        progress.steps += 1
        left = progress.t1 - progress.t  # what rounding leaves of an interval is no step
        last = left <= progress.dt * (1.0 + 1e-12)
        progress.t = progress.t1 if last else progress.t + progress.dt
        bounce(domain, cloud.x)
        lost = left_at(domain, cloud.x)
        if lost >= 0:
            progress.culprit = lost
            return LEFT
        if progress.steps - first >= options.pause_after and progress.t < progress.t1:
            return PAUSED
    go_round(domain, cloud.x)
    return OK


@jit
def step(parts, equations, cloud, domain, near, work, options, progress):
    """One step of 002 section 4.3, from progress.t over progress.dt; arguments as of `march`.

    `near` is what the particles saw in the step before. Returns what they see in this one, and a code: OK,
    NOT_FINITE, STALLED or UNSETTLED.
    """
    if progress.follows and _unsettled(parts, cloud, near, work, options, progress):
        return near, UNSETTLED
    progress.follows = True
    searched = progress.must_search or outgrown(cloud, work.reach, RADIUS[options.kernel])
    if searched:
        near = search_at(parts.search)(cloud, domain, work, options)
        progress.elapsed, progress.k_bypass, progress.searches = 0.0, 0, progress.searches + 1
    else:
        progress.k_bypass, progress.bypassed = progress.k_bypass + 1, progress.bypassed + 1
    evaluate(parts.density, equations, progress.t, cloud, near, work, options, work.v)
    progress.evaluations += 1
    if not progress.known:
        _keep_invariant(cloud)
        progress.known = True
    dt_before, v = progress.dt, velocities(near.seen, work.v)
    dt, progress.culprit = stable_step(cloud, v, near, work, options)
    if not dt >= progress.shortest:
        return near, NOT_FINITE if math.isnan(dt) else STALLED
    progress.dt = min(dt, options.dt_max, progress.t1 - progress.t)
    progress.must_search = search_is_due(cloud, v, dt_before, searched, near, work, options, progress)
    progress.evaluations += move(
        parts.density, equations, progress.t, progress.dt, cloud, near, work, options
    )
    progress.elapsed += progress.dt
    return near, OK


@jit
def _begin(parts, equations, cloud, domain, options, progress):
    """Room for a march, and what particles see if rho h^n is known: no step has to find it then.

    h follows from the density here and now, however an interval is cut into calls.
    """
    progress.longest = half_period(domain) / RADIUS[options.kernel]
    _cap(cloud.h, progress.longest)
    work = room_for(cloud, equations, options)
    progress.known = cloud.invariant[0] > 0.0
    progress.follows = progress.known and not options.up_to_date
    progress.must_search = not progress.known
    progress.dt, progress.shortest = 1.0, ROUNDING * (progress.t1 - progress.t)
    progress.elapsed, progress.k_bypass, progress.t_ref = 0.0, 0, np.inf
    if progress.known:
        near = search_at(parts.search)(cloud, domain, work, options)
        progress.searches += 1
        density_at(parts.density)(cloud, near, work, options)
    else:
        nobody = (np.zeros(cloud.h.size + 1, np.int64), np.empty(0, np.int32))
        near = Near(unseen(cloud.x, cloud.m, cloud.h), nobody, np.empty(0))
    return near, work


@jit
def _unsettled(parts, cloud, near, work, options, progress):
    """Let the smoothing lengths follow the density: True if particles that do not settle are discarded.

    Their mass is taken (000 Algorithm 3).
    """
    for i in range(cloud.h.size):
        work.h_before[i] = cloud.h[i]
    failed = smoothing_at(parts.smoothing)(parts.density, cloud, near, work, options)
    progress.smoothing_failed += failed
    _cap(cloud.h, progress.longest)
    if failed == 0 or not options.discards:
        return False
    for i in range(cloud.m.size):
        if not work.settled[i]:
            cloud.m[i] = 0.0
    return True


@jit
def _keep_invariant(cloud):
    """rho h^n as it is now, to be kept (002 (14))."""
    for i in range(cloud.h.size):
        cloud.invariant[i] = cloud.rho[i] * cloud.h[i] ** cloud.x.shape[1]


@jit
def _cap(h, longest):
    """No support beyond half a period."""
    for i in range(h.size):
        h[i] = min(h[i], longest)
