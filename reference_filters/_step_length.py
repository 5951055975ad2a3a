"""How long a step of many paths may be: accurate for their moments, stable for every one of them.

A trial step asks the drift two or three times; its noise is of typical size, with signs that differ by state.
The trial looks at the states as they are now, never at what a step has done: steps that were chosen by their
outcome would be biased.
"""

import numpy as np
from numba import njit

from sphfilter.core._jit import jit
from sphfilter.core.sde_steps import root_noise, root_now, scaled_noise

SPLIT, SHIFTED_PATH, PLATEN = 0, 1, 2
#: Bias that the covariance of an interval gets for a rough error of one in its steps, by scheme: about the
#: largest of six scenarios with two to four states (the smallest is a tenth of it).
BIAS_PER_ERROR = (0.5, 0.06, 0.5)
#: Largest rough error of one state, in standard deviations.
_LARGEST = 1.0
#: Largest rate of any state times the step. Classical Runge-Kutta is stable up to 2.8, Platen's scheme up to
#: 2; the rate may grow until the next look.
_STABLE = (2.0, 2.0, 1.0)
#: Most steps of an interval.
MOST_STEPS = 1_000_000


@jit
def step_length(scheme, x, t, h, functions, constants, tolerance):
    """Step, at most twice h, whose bias is about the tolerance; zero when there is none.

    Parameters
    ----------
    scheme : int
    x : ndarray, shape (N, n)
    t, h : float
        Time, and the step that is tried first, seconds.
    functions : tuple (drift, noise)
    constants : tuple (p, variance, L)
        Variance (n,) of all states at this time.
    tolerance : float
        In standard deviations.
    """
    work = np.empty((5, *x.shape))
    for _ in range(60):
        rms, largest, rate = _trial(scheme, x, t, h, functions, constants, work)
        h, enough = better_length(scheme, h, rms, largest, rate, tolerance)
        if enough:
            return h
    return 0.0


@jit
def better_length(scheme, h, rms, largest, rate, tolerance):
    """Step that a trial step h recommends, and whether it is near enough to be taken without another trial.

    `rms` and `largest` are the change of the drift's slope in the trial, h (k₃ − k₂), over the states in
    standard deviations, or what stands for it; `rate` is the largest rate times h.
    """
    if scheme == SPLIT:
        rms, largest = rms ** (2 / 3), largest ** (2 / 3)
    elif scheme == PLATEN:
        rms, largest = rms**2, largest**2
    excess = max(BIAS_PER_ERROR[scheme] * rms / tolerance, largest / _LARGEST)
    power = -1 / 3 if scheme == SHIFTED_PATH else -1 / 2
    accurate = excess**power if excess > 0.0 else 2.0
    ratio = min(accurate, _STABLE[scheme] / rate) if rate > 0.0 else accurate
    return h * (min(2.0, 0.9 * ratio) if ratio > 0.2 else 0.2), ratio > 0.7


@jit
def _trial(scheme, x, t, h, functions, constants, work):
    """Rough error of a step h from x, root mean square and largest over the states; and h times their rates.

    Errors are in standard deviations, of the order in h that the scheme has as measured: three for
    SHIFTED_PATH, two for the others.
    """
    p, variance, L = constants
    unit = np.empty(x.shape[1])
    change, moved, bend = work[0], work[1], work[2]
    if scheme == PLATEN:
        _general_trial(x, t, h, functions, p, L, work)
    else:
        _additive_trial(x, t, h, functions, p, L, work)
    rms, largest = _in_deviations(change, moved, variance, unit)
    if scheme == PLATEN:
        by_drift, by_drift_largest = _in_deviations(bend, moved, variance, unit)
        rms, largest, bend = np.sqrt(rms**2 + by_drift), np.sqrt(largest**2 + by_drift_largest), moved
    if not np.isfinite(rms):
        return np.inf, np.inf, np.inf
    rate = _largest_ratio(change, bend, unit)
    return rms, largest, rate if scheme == PLATEN else 2.0 * rate


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "nsz"})
def _in_deviations(change, moved, variance, unit):
    """Root mean square and largest of change (N, n) in standard deviations, of the worst component.

    The variance (n,) is that of all states now, to which the spread of `moved` (N, n) is added; `unit` (n,)
    gets the root of the sum.
    """
    N, n = change.shape
    worst_rms, worst = 0.0, 0.0
    for a in range(n):
        mean = square = total = top = 0.0
        for i in range(N):
            mean += moved[i, a]
            square += moved[i, a] ** 2
            total += change[i, a] ** 2
            top = max(top, abs(change[i, a]))
        if not total + square < np.inf:  # isfinite lies where sums may be reordered
            return np.inf, np.inf
        unit[a] = np.sqrt(variance[a] + max(square / N - (mean / N) ** 2, 0.0))
        if total > 0.0:
            worst_rms, worst = max(worst_rms, np.sqrt(total / N) / unit[a]), max(worst, top / unit[a])
    return worst_rms, worst


