"""When to look for neighbours, and what is found: lists that last for several steps (002 section 4.3)."""

import math

import numpy as np

from .._addresses import Entry
from .._jit import jit
from ..domain import DOMAIN, go_round, half_period, view_of, with_images
from ..limits import TINY
from .kernels import RADIUS
from .neighbors import build_index, neighbor_lists
from .state import CLOUD, OPTIONS, WORK, Near


@jit
def search(cloud, domain, work, options):
    """What the particles see now, and new neighbour lists of it, as `Near`.

    `work.reach` starts from what sufficed last time, relative to the support: iterated smoothing lengths and
    the stages of a step look a little beyond the support as it is now.
    """
    K, total, N = RADIUS[options.kernel], 0.0, cloud.h.size
    support, reach = work.support, work.reach
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
            return Near(seen, (lists[0][: N + 1], lists[1]), np.empty(lists[1].size))


@jit
def outgrown(cloud, reach, K):
    """Has a support grown past the radius its list was made for?"""
    for i in range(reach.size):  # noqa: SIM110 - numba compiles no generator
        if K * cloud.h[i] > reach[i]:
            return True
    return False


@jit
def bypass_time(cloud, v, dt_before, near, work, options):
    """t_NNS of 002 (43) and the smallest number of buffer neighbours; v as in `stable_step`.

    Corrected: the support is K h, so that its rate is K dh/dt, and the distance to cover is that from the
    support to the farthest particle listed within the reach of i (unseen ones were farther when the list was
    made), not the width of the buffer.
    """
    (start, neighbors), r, reach = near.lists, near.r, work.reach
    N, n = cloud.x.shape
    K, c_nns = RADIUS[options.kernel], options.c_nns
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
            rate = math.sqrt(fastest2) + K * (cloud.h[i] - work.h_before[i]) / dt_before
            t_nns = min(t_nns, c_nns * (min(farthest, reach[i]) - support) / max(rate, TINY))
    return t_nns, fewest


@jit
def search_is_due(cloud, v, dt_before, searched, near, work, options, progress):
    """Must the next step search for neighbours, or do the lists at hand last: the test of 002 section 4.3.

    Velocities v (N + G, n) are those of the particles and of their images; `dt_before` is the step before
    this one, seconds, over which the smoothing lengths came to be what they are, `searched` whether this one
    has; ``progress.dt`` is the step that comes.
    """
    if not options.bypass:
        return True
    t_nns, fewest = bypass_time(cloud, v, dt_before, near, work, options)
    if searched:
        progress.t_ref = t_nns
    late = progress.elapsed + progress.dt >= min(progress.t_ref, t_nns)
    return late or fewest <= options.buffer_min or progress.k_bypass >= options.k_bypass_max


#: `search` by its address.
SEARCH = Entry(search, (CLOUD, DOMAIN, WORK, OPTIONS))
