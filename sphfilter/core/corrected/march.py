"""The time loop of the moment-corrected scheme, in compiled code.

The drift is cheap, the diffusion velocity u a sum over neighbours: each particle is carried along
x' = f(x, t) + u(t) by a Runge-Kutta step of order five (Dormand & Prince 1980), with u extrapolated from the
two sums before (Adams-Bashforth), evaluated once at the end, and its change against the extrapolation put
right (Adams-Moulton). That change, and the embedded error of the Runge-Kutta step, choose the step size.
"""

import math
from typing import NamedTuple

import numpy as np

from .._jit import jit
from ..dormand_prince import A as _A
from ..dormand_prince import C as _C
from ..dormand_prince import E as _E
from ..sph.kernels import RADIUS
from .frame import (
    Cloud,
    Options,
    crosses,
    follow_spacing,
    keep_lengths,
    make_frame,
    search,
    settle,
    still_valid,
    whiten_frame,
)
from .moment_correction import correct, keep_affine
from .number_density import density_sums, transform, whiten

__all__ = ["COUNTERS", "STATUS", "Cloud", "Options", "march", "settle"]

STATUS = ("ok", "not finite", "paused", "stalled", "flat")
OK, NOT_FINITE, PAUSED, STALLED, FLAT = range(5)
COUNTERS = ("steps", "rejected", "evaluations", "searches", "functions", "culprit")
STEPS, REJECTED, EVALUATIONS, SEARCHES, FUNCTIONS, CULPRIT = range(6)

_PARABOLIC = 0.61  # 0.9 of the stability interval, 1; that of Heun's method, 2, was measured as 1.36 h^2 / D


class Work(NamedTuple):
    z: np.ndarray
    rho: np.ndarray
    grad: np.ndarray
    number: np.ndarray
    phi: np.ndarray
    A: np.ndarray
    D: np.ndarray
    divergence: np.ndarray


class History(NamedTuple):
    """Diffusion velocity now and at the end of the step, its rate of change, and Runge-Kutta stages."""

    u: np.ndarray  # (N, n)
    new: np.ndarray  # (N, n)
    slope: np.ndarray  # (N, n)
    K: np.ndarray  # (7, N, n)


@jit
def diffusion_velocity(model, coefficients, t, x, m, frame, pairs, powers, work, options, u):
    """u = -div D - D grad p / p at positions x, corrected; returns how many functions the correction used."""
    _, diffusion, divergence = model
    N, n = x.shape
    kernel, rows = (options.kernel, options.normalisation), coefficients.rows
    whiten(x, m, frame.inverse, work.z)
    density_sums(work.z, m, frame.h, pairs, kernel, work.rho, work.grad, work.number)
    if coefficients.time_dependent or coefficients.state_dependent:
        diffusion(x, t, coefficients.p, work.D)
    if coefficients.state_dependent:
        divergence(x, t, coefficients.p, work.divergence)
    score = np.empty(n)
    for i in range(N):
        for d in range(n):  # grad p / p = L^-T grad_z p / p
            score[d] = 0.0
            for e in range(d, n):
                score[d] += frame.inverse[e, d] * work.grad[i, e] / work.rho[i]
        k = i if work.D.shape[0] > 1 else 0
        for c in rows:
            s = work.divergence[i, c] if coefficients.state_dependent else 0.0
            for d in range(n):
                s += work.D[k, c * n + d] * score[d]
            u[i, c] = -s
    if powers.shape[0] == 0:
        return 0
    return correct(work.z, m, frame.inverse, work.D, rows, powers, u, work.phi, work.A)


@jit
def _stable_steps(frame, work, variance, degree):
    """Largest steps at which extrapolated diffusion is stable: plain, put right, put right in affine parts.

    Whitened, the fastest mode of the sums decays at a rate of about 1.5 D / (c_K h^2), a moment of order k,
    which the correction makes exact, at k D. The rates times dt may be 1 without and .55 with what
    Adams-Moulton adds (roots of the characteristic polynomials of the two methods).
    """
    n = frame.L.shape[0]
    G, limit, spread, fastest = np.empty((n, n)), np.inf, 0.0, 1e-300
    for i in range(frame.h.size):
        if i < work.D.shape[0]:
            spread = 0.0
            for a in range(n):
                for b in range(n):
                    G[a, b] = 0.0
                    for c in range(n):
                        for d in range(n):
                            G[a, b] += frame.inverse[a, c] * work.D[i, c * n + d] * frame.inverse[b, d]
                    spread += G[a, b] * G[a, b]
            spread = math.sqrt(spread)  # Frobenius: no less than the largest eigenvalue, equal for rank one
        fastest = max(fastest, spread)
        limit = min(limit, _PARABOLIC * 2.0 * variance * frame.h[i] ** 2 / max(spread, 1e-300))
    plain = min(limit, 0.9 / ((degree + 1) * fastest))
    return plain, 0.5 * plain, min(plain, 0.25 / fastest)


