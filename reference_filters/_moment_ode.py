"""Mean and covariance carried through a nonlinear SDE in continuous time, for the EKF and the UKF.

One adaptive Dormand-Prince 5(4) loop integrates either closure of the moment equations
dm/dt = E[f], dP/dt = E[(x-m) fᵀ + f (x-m)ᵀ] + E[2 D] (Jazwinski 1970, §4.7; Särkkä 2007 for sigma points):
linearised about the mean, or averaged over the sigma points of (m, P).
"""

from functools import cache

import numpy as np
from numba import types

from sphfilter.core._addresses import ADDRESS, address_of, function_at
from sphfilter.core._jit import jit, jit_for
from sphfilter.core.dormand_prince import A as _A
from sphfilter.core.dormand_prince import C as _C
from sphfilter.core.dormand_prince import E as _E
from sphfilter.errors import PropagationError
from sphfilter.model.compile import surfacing

LINEARISED, SIGMA_POINTS = 0, 1
_DONE, _TOO_MANY, _BLOWN_UP = 0, 1, 2
_MAX_STEPS = 100_000


@jit
def _linearised_rates(P, f, J, D, dm, dP):
    """dm = f(m), dP = J P + P Jᵀ + 2 D(m)."""
    n = dm.size
    dm[:] = f[0]
    for a in range(n):
        for b in range(n):
            rate = 2.0 * D[0, a * n + b]
            for j in range(n):
                rate += J[0, a * n + j] * P[j, b] + P[a, j] * J[0, b * n + j]
            dP[a, b] = rate


@jit
def _fill_sigma_points(m, P, kappa, L, points):
    """Rows of `points` (2n+1, n): m, m ± sqrt(n + kappa) L_j; False when P is not positive definite."""
    n = m.size
    for a in range(n):
        for b in range(a + 1):
            s = P[a, b]
            for c in range(b):
                s -= L[a, c] * L[b, c]
            if a == b:
                if not s > 0.0:
                    return False
                L[a, a] = np.sqrt(s)
            else:
                L[a, b] = s / L[b, b]
    spread = np.sqrt(n + kappa)
    points[:] = m
    for j in range(n):
        for a in range(j, n):
            points[1 + j, a] += spread * L[a, j]
            points[1 + n + j, a] -= spread * L[a, j]
    return True


@jit
def _sigma_point_rates(m, kappa, points, f, D, dm, dP):
    """dm = Σ W f_i, dP = Σ W [(x_i-m) f_iᵀ + f_i (x_i-m)ᵀ + 2 D_i]."""
    n = m.size
    dm[:] = 0.0
    dP[:] = 0.0
    for i in range(2 * n + 1):
        W = (kappa if i == 0 else 0.5) / (n + kappa)
        for a in range(n):
            dm[a] += W * f[i, a]
            for b in range(n):
                cross = (points[i, a] - m[a]) * f[i, b] + (points[i, b] - m[b]) * f[i, a]
                dP[a, b] += W * (cross + 2.0 * D[i, a * n + b])


@jit
def _rates(scheme, t, y, p, functions, kappa, work, dy):
    """Right-hand side of the moment equations for y = (m, P) flat; False when P is not positive definite."""
    drift, jacobian, diffusion = functions
    points, f, J, D, L = work
    n = points.shape[1]
    m, P = y[:n], y[n:].reshape(n, n)
    dm, dP = dy[:n], dy[n:].reshape(n, n)
    if scheme == LINEARISED:
        points[0] = m
        jacobian(points, t, p, J)
    elif not _fill_sigma_points(m, P, kappa, L, points):
        return False
    drift(points, t, p, f)
    diffusion(points, t, p, D)
    if scheme == LINEARISED:
        _linearised_rates(P, f, J, D, dm, dP)
    else:
        _sigma_point_rates(m, kappa, points, f, D, dm, dP)
    return True


@jit
def _error_norm(n, y, y_new, step_error):
    """Rms error of the means in standard deviations and of the covariances in their products.

    A sum, not a maximum: NaN must come through, and `max` would drop it.
    """
    total = 0.0
    for a in range(n):
        var_a = max(abs(y[n + a * n + a]), abs(y_new[n + a * n + a]))
        total += step_error[a] ** 2 / var_a
        for b in range(n):
            var_b = max(abs(y[n + b * n + b]), abs(y_new[n + b * n + b]))
            total += step_error[n + a * n + b] ** 2 / (var_a * var_b)
    return np.sqrt(total / (n + n * n))


