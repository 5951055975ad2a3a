"""The time loop of the log-density scheme: from lattice to lattice along backward stochastic characteristics.

The FPK equation dp/dt = -div(f p) + D:grad grad p of additive noise is solved exactly by (Feynman-Kac)

    p(y, t + tau) = E[ p(Y, t) exp(-int div f ds) ],     Y the end of dY = -f ds + g dW from y, back to t,

and the expectation by a few weighted paths of the noise. Each path is a Runge-Kutta step of an ordinary
equation (002 has no counterpart: there the diffusion velocity is summed over neighbours, with explicit
limits on the step). Weights and densities are positive, so no step can become unstable; what limits tau is
accuracy.
"""

import math
from typing import NamedTuple

import numpy as np

from .._addresses import function_at
from .._jit import jit
from ..field.fitting import BUILD
from ..field.shape import local_shape, nodes_of
from ..field.walls import is_inside
from ..limits import ROUNDING
from ..small_matrices import cholesky, moments
from ..step_control import GROW, HELPED, MORE, next_step
from .aim import AIMED
from .control import (
    EVALUATIONS,
    FLOOR,
    LATTICE_STEP,
    LOST,
    LOST_MASS,
    NET_MASS,
    NODES,
    NOT_FINITE,
    OK,
    PAUSED,
    REJECTED,
    RELAID,
    RESIDUAL,
    SQUARES,
    STALLED,
    STEP_ERRORS,
    STEPS,
    VOLUME,
)
from .expectation import BACK, Step
from .flood import LAY
from .judge import BETWEEN, JUDGE
from .step_choice import CHOOSE
from .step_limits import noise_limit

_MOST = 1e-2  # residual that steps go by where the lattice's own is larger
_UNDOUBTED = 5.0  # times what may be lost, where no error is seen: 5 · .01 = .05 of the mass, by default
_UNSEEN = 0.1  # variance of a step's noise, in units of the lattice, below which shorter steps gain nothing
_PATIENCE, _GROWING = 10, 1.5  # steps that hardly grow, after which one as long as any may grow is tried
_FORGOTTEN = 0.95  # of the floor, that is left after a step: half of it after 14, .95^14 = .49
_AGAIN = 2.0  # times what is aimed at, for which a lattice is laid again
_OVERDRAWN = 0.3  # of an even share, that is left to the rest of an interval at least
ORDER = 5.0  # of a lattice's residual in its spacing: polynomials of degree 4 leave h^5

back_at, choose_at, aim_at, lay_at, build_at = BACK.at, CHOOSE.at, AIMED.at, LAY.at, BUILD.at
judge_at, between_at = JUDGE.at, BETWEEN.at


class Entries(NamedTuple):
    """Addresses of what the march calls."""

    drift: int
    divergence: int
    diffusion: int
    back: int  # or `back_in_blocks`
    choose: int
    aim: int
    judge: int
    lay: int
    between: int
    build: int
    expected: int
    reflected: int  # nowhere if no axis ends at a wall


@jit
def needed(residual, count, most, n):
    """Nodes that a lattice needs after one of `count`, whose residual tells; at most `most`.

    Of one state there may be nodes in plenty: far closer to each other than the noise of a step is wide, they
    make rounding errors at the lattice's ends grow from step to step. Of more there never are.
    """
    if n > 1:
        return float(most)
    times = (residual / ROUNDING) ** (1.0 / ORDER)
    return min(max(count * min(MORE, max(1.0 / MORE, times)), 40.0), float(most))


@jit
def _keep_inside(noise, x, m):
    """Take their mass from nodes x (N, n) beyond walls: they are there for the polynomials alone."""
    total = 0.0
    for i in range(m.size):
        m[i] = m[i] if is_inside(noise.low, noise.high, x[i]) else 0.0
        total += m[i]
    for i in range(m.size):
        m[i] /= total


@jit
def wrong(state):
    """What steps and lattices of a march have got wrong of the density: errors of steps add up."""
    return state[STEP_ERRORS] + math.sqrt(state[SQUARES])


@jit
def march(entries, noise, field, sten, paths, times, run):
    """What `carried` returns, its field as values: an interrupt in the making of a named tuple is lost."""
    told = carried(entries, noise, field, sten, paths, times, run)
    f, box = told[0], (told[0].mu, told[0].A, told[0].inverse, told[0].low, told[0].dims, told[0].owner)
    return (*box, f.node, f.kept, f.log_p, f.coefficient, f.cap, f.tail, *told[1:])