@jit
def _rms(z, m):
    """Root mean square of whitened vectors, over the mass and the axes."""
    square, total = 0.0, 0.0
    for i in range(m.size):
        total += m[i]
        for d in range(z.shape[1]):
            square += m[i] * z[i, d] * z[i, d]
    return math.sqrt(square / (total * z.shape[1]))


@jit
def _size(v, m, inverse, z):
    """Root mean square of displacements v, in whitened coordinates."""
    transform(v, np.zeros(v.shape[1]), inverse, z)
    return _rms(z, m)


@jit
def _drift_step(drift, p, t, dt, x0, history, x):
    """x after dt of x' = f(x, t) + u + slope (t - t0); K[6] becomes the error of order four against five."""
    u, _, slope, K = history
    N, n = x0.shape
    for stage in range(7):
        for i in range(N):
            for d in range(n):
                s = 0.0
                for k in range(stage):
                    s += _A[stage, k] * K[k, i, d]
                x[i, d] = x0[i, d] + dt * s
        drift(x, t + _C[stage] * dt, p, K[stage])
        for i in range(N):
            for d in range(n):
                K[stage, i, d] += u[i, d] + _C[stage] * dt * slope[i, d]
    for i in range(N):
        for d in range(n):
            s = 0.0
            for k in range(7):
                s += _E[k] * K[k, i, d]
            K[6, i, d] = dt * s


@jit
def _begin(model, coefficients, t, span, cloud, frame, pairs, powers, work, options, history):
    """u and its rate of change at the start, the step to try, and the largest stable steps.

    The rate comes from a look a little ahead, which counts as a point of the past of negative age.
    """
    x, m, K = cloud.x, cloud.m, history.K
    N, n = x.shape
    limits, ago = (np.inf, np.inf, np.inf), 1.0
    interacting = coefficients.rows.size > 0
    if interacting:
        diffusion_velocity(model, coefficients, t, x, m, frame, pairs, powers, work, options, history.u)
        limits = _stable_steps(frame, work, options.variance, options.degree)
    model[0](x, t, coefficients.p, K[0])
    for i in range(N):
        for d in range(n):
            K[0, i, d] += history.u[i, d]
    whiten(K[0], m, frame.inverse, work.z)
    first = 0.1 / max(_rms(work.z, m), 1e-300)  # a tenth of the time in which the cloud deforms by its size
    if interacting:
        ago = -min(0.1 * first, 0.1 * limits[0], 0.1 * span, options.dt_max)
        for i in range(N):
            for d in range(n):
                K[1, i, d] = x[i, d] - ago * K[0, i, d]
        ahead = (model, coefficients, t - ago, K[1], m, frame, pairs, powers, work, options, history.new)
        diffusion_velocity(*ahead)
        for i in range(N):
            for d in range(n):
                history.slope[i, d] = (history.u[i, d] - history.new[i, d]) / ago
    return first, limits, ago


@jit
def _surprise(dt, ago, history, m, inverse, z):
    """What Adams-Moulton adds to the extrapolated step, into K[0]; returns its size."""
    u, new, slope, K = history
    weight = dt * (dt / 3.0 + ago / 2.0) / (dt + ago)
    for i in range(u.shape[0]):
        for d in range(u.shape[1]):
            K[0, i, d] = weight * (new[i, d] - u[i, d] - dt * slope[i, d])
    return _size(K[0], m, inverse, z)


@jit
def _accept(x, m, dt, limits, work, history):
    """Put the step right as far as that is stable, and make the new u the present one.

    The whole of the correction damps short waves less than the extrapolation alone. Its affine part, which
    is what mean and covariance see of it, has no short waves.
    """
    u, new, slope, K = history
    if dt > limits[1] and work.A.shape[0] > 0:
        keep_affine(m, work.phi, work.A, K[0])
    put_right = dt <= limits[1] or (work.A.shape[0] > 0 and dt <= limits[2])
    for i in range(x.shape[0]):
        for d in range(x.shape[1]):
            x[i, d] += K[0, i, d] if put_right else 0.0
            slope[i, d] = (new[i, d] - u[i, d]) / dt
            u[i, d] = new[i, d]


