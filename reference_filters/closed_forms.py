"""Exact solutions of Fokker-Planck equations and of one nonlinear filter: oracles for everything else."""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import quad
from scipy.linalg import expm
from scipy.special import erf, expit, logsumexp

from sphfilter.density.weighted import WeightedStates
from sphfilter.errors import ModelError

from ._base import ReferenceFilter


def linear_transition(A, b, noise_intensity, dt):
    """Exact transition of dX = (A X + b) dt + dB with E[dB dBᵀ] = S dt: X(dt) ~ N(Phi X(0) + c, Qd).

    Parameters
    ----------
    A : array_like, shape (n, n)
    b : array_like, shape (n,), or None for zero
    noise_intensity : array_like, shape (n, n)
        S = g Q gᵀ = 2 D.
    dt : float
        Seconds.

    Returns
    -------
    Phi, c, Qd : ndarray, shapes (n, n), (n,), (n, n)

    Notes
    -----
    Van Loan, "Computing integrals involving the matrix exponential", IEEE TAC 23 (1978) 395, over a part of
    dt, then doubled.
    """
    A = np.atleast_2d(np.asarray(A, dtype=float))
    n = len(A)
    # -A grows as fast as A decays: over too long a step the block would lose every digit
    doublings = max(0, int(np.ceil(np.log2(max(np.linalg.norm(A, 2) * dt, 1.0)))))
    h = dt / 2**doublings
    block = np.zeros((2 * n, 2 * n))
    block[:n, :n], block[:n, n:], block[n:, n:] = -A, np.asarray(noise_intensity, dtype=float), A.T
    E = expm(block * h)
    Phi = E[n:, n:].T
    Qd = Phi @ E[:n, n:]
    affine = np.zeros((n + 1, n + 1))
    affine[:n, :n], affine[:n, n] = A, 0.0 if b is None else np.asarray(b, dtype=float)
    c = expm(affine * h)[:n, n]
    for _ in range(doublings):
        Phi, c, Qd = Phi @ Phi, Phi @ c + c, Phi @ Qd @ Phi.T + Qd
    return Phi, c, 0.5 * (Qd + Qd.T)


def linear_moments(A, b, noise_intensity, mean, cov, t):
    """Mean (n,) and covariance (n, n) after `t` seconds of the linear equation of `linear_transition`."""
    Phi, c, Qd = linear_transition(A, b, noise_intensity, t)
    return Phi @ np.asarray(mean, dtype=float) + c, Phi @ np.asarray(cov, dtype=float) @ Phi.T + Qd


def drifted_uniform(x, t, drift=1.0, D=0.125, half_width=0.5):
    """Density at x (N,) of a uniform start on ±half_width after `t` > 0 of drift and diffusion, 000 (58)."""
    scale = np.sqrt(4 * D * t)
    y = np.asarray(x, dtype=float) - drift * t
    return (erf((y + half_width) / scale) - erf((y - half_width) / scale)) / (4 * half_width)


@dataclass(frozen=True)
class DuffingSteadyState:
    """Steady state of dx = v dt, dv = -(c v + k x + e x³) dt + dW, E[dW²] = q dt.

    The density is Z⁻¹ exp(-(2c/q) (v²/2 + k x²/2 + e x⁴/4)); 000 (157) is q = 1, e = k b.
    """

    c: float
    k: float
    e: float
    q: float = 1.0

    def _position_weight(self, x):
        """Unnormalised density of x, one at its mode (so that deep double wells do not overflow)."""
        lowest = -0.25 * self.k**2 / self.e if self.k < 0 else 0.0
        return np.exp(-2 * self.c / self.q * (0.5 * self.k * x**2 + 0.25 * self.e * x**4 - lowest))

    def _position_integral(self, power):
        mode = np.sqrt(-self.k / self.e) if self.k < 0 else 0.0
        weight = lambda x: x**power * self._position_weight(x)  # noqa: E731
        tight = {"epsabs": 0.0, "epsrel": 1e-12, "limit": 200}
        inner = quad(weight, 0.0, mode, **tight)[0] if mode else 0.0
        return 2 * (inner + quad(weight, mode, np.inf, **tight)[0])

    def pdf(self, X):
        """Density at X, shape (N, 2) -> (N,)."""
        X = np.asarray(X, dtype=float)
        var_v = self.q / (2 * self.c)
        velocity = np.exp(-0.5 * X[:, 1] ** 2 / var_v) / np.sqrt(2 * np.pi * var_v)
        return self._position_weight(X[:, 0]) / self._position_integral(0) * velocity

    def cov(self):
        """Covariance, shape (2, 2); the mean is zero."""
        return np.diag([self._position_integral(2) / self._position_integral(0), self.q / (2 * self.c)])


