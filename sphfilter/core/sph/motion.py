"""How particles move: their velocity v = f + u, how long a step may be, and the step (002 section 2.2)."""

import math

import numpy as np

from .._addresses import function_at
from .._jit import jit
from ..limits import TINY
from ..sde_steps import moved
from .state import INTEGRATORS
from .summation import DENSITY

EULER, MIDPOINT, RK4 = range(len(INTEGRATORS))

density_at = DENSITY.at


@jit
def velocity(equations, t, cloud, work, v):
    """v = f - div D - D grad(rho)/rho: 002 (7) with the factor 1/2 that its D2 terms lack."""
    x, D, p, rho = cloud.x, work.D, equations.p, cloud.rho
    n, by_state = x.shape[1], equations.state_dependent
    function_at(equations.drift)(x, t, p, v)
    if by_state or equations.time_dependent:
        function_at(equations.diffusion)(x, t, p, D)
    if by_state:
        function_at(equations.divergence)(x, t, p, work.divergence)
    for i in range(x.shape[0]):
        k = i if D.shape[0] > 1 else 0
        for c in equations.rows:
            u = 0.0
            for d in range(n):
                u += D[k, c * n + d] * work.grad[i, d]
            v[i, c] -= u / rho[i]
            if by_state:
                v[i, c] -= work.divergence[i, c]


@jit
def evaluate(density, equations, t, cloud, near, work, options, v):
    """Density, gradient and velocity v (N, n) of the particles at a time, seconds, which are written.

    `density` is the address of `DENSITY`; cloud, near, work and options are as the march holds them.
    """
    density_at(density)(cloud, near, work, options)
    velocity(equations, t, cloud, work, v)


@jit
def stable_step(cloud, v, near, work, options):
    """Step size of 002 (18), absolute or relative to the nearest neighbour, within the diffusion limit.

    The diffusion limit is that of an explicit step on kernels of variance c_K h^2 (unstable from about
    2.7 c_K h^2 / D on). v (N + G, n) are velocities of the particles and, after them, of their images; `work`
    has D as it is now. Returns seconds, NaN where a velocity is not finite, and the particle that limits it.
    """
    (start, neighbors), r, D = near.lists, near.r, work.D
    N, n = cloud.x.shape
    relative, c_cfl = options.relative_cfl, options.c_cfl
    widest = options.c_diffusion * options.kernel_variance
    dt, culprit = np.inf, 0
    for i in range(N):
        nearest, at = np.inf, -1
        for s in range(start[i], start[i + 1]):
            if r[s] < nearest:
                nearest, at = r[s], neighbors[s]
        speed2, spread = 0.0, 0.0
        for d in range(n):
            other = v[at, d] if relative and at >= 0 else 0.0
            speed2 += (v[i, d] - other) ** 2
            spread += D[i if D.shape[0] > 1 else 0, d * n + d]
        if not math.isfinite(speed2):
            return np.nan, i
        limit = widest * cloud.h[i] ** 2 / max(spread, TINY)
        if nearest < np.inf:
            limit = min(limit, c_cfl * nearest / max(math.sqrt(speed2), TINY))
        if math.isnan(limit):
            return np.nan, i
        if limit < dt:
            dt, culprit = limit, i
    return dt, culprit


@jit
def move(density, equations, t, dt, cloud, near, work, options):
    """Evaluations made by one Euler, midpoint or RK4 step of the cloud's x from time t over dt seconds.

    At the start the velocity is in `work.v`; the rest is as `evaluate` takes it. Smoothing lengths stay as
    they are within a step. 001 (29) prints the midpoint rule as "leapfrog".
    """
    x, v = cloud.x, work.v
    if options.integrator == EULER:
        moved(x, dt, v, x)
        return 0
    x0, k = x.copy(), np.empty_like(x)
    n_stages = 1 if options.integrator == MIDPOINT else 3
    total = v.copy()
    for stage in range(n_stages):
        ahead = dt if stage == 2 else 0.5 * dt
        moved(x0, ahead, v if stage == 0 else k, x)
        evaluate(density, equations, t + ahead, cloud, near, work, options, k)
        moved(total, 1.0 if stage == 2 else 2.0, k, total)
    if options.integrator == MIDPOINT:
        moved(x0, dt, k, x)
    else:
        moved(x0, dt / 6.0, total, x)
    return n_stages
