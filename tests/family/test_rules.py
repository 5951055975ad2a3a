"""Cubature rules: all moments of the standard normal law that they are to have, and polynomials by them."""

import itertools
import math

import numpy as np
import pytest

from experiments.cubature import solved
from sphfilter.core.family.basis import basis, values_at
from sphfilter.core.family.rules import degrees, rule

RULES = [(n, degree) for n in range(1, 7) for degree in degrees(n)]


def odd_factorial(k):
    return math.prod(range(k, 0, -2))


@pytest.mark.parametrize(("n", "degree"), RULES)
def test_all_moments_are_exact(n, degree):
    x, u = rule(n, degree)
    assert u.min() > 0.0
    for power in itertools.product(range(2 * degree + 2), repeat=n):
        if sum(power) <= 2 * degree + 1:
            even = not any(k % 2 for k in power)
            exact = math.prod(odd_factorial(k - 1) for k in power) if even else 0.0
            scale = math.sqrt(math.prod(odd_factorial(2 * k - 1) for k in power))
            assert abs(u @ np.prod(x ** np.array(power), axis=1) - exact) < 1e-12 * scale


@pytest.mark.parametrize(("n", "degree"), [(1, 6), (2, 5), (3, 4), (4, 4), (6, 3)])
def test_polynomials_are_orthonormal_and_have_the_derivatives_that_are_told(n, degree):
    b = basis(n, degree)
    np.testing.assert_allclose(b.V @ b.F, np.eye(len(b.V)), atol=1e-12)
    c, point, step = np.cos(np.arange(len(b.V))), np.full((1, n), 0.3), 1e-5
    for a in range(n):
        below = np.zeros(len(c))
        for j in np.flatnonzero(b.below[a] >= 0):
            below[b.below[a, j]] += b.root[a, j] * c[j]
        slope, ends = np.empty(1), np.empty(2)
        values_at(b.power, below, point, np.inf, slope)
        values_at(b.power, c, np.vstack([point, point]) + step * np.eye(n)[a] * [[1], [-1]], np.inf, ends)
        np.testing.assert_allclose(slope[0], (ends[0] - ends[1]) / (2 * step), rtol=1e-7)


def test_the_search_finds_a_rule_within_a_radius():
    weights, generators = solved(2, 3, ["00", "a0", "aa", "a0"], tries=100, seed=1, within=3.2)
    assert weights.min() > 0.0
    assert np.linalg.norm(generators, axis=1).max() <= 3.2
    assert solved(2, 3, ["00", "a0"], tries=3, seed=1, within=3.2) is None
