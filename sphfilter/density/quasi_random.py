"""Points that lie more evenly than random ones, by a key: always the same."""

import numpy as np

from .._types import Floats, OfStates
from .shapes import spread_evenly

__all__ = ["quasi_random", "standard_normal", "weighted_points"]

_WIDER = 1.15  # standard deviations of the Gaussian that points come from, over the density's own


def quasi_random(count: int, n: int, key: int) -> Floats:
    """Points (count, n) evenly spread over the unit cube, shifted by a key."""
    shift = np.random.Generator(np.random.Philox(key)).random(n)
    shifted = spread_evenly(count, n) + shift
    return shifted - np.floor(shifted)


def standard_normal(count: int, n: int, key: int) -> Floats:
    """Points (count, n) evenly spread as the standard normal law is, by a key."""
    from scipy.special import ndtri  # on use: import time

    normal: Floats = ndtri(np.clip(quasi_random(count, n, key), 1e-12, 1.0 - 1e-12))
    return normal


def weighted_points(
    log_p: OfStates, moments: tuple[Floats, Floats], count: int, key: int
) -> tuple[Floats, Floats]:
    """Points (count, n) with weights (count,) of a density of given mean and covariance.

    They come from a Gaussian somewhat wider than that, weighted by the ratio of the two.
    """
    mean, cov = moments
    z = _WIDER * standard_normal(count, len(mean), key)
    x = mean + np.einsum("ij,kj->ik", z, np.linalg.cholesky(cov))
    log_w = log_p(x) + 0.5 * np.sum(z**2, axis=1) / _WIDER**2
    w = np.exp(log_w - log_w.max())
    return x, w / w.sum()
