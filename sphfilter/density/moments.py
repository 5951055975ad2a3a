"""Moments of weighted points and of sums of densities, and points that have them."""

from typing import Any

import numpy as np

from .._types import Floats
from ..core.cloud.weights import weighted_moments


def columns(x: Floats) -> Floats:
    """Points (N, n) as compiled code takes them, (n, N): a copy of what is not such in memory already.

    What that code has made is, as its transpose.
    """
    turned = x.T
    return turned if turned.flags.carray else np.array(turned, order="C")


def moments(x: Floats, w: Floats) -> tuple[Floats, Floats]:
    """Mean (n,) and covariance (n, n) of weighted points, the same bits whatever the threads."""
    n = x.shape[1]
    mean, cov = np.empty(n), np.empty((n, n))
    weighted_moments(columns(x), w, mean, cov)
    return mean, cov


def moments_of_sum(w: Floats, means: Any, covs: Any) -> tuple[Floats, Floats]:
    """Mean (n,) and covariance (n, n) of a sum of densities, of shares w (K,), by those of its parts."""
    mean = w @ means
    return mean, cov_of_sum(w, means - mean, covs)


def cov_of_sum(w: Floats, off: Any, covs: Any) -> Floats:
    """Covariance (n, n) of a sum of densities, of shares w (K,), whose means are off its own by (K, n)."""
    return np.einsum("k,kab->ab", w, covs) + np.einsum("k,ka,kb->ab", w, off, off)


def matched(x: Floats, mass: Floats, mean: Floats, cov: Floats) -> Floats:
    """Points shifted and stretched, so that they have a mean and covariance."""
    own_mean, own_cov = moments(x, mass)
    change = np.linalg.cholesky(cov) @ np.linalg.inv(np.linalg.cholesky(own_cov))
    return mean + np.einsum("ij,kj->ik", x - own_mean, change)