@jit
def _combine(y, dt, weights, k, n_rows, out):
    """out = y + dt Σ_r weights_r k_r over the first `n_rows` rows."""
    for i in range(y.size):
        total = 0.0
        for r in range(n_rows):
            total += weights[r] * k[r, i]
        out[i] = y[i] + dt * total


def _integrate(scheme, y, span, p, addresses, settings):
    """Integrate y = (m, P) flat over `span`; return (status, steps, time reached), `y` overwritten."""
    n = int(np.sqrt(y.size))
    rows = 1 if scheme == LINEARISED else 2 * n + 1
    matrices = np.empty((2, rows, n * n))
    work = (np.empty((rows, n)), np.empty((rows, n)), matrices[0], matrices[1], np.zeros((n, n)))
    k, stage, error, nought = np.empty((7, y.size)), np.empty(y.size), np.empty(y.size), np.zeros(y.size)
    functions = (function_at(addresses[0]), function_at(addresses[1]), function_at(addresses[2]))
    (t, t1), (kappa, rtol) = span, settings
    dt = t1 - t
    if not _rates(scheme, t, y, p, functions, kappa, work, k[0]):
        return _BLOWN_UP, 0, t
    for steps in range(1, _MAX_STEPS):
        dt = min(dt, t1 - t)
        sound, s = True, 1
        while sound and s < 7:
            _combine(y, dt, _A[s], k, s, stage)
            sound = _rates(scheme, t + _C[s] * dt, stage, p, functions, kappa, work, k[s])
            s += 1
        ratio = np.inf
        if sound:
            _combine(nought, dt, _E, k, 7, error)
            ratio = _error_norm(n, y, stage, error) / rtol
        if ratio <= 1.0:
            last = t + dt >= t1
            t = t1 if last else t + dt
            y[:], k[0] = stage, k[6]
            if last:
                return _DONE, steps, t
        if not dt > 1e-14 * (abs(t) + abs(t1)):
            return _BLOWN_UP, steps, t
        growth = 0.9 * ratio**-0.2 if ratio > 0.0 else 5.0
        dt *= min(5.0, growth) if growth > 0.2 else 0.2  # NaN shrinks too
    return _TOO_MANY, _MAX_STEPS, t


@cache
def _compiled_integrate():
    """`_integrate` for any model: compiled (or loaded from the disk cache) at first use, not at import."""
    vector = types.float64[::1]
    outcome = types.Tuple((types.int64, types.int64, types.float64))
    pair = types.UniTuple(types.float64, 2)
    return jit_for(outcome(types.int64, vector, pair, vector, types.UniTuple(ADDRESS, 3), pair), _integrate)


def propagate_moments(model, scheme, m, P, t0, t1, kappa=0.0, rtol=1e-6):
    """Mean and covariance at t1 of the closure `scheme` (LINEARISED or SIGMA_POINTS).

    Parameters
    ----------
    model : sphfilter.SDE
    scheme : int
    m, P : ndarray, shapes (n,), (n, n)
    t0, t1 : float
        Seconds.
    kappa : float
        Spread of the sigma points, n + kappa > 0 (Julier & Uhlmann 1997).
    rtol : float
        Error allowed per step, in standard deviations.

    Returns
    -------
    m, P, n_steps

    Raises
    ------
    PropagationError
        The moments blow up or the covariance loses its positive definiteness.
    """
    n = m.size
    y = np.concatenate([m, P.ravel()])
    functions = model.drift_batch, model.jacobian_batch, model.diffusion_batch
    addresses = tuple([address_of(f) for f in functions])
    with surfacing():
        status, n_steps, t = _compiled_integrate()(scheme, y, (t0, t1), model.p, addresses, (kappa, rtol))
    if status != _DONE:
        raise PropagationError(
            f"moment equations stopped at t = {t:g} s between {t0:g} and {t1:g} s after {n_steps} steps: "
            f"the mean {y[:n]} or its covariance blew up; measure more often or use a filter that carries "
            f"the density"
        )
    return y[:n], y[n:].reshape(n, n), n_steps
