"""Normals in bulk: their law, their independence, and that lanes and streams do not depend on each other."""

import numpy as np
from scipy import stats

from reference_filters._normals import LANES, fill_normals, seed_lanes


def draw(seed, stream, rows, n_lanes=LANES):
    state, out = np.empty((6, LANES), dtype=np.uint64), np.empty((rows, n_lanes))
    seed_lanes(np.uint64(seed), np.uint64(stream), state)
    fill_normals(state, out)
    return out


def test_they_are_normal():
    z = draw(1, 0, 8000)
    assert stats.kstest(z.ravel(), "norm").pvalue > 1e-3
    n = z.size
    for power, moment in ((1, 0.0), (2, 1.0), (3, 0.0), (4, 3.0), (6, 15.0), (8, 105.0)):
        spread = np.sqrt((stats.norm.moment(2 * power) - moment**2) / n)
        assert abs(np.mean(z**power) - moment) < 4.5 * spread, power
    for level in (3.0, 4.0):
        expected = n * 2 * stats.norm.sf(level)
        assert abs(np.sum(np.abs(z) > level) - expected) < 5 * np.sqrt(expected)


def test_pairs_rows_lanes_and_streams_are_uncorrelated():
    z, other = draw(1, 0, 4000), draw(1, 1, 4000)
    pairs = (z[0::2], z[1::2]), (z[:-2], z[2:]), (z[:, 1:], z[:, :-1]), (z, other), (z, draw(2, 0, 4000))
    for one, two in pairs:
        for f in (lambda v: v, np.square, np.abs):
            a, b = f(one).ravel(), f(two).ravel()
            assert abs(np.corrcoef(a, b)[0, 1]) < 4.5 / np.sqrt(a.size)


def test_a_lane_does_not_depend_on_how_many_there_are():
    np.testing.assert_array_equal(draw(5, 3, 7, 10), draw(5, 3, 7)[:, :10])


def test_an_odd_number_of_rows():
    np.testing.assert_array_equal(draw(5, 3, 7), draw(5, 3, 8)[:7])


def test_the_generator_moves_on():
    state, first, second = np.empty((6, LANES), dtype=np.uint64), np.empty((2, LANES)), np.empty((2, LANES))
    seed_lanes(np.uint64(9), np.uint64(0), state)
    fill_normals(state, first)
    fill_normals(state, second)
    np.testing.assert_array_equal(np.concatenate([first, second]), draw(9, 0, 4))
    assert not np.array_equal(first, second)
