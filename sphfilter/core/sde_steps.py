"""Steps of a stochastic differential equation that are accurate in distribution, many paths at once.

All loops take pre-drawn standard normals, one row of paths for each, so that a path depends on the generator
alone; and model functions as first-class values, so that they compile once for all models. σ = g L with
L Lᵀ = Q has independent columns. States and slopes are swept flat, as vectors of N n numbers.
"""

import functools

import numpy as np
from numba import types

from ._jit import BATCH_FUNCTION, jit, jit_for

_SIGNATURE = types.void(
    types.float64[:, ::1],  # x (N, n), moved in place
    types.float64,  # t0
    types.float64,  # dt
    BATCH_FUNCTION,  # drift
    BATCH_FUNCTION,  # noise
    types.float64[::1],  # p
    types.float64[:, ::1],  # L (m, m)
    types.float64[:, :, ::1],  # normals (steps, normals_per_step, N)
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
    loop = shifted_path_steps if additive else platen_steps
    return jit_for(_SIGNATURE, loop.py_func)


@jit
def root_now(noise, x, t, p, L, g, sigma):
    """Fill σ = g L (n, m) at time t, for noise that does not depend on the state; g (1, n m) is scratch."""
    noise(x[:1], t, p, g)
    n, m = sigma.shape
    for a in range(n):
        for k in range(m):
            s = 0.0
            for r in range(m):
                s += g[0, a * m + r] * L[r, k]
            sigma[a, k] = s


@jit
def scaled_noise(sigma, w, out):
    """Fill σ w_i at every path: w (m, N), out (N, n)."""
    N = out.shape[0]
    for a in range(out.shape[1]):
        for i in range(N):
            out[i, a] = 0.0
        for k in range(w.shape[0]):
            s = sigma[a, k]
            if s != 0.0:
                for i in range(N):
                    out[i, a] += s * w[k, i]


@jit
def runge_kutta(x, t, dt, drift, p, slopes, work):
    """Move x over dt along the drift plus slopes, three of (N, n) at begin, middle and end: classical RK4."""
    y, k1, k2, k3, k4 = work[0], work[1], work[2], work[3], work[4]
    X, Y = x.reshape(-1), y.reshape(-1)
    K1, K2, K3, K4 = k1.reshape(-1), k2.reshape(-1), k3.reshape(-1), k4.reshape(-1)
    S0, S1, S2 = slopes[0].reshape(-1), slopes[1].reshape(-1), slopes[2].reshape(-1)
    half = 0.5 * dt
    drift(x, t, p, k1)
    for i in range(X.size):
        K1[i] += S0[i]
        Y[i] = X[i] + half * K1[i]
    drift(y, t + half, p, k2)
    for i in range(X.size):
        K2[i] += S1[i]
        Y[i] = X[i] + half * K2[i]
    drift(y, t + half, p, k3)
    for i in range(X.size):
        K3[i] += S1[i]
        Y[i] = X[i] + dt * K3[i]
    drift(y, t + dt, p, k4)
    for i in range(X.size):
        X[i] += dt / 6.0 * (K1[i] + 2.0 * (K2[i] + K3[i]) + K4[i] + S2[i])


@jit
def jump(sigma, w, work, x):
    """Add σ w_i to every path, w (m, N)."""
    scaled_noise(sigma, w, work[0])
    X, change = x.reshape(-1), work[0].reshape(-1)
    for i in range(X.size):
        X[i] += change[i]


@jit
def _draw_path(xi, dt, path):
    """Fill the step's path of noise, for independent unit noises: jump, slope over dt, jump; (3, m, N).

    With W the increment over the step, dt H its area beyond dt W/2, H ~ N(0, dt/12), and c = ±√dt: the
    path jumps by c/2 + H, rises by W − c, jumps by c/2 − H. Increment, area and E∫W² are the true path's.
    """
    m = path.shape[1]
    root, area = np.sqrt(dt), np.sqrt(dt / 12.0)
    for k in range(m):
        W, H, sign = xi[k], xi[m + k], xi[2 * m + k]
        start, slope, end = path[0, k], path[1, k], path[2, k]
        for i in range(W.size):
            half = 0.5 * root if sign[i] > 0.0 else -0.5 * root
            start[i] = half + area * H[i]
            slope[i] = (root * W[i] - 2.0 * half) / dt
            end[i] = half - area * H[i]


@jit
def shifted_path_steps(x, t0, dt, drift, noise, p, L, normals):
    """Replace the noise of each step by a simple random path and solve along it with RK4.

    After the shifted ordinary differential equations of Foster, dos Reis and Strange, "High order splitting
    methods for SDEs satisfying a commutativity condition" (2024); of weak order 2 at least, 3 as measured;
    without noise it is the classical Runge–Kutta method of order 4.
    """
    N, n, m = x.shape[0], x.shape[1], L.shape[0]
    path, slopes, work = np.empty((3, m, N)), np.empty((3, N, n)), np.empty((5, N, n))
    g, sigma = np.empty((1, n * m)), np.empty((3, n, m))
    for s in range(normals.shape[0]):
        t = t0 + s * dt
        for i in range(3):
            root_now(noise, x, t + 0.5 * i * dt, p, L, g, sigma[i])
        _draw_path(normals[s], dt, path)
        jump(sigma[0], path[0], work, x)
        scaled_noise(sigma[0], path[1], slopes[0])
        middle = end = slopes[0]
        if np.any(sigma[1] != sigma[0]) or np.any(sigma[2] != sigma[0]):
            middle, end = slopes[1], slopes[2]
            scaled_noise(sigma[1], path[1], middle)
            scaled_noise(sigma[2], path[1], end)
        runge_kutta(x, t, dt, drift, p, (slopes[0], middle, end), work)
        jump(sigma[2], path[2], work, x)


@jit
def moved(x, h, k, out):
    """Fill x + h k, written out: numba compiles an array expression ten times as long."""
    for i in range(x.shape[0]):
        for a in range(x.shape[1]):
            out[i, a] = x[i, a] + h * k[i, a]


@jit
def root_noise(noise, y, t, p, L, raw, out):
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
        root_noise(noise, x, t, p, L, raw, b0)
        for i in range(N):
            for a in range(n):
                w = 0.0
                for k in range(m):
                    w += b0[i, a * m + k] * root * xi[k, i]
                y[i, a] = x[i, a] + a0[i, a] * dt + w
                new[i, a] = x[i, a] + 0.5 * dt * a0[i, a] + 0.5 * w
        drift(y, t + dt, p, a1)
        moved(new, 0.5 * dt, a1, new)
        for j in range(m):
            for sign in (-1.0, 1.0):
                for i in range(N):
                    for a in range(n):
                        y[i, a] = x[i, a] + a0[i, a] * dt + sign * root * b0[i, a * m + j]
                root_noise(noise, y, t + dt, p, L, raw, b)
                _add_own(b, xi[j], root, sign, j, new)
                if m > 1:
                    for i in range(N):
                        for a in range(n):
                            y[i, a] = x[i, a] + sign * root * b0[i, a * m + j]
                    root_noise(noise, y, t, p, L, raw, b)
                    _add_mixed(b, b0, j, xi, root, sign, new)
        x[:] = new


@jit
def _add_own(b, xi, root, sign, j, new):
    """Add ¼ b^j(R±) [ΔW_j ± (ΔW_j² − dt)/√dt]."""
    m = b.shape[1] // new.shape[1]
    for i in range(new.shape[0]):
        weight = 0.25 * root * (xi[i] + sign * (xi[i] ** 2 - 1.0))
        for a in range(new.shape[1]):
            new[i, a] += weight * b[i, a * m + j]


@jit
def _add_mixed(b, b0, r, xi, root, sign, new):
    """Add ¼ Σ_{j≠r} [(b^j(U±) − b^j) ΔW_j ± b^j(U±) (ΔW_j ΔW_r + V_rj)/√dt], V_rj = −V_jr = ±dt."""
    m = b.shape[1] // new.shape[1]
    for j in range(m):
        if j == r:
            continue
        low, high = min(j, r), max(j, r)
        toss = xi[m + high * (high - 1) // 2 + low]
        for i in range(new.shape[0]):
            V = 1.0 if (toss[i] > 0.0) == (r > j) else -1.0
            for a in range(new.shape[1]):
                change = (b[i, a * m + j] - b0[i, a * m + j]) * xi[j, i]
                new[i, a] += 0.25 * root * (change + sign * b[i, a * m + j] * (xi[j, i] * xi[r, i] + V))
