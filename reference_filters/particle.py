"""Bootstrap particle filter: weak second-order propagator, log-weights, systematic resampling of filterpy."""

import numpy as np
from filterpy.monte_carlo import systematic_resample
from numba import njit
from scipy.special import logsumexp

from sphfilter import validate
from sphfilter.simulate import advance

from ._base import ReferenceFilter, gaussian_start

__all__ = ["ParticleFilter", "systematic_indices"]


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
    step : float
        Longest time step, seconds.
    dt : float, optional
        Interval of `predict()` without arguments.
    """

    def __init__(self, model, measurement, x0, P0, t0=0.0, *, n_particles=1000, rng=None, resampling="always",
                 step=0.1, dt=None):  # fmt: skip
        self.model = model
        self.n_particles = validate.count("n_particles", n_particles, 2)
        self.resampling = validate.choice("resampling", resampling, ("always", "ess"))
        self.step = validate.positive("step", step)
        self._rng = validate.generator(rng)
        x0, P0 = gaussian_start(x0, P0, model.dim)
        X = x0 + self._rng.standard_normal((self.n_particles, model.dim)) @ np.linalg.cholesky(P0).T
        super().__init__((X, np.full(self.n_particles, -np.log(self.n_particles))), measurement, t0, dt)

    @property
    def particles(self):
        """States, shape (N, n)."""
        return self._belief[0]

    @property
    def weights(self):
        """Weights, shape (N,), summing to one."""
        return np.exp(self._belief[1])

    @property
    def effective_size(self):
        """Effective number of particles, 1 / Σ w²."""
        return 1.0 / np.sum(self.weights**2)

    def _moments(self, belief):
        X, log_w = belief
        w = np.exp(log_w)
        mean = w @ X
        Y = X - mean
        return mean, (w[:, None] * Y).T @ Y

    def _predicted(self, belief, t0, t1):
        X, log_w = self._resampled(*belief)
        X = advance(self.model, X, t0, t1, self._rng, self.step)
        return (X, log_w), int(np.ceil((t1 - t0) / self.step * (1 - 1e-12)))

    def _updated(self, belief, z, measurement):
        X, log_w = belief
        joint = log_w + measurement.log_likelihood(z, X, self.t)
        log_evidence = logsumexp(joint)
        if not np.isfinite(log_evidence):
            return belief, {"log_evidence": float(log_evidence)}
        return (X, joint - log_evidence), {"log_evidence": float(log_evidence)}

    def _resampled(self, X, log_w):
        w = np.exp(log_w)
        enough = self.resampling == "ess" and np.sum(w**2) * len(w) <= 2.0
        if enough or np.ptp(log_w) == 0.0:
            return X, log_w
        return X[systematic_indices(w, self._rng)], np.full(len(w), -np.log(len(w)))


def systematic_indices(weights, rng):
    """Indices, shape (N,), of a systematic draw from `weights`, by filterpy's routine.

    That routine draws from a global generator and runs off the end when rounding leaves the sum of the
    weights below one. Compiled, its generator is numba's, seeded here from `rng` (numpy's stays untouched);
    and the last particle that has a weight gets all that rounding may have lost.
    """
    padded = np.array(weights, dtype=float)
    padded[np.flatnonzero(padded)[-1]] += 1.0
    return _seeded_resample(padded, rng.integers(2**32, dtype=np.uint32))


_compiled_resample = njit(systematic_resample)


@njit
def _seeded_resample(weights, seed):
    np.random.seed(seed)  # noqa: NPY002 - numba's own generator
    return _compiled_resample(weights)