@jit
def _allocate(N, n, q, coefficients):
    """Arrays of the march; D is filled in where it is constant."""
    varies = coefficients.time_dependent or coefficients.state_dependent
    D = np.empty((N if varies else 1, n * n))
    if not varies:
        D[0] = coefficients.D.ravel()
    sums = (np.empty((N, n)), np.empty(N), np.empty((N, n)), np.empty(N))
    work = Work(*sums, np.empty((N, q)), np.empty((q, q)), D, np.empty((N, n)))
    return work, History(np.zeros((N, n)), np.zeros((N, n)), np.zeros((N, n)), np.empty((7, N, n)))


@jit
def _next_step(dt, left):
    """The step that is wanted, or all that is left, or half of it where two steps will do."""
    if dt > 0.999 * left:
        return left
    return min(dt, 0.5 * left)


@jit
def march(drift, diffusion, divergence, coefficients, cloud, options, powers, times, counters):
    """Carry the cloud from times[0] to times[1]; times[0], times[2] and the counters are kept up to date.

    times[2] is the step to try, 0 to choose one. Returns a code of `STATUS`. "paused" asks to be called
    again: between calls Python can be interrupted.
    """
    N, n = cloud.x.shape
    x, m, model, interacting = cloud.x, cloud.m, (drift, diffusion, divergence), coefficients.rows.size > 0
    frame, (work, history) = make_frame(N, n), _allocate(N, n, powers.shape[0], coefficients)
    x0, steps_before, span = x.copy(), counters[STEPS], times[1] - times[0]
    if not whiten_frame(cloud, frame):
        return FLAT
    pairs = search(frame, options)
    arguments = (times[0], span, cloud, frame, pairs, powers, work, options, history)
    first, limits, ago = _begin(model, coefficients, *arguments)
    counters[SEARCHES] += interacting
    counters[EVALUATIONS] += 2 * interacting
    times[2] = first if times[2] == 0.0 else times[2]
    while times[0] < times[1]:
        dt = _next_step(min(times[2], limits[0], options.dt_max), times[1] - times[0])
        if not dt > 1e-9 * span:
            return STALLED if dt > 0.0 else NOT_FINITE
        x0[:] = x
        _drift_step(drift, coefficients.p, times[0], dt, x0, history, x)
        error = _size(history.K[6], m, frame.inverse, work.z) / options.tol
        way, counters[CULPRIT] = crosses(x0, x, m, frame)
        way = way if interacting or not math.isfinite(way) else 0.0
        factor = min(0.9 * max(error, 1e-6) ** -0.2, 0.45 / max(way, 0.01))
        accepted = error <= 1.0 and way <= 0.5
        if accepted and interacting:
            whiten(x, m, frame.inverse, work.z)
            if not still_valid(work.z, m, frame, RADIUS[options.kernel]):
                keep_lengths(cloud, frame)
                if not whiten_frame(cloud, frame):
                    return FLAT
                pairs = search(frame, options)
                counters[SEARCHES] += 1
            ends = (times[0] + dt, x, m, frame, pairs, powers, work, options, history.new)
            counters[FUNCTIONS] = diffusion_velocity(model, coefficients, *ends)
            counters[EVALUATIONS] += 1
            error = _surprise(dt, ago, history, m, frame.inverse, work.z) / options.tol
            factor = min(factor, 0.9 * max(error, 1e-6) ** (-1 / 3))
            accepted = error <= 1.0
        if not accepted:
            x[:] = x0
            counters[REJECTED] += 1
            times[2] = dt * (min(max(factor, 0.2), 0.9) if math.isfinite(factor) else 0.2)
            continue
        counters[STEPS] += 1
        # A step cut short by the end or a limit says nothing against the longer one that was planned.
        planned = times[2] if dt < times[2] and factor > 1.0 else 0.0
        times[2] = max(planned, dt * min(factor, 5.0))
        if interacting:
            _accept(x, m, dt, limits, work, history)
            follow_spacing(frame, work.number, options, n)
            ago, limits = dt, _stable_steps(frame, work, options.variance, options.degree)
        times[0] = times[1] if dt == times[1] - times[0] else times[0] + dt
        if counters[STEPS] - steps_before >= options.pause_after and times[0] < times[1]:
            break
    keep_lengths(cloud, frame)
    return OK if times[0] == times[1] else PAUSED
