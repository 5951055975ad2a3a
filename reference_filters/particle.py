"""Bootstrap particle filter at its best: steps of high weak order, systematic resampling, all compiled."""

from typing import NamedTuple

import numpy as np

from sphfilter import validate
from sphfilter.core.paths.weights import condition, resample, weighted_moments
from sphfilter.density.weighted import WeightedStates
from sphfilter.errors import ModelError

from ._base import ReferenceFilter, gaussian_start
from ._paths import Paths

__all__ = ["ParticleFilter"]

#: Default of the bias of an interval over 1/√N, the least sampling error of moments.
_BIAS = 0.6


class Cloud(NamedTuple):
    """Weighted states: X (N, n), logarithms of the weights (N,), weights (N,), all equal or not."""

    X: np.ndarray
    log_w: np.ndarray
    w: np.ndarray
    equal: bool


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
        4: Runge-Kutta of order 4 along random paths, of weak order 3 as measured. Other noise has Platen's
        scheme of weak order 2, and a linear model one exact step.
    n_threads : int
        Threads of a prediction; the result does not depend on it.
    tolerance : float, optional
        Bias that steps of automatic length may give to mean and covariance over an interval, in standard
        deviations. Default 0.6 / sqrt(n_particles), below the sampling error.
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
        X = x0 + self._rng.standard_normal((N, model.dim)) @ np.linalg.cholesky(P0).T
        super().__init__(Cloud(X, np.full(N, -np.log(N)), np.full(N, 1.0 / N), True), measurement, t0, dt)

    @property
    def particles(self):
        """States, shape (N, n)."""
        return self._belief.X

    @property
    def weights(self):
        """Weights, shape (N,), summing to one."""
        return self._belief.w

    @property
    def effective_size(self):
        """Effective number of particles, 1 / Σ w²."""
        return 1.0 / np.sum(self.weights**2)

    def spread(self):
        """The cloud as `WeightedStates`: it has no density."""
        return WeightedStates(self.particles, self.weights)

    def _moments(self, belief):
        n = self.model.dim
        mean, cov = np.empty(n), np.empty((n, n))
        weighted_moments(belief.X, belief.w, mean, cov)
        return mean, cov

    def _predicted(self, belief, t0, t1):
        belief = self._resampled(belief)
        variance = np.diagonal(self.P).copy()
        self._paths.model = self.driven
        n_steps = self._paths.move(belief.X, t0, t1, variance, self.tolerance, self._rng)
        return belief, n_steps

    def _updated(self, belief, z, measurement):
        log_likelihood = measurement.log_likelihood(z, belief.X, self.t)
        log_w, w = belief.log_w.copy(), np.empty_like(belief.w)
        log_evidence = condition(log_w, log_likelihood, w)
        if np.isfinite(log_evidence):
            belief = Cloud(belief.X, log_w, w, False)
        return belief, {"log_evidence": log_evidence}

    def _resampled(self, belief):
        """Equally weighted copy of the cloud, or a copy of it as it is when its weights are good enough."""
        X, w, N = belief.X, belief.w, len(belief.w)
        if belief.equal or (self.resampling == "ess" and np.sum(w**2) * N <= 2.0):
            return belief._replace(X=X.copy())
        new = np.empty_like(X)
        resample(X, w, self._rng.random(), new)
        return Cloud(new, np.full(N, -np.log(N)), np.full(N, 1.0 / N), True)
