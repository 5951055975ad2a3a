"""Smoothing lengths that follow the density: proportional update, fixed point, or Newton.

All three keep rho_i h_i^n at its value on the last lattice, the `invariant` (002 (14), 000 (110)); they
differ in the density they use.
"""

import math
from typing import NamedTuple

from .._jit import jit
from ..domain import refresh
from .kernels import RADIUS
from .summation import density_and_gradient, own_density

__all__ = ["SMOOTHING", "Rule", "update_smoothing"]

SMOOTHING = ("fixed", "proportional", "fixed_point", "newton")
FIXED, PROPORTIONAL, FIXED_POINT, NEWTON = range(4)
_NEWTON_TOLERANCE = 1e-6


class Rule(NamedTuple):
    """How smoothing lengths follow: numbers of `PaperScheme`, a code instead of a word."""

    mode: int
    tolerance: float  # relative change of a sweep of the fixed point, below which it has settled
    sweeps: int  # at most


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
def newton(i, m, h_i, target, lists, r, kernel, n, limit, sweeps):
    """Root of rho_i(h) h^n = target (000 (114), with the kernels of i's own h), or -1; and is it settled?

    The left side grows with h, so that a bracket always holds the root; h may not pass `limit`, beyond
    which the neighbour lists are blind. No root exists where the particle's own kernel fills the sum.
    """
    low, high = 0.0, limit
    rho, _ = own_density(i, m, limit, lists, r, kernel, n)
    if rho * limit**n < target:
        return -1.0, False
    for _ in range(sweeps):
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
        if abs(new - h_i) <= _NEWTON_TOLERANCE * h_i:
            return new, True
        h_i = new
    return (-1.0 if low == 0.0 else h_i), False


@jit
def _density(cloud, seen, lists, kernel, grad, r):
    refresh(seen, cloud.x, cloud.h)
    density_and_gradient(seen.x, seen.m, seen.h, lists, kernel, cloud.rho, grad, r)


@jit
def _fixed_point(rule, cloud, seen, reach, lists, kernel, grad, r, settled):
    """Sweeps of `proportional` until no h changes by more than the tolerance; `settled` says whose do not."""
    for _ in range(rule.sweeps):
        old = cloud.h.copy()
        if proportional(cloud.rho, cloud.invariant, cloud.x.shape[1], cloud.h) < rule.tolerance:
            settled[:] = True
            return
        # The plain iteration oscillates where few neighbours carry the sum: go to the geometric mean.
        for i in range(old.size):
            settled[i] = abs(cloud.h[i] - old[i]) < rule.tolerance * old[i]
            cloud.h[i] = min(math.sqrt(old[i] * cloud.h[i]), reach[i] / RADIUS[kernel[0]])
        _density(cloud, seen, lists, kernel, grad, r)


@jit
def update_smoothing(rule, cloud, seen, reach, lists, kernel, grad, r, settled):
    """Bring h to the present positions; return how many particles' lengths have not settled.

    Those that have are marked in `settled`. Where an equation has no root the old h is kept. `cloud.rho`
    holds the density of the last evaluation, which the lagged proportional update uses.
    """
    if rule.mode == FIXED:
        return 0
    n = cloud.x.shape[1]
    if rule.mode == PROPORTIONAL:
        proportional(cloud.rho, cloud.invariant, n, cloud.h)
        return 0
    _density(cloud, seen, lists, kernel, grad, r)
    if rule.mode == FIXED_POINT:
        _fixed_point(rule, cloud, seen, reach, lists, kernel, grad, r, settled)
    if rule.mode == NEWTON:
        for i in range(cloud.h.size):
            limit = reach[i] / RADIUS[kernel[0]]
            start, target = min(cloud.h[i], limit), cloud.invariant[i]
            root, settled[i] = newton(i, seen.m, start, target, lists, r, kernel, n, limit, rule.sweeps)
            if root > 0.0:
                cloud.h[i] = root
    return settled.size - settled.sum()
