"""One step of particles whose diffusion velocity is a sum over neighbours: predicted, and put right.

Runge and Kutta's method of order five carries them along x' = f(x, t) + u + slope (t - t0) (Dormand & Prince
1980); Adams and Moulton's correction is what the diffusion velocity at the end adds to that.
"""

import math
from typing import NamedTuple

import numpy as np

from .._addresses import function_at
from .._jit import jit
from ..dormand_prince import A as _A
from ..dormand_prince import C as _C
from ..dormand_prince import E as _E
from .moment_correction import keep_affine
from .number_density import transform

__all__ = ["History", "drift_step", "put_right", "rms", "size", "surprise"]


class History(NamedTuple):
    """Diffusion velocity now and at the end of the step, its rate of change, and Runge-Kutta stages."""

    u: np.ndarray  # (N, n)
    new: np.ndarray  # (N, n)
    slope: np.ndarray  # (N, n)
    K: np.ndarray  # (7, N, n)
    x0: np.ndarray  # (N, n) where the step began


@jit
def drift_step(equations, t, dt, x, history):
    """x after dt of x' = f(x, t) + u + slope (t - t0); K[6] becomes the error of order four against five."""
    u, _, slope, K, x0 = history
    N, n = x.shape
    for i in range(N):
        for d in range(n):
            x0[i, d] = x[i, d]
    for stage in range(7):
        for i in range(N):
            for d in range(n):
                s = 0.0
                for k in range(stage):
                    s += _A[stage, k] * K[k, i, d]
                x[i, d] = x0[i, d] + dt * s
        function_at(equations.drift)(x, t + _C[stage] * dt, equations.p, K[stage])
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
def rms(z, m):
    """Root mean square of whitened vectors, over the mass and the axes."""
    square, total = 0.0, 0.0
    for i in range(m.size):
        total += m[i]
        for d in range(z.shape[1]):
            square += m[i] * z[i, d] * z[i, d]
    return math.sqrt(square / (total * z.shape[1]))


@jit
def size(v, frame, z):
    """Root mean square of displacements v, in whitened coordinates."""
    transform(v, np.zeros(v.shape[1]), frame.inverse, z)
    return rms(z, frame.cloud.m)


@jit
def surprise(dt, ago, history, frame, z):
    """What Adams-Moulton adds to the extrapolated step, into K[0]; returns its size."""
    u, new, slope, K = history.u, history.new, history.slope, history.K
    weight = dt * (dt / 3.0 + ago / 2.0) / (dt + ago)
    for i in range(u.shape[0]):
        for d in range(u.shape[1]):
            K[0, i, d] = weight * (new[i, d] - u[i, d] - dt * slope[i, d])
    return size(K[0], frame, z)


@jit
def put_right(dt, frame, polynomials, history, progress):
    """Put the step right as far as that is stable, and make the new u the present one.

    The whole of the correction damps short waves less than the extrapolation alone. Its affine part, which
    is what mean and covariance see of it, has no short waves.
    """
    x, u, new, slope, K = frame.cloud.x, history.u, history.new, history.slope, history.K
    corrects, stable = polynomials.A.shape[0] > 0, dt <= progress.put_right
    if corrects and not stable:
        keep_affine(frame.cloud.m, polynomials, K[0])
        stable = dt <= progress.affine
    for i in range(x.shape[0]):
        for d in range(x.shape[1]):
            x[i, d] += K[0, i, d] if stable else 0.0
            slope[i, d] = (new[i, d] - u[i, d]) / dt
            u[i, d] = new[i, d]
