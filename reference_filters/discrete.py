"""References for models in discrete time: a fine grid of one state, and a bootstrap particle filter."""

import math

import numpy as np
from scipy import stats


class GridOfSteps:
    """Chapman and Kolmogorov's equation of one state with additive noise on a fine grid, forward and back.

    Parameters
    ----------
    model : DiscreteModel
        Of steps of one second from zero on.
    log_likelihood : callable
        (z, x (M,)) to (M,).
    start : tuple
        Mean and standard deviation.
    reach : float
        The grid goes from -reach to reach.
    z : sequence
        A reading after each step.
    """

    def __init__(self, model, log_likelihood, start, reach, z, nodes=2001):
        self.x, self.step = np.linspace(-reach, reach, nodes, retstep=True)
        self.seen = [np.exp(log_likelihood(number, self.x)) for number in z]
        self.each, self.log_evidence = [], 0.0
        std, X, p = math.sqrt(model.covariance[0, 0]), self.x[:, None], stats.norm(*start).pdf(self.x)
        times = range(1 if model.autonomous else len(z))
        self.K = [stats.norm.pdf(X, model.transition(X, k)[:, 0], std) * self.step for k in times]
        for k, seen in enumerate(self.seen):
            p = (self.K[k % len(self.K)] @ p) * seen
            self.log_evidence += math.log(p.sum() * self.step)
            p /= p.sum() * self.step
            self.each.append(p)

    def smoothed(self):
        """Densities (T, nodes) given all readings, up to a factor each."""
        out, beta = [self.each[-1]], np.ones_like(self.x)
        for k in range(len(self.each) - 1, 0, -1):
            beta = self.K[k % len(self.K)].T @ (beta * self.seen[k])
            beta /= beta.max()
            out.append(self.each[k - 1] * beta)
        return out[::-1]

    def moments(self, densities):
        """Means and standard deviations of densities, (T,) each."""
        p = np.array(densities) / np.sum(densities, axis=1, keepdims=True)
        mean = p @ self.x
        return mean, np.sqrt(p @ self.x**2 - mean**2)


class BootstrapFilter:
    """Particles moved by the model, weighted by the likelihood, resampled systematically at every reading.

    Parameters
    ----------
    model : DiscreteModel
    sensor : sensor
    x0, P0 : array_like, shapes (n,), (n, n)
    n_points : int
    rng : numpy Generator or seed
    """

    def __init__(self, model, sensor, x0, P0, n_points, rng=None):
        self.model, self.sensor, self.rng, self.t = model, sensor, np.random.default_rng(rng), 0.0
        self.x_points = self.rng.multivariate_normal(x0, P0, n_points)
        self.root, self.log_evidence = np.linalg.cholesky(model.covariance), 0.0

    def run(self, times, z):
        """Means (T, n) after each reading."""
        means = []
        for t, number in zip(times, z, strict=True):
            self.x_points = self.model.drawn(self.x_points, self.t, t, self.root, self.rng)
            self.t = t
            log_w = self.sensor.log_likelihood(number, self.x_points, t)
            w = np.exp(log_w - log_w.max())
            self.log_evidence += log_w.max() + math.log(w.mean())
            w /= w.sum()
            means.append(w @ self.x_points)
            cuts = (np.arange(len(w)) + self.rng.random()) / len(w)
            self.x_points = self.x_points[np.minimum(np.searchsorted(np.cumsum(w), cuts), len(w) - 1)]
        return np.array(means)