@jit
def carried(entries, noise, field, sten, paths, times, run):
    """The field carried from times[0], which is kept up to date, to times[1], seconds.

    With it its states and masses, their mean and covariance, and a code of `STATUS`. On failure they are as
    far as they came.
    """
    drift, divergence = function_at(entries.drift), function_at(entries.divergence)
    diffusion, back = function_at(entries.diffusion), back_at(entries.back)
    choose, aim = choose_at(entries.choose), aim_at(entries.aim)
    lay, build = lay_at(entries.lay), build_at(entries.build)
    judge, between = judge_at(entries.judge), between_at(entries.between)
    n, (control, state, counters) = field.mu.size, run
    mean, P, L, Q = np.empty(n), np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    x, m = nodes_of(field)
    if noise.low.size > 0:
        _keep_inside(noise, x, m)
    span, first = times[1] - times[0], counters[STEPS]
    moments(x, m, mean, P)
    before = np.inf  # error of the step refused last
    lost = np.inf  # what the step lost that was refused for that
    own, shorter = 0.0, np.inf  # error and length of the step before a long one that is tried
    since, usual = 0, 0.0  # steps since then, and how long they were
    while times[0] < times[1]:
        if counters[STEPS] - first >= control.pause_after or counters[EVALUATIONS] > control.most_work:
            return field, x, m, mean, P, PAUSED
        if not cholesky(P, L):
            return field, x, m, mean, P, NOT_FINITE
        local_shape(field, m, L, Q)
        pick = choose(drift, diffusion, noise, (x, m), (L, Q), times, span, run)
        if pick.code != OK:
            return field, x, m, mean, P, pick.code
        h, parts, t1 = pick.h, pick.parts, times[0] + pick.h
        response = aim(drift, noise, field, pick.mean, t1, h, parts)
        step = Step(
            drift, divergence, noise, field, sten, paths, response, t1, h, parts, pick.blurred,
            entries.expected, entries.reflected,
        )  # fmt: skip
        error = judge(back, step, pick.mean, m, pick.ends)
        if h > shorter:
            if error * shorter < own * h:  # less goes wrong by the second: what is seen is the lattice's own
                state[FLOOR] = 2.0 * error
            else:
                counters[REJECTED] += 1
                state[LATTICE_STEP], shorter = shorter, np.inf
                continue
        allowed, shorter = max(control.share * state[RESIDUAL], state[FLOOR]), np.inf
        if control.steps > 0.0:
            aimed = _for_step(run, h, times[1] - times[0], span)
            allowed = max(allowed, min(aimed, control.share * _MOST))
        state[LATTICE_STEP] = next_step(h, error / allowed, 3.0)  # a step gets h³ wrong
        seen = noise.G.shape[1] == 0 or h * noise_limit(noise.G, field.A) > _UNSEEN
        if error > allowed and seen and not error > HELPED * before:
            counters[REJECTED] += 1
            before = error
            if state[LATTICE_STEP] < ROUNDING * span:
                return field, x, m, mean, P, STALLED
            continue
        before = np.inf
        state[FLOOR] *= _FORGOTTEN
        since += 1
        if since == _PATIENCE:
            if state[LATTICE_STEP] < _GROWING * usual:
                own, shorter, state[LATTICE_STEP] = error, h, GROW * h
            since, usual = 0, h
        coarse = np.inf  # residual of a lattice that is laid again
        while True:
            new = lay(back, step, pick.mean, pick.shape, pick.ends, run)
            if new.code != OK:
                return field, x, m, mean, P, new.code
            laid = build(new.mu, new.A, new.node, new.x.shape[0], new.log_p, sten)
            residual = between(back, step, laid, new.log_mass)
            gone = abs(new.log_mass)  # no step has mass to lose: where one does, its witnesses were too few
            refused = control.lattices > 0.0 and _AGAIN * allowed < gone < HELPED * lost
            if control.lattices == 0.0 or refused:
                break
            state[VOLUME], aimed = new.volume, _for_lattice(run, h, times[1] - times[0], span)
            count, helped = float(new.x.shape[0]), not residual > HELPED * coarse
            state[NODES] = _nodes_for(residual, aimed, count, control, n) if helped else count
            if not helped or residual < _AGAIN * aimed or state[NODES] <= count:
                break
            coarse = residual
            counters[RELAID] += 1
        if refused:
            counters[REJECTED] += 1
            lost, state[LATTICE_STEP] = gone, next_step(h, gone / allowed, 3.0)
            continue
        if control.lattices > 0.0:
            error, lost = max(error, gone), np.inf
        else:
            if new.x.shape[0] < 0.6 * state[NODES]:  # else the next lattice has this one's spacing: it fits
                state[VOLUME] = new.volume
            state[NODES] = needed(residual, state[NODES], control.n_particles, n)
        state[LOST_MASS] += abs(new.log_mass)
        state[NET_MASS] += new.log_mass
        field, x, m, mean, P = laid, new.x, new.mass, new.mean, new.cov
        state[RESIDUAL] = min(max(residual, control.least), _MOST)
        state[SQUARES] += residual**2
        state[STEP_ERRORS] += error
        counters[STEPS] += 1
        times[0] = times[1] if pick.last else t1
        doubted = not wrong(state) < control.doubtful
        if not state[LOST_MASS] < (control.most_lost if doubted else _UNDOUBTED * control.most_lost):
            return field, x, m, mean, P, LOST
    return field, x, m, mean, P, OK


@jit
def _for_step(run, h, left, span):
    """Error that a step of length h may have, of those of which the time left is made up."""
    steps = run.control.steps
    return h * max((steps - run.state[STEP_ERRORS]) / left, _OVERDRAWN * steps / span)


@jit
def _for_lattice(run, h, left, span):
    """Residual that the lattice after a step of length h may have; those of lattices add up by squares."""
    squares = run.control.lattices**2
    return math.sqrt(h * max((squares - run.state[SQUARES]) / left, _OVERDRAWN * squares / span))


@jit
def _nodes_for(residual, allowed, count, control, n):
    """Nodes for a residual, after a lattice of `count`, whose own tells."""
    times = next_step(1.0, residual / allowed, ORDER) ** -n
    count *= min(max(times, 1.0 / MORE), MORE)
    return min(max(count, float(control.fewest)), float(control.n_particles))
