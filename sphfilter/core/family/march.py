"""A family carried through time: Dormand and Prince's steps, and frames that follow the density."""

import math
from typing import NamedTuple

import numpy as np

from .. import dormand_prince as dp
from .._jit import jit
from ..limits import FAR, TINY
from ..small_matrices import moments
from ..step_control import GROW, next_step
from .frame import inverse, moved, refitted, reframed, root_between, weigh
from .rates import DEFECT, RATES, multiplied, work

OK, STALLED, TOO_MANY, NOT_FINITE, ASTRAY = range(5)
#: What a code says.
STATUS = "ok", "stalled", "too many steps", "not finite", "astray"

_OFF = 0.15  # of the moments in the frame, from which it follows
_TRIES = 5  # steps refused one after the other: each a fifth of the last or less, 5^-5 = 3e-4 of the first

MISSED = 1.0  # of log p, as rms, at which it is given up: more is missed than there is, as exp(1) - 1 > 1
_MOST = 0.7  # norm of a defect's polynomial: of exp(.7) - 1 the second order is a quarter

#: Squarings of 1 + x + x²/2 for x over 2^4: exp(1) to 6e-4, stable up to |x| = 32.
_SQUARED = 4

rates_at, defect_at = RATES.at, DEFECT.at


class Control(NamedTuple):
    """When and how."""

    t: float
    t1: float
    tolerance: float  # error of a step, in units of the frame
    longest: float  # step, seconds
    max_steps: int


class Report(NamedTuple):
    """Report of a march."""

    code: int
    t: float  # where it ended
    steps: int
    rejected: int
    evaluations: int
    residual: float  # integral over time of what the family could not follow
    stepping: float  # sum of the errors of the steps


@jit
def march(flow, basis, beyond, turned, control, y, defect):
    """Carry y = (mu, A, c) and its defect from t to t1, in place; returns a `Report`.

    A defect is what `defect_rates` describes. It goes by exponential steps of second order (Cox and Matthews
    2002), which do not decide how long they are. What the nodes of a rule see nothing of, such as a bend
    between two of them, those of the `turned` one tell at both ends.
    """
    own, n, rates = work(beyond, flow.state_dependent), basis.xi.shape[1], rates_at(flow.rates)
    unseen = np.zeros(2)
    k, trial, error = np.empty((7, y.size)), np.empty(y.size), np.empty(y.size)
    slope, other = np.empty((2, defect.size)), np.empty((2, defect.size))
    t, residual, stepping, steps, rejected, refused, asked = control.t, 0.0, 0.0, 0, 0, 0, 1
    before = math.sqrt(rates(flow, basis, own, t, y, k[0]))
    speed = _norm(own, n, k[0])
    if not math.isfinite(speed):
        return Report(NOT_FINITE, t, 0, 0, 1, 0.0, 0.0)
    h = min(control.t1 - t, control.longest, control.tolerance**0.2 / max(speed, TINY))
    _add_unseen(flow, turned, t, y, k[0], before, unseen)
    defect_at(flow.defect)(flow, basis, beyond, own, y, k[0], defect, slope)
    while t < control.t1:
        if steps + rejected >= control.max_steps:
            return Report(TOO_MANY, t, steps, rejected, asked, residual, stepping)
        last = h >= (control.t1 - t) * (1.0 - 1e-9)
        h = control.t1 - t if last else h
        after = _step(flow, basis, own, t, h, y, k, trial)
        asked += 6
        for e in range(y.size):
            error[e] = 0.0
            for s in range(7):
                error[e] += h * dp.E[s] * k[s, e]
        inverse(y[n : n + n * n].reshape((n, n)), own.inverse)
        off = _norm(own, n, error) / control.tolerance
        if not off <= 1.0:
            rejected, refused = rejected + 1, refused + 1
            if refused >= _TRIES * (1 if math.isnan(off) else 4):
                return Report(STALLED, t, steps, rejected, asked, residual, stepping)
            h = next_step(h, off, 5.0)
            continue
        residual += 0.5 * h * (before + after)
        stepping += off * control.tolerance
        t, steps, refused = control.t1 if last else t + h, steps + 1, 0
        for e in range(y.size):
            y[e] = trial[e]
        for e in range(defect.size):
            defect[e] += h * _phi(h * slope[1, e])[0] * slope[0, e]
        _bounded(defect[: beyond.V.shape[0]])  # its square makes some of the rest, and that is not forgotten
        inverse(y[n : n + n * n].reshape((n, n)), own.inverse)  # as the rates k[6] have left it
        defect_at(flow.defect)(flow, basis, beyond, own, y, k[6], defect, other)
        _shear(h, n, slope[1], other[1], defect)
        for e in range(defect.size):
            z = h * slope[1, e]
            defect[e] += h * _phi(z)[1] * (other[0, e] - math.exp(-z) * slope[0, e])
        _bounded(defect[: beyond.V.shape[0]])
        h = min(next_step(h, off, 5.0), control.longest)
        followed = _follow(basis, beyond, y, defect, 0.0 if t >= control.t1 else _OFF)
        if followed < 0 or not residual < MISSED:
            return Report(ASTRAY, t, steps, rejected, asked, residual, stepping)
        if followed > 0:
            before = math.sqrt(rates(flow, basis, own, t, y, k[0]))
            asked += t < control.t1  # at the end it tells an error, and is of no step
        else:
            before = after
            for e in range(y.size):  # not k[0] = k[6]: numba compiles forty functions for that
                k[0, e] = k[6, e]
        if t < control.t1:
            defect_at(flow.defect)(flow, basis, beyond, own, y, k[0], defect, slope)
    if steps > 0:
        _add_unseen(flow, turned, t, y, k[0], before, unseen)
        span, last, A = t - control.t, defect.size - 1, y[n : n + n * n].reshape((n, n))
        defect[last] += 0.5 * span * _phi(span * slope[1, last])[0] * unseen[1]
        for a in range(n):
            for b in range(n):
                for e in range(n):
                    defect[last - n * n + a * n + b] += (0.5 * span * unseen[0]) ** 2 * A[a, e] * A[b, e]
    return Report(OK, t, steps, rejected, asked, residual, stepping)


