"""Fast searches against brute force in numpy and scipy's k-d tree."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from sphfilter.core.sph import neighbors


def cloud(N, n, seed=0):
    return np.random.default_rng(seed).normal(size=(N, n))


def as_sets(lists):
    start, rows = lists
    return [set(rows[start[i] : start[i + 1]].tolist()) for i in range(len(start) - 1)]


@pytest.mark.parametrize("method", range(len(neighbors.METHODS)))
@pytest.mark.parametrize(("N", "n"), [(3, 1), (60, 1), (300, 2), (300, 3), (200, 4), (150, 6)])
def test_query_finds_what_scipy_finds(method, N, n):
    x = cloud(N, n)
    R = 0.4 * np.sqrt(n)
    index = neighbors.build_index(x, R, method)
    found, r2 = np.empty(N, np.int64), np.empty(N)
    outside = 3.0 * cloud(20, n, seed=1)
    expected = cKDTree(x).query_ball_point(outside, R)
    for k in range(len(outside)):
        count = neighbors.query(index, x, outside, k, R, found, r2)
        assert sorted(found[:count]) == sorted(expected[k])
        assert r2[:count] == pytest.approx(((x[found[:count]] - outside[k]) ** 2).sum(axis=1))


@pytest.mark.parametrize("method", range(len(neighbors.METHODS)))
def test_lists_are_the_symmetric_closure(method):
    """j is a neighbour of i when r < max(reach_i, reach_j): 002's own k nearest would miss some."""
    x = cloud(250, 2)
    reach = np.random.default_rng(2).uniform(0.1, 0.9, 250)
    lists = neighbors.neighbor_lists(x, reach, reach.copy(), 0, neighbors.build_index(x, 0.5, method))
    r = np.linalg.norm(x[:, None] - x[None], axis=2)
    expected = (r <= np.maximum(reach[:, None], reach[None])) & ~np.eye(250, dtype=bool)
    assert as_sets(lists) == [set(np.flatnonzero(row)) for row in expected]
    one_sided = (r <= reach[:, None]) & ~np.eye(250, dtype=bool)
    assert one_sided.sum() < expected.sum()


def test_every_method_gives_the_same_rows_in_the_same_order():
    x = cloud(400, 3)
    support = np.full(400, 0.5)
    lists = [
        neighbors.neighbor_lists(x, support, 1.2 * support, 12, neighbors.build_index(x, 0.6, method))
        for method in range(len(neighbors.METHODS))
    ]
    for start, rows in lists[1:]:
        np.testing.assert_array_equal(start, lists[0][0])
        np.testing.assert_array_equal(rows, lists[0][1])


def test_buffer_holds_enough_particles_beyond_every_support():
    x = cloud(300, 2)
    support = np.full(300, 0.3)
    reach = support.copy()
    start, rows = neighbors.neighbor_lists(x, support, reach, 8, neighbors.build_index(x, 0.4, 1))
    for i in range(300):
        row = rows[start[i] : start[i + 1]]
        r = np.linalg.norm(x[row] - x[i], axis=1)
        assert (r > support[i]).sum() >= 8
    unseen_is_farther = [
        np.delete(np.linalg.norm(x - x[i], axis=1), [*rows[start[i] : start[i + 1]], i]).min() > reach[i]
        for i in range(300)
    ]
    assert all(unseen_is_farther)


def test_buffer_larger_than_the_cloud_lists_everyone():
    x = cloud(10, 2)
    start, _ = neighbors.neighbor_lists(
        x, np.full(10, 0.1), np.full(10, 0.1), 50, neighbors.build_index(x, 1.0, 0)
    )
    assert np.all(np.diff(start) == 9)


@pytest.mark.parametrize("method", range(len(neighbors.METHODS)))
def test_coincident_particles(method):
    x = np.zeros((40, 2))
    start, _ = neighbors.neighbor_lists(x, np.ones(40), np.ones(40), 0, neighbors.build_index(x, 1.0, method))
    assert np.all(np.diff(start) == 39)


def test_method_follows_number_and_dimension():
    names = [
        neighbors.METHODS[neighbors.choose_method(N, n)]
        for N, n in [(100, 2), (5000, 1), (5000, 2), (5000, 4)]
    ]
    assert names == ["brute", "cells", "cells", "tree"]
