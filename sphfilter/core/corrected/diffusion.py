"""The corrected diffusion velocity u = -div D - D grad p / p, and the steps that it allows."""

import math
from typing import NamedTuple

import numpy as np
from numba import types

from .._addresses import Entry, function_at
from .._jit import MATRIX, VECTOR, jit
from ..equations import EQUATIONS
from .frame import FRAME, OPTIONS
from .moment_correction import Diffusion, Polynomials, correct
from .number_density import Sums, density_sums, whiten
from .pairs import PAIRS

__all__ = ["VELOCITY", "Work", "room_for", "stable_steps"]

_PARABOLIC = 0.61  # 0.9 of the stability interval, 1; that of Heun's method, 2, was measured as 1.36 h^2 / D


class Work(NamedTuple):
    """Arrays that one evaluation leaves to the next step."""

    z: np.ndarray  # (N, n) whitened positions
    sums: Sums
    polynomials: Polynomials
    D: np.ndarray  # (1, n n) or (N, n n)
    divergence: np.ndarray  # (N, n) of D


@jit
def room_for(equations, powers, N):
    """The `Work` of a march; D is filled in where it is constant.

    powers: (q, n) exponents of the polynomials of the correction, none without it.
    """
    q, n = powers.shape
    varies = equations.time_dependent or equations.state_dependent
    D = np.empty((N if varies else 1, n * n))
    if not varies:
        for a in range(n):
            for b in range(n):
                D[0, a * n + b] = equations.D[a, b]
    sums = Sums(np.empty(N), np.empty((N, n)), np.empty(N))
    polynomials = Polynomials(powers, np.empty((N, q)), np.empty((q, q)))
    return Work(np.empty((N, n)), sums, polynomials, D, np.empty((N, n)))


@jit
def diffusion_velocity(equations, t, x, frame, pairs, work, options, u):
    """u = -div D - D grad p / p at positions x, corrected.

    Parameters
    ----------
    equations : Equations
    t : float
        Seconds.
    x : ndarray, shape (N, n)
    frame : Frame
    pairs : tuple
        Every pair of neighbours once, of `search`.
    work : Work
    options : record
        `Options`, packed.
    u : ndarray, shape (N, n), written
        Rows without noise are left as they are.

    Returns
    -------
    int
        How many functions the correction used.
    """
    N, n = x.shape
    D, divergence, sums = work.D, work.divergence, work.sums
    rows, inverse, by_state = equations.rows, frame.inverse, equations.state_dependent
    m = frame.cloud.m
    whiten(x, m, inverse, work.z)
    density_sums(work.z, m, frame.h, pairs, (options.kernel, options.normalisation), sums)
    if by_state or equations.time_dependent:
        function_at(equations.diffusion)(x, t, equations.p, D)
    if by_state:
        function_at(equations.divergence)(x, t, equations.p, divergence)
    score = np.empty(n)
    for i in range(N):
        for d in range(n):  # grad p / p = L^-T grad_z p / p
            score[d] = 0.0
            for e in range(d, n):
                score[d] += inverse[e, d] * sums.grad[i, e] / sums.rho[i]
        k = i if D.shape[0] > 1 else 0
        for c in rows:
            s = divergence[i, c] if by_state else 0.0
            for d in range(n):
                s += D[k, c * n + d] * score[d]
            u[i, c] = -s
    if work.polynomials.powers.shape[0] == 0:
        return 0
    return correct(work.z, m, Diffusion(D, rows, inverse), work.polynomials, u)


_SUMS = types.NamedTuple([VECTOR, MATRIX, VECTOR], Sums)
_POLYNOMIALS = types.NamedTuple([types.int64[:, ::1], MATRIX, MATRIX], Polynomials)
_WORK = types.NamedTuple([MATRIX, _SUMS, _POLYNOMIALS, MATRIX, MATRIX], Work)
#: `diffusion_velocity` by its address: it is compiled once, not wherever the march evaluates it.
VELOCITY = Entry(diffusion_velocity, (EQUATIONS, types.float64, MATRIX, FRAME, PAIRS, _WORK, OPTIONS, MATRIX))


@jit
def stable_steps(frame, D, options):
    """Largest steps at which extrapolated diffusion is stable: plain, put right, put right in affine parts.

    Whitened, the fastest mode of the sums decays at a rate of about 1.5 D / (c_K h^2), a moment of order k,
    which the correction makes exact, at k D. The rates times dt may be 1 without and .55 with what
    Adams-Moulton adds (roots of the characteristic polynomials of the two methods).
    """
    n, inverse = frame.L.shape[0], frame.inverse
    G, limit, spread, fastest = np.empty((n, n)), np.inf, 0.0, 1e-300
    parabolic = _PARABOLIC * 2.0 * options.variance
    for i in range(frame.h.size):
        if i < D.shape[0]:
            spread = 0.0
            for a in range(n):
                for b in range(n):
                    G[a, b] = 0.0
                    for c in range(n):
                        for d in range(n):
                            G[a, b] += inverse[a, c] * D[i, c * n + d] * inverse[b, d]
                    spread += G[a, b] * G[a, b]
            spread = math.sqrt(spread)  # Frobenius: no less than the largest eigenvalue, equal for rank one
        fastest = max(fastest, spread)
        limit = min(limit, parabolic * frame.h[i] ** 2 / max(spread, 1e-300))
    plain = min(limit, 0.9 / ((options.degree + 1) * fastest))
    return plain, 0.5 * plain, min(plain, 0.25 / fastest)