@jit
def _add_unseen(flow, turned, t, y, dy, left, unseen):
    """Add by how much the nodes of another rule change the rates dy, in the frame, and leave more of them."""
    own, n, there = work(turned, flow.state_dependent), turned.xi.shape[1], np.empty(y.size)
    more = math.sqrt(rates_at(flow.rates)(flow, turned, own, t, y, there)) - left
    for e in range(y.size):
        there[e] -= dy[e]
    unseen[0] += _norm(own, n, there)
    unseen[1] += max(more, 0.0)


@jit
def _step(flow, basis, own, t, h, y, k, trial):
    """One step from y, whose rates are k[0]; returns the residual's rate at its end."""
    left, rates = 0.0, rates_at(flow.rates)
    for s in range(1, 7):
        for e in range(y.size):
            trial[e] = y[e]
            for r in range(s):
                trial[e] += h * dp.A[s, r] * k[r, e]
        left = rates(flow, basis, own, t + dp.C[s] * h, trial, k[s])
    return math.sqrt(left)


@jit
def _shear(h, n, begin, end, defect):
    """Change the covariance U of a defect to M U M^T, for the flow M of the gradients at both ends of a step.

    Unlike U + h dU that has no variance below zero.
    """
    own, M, X = slice(defect.size - 1 - n * n, defect.size - 1), np.eye(n), np.empty((n, n))
    U, begin, end = defect[own].reshape((n, n)), begin[own].reshape((n, n)), end[own].reshape((n, n))
    for a in range(n):
        for b in range(n):
            X[a, b] = 0.5 * h * (begin[a, b] + end[a, b]) / 2.0**_SQUARED
    square = multiplied(X, X)
    for a in range(n):
        for b in range(n):
            M[a, b] += X[a, b] + 0.5 * square[a, b]
    for _ in range(_SQUARED):
        M = multiplied(M, M)
    once = multiplied(M, U)
    for a in range(n):
        for b in range(n):
            U[a, b] = 0.0
            for k in range(n):
                U[a, b] += once[a, k] * M[b, k]


@jit
def _phi(z):
    """(1 - exp(-z)) / z, and one less that, over z."""
    if abs(z) < 1e-6:
        return 1.0 - 0.5 * z, 0.5 - z / 6.0
    first = -math.expm1(-z) / z
    return first, (1.0 - first) / z


@jit
def _bounded(e):
    """Shorten a defect's polynomial, but for its constant, to where its first order says something."""
    square = 0.0
    for j in range(1, e.size):
        square += e[j] ** 2
    if not square <= _MOST**2:
        part = _MOST / math.sqrt(square) if square < np.inf else 0.0
        for j in range(e.size):
            e[j] *= part


@jit
def _norm(own, n, d):
    """Size of a change d = (dmu, dA, dc), the first two in the frame; NaN where it is not finite."""
    total = 0.0
    for e in range(n + n * n, d.size):
        total += d[e] ** 2
    for b in range(n + 1):
        for a in range(n):
            inside = 0.0
            for k in range(n):
                inside += own.inverse[a, k] * (d[k] if b == n else d[n + k * n + b])
            total += inside**2
    return math.sqrt(total)


@jit
def _follow(basis, beyond, y, defect, least):
    """Move the frame to the density where it is off by more than `least`; 1 if it was, -1 if that is far."""
    N, n = basis.xi.shape
    mu, A, c = y[:n], y[n : n + n * n].reshape((n, n)), y[n + n * n :]
    T, w, b, C, root = np.zeros(N), np.empty(N), np.empty(n), np.empty((n, n)), np.empty((n, n))
    for j in range(c.size):
        for i in range(N):
            T[i] += c[j] * basis.V[j, i]
    weigh(basis.log_w, n, T, w)
    moments(basis.xi, w, b, C)
    off = moved(b, C)
    if not off < FAR:
        return -1
    if off <= least:
        return 0
    root_between(C, 1.0 / GROW, GROW, root)
    reframed(basis, mu, A, c, b, root)
    refitted(beyond, defect[: beyond.V.shape[0]], b, root)
    return 1
