"""Exact filters of two models that are nonlinear or change with time, from any Gaussian start."""

import numpy as np
from scipy.special import logsumexp

from sphfilter.model.sde import LinearSDE

from ._base import ReferenceFilter
from .kalman import KalmanFilter

#: Nodes of a start, and the standard deviations that they reach: outliers push its posterior far out.
_NODES, _REACH = 40_001, 80.0


class ForcedFilter(KalmanFilter):
    """Filter of dX = -k (X - sin t) dt + dB with E[dB²] = q dt, whose sensors read X as matrices.

    X - s is linear, where s = (k² sin t - k cos t) / (k² + 1) solves s' = -k (s - sin t).
    """

    def __init__(self, k, q, measurement, x0, P0, t0=0.0):
        self.k = k
        super().__init__(LinearSDE([[-k]], noise=[[np.sqrt(q)]]), measurement, x0, P0, t0)

    def _predicted(self, belief, t0, t1):
        x, P = belief
        (x, P), n_steps = super()._predicted((x - self._forced(t0), P), t0, t1)
        return (x + self._forced(t1), P), n_steps

    def _forced(self, t):
        return (self.k**2 * np.sin(t) - self.k * np.cos(t)) / (self.k**2 + 1.0)


class BenesFromGaussian(ReferenceFilter):
    """Filter of dX = tanh(X) dt + dW, E[dW²] = dt, from the start N(x0, P0), that reads X itself.

    From a known start x₀ the density stays cosh(x) N(x; m, s), see `closed_forms.BenesFilter`. A Gaussian one
    is a weight on x₀, kept as a logarithm, so that nothing underflows in the tails.
    """

    def __init__(self, measurement, x0, P0, t0=0.0):
        y = np.linspace(-_REACH, _REACH, _NODES)
        m = x0[0] + np.sqrt(P0[0, 0]) * y
        log_w = -0.5 * y**2 - np.logaddexp(m, -m)
        log_w -= logsumexp(log_w + np.logaddexp(m, -m))
        super().__init__((log_w, m, 0.0), measurement, t0)

    def _predicted(self, belief, t0, t1):
        log_w, m, s = belief
        return (log_w - 0.5 * (t1 - t0), m, s + t1 - t0), 1

    def _updated(self, belief, z, measurement):
        log_w, m, s = belief
        R = measurement.noise_cov[0, 0]
        S, off = s + R, z[0] - m
        log_w = log_w - 0.5 * (off**2 / S + np.log(2 * np.pi * S))
        posterior = log_w, m + s / S * off, s * R / S
        return posterior, {"log_evidence": float(logsumexp(_joint(posterior)) - logsumexp(_joint(belief)))}

    def _moments(self, belief):
        _, m, s = belief
        joint = _joint(belief)
        w, means = np.exp(joint - logsumexp(joint)), m + s * np.tanh(m)
        x = w @ means
        return np.array([x]), np.array([[w @ (s + s**2 * (1.0 - np.tanh(m) ** 2) + (means - x) ** 2)]])


def _joint(belief):
    """Logarithms of the mass that comes from each x₀, shape (N,)."""
    log_w, m, s = belief
    return log_w + 0.5 * s + np.logaddexp(m, -m)
