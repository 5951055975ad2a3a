"""The time loop of the log-density scheme: from lattice to lattice along backward stochastic characteristics.

The FPK equation dp/dt = -div(f p) + D:grad grad p of additive noise is solved exactly by (Feynman-Kac)

    p(y, t + tau) = E[ p(Y, t) exp(-int div f ds) ],     Y the end of dY = -f ds + g dW from y, back to t,

and the expectation by a few weighted paths of the noise. Each path is a Runge-Kutta step of an ordinary
equation (002 has no counterpart: there the diffusion velocity is summed over neighbours, with explicit
limits on the step). Weights and densities are positive, so no step can become unstable; what limits tau is
accuracy.
"""

import math

import numpy as np

from ._first_class import function_at
from ._jit import jit
from .fitting import build_field
from .flood import EVALUATIONS, MOST_ASKED, REJECTED, RELAID, STEPS, flooded, relaid
from .noise_paths import Step, aimed, along, noise_factor_at
from .small_matrices import cholesky, eigen, invert_lower, moments, times_lower
from .step_limits import bentness, noise_limit, path_error, predicted, sheared

__all__ = ["LOCAL", "LOST_MASS", "STATUS", "VOLUME", "local_shape", "march"]

STATUS = ("ok", "not finite", "paused", "stalled", "too few nodes", "outgrown", "lost")
OK, NOT_FINITE, PAUSED, STALLED, TOO_FEW, OUTGROWN, LOST = range(7)
#: What `state` holds: filled volume of the whitened lattice, next step of the paths, sum of |log mass| lost,
#: longest step, next step of the lattice.
VOLUME, PATH_STEP, LOST_MASS, LONGEST, LATTICE_STEP = range(5)
_TRIES = 6
LOCAL = 0.9  # variance within pieces, over that of the whole, below which lattices follow the pieces
_FILL = 0.85  # nodes aimed at, over those allowed
_STEP_LOSS = 0.13  # of all that may be lost, from which a step is tried again in halves
_SMALLER = 2  # times a step that loses probability is halved
_MOST_PARTS = 16  # Runge-Kutta steps from lattice to lattice


@jit
def nodes_of(field):
    """States (N, n) and masses of a field's nodes."""
    N, n = field.node.shape
    x, m, total = np.empty((N, n)), np.empty(N), 0.0
    for i in range(N):
        m[i] = math.exp(field.log_p[i])
        total += m[i]
        for a in range(n):
            x[i, a] = field.mu[a]
            for c in range(n):
                x[i, a] += field.A[a, c] * field.node[i, c]
    for i in range(N):
        m[i] /= total
    return x, m


@jit
def local_shape(field, m, L, Q):
    """Lower Q with which L Q whitens the density piece by piece, where L whitens it as a whole.

    (L Q)(L Q)^T is the inverse of the Fisher information E[grad log p (grad log p)^T]: the covariance of a
    Gaussian, and that within the pieces of a density in several, or across a bent one. Q is the identity
    unless the two differ by much.
    """
    n = L.shape[0]
    info, R, B = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    w, V, total = np.empty(n), np.empty((n, n)), 0.0
    for i in range(m.size):
        known = False
        for a in range(n):
            known |= field.coefficient[i, a] != 0.0
        if known:  # nodes at the rim have no polynomial
            total += m[i]
            for a in range(n):
                for b in range(n):
                    info[a, b] += m[i] * field.coefficient[i, a] * field.coefficient[i, b]
    inverse = invert_lower(L)
    for a in range(n):
        for b in range(n):
            info[a, b] /= total
            for k in range(n):
                B[a, b] += inverse[a, k] * field.A[k, b]
    eigen(info, w, V)
    for k in range(n):  # R = B info^-1 B^T
        for a in range(n):
            v = 0.0
            for b in range(n):
                v += B[a, b] * V[b, k]
            info[a, k] = v / math.sqrt(max(w[k], 1e-300))
    for a in range(n):
        for b in range(n):
            for k in range(n):
                R[a, b] += info[a, k] * info[b, k]
            Q[a, b] = 1.0 if a == b else 0.0
    for a in range(n):
        for b in range(n):
            B[a, b] = R[a, b]
    eigen(B, w, V)
    smallest = w[0]
    for k in range(n):
        smallest = min(smallest, w[k])
    if 0.0 < smallest < LOCAL:
        cholesky(R, Q)


