"""Bootstrap particle filter at its best: its drift compiled into steps of high weak order, few passes.

Every ratio of run times is held against this filter: it is to be as fast as such a filter can be written.
"""

from typing import NamedTuple

import numpy as np

from sphfilter import validate
from sphfilter.density.weighted import WeightedStates
from sphfilter.errors import ModelError
from sphfilter.model.measurements import GaussianMeasurement

from ._base import ReferenceFilter, gaussian_start
from ._paths import Paths
from ._weights import ancestors, linear_log_likelihood, moments_of

#: Default of the bias of an interval over 1/√N, the least sampling error of moments.
_BIAS = 0.4


class Cloud(NamedTuple):
    """Weighted states, with their mean (n,) and covariance (n, n).

    The states x (n, N) are stored axis by axis, as vector instructions want them. Logarithms of the weights
    (N,) and weights w (N,) are not written to: clouds share them.
    """

    x: np.ndarray
    log_w: np.ndarray
    w: np.ndarray
    mean: np.ndarray
    cov: np.ndarray


class ParticleFilter(ReferenceFilter):
    """Sequential importance resampling.

    Resampling waits for the next prediction: moments and further sensors of the same time use the weights,
    which are never noisier.

    Parameters
    ----------
    model : SDE
    measurement : measurement model or None
    x0, P0 : array_like, shapes (n,), (n, n)
        Gaussian start, drawn from.
    t0 : float
        Seconds.
    n_particles : int
    rng : Generator or int, optional
        Everything random comes from here.
    resampling : {"always", "ess"}
        After every update, or only when the effective number of particles 1 / Σ w² is below half of
        `n_particles` (002 triggers by it).
    step : float, optional
        Longest time step, seconds. None: as long as `tolerance` lets it be.
    dt : float, optional
        Interval of `predict()` without arguments.
    order : {2, 4}
        Of the steps, where the noise does not depend on the state. 2: Strang splitting, of weak order 2;
        4: Runge-Kutta of order 4 along random paths, of weak order 3 as measured, and mostly the faster at
        equal error. Other noise has Platen's scheme of weak order 2, and a linear model one exact step.
    n_threads : int
        Threads of a prediction; the result does not depend on it.
    tolerance : float, optional
        Bias that steps of automatic length may give to mean and covariance over an interval, in standard
        deviations. Default 0.4 / sqrt(n_particles), below the sampling error.
    """

    takes_inputs = True

    def __init__(self, model, measurement, x0, P0, t0=0.0, *, n_particles=1000, rng=None, resampling="always",
                 step=None, dt=None, order=4, n_threads=1, tolerance=None):  # fmt: skip
        self.model = model
        self.n_particles = N = validate.count("n_particles", n_particles, 2)
        self.resampling = validate.choice("resampling", resampling, ("always", "ess"))
        self.step = None if step is None else validate.positive("step", step)
        default = _BIAS / np.sqrt(N)
        self.tolerance = validate.positive("tolerance", default if tolerance is None else tolerance)
        if order not in (2, 4):
            raise ModelError(f"order must be 2 or 4, got {order!r}")
        self._paths = Paths(model, order, self.step, validate.count("n_threads", n_threads))
        self._rng = validate.generator(rng)
        x0, P0 = gaussian_start(x0, P0, model.dim)
        x = x0[:, None] + np.linalg.cholesky(P0) @ self._rng.standard_normal((N, model.dim)).T
        self._known = None, None  # last sensor, and what it is as whitened
        self._equal = np.full(N, -np.log(N)), np.full(N, 1.0 / N)
        super().__init__(self._cloud(x, *self._equal), measurement, t0, dt)

    @property
    def particles(self):
        """States, shape (N, n)."""
        return np.ascontiguousarray(self._belief.x.T)

    @property
    def weights(self):
        """Weights, shape (N,), summing to one."""
        return self._belief.w.copy()

    @property
    def effective_size(self):
        """Effective number of particles, 1 / Σ w²."""
        return 1.0 / np.sum(self._belief.w**2)

    def spread(self):
        """The cloud as `WeightedStates`: it has no density."""
        return WeightedStates(self.particles, self.weights)

    def _cloud(self, x, log_w, w):
        return Cloud(x, log_w, w, *moments_of(x, w))

    def _moments(self, belief):
        return belief.mean, belief.cov

    def _predicted(self, belief, t0, t1):
        taken, log_w, w = self._resampled(belief)
        self._paths.model = self.driven
        variance = np.diagonal(belief.cov).copy()
        found = self._paths.moved(belief.x, taken, w, (t0, t1), variance, self.tolerance, self._rng)
        return Cloud(found.states, log_w, w, found.mean, found.cov), found.n_steps

    def _updated(self, belief, z, measurement):
        joint = belief.log_w + self._log_likelihood(belief.x, z, measurement)
        top = joint.max()
        if not np.isfinite(top):
            return belief, {"log_evidence": top}
        w = np.exp(joint - top)
        total = w.sum()
        w /= total
        log_evidence = top + np.log(total)
        joint -= log_evidence
        return self._cloud(belief.x, joint, w), {"log_evidence": log_evidence}

    def _log_likelihood(self, x, z, measurement):
        """Log-likelihood of each state x (n, N), shape (N,); of a linear sensor in one pass."""
        if measurement is not self._known[0]:
            self._known = measurement, _whitened(measurement)
        whitened = self._known[1]
        if whitened is None or len(z) != measurement.dim_z or np.isnan(z).any():
            return measurement.log_likelihood(z, x.T, self.t)
        inverse, H, constant = whitened
        out = np.empty(x.shape[1])
        linear_log_likelihood(x, H, inverse @ z, constant, out)
        return out

    def _resampled(self, belief):
        """Numbers of the states that go on, None for all; logarithms of their weights, and these."""
        w, N = belief.w, self.n_particles
        if w is self._equal[1] or (self.resampling == "ess" and np.dot(w, w) * N <= 2.0):
            return None, belief.log_w, w
        taken = np.empty(N, np.int64)
        ancestors(w, self._rng.random(), taken)
        return taken, *self._equal


def _whitened(measurement):
    """Of a linear sensor with R = L Lᵀ: L⁻¹, L⁻¹ H and the constant of its log-likelihood; None of others."""
    linear = type(measurement) is GaussianMeasurement and measurement.H is not None
    if not linear or measurement.angles:
        return None
    root = np.linalg.cholesky(measurement.noise_cov)
    constant = -np.log(np.diagonal(root)).sum() - 0.5 * len(root) * np.log(2.0 * np.pi)
    inverse = np.linalg.inv(root)
    return inverse, inverse @ measurement.H, constant