@jit
def _largest_ratio(change, bend, unit):
    """Largest |change| / |bend| of any row (N, n), in units (n,): what the Jacobian did to the bend."""
    worst = 0.0
    for i in range(change.shape[0]):
        above = below = 0.0
        for a in range(change.shape[1]):
            if unit[a] > 0.0:
                above += (change[i, a] / unit[a]) ** 2
                below += (bend[i, a] / unit[a]) ** 2
        if above > worst * below and below > 1e-24:  # not rounding alone
            worst = above / below
    return np.sqrt(worst)


@jit
def _additive_trial(x, t, h, functions, p, L, work):
    """Fill change h (k₃ − k₂) of a Runge-Kutta step, its move h k₃, and bend h (k₂ − k₁)."""
    drift, noise = functions
    change, moved, bend, y, slope = work[0], work[1], work[2], work[3], work[4]
    (N, n), m = x.shape, L.shape[0]
    g, sigma = np.empty((1, n * m)), np.empty((n, m))
    root_now(noise, x, t, p, L, g, sigma)
    scaled_noise(sigma, _signs(m, N), slope)
    X, Y, S = x.reshape(-1), y.reshape(-1), slope.reshape(-1)
    C, M, B, root = change.reshape(-1), moved.reshape(-1), bend.reshape(-1), 1.0 / np.sqrt(h)
    drift(x, t, p, bend)
    for i in range(X.size):
        S[i] *= root
        Y[i] = X[i] + 0.5 * h * (B[i] + S[i])
    drift(y, t + 0.5 * h, p, change)
    for i in range(X.size):
        Y[i] = X[i] + 0.5 * h * (C[i] + S[i])
        B[i] = h * (C[i] - B[i])
    drift(y, t + 0.5 * h, p, moved)
    for i in range(X.size):
        C[i] = h * (M[i] - C[i])
        M[i] = h * (M[i] + S[i])


@jit
def _general_trial(x, t, h, functions, p, L, work):
    """Fill the changes of h f and √h σ over an Euler step, the move that this step is, and the change of h f
    over the step without noise, which is of second order in h where the noise is small."""
    drift, noise = functions
    change, moved, by_drift, y, k = work[0], work[1], work[2], work[3], work[4]
    N, n, m = x.shape[0], x.shape[1], L.shape[0]
    signs, raw, b, b_new = _signs(m, N), np.empty((N, n * m)), np.empty((N, n * m)), np.empty((N, n * m))
    drift(x, t, p, k)
    root_noise(noise, x, t, p, L, raw, b)
    for i in range(N):
        for a in range(n):
            y[i, a] = x[i, a] + h * k[i, a]
    drift(y, t + h, p, by_drift)
    for i in range(N):
        for a in range(n):
            moved[i, a] = h * k[i, a]
            for j in range(m):
                moved[i, a] += np.sqrt(h) * signs[j, i] * b[i, a * m + j]
            y[i, a] = x[i, a] + moved[i, a]
            by_drift[i, a] = h * (by_drift[i, a] - k[i, a])
    drift(y, t + h, p, change)
    root_noise(noise, y, t + h, p, L, raw, b_new)
    for i in range(N):
        for a in range(n):
            change[i, a] = h * (change[i, a] - k[i, a])
            for j in range(m):
                change[i, a] += np.sqrt(h) * signs[j, i] * (b_new[i, a * m + j] - b[i, a * m + j])


@jit
def _signs(m, N):
    """Return ±1, shape (m, N), in all combinations along the states."""
    signs = np.empty((m, N))
    for k in range(m):
        for i in range(N):
            signs[k, i] = 1.0 if (i >> (k % 8)) & 1 else -1.0
    return signs
