"""Points that are to lie more evenly than random ones: no covariance and no slanting tail says otherwise."""

import numpy as np
import pytest
from scipy.stats import chi2, norm

from sphfilter.density.quasi_random import quasi_random, weighted_points

EDGES = norm.isf([0.02, 0.015, 0.01, 0.006, 0.003, 0.001])  # of six parts of a tail, the last a thousandth


def slanting(n):
    """Directions (60, n), half of them near an axis."""
    rng = np.random.default_rng(5)
    v = np.concatenate([rng.normal(size=(30, n)), np.eye(n)[rng.integers(0, n, 30)]])
    v[30:] += 0.15 * rng.normal(size=(30, n))
    return v / np.linalg.norm(v, axis=1)[:, None]


def assert_even(z, w):
    """Covariances and tails along any direction are as far off as those of random points, at most."""
    N, n = z.shape
    cov = (z * w[:, None]).T @ z
    assert np.abs(cov - np.eye(n)).max() < 2.0 * N**-0.5
    for v in slanting(n):
        expected = -np.diff(norm.sf(EDGES)) * N
        found = N * np.histogram(z @ v, EDGES, weights=w)[0]
        assert ((found - expected) ** 2 / expected).sum() < chi2.isf(1e-5, len(expected))


@pytest.mark.parametrize("key", [1, 2])
@pytest.mark.parametrize("N", [4096, 65536])
@pytest.mark.parametrize("n", range(2, 7))
def test_points_lie_evenly_in_all_directions(n, N, key):
    """Of the additive sequence in three dimensions tails are off by ten standard deviations."""
    assert_even(norm.ppf(quasi_random(N, n, key)), np.full(N, 1.0 / N))


@pytest.mark.parametrize("n", [1, 3, 5])
def test_weighted_points_stand_for_the_tails_of_a_density(n):
    z, w = weighted_points(lambda x: -0.5 * np.sum(x * x, axis=1), (np.zeros(n), np.eye(n)), 2**16, 3)
    assert_even(z, w)