class BenesFilter(ReferenceFilter):
    """Exact filter of dX = tanh(X) dt + dW, E[dW²] = dt, with z = H X + N(0, R): two Gaussians for ever.

    The transition density cosh(x) / cosh(x₀) e^(-t/2) N(x; x₀, t) and the likelihood keep the form
    p(x) = cosh(x) N(x; m, s) / (e^(s/2) cosh m), which is N(m + s, s) and N(m - s, s) weighted with
    e^(±m) / (2 cosh m). (V. Beneš, Stochastics 5 (1981) 65; Särkkä & Solin 2019, §7.4.)

    Parameters
    ----------
    measurement : GaussianMeasurement with a (1, 1) matrix H and covariance R
    m, s : float
        Start; s = 0 is the known state X(t0) = m. This is *not* N(m, s) unless s = 0.
    t0, dt : float
        Seconds.
    """

    exact = True

    def __init__(self, measurement, m=0.0, s=0.0, t0=0.0, dt=None):
        if s < 0 or not np.isfinite(m + s):
            raise ModelError(f"the Beneš start needs a finite m and s >= 0; got m = {m}, s = {s}")
        super().__init__((float(m), float(s)), measurement, t0, dt)

    @property
    def parameters(self):
        """m and s of the density cosh(x) N(x; m, s)."""
        return self._belief

    def components(self):
        """Weights (2,), means (2,) and the common variance of the two Gaussians."""
        m, s = self._belief
        return expit([2 * m, -2 * m]), np.array([m + s, m - s]), s

    def logpdf(self, x):
        """Log-density at x, shape (N,), for s > 0."""
        w, means, s = self.components()
        x = np.asarray(x, dtype=float)[:, None]
        with np.errstate(divide="ignore"):
            return logsumexp(np.log(w) + _log_normal(x - means, s), axis=1)

    def pdf(self, x):
        """Density at x, shape (N,), for s > 0."""
        return np.exp(self.logpdf(x))

    def spread(self):
        """Points of the density, evenly over twelve standard deviations, as `WeightedStates`."""
        X = self.x + np.sqrt(self.P[0, 0]) * np.linspace(-12.0, 12.0, 4001)[:, None]
        w = self.pdf(X[:, 0])
        return WeightedStates(X, w / w.sum(), lambda Y: self.logpdf(Y[:, 0]))

    def _predicted(self, belief, t0, t1):
        m, s = belief
        return (m, s + t1 - t0), 1

    def _updated(self, belief, z, measurement):
        m, s = belief
        H, R = measurement.H.item(), measurement.noise_cov.item()
        S = H * s * H + R
        innovation = z.item() - H * m
        gain = s * H / S
        m1, s1 = m + gain * innovation, s - gain * H * s
        log_evidence = _log_normal(innovation, S) + 0.5 * (s1 - s) + _log_cosh(m1) - _log_cosh(m)
        return (m1, s1), {"log_evidence": float(log_evidence)}

    def _moments(self, belief):
        m, s = belief
        slope = np.tanh(m)
        return np.array([m + s * slope]), np.array([[s + s**2 * (1 - slope**2)]])


def _log_normal(r, var):
    return -0.5 * (r**2 / var + np.log(2 * np.pi * var))


def _log_cosh(x):
    return np.logaddexp(x, -x) - np.log(2.0)
