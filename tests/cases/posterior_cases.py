"""Priors times likelihoods that a coarse lattice overlooks, with brute-force grids as their judges."""

from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp
from scipy.stats import norm

import sphfilter as sf


class Exact(NamedTuple):
    """Moments and log-evidence of a posterior."""

    mean: np.ndarray
    cov: np.ndarray
    log_evidence: float


def on_grid(log_p, box, nodes):
    """`Exact` of an unnormalised log-density of one or two states, by sums over a grid."""
    axes = [np.linspace(low, high, nodes) for low, high in box]
    X = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    values = log_p(X)
    total = logsumexp(values)
    w = np.exp(values - total)
    mean = w @ X
    d = X - mean
    cell = np.prod([axis[1] - axis[0] for axis in axes])
    return Exact(mean, (d * w[:, None]).T @ d, float(total + np.log(cell)))


def standard(X):
    """log N(X; 0, I)."""
    return norm.logpdf(X).sum(axis=1)


def robust(s, peaks=None):
    """A sensor of the first state: .9 N(z; x, s²) + .1 N(z; x, 10²)."""

    def loglik(z, X, t):
        r = z[0] - X[:, 0]
        return np.logaddexp(np.log(0.9) + norm.logpdf(r, scale=s), np.log(0.1) + norm.logpdf(r, scale=10.0))

    options = {} if peaks is None else {"peaks": peaks}
    return sf.LikelihoodMeasurement(loglik, **options)


def quantised(step, noise):
    """A sensor of the first state that rounds to multiples of a step; the impossible is made 1e-300."""

    def loglik(z, X, t):
        below, above = ((z[0] + side * step / 2 - X[:, 0]) / noise for side in (-1.0, 1.0))
        return np.log(np.maximum(norm.cdf(above) - norm.cdf(below), 1e-300))

    return sf.LikelihoodMeasurement(loglik)


def box(half):
    """A sensor of the first state with errors uniform within a half-width."""

    def loglik(z, X, t):
        return np.where(np.abs(z[0] - X[:, 0]) < half, -np.log(2.0 * half), -np.inf)

    return sf.LikelihoodMeasurement(loglik)


def ranges(anchors, noise):
    """Distances of two states from anchors (k, 2)."""
    anchors = np.asarray(anchors, float)

    def h(X, t):
        return np.linalg.norm(X[:, None] - anchors, axis=2)

    return sf.GaussianMeasurement(h, noise**2 * np.eye(len(anchors)), vectorized=True)


def wrong(density, log_evidence, exact):
    """Errors of mean (standard deviations), of variance (largest relative), and of the log-evidence."""
    std = np.sqrt(np.diag(exact.cov))
    mean = np.abs((density.mean() - exact.mean) / std).max()
    return mean, np.abs(np.diag(density.cov()) / std**2 - 1.0).max(), abs(log_evidence - exact.log_evidence)
