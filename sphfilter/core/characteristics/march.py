"""The time loop of the log-density scheme: from lattice to lattice along backward stochastic characteristics.

The FPK equation dp/dt = -div(f p) + D:grad grad p of additive noise is solved exactly by (Feynman-Kac)

    p(y, t + tau) = E[ p(Y, t) exp(-int div f ds) ],     Y the end of dY = -f ds + g dW from y, back to t,

and the expectation by a few weighted paths of the noise. Each path is a Runge-Kutta step of an ordinary
equation (002 has no counterpart: there the diffusion velocity is summed over neighbours, with explicit
limits on the step). Weights and densities are positive, so no step can become unstable; what limits tau is
accuracy.
"""

from typing import NamedTuple

import numpy as np

from .._addresses import function_at
from .._jit import jit
from ..field.fitting import BUILD
from ..field.shape import local_shape, nodes_of
from ..small_matrices import cholesky, moments
from .control import LATTICE_STEP, LOST, LOST_MASS, NOT_FINITE, OK, PAUSED, REJECTED, STEPS, VOLUME
from .expectation import AIMED, BACK, Step
from .flood import LAY
from .step_choice import CHOOSE

__all__ = ["Entries", "march"]

_STEP_LOSS = 0.13  # of all that may be lost, from which a step is tried again in halves
_SMALLER = 2  # times a step that loses probability is halved

back_at, choose_at, aim_at, lay_at, build_at = BACK.at, CHOOSE.at, AIMED.at, LAY.at, BUILD.at


class Entries(NamedTuple):
    """Addresses of what the march calls."""

    drift: tuple
    divergence: tuple
    diffusion: tuple
    back: tuple  # or `back_in_blocks`
    choose: tuple
    aim: tuple
    lay: tuple
    build: tuple


@jit
def march(entries, noise, field, sten, paths, control, times, state, counters):
    """Carry a field from times[0] to times[1].

    Parameters
    ----------
    entries : Entries
    noise : Noise
    field : Field
    sten : Stencils
    paths : Paths
    control : Control
    times : ndarray, shape (2,)
        Seconds; times[0] is kept up to date.
    state, counters : ndarray
        As `control` names them; kept up to date.

    Returns
    -------
    tuple
        The field, its states and masses, their mean and covariance, and a code of `STATUS`. On failure they
        are as far as they came.
    """
    drift, divergence = function_at(entries.drift), function_at(entries.divergence)
    diffusion, back = function_at(entries.diffusion), back_at(entries.back)
    choose, aim = choose_at(entries.choose), aim_at(entries.aim)
    lay, build = lay_at(entries.lay), build_at(entries.build)
    n = field.mu.size
    mean, P, L, Q = np.empty(n), np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    x, m = nodes_of(field)
    span, first = times[1] - times[0], counters[STEPS]
    moments(x, m, mean, P)
    tried, before, coarse = 0, np.inf, False
    while times[0] < times[1]:
        if counters[STEPS] - first >= control.pause_after:
            return field, x, m, mean, P, PAUSED
        if not cholesky(P, L):
            return field, x, m, mean, P, NOT_FINITE
        local_shape(field, m, L, Q)
        pick = choose(drift, diffusion, noise, x, m, L, Q, times, span, control, state, counters)
        if pick.code != OK:
            return field, x, m, mean, P, pick.code
        h, parts, t1 = pick.h, pick.parts, times[0] + pick.h
        response = aim(drift, noise, field, pick.mean, t1, h, parts)
        step = Step(drift, divergence, noise, field, sten, paths, response, t1, h, parts, pick.blurred)
        new = lay(back, step, pick.mean, pick.shape, pick.ends, control, state, counters)
        if new.code != OK:
            return field, x, m, mean, P, new.code
        lost = abs(new.log_mass)
        coarse |= lost > 0.5 * before  # a shorter step did not help: it is the lattice
        if lost > _STEP_LOSS * control.most_lost and tried < _SMALLER and not coarse:
            tried, before, state[LATTICE_STEP] = tried + 1, lost, 0.5 * h
            counters[REJECTED] += 1
            continue
        tried, before = 0, np.inf
        if (
            new.x.shape[0] < 0.6 * control.n_particles
        ):  # else the next lattice has this one's spacing: it fits
            state[VOLUME] = new.volume
        state[LOST_MASS] += lost
        x, m, mean, P = new.x, new.mass, new.mean, new.cov
        field = build(new.mu, new.A, new.node, new.log_p, sten)
        counters[STEPS] += 1
        times[0] = times[1] if pick.last else t1
        if not state[LOST_MASS] < control.most_lost:
            return field, x, m, mean, P, LOST
    return field, x, m, mean, P, OK
