"""Bootstrap particle filter of models that switch between modes: the referee where a grid is too large."""

import numpy as np

from sphfilter import validate
from sphfilter.model.paths import advance

from ._base import ReferenceFilter, gaussian_start
from ._weights import condition


class JumpParticleFilter(ReferenceFilter):
    """Sequential importance resampling of states and modes.

    Parameters
    ----------
    model : JumpMarkovModel
    measurement : measurement model
    x0, P0 : array_like, shapes (n,), (n, n)
    mode_probabilities : array_like, shape (M,), optional
    n_particles : int
    n_steps : int
        Parts of an interval, in the middles of which particles jump: the modes are exact, and the times of
        jumps as fine as the parts.
    rng : Generator or int, optional

    Attributes
    ----------
    mode_probabilities : ndarray, shape (M,)
    """

    def __init__(self, model, measurement, x0, P0, t0=0.0, dt=None, *, mode_probabilities=None,
                 n_particles=100_000, n_steps=16, rng=None):  # fmt: skip
        self.model, self._rng = model, validate.generator(rng)
        self.n_steps = validate.count("n_steps", n_steps)
        N = validate.count("n_particles", n_particles, 2)
        x0, P0 = gaussian_start(x0, P0, model.dim)
        X = x0 + self._rng.standard_normal((N, model.dim)) @ np.linalg.cholesky(P0).T
        p = model.stationary if mode_probabilities is None else np.asarray(mode_probabilities, dtype=float)
        modes = self._rng.choice(len(p), size=N, p=p)
        super().__init__((X, modes, np.full(N, 1.0 / N)), measurement, t0, dt)

    @property
    def mode_probabilities(self):
        _, modes, w = self._belief
        return np.bincount(modes, w, len(self.model.names))

    def _moments(self, belief):
        X, _, w = belief
        mean = w @ X
        return mean, (w[:, None] * (X - mean)).T @ (X - mean)

    def _predicted(self, belief, t0, t1):
        X, modes, w = belief
        ends = np.cumsum(w)
        taken = np.searchsorted(ends, (np.arange(len(w)) + self._rng.random()) * (ends[-1] / len(w)))
        taken = np.minimum(taken, len(w) - 1)
        X, modes, h = X[taken], modes[taken], (t1 - t0) / self.n_steps
        for part in range(2 * self.n_steps):  # halves of steps, with a jump after every other one
            start = t0 + 0.5 * part * h
            for i, mode in enumerate(self.model.modes.values()):
                own = modes == i
                X[own] = mode.domain.wrap(advance(mode, X[own], start, start + 0.5 * h, self._rng))
            modes = modes if part % 2 else self._jumped(modes, h)
        return (X, modes, np.full(len(w), 1.0 / len(w))), self.n_steps

    def _jumped(self, modes, h):
        ends = np.cumsum(self.model.transition(h), axis=1)[modes]
        found = (self._rng.random(len(modes))[:, None] > ends).sum(axis=1)
        return np.minimum(found, len(self.model.names) - 1)

    def _updated(self, belief, z, measurement):
        X, modes, w = belief
        with np.errstate(divide="ignore"):
            log_w = np.log(w)
        new = np.empty_like(w)
        log_evidence = condition(log_w, measurement.log_likelihood(z, X, self.t), new)
        return ((X, modes, new) if np.isfinite(log_evidence) else belief), {"log_evidence": log_evidence}
