"""Smoothing lengths that follow the density: proportional update, fixed point, or Newton.

All three keep rho_i h_i^n at its value on the last lattice, the `invariant` (002 (14), 000 (110)); they
differ in the density they use.
"""

import math

from .._addresses import ADDRESS, Entry
from .._jit import jit
from ..limits import ROUNDING
from .kernels import RADIUS
from .state import CLOUD, NEAR, OPTIONS, WORK
from .summation import DENSITY, own_density

SMOOTHING = ("fixed", "proportional", "fixed_point", "newton")
FIXED, PROPORTIONAL, FIXED_POINT, NEWTON = range(4)

density_at = DENSITY.at


@jit
def proportional(rho, invariant, n, h):
    """h_i = (rho0_i h0_i^n / rho_i)^(1/n) (002 (14)); return the largest relative change."""
    change = 0.0
    for i in range(h.size):
        new = (invariant[i] / rho[i]) ** (1.0 / n)
        change = max(change, abs(new - h[i]) / h[i])
        h[i] = new
    return change


@jit
def newton(i, near, h_i, target, limit, n, options):
    """Root of rho_i(h) h^n = target (000 (114), with the kernels of i's own h), or -1; and is it settled?

    The left side grows with h, so that a bracket always holds the root; h may not pass `limit`, beyond
    which the neighbour lists are blind. No root exists where the particle's own kernel fills the sum.
    """
    m, lists, r = near.seen.m, near.lists, near.r
    kernel, low, high = (options.kernel, options.normalisation), 0.0, limit
    rho, _ = own_density(i, m, limit, lists, r, kernel, n)
    if rho * limit**n < target:
        return -1.0, False
    for _ in range(options.smoothing_iterations):
        rho, slope_h = own_density(i, m, h_i, lists, r, kernel, n)
        excess = rho * h_i**n - target
        if excess > 0.0:
            high = h_i
        else:
            low = h_i
        gradient = slope_h * h_i**n + n * rho * h_i ** (n - 1)
        new = h_i - excess / gradient if gradient > 0.0 else 0.5 * (low + high)
        if not low < new < high:
            new = 0.5 * (low + high)
        if abs(new - h_i) <= ROUNDING * h_i:  # the next change would be the square
            return new, True
        h_i = new
    return (-1.0 if low == 0.0 else h_i), False


@jit
def _fixed_point(density, cloud, near, work, options):
    """Sweeps of `proportional` until no h changes by more than the tolerance; marks whose do not."""
    settled, tolerance, K = work.settled, options.smoothing_tolerance, RADIUS[options.kernel]
    for _ in range(options.smoothing_iterations):
        old = cloud.h.copy()
        if proportional(cloud.rho, cloud.invariant, cloud.x.shape[1], cloud.h) < tolerance:
            settled[:] = True
            return
        # The plain iteration oscillates where few neighbours carry the sum: go to the geometric mean.
        for i in range(old.size):
            settled[i] = abs(cloud.h[i] - old[i]) < tolerance * old[i]
            cloud.h[i] = min(math.sqrt(old[i] * cloud.h[i]), work.reach[i] / K)
        density_at(density)(cloud, near, work, options)


@jit
def update_smoothing(density, cloud, near, work, options):
    """Bring h to the present positions; return how many particles' lengths have not settled.

    Those that have are marked in `work.settled`. Where an equation has no root the old h is kept. `cloud.rho`
    holds the density of the last evaluation, which the lagged proportional update uses; `density` is the
    address of `DENSITY`. The lists are made for the radii ``work.reach``, which no support may pass.
    """
    rule, n = options.smoothing, cloud.x.shape[1]
    if rule == FIXED:
        return 0
    if rule == PROPORTIONAL:
        proportional(cloud.rho, cloud.invariant, n, cloud.h)
        return 0
    density_at(density)(cloud, near, work, options)
    if rule == FIXED_POINT:
        _fixed_point(density, cloud, near, work, options)
    if rule == NEWTON:
        for i in range(cloud.h.size):
            limit = work.reach[i] / RADIUS[options.kernel]
            start, target = min(cloud.h[i], limit), cloud.invariant[i]
            root, work.settled[i] = newton(i, near, start, target, limit, n, options)
            if root > 0.0:
                cloud.h[i] = root
    return work.settled.size - work.settled.sum()


#: `update_smoothing` by its address.
UPDATE = Entry(update_smoothing, (ADDRESS, CLOUD, NEAR, WORK, OPTIONS))
