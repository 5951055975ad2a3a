"""Steps of a stochastic differential equation that are accurate in distribution, many paths at once.

Both loops take pre-drawn standard normals, so that a path depends on the generator alone, and model functions
as first-class values, so that they compile once for all models. σ = g L with L Lᵀ = Q has independent
columns.
"""

import functools

import numpy as np
from numba import njit, types

from ._jit import BATCH_FUNCTION, jit

__all__ = ["normals_per_step", "steps"]

_SIGNATURE = types.void(
    types.float64[:, ::1],  # x (N, n), moved in place
    types.float64,  # t0
    types.float64,  # dt
    BATCH_FUNCTION,  # drift
    BATCH_FUNCTION,  # noise
    types.float64[::1],  # p
    types.float64[:, ::1],  # L (m, m)
    types.float64[:, :, ::1],  # normals (steps, N, normals_per_step)
)


def normals_per_step(m, additive):
    """Return how many standard normals one step of one path takes."""
    return 3 * m if additive else m + m * (m - 1) // 2


@functools.cache
def steps(additive):
    """Return the compiled loop ``(x, t0, dt, drift, noise, p, L, normals)`` that moves x in place.

    Parameters
    ----------
    additive : bool
        True: noise without state dependence (`shifted_path_steps`); False: any Itô noise (`platen_steps`).
    """
    function = shifted_path_steps if additive else platen_steps
    return njit(_SIGNATURE, cache=True, error_model="numpy", nogil=True)(function)


@jit
def _add(G, w, scale, out):
    """Add scale · G w_i to every row, G (1, n m) the same for all."""
    m = w.shape[1]
    for i in range(out.shape[0]):
        for a in range(out.shape[1]):
            s = 0.0
            for k in range(m):
                s += G[0, a * m + k] * w[i, k]
            out[i, a] += scale * s


@jit
def _move(x, h, k, out):
    """Fill x + h k."""
    for i in range(x.shape[0]):
        for a in range(x.shape[1]):
            out[i, a] = x[i, a] + h * k[i, a]


@jit
def _root_noise(noise, y, t, p, L, raw, out):
    """Fill σ = g L at every row; out (N, n m)."""
    m = L.shape[0]
    noise(y, t, p, raw)
    for i in range(y.shape[0]):
        for a in range(y.shape[1]):
            for k in range(m):
                s = 0.0
                for r in range(m):
                    s += raw[i, a * m + r] * L[r, k]
                out[i, a * m + k] = s


@jit
def _draw_path(xi, L, dt, start, slope, end):
    """Fill the increments of the step's path: a jump, a straight line over dt, a jump; each (N, m).

    With W the increment over the step, dt H its area beyond dt W/2, H ~ N(0, dt/12), and c = ±√dt: the
    path jumps by c/2 + H, rises by W − c, jumps by c/2 − H. Increment, area and E∫W² are the true path's.
    """
    m = L.shape[0]
    for i in range(start.shape[0]):
        for k in range(m):
            a = b = c = 0.0
            for r in range(m):
                W = L[k, r] * xi[i, r] * np.sqrt(dt)
                H = L[k, r] * xi[i, m + r] * np.sqrt(dt / 12.0)
                half = 0.5 * L[k, r] * (1.0 if xi[i, 2 * m + r] > 0.0 else -1.0) * np.sqrt(dt)
                a += half + H
                b += (W - 2.0 * half) / dt
                c += half - H
            start[i, k], slope[i, k], end[i, k] = a, b, c


