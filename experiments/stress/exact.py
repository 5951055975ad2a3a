"""Exact posteriors of two nonlinear or time-dependent problems, valid arbitrarily far in the tails."""

import numpy as np
from scipy.special import logsumexp

import sphfilter as sf
from reference_filters.kalman import KalmanFilter

__all__ = ["benes_posterior", "forced_posterior"]

#: Start nodes reach this many standard deviations (outliers push the start's posterior far out).
_REACH, _NODES = 80.0, 40_001


def forced_posterior(problem):
    """Kalman filter of dX = -k (X - sin t) dt + dW about the forced solution s(t), X - s being linear.

    s = (k² sin t - k cos t) / (k² + 1) solves s' = -k (s - sin t).

    Returns
    -------
    means (T, 1), covariances (T, 1, 1), log-evidence (T,)
    """
    k, q = problem.model.p[0], problem.model.spectral_density
    model = sf.LinearSDE([[-k]], noise=[[1.0]], spectral_density=q)

    def forced(t):
        return (k**2 * np.sin(t) - k * np.cos(t)) / (k**2 + 1.0)

    s = forced(problem.times)[:, None]
    start = (problem.x0 - forced(problem.t0), problem.P0, problem.t0)
    found = KalmanFilter(model, problem.measurement, *start).run(problem.times, problem.z - s)
    return found.x + s, found.P, found.log_evidence


def benes_posterior(problem):
    """Filter of dX = tanh(X) dt + dW, E[dW²] = dt, from a Gaussian start, by quadrature over the start.

    The transition density is cosh(x) / cosh(x₀) e^(-t/2) N(x; x₀, t): for a known start x₀ the density stays
    cosh(x) N(x; m, s), m and s following the Kalman filter of Brownian motion. The start is then a weight on
    x₀, kept as a logarithm, so that nothing underflows in the tails. (V. Beneš, Stochastics 5 (1981) 65.)

    Returns
    -------
    means (T, 1), covariances (T, 1, 1), log-evidence (T,)
    """
    R, sd = problem.measurement.noise_cov[0, 0], np.sqrt(problem.P0[0, 0])
    y = np.linspace(-_REACH, _REACH, _NODES)
    m, s, before = problem.x0[0] + sd * y, 0.0, problem.t0
    log_w = -0.5 * y**2 - np.logaddexp(m, -m)
    log_w -= logsumexp(log_w + np.logaddexp(m, -m))
    total, rows = 0.0, []
    for t, z in zip(problem.times, problem.z[:, 0], strict=True):
        s += t - before
        log_w, before = log_w - 0.5 * (t - before), t
        if np.isfinite(z):
            S = s + R
            log_w = log_w - 0.5 * ((z - m) ** 2 / S + np.log(2 * np.pi * S))
            m, s = m + s / S * (z - m), s * R / S
        joint = log_w + 0.5 * s + np.logaddexp(m, -m)
        evidence = logsumexp(joint)
        w, mean, slope = np.exp(joint - evidence), m + s * np.tanh(m), 1.0 - np.tanh(m) ** 2
        x = w @ mean
        rows.append((x, w @ (s + s**2 * slope + (mean - x) ** 2), evidence - total))
        total = evidence
    x, P, evidence = np.array(rows).T
    return x[:, None], P[:, None, None], evidence