@jit
def march(addresses, noise, field, sten, paths, control, times, state, counters, threads):
    """Carry a field from times[0] to times[1]; times[0], `state` and the counters are kept up to date.

    addresses: of the model's drift, divergence and D, so that it is entered without looking functions up.
    threads: None for one thread, True for as many as there are.
    state: see `VOLUME` and what follows it.
    Returns the field, its states and masses, their mean and covariance, and a code of `STATUS`. On failure
    they are as far as they came.
    """
    drift, divergence = function_at(addresses[0]), function_at(addresses[1])
    diffusion = function_at(addresses[2])
    n = field.mu.size
    mean, P, L = np.empty(n), np.empty((n, n)), np.empty((n, n))
    Q, S = np.empty((n, n)), np.empty((n, n))
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
        times_lower(L, Q, S)
        t, left = times[0], times[1] - times[0]
        h = min(_MOST_PARTS * state[PATH_STEP], left, state[LONGEST], state[LATTICE_STEP])
        if noise.time_dependent:
            noise_factor_at(diffusion, x, t + 0.5 * h, noise)
        limit = control.noise_share / max(noise_limit(noise.G, S), 1e-300)
        bent = control.bent_share / max(sheared(drift, noise, x, m, t, S), 1e-300)
        h = min(h, limit, bent ** (1.0 / 3.0))
        pieces = math.ceil(left / h - 1e-9)
        h = left if pieces <= 1 else (0.5 * left if pieces == 2 else h)
        parts = max(1, math.ceil(h / state[PATH_STEP] - 1e-9))
        once, twice, f, still = np.empty_like(x), np.empty_like(x), np.empty_like(x), np.zeros_like(x)
        drift(x, t, noise.p, f)
        along(drift, None, noise, x, f, f, t, h, parts, still, still, once, m)
        along(drift, None, noise, x, f, f, t, h, 2 * parts, still, still, twice, m)
        counters[EVALUATIONS] += (12 * parts + 2 * noise.G.shape[1]) * x.shape[0]
        error = path_error(once, twice, m, S) / control.tolerance
        factor = 5.0 if error == 0.0 else min(5.0, max(0.2, 0.9 * error**-0.25)) if error < np.inf else 0.1
        state[PATH_STEP] = min(h / parts * factor, 1e300)
        if error > 1.0:
            counters[REJECTED] += 1
            if state[PATH_STEP] < 1e-9 * span:
                return field, x, m, mean, P, (NOT_FINITE if error == np.inf else STALLED)
            continue
        mean_new, P_new = np.empty(n), np.empty((n, n))
        X = predicted(drift, noise, x, f, twice, m, t, h, parts, mean_new, P_new)
        counters[EVALUATIONS] += 16 * parts * noise.G.shape[1] * x.shape[0]
        if not cholesky(P_new, L):
            return field, x, m, mean, P, NOT_FINITE
        times_lower(L, Q, S)
        curved = bentness(X, m, S) / control.curved
        state[LATTICE_STEP] = h * min(3.0, max(0.2, 0.9 / math.sqrt(max(curved, 1e-6))))
        if curved > 1.0:
            counters[REJECTED] += 1
            continue
        mean_old, P_old = mean, P
        mean, P = mean_new, P_new
        aim = aimed(drift, noise, field, mean, t + h, h, parts)
        step = Step(drift, divergence, noise, field, sten, paths, aim, t + h, h, parts)
        for attempt in range(_TRIES):
            spacing = (state[VOLUME] / (_FILL * control.n_particles)) ** (1.0 / n)
            A, origin = S.copy(), mean.copy()
            for a in range(n):
                for b in range(n):
                    A[a, b] *= spacing
            value, low, dims, highest, asked = flooded(step, origin, A, twice, control, counters, threads)
            if value.size == 0:
                return field, x, m, mean, P, OUTGROWN
            node, x_new, log_p, m_new, log_mass, mean, P = relaid(
                value, low, dims, highest, asked, origin, A, sten, control.depth
            )
            closed = asked.size <= MOST_ASKED * control.n_particles
            count = x_new.shape[0] if closed else asked.size
            if 0.5 * control.n_particles <= count <= control.n_particles:
                break
            counters[RELAID] += 1
            state[VOLUME] *= max(count, 0.1 * control.n_particles) / (_FILL * control.n_particles)
            if attempt == _TRIES - 1 and (count == 0 or count > control.n_particles):
                return field, x, m, mean, P, TOO_FEW
        lost = abs(log_mass)
        coarse |= lost > 0.5 * before  # a shorter step did not help: it is the lattice
        if lost > _STEP_LOSS * control.most_lost and tried < _SMALLER and not coarse:
            tried, before, state[LATTICE_STEP] = tried + 1, lost, 0.5 * h
            counters[REJECTED] += 1
            mean, P = mean_old, P_old
            continue
        tried, before = 0, np.inf
        if count < 0.6 * control.n_particles:  # else the next lattice has this one's spacing: it fits
            state[VOLUME] = count * spacing**n
        state[LOST_MASS] += lost
        x, m = x_new, m_new
        field = build_field(origin, A, node, log_p, sten)
        counters[STEPS] += 1
        times[0] = times[1] if pieces <= 1 else t + h
        if not state[LOST_MASS] < control.most_lost:
            return field, x, m, mean, P, LOST
    return field, x, m, mean, P, OK