def shifted_path_steps(x, t0, dt, drift, noise, p, L, normals):
    """Replace the noise of each step by a simple random path and solve along it with RK4.

    After the shifted ordinary differential equations of Foster, dos Reis and Strange, "High order splitting
    methods for SDEs satisfying a commutativity condition" (2024); of weak order 2 at least, 3 as measured;
    without noise it is the classical Runge–Kutta method of order 4.
    """
    N, n, m = x.shape[0], x.shape[1], L.shape[0]
    start, slope, end = np.empty((N, m)), np.empty((N, m)), np.empty((N, m))
    k1, k2, k3, k4 = np.empty((N, n)), np.empty((N, n)), np.empty((N, n)), np.empty((N, n))
    y = np.empty((N, n))
    G0, G1, G2 = np.empty((1, n * m)), np.empty((1, n * m)), np.empty((1, n * m))
    for s in range(normals.shape[0]):
        t = t0 + s * dt
        _draw_path(normals[s], L, dt, start, slope, end)
        noise(x[:1], t, p, G0)
        noise(x[:1], t + 0.5 * dt, p, G1)
        noise(x[:1], t + dt, p, G2)
        _add(G0, start, 1.0, x)
        drift(x, t, p, k1)
        _add(G0, slope, 1.0, k1)
        _move(x, 0.5 * dt, k1, y)
        drift(y, t + 0.5 * dt, p, k2)
        _add(G1, slope, 1.0, k2)
        _move(x, 0.5 * dt, k2, y)
        drift(y, t + 0.5 * dt, p, k3)
        _add(G1, slope, 1.0, k3)
        _move(x, dt, k3, y)
        drift(y, t + dt, p, k4)
        _add(G2, slope, 1.0, k4)
        _move(x, dt / 6.0, k1, x)
        _move(x, dt / 3.0, k2, x)
        _move(x, dt / 3.0, k3, x)
        _move(x, dt / 6.0, k4, x)
        _add(G2, end, 1.0, x)


def platen_steps(x, t0, dt, drift, noise, p, L, normals):
    """Platen's explicit scheme of weak order 2 for any Itô noise (Kloeden & Platen 1992, eq. 15.1.3).

    Time is carried as a state of drift one: supporting values that contain the drift are taken at t + dt.
    """
    N, n, m = x.shape[0], x.shape[1], L.shape[0]
    a0, a1, y, new = np.empty((N, n)), np.empty((N, n)), np.empty((N, n)), np.empty((N, n))
    raw, b0, b = np.empty((N, n * m)), np.empty((N, n * m)), np.empty((N, n * m))
    root = np.sqrt(dt)
    for s in range(normals.shape[0]):
        t, xi = t0 + s * dt, normals[s]
        drift(x, t, p, a0)
        _root_noise(noise, x, t, p, L, raw, b0)
        for i in range(N):
            for a in range(n):
                w = 0.0
                for k in range(m):
                    w += b0[i, a * m + k] * root * xi[i, k]
                y[i, a] = x[i, a] + a0[i, a] * dt + w
                new[i, a] = x[i, a] + 0.5 * dt * a0[i, a] + 0.5 * w
        drift(y, t + dt, p, a1)
        _move(new, 0.5 * dt, a1, new)
        for j in range(m):
            for sign in (-1.0, 1.0):
                for i in range(N):
                    for a in range(n):
                        y[i, a] = x[i, a] + a0[i, a] * dt + sign * root * b0[i, a * m + j]
                _root_noise(noise, y, t + dt, p, L, raw, b)
                _add_own(b, j, xi, root, sign, new)
                if m > 1:
                    for i in range(N):
                        for a in range(n):
                            y[i, a] = x[i, a] + sign * root * b0[i, a * m + j]
                    _root_noise(noise, y, t, p, L, raw, b)
                    _add_mixed(b, b0, j, xi, root, sign, new)
        x[:] = new


@jit
def _add_own(b, j, xi, root, sign, new):
    """Add ¼ b^j(R±) [ΔW_j ± (ΔW_j² − dt)/√dt]."""
    m = b.shape[1] // new.shape[1]
    for i in range(new.shape[0]):
        weight = 0.25 * root * (xi[i, j] + sign * (xi[i, j] ** 2 - 1.0))
        for a in range(new.shape[1]):
            new[i, a] += weight * b[i, a * m + j]


@jit
def _add_mixed(b, b0, r, xi, root, sign, new):
    """Add ¼ Σ_{j≠r} [(b^j(U±) − b^j) ΔW_j ± b^j(U±) (ΔW_j ΔW_r + V_rj)/√dt], V_rj = −V_jr = ±dt."""
    m = b.shape[1] // new.shape[1]
    for i in range(new.shape[0]):
        for j in range(m):
            if j == r:
                continue
            low, high = min(j, r), max(j, r)
            V = 1.0 if xi[i, m + high * (high - 1) // 2 + low] > 0.0 else -1.0
            V = V if r > j else -V
            for a in range(new.shape[1]):
                change = (b[i, a * m + j] - b0[i, a * m + j]) * xi[i, j]
                new[i, a] += 0.25 * root * (change + sign * b[i, a * m + j] * (xi[i, j] * xi[i, r] + V))
