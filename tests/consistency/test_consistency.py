"""Consistency measures, against textbook forms and against Kalman filters, which are consistent."""

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.distance import mahalanobis

from sphfilter import consistency as c
from sphfilter.errors import ModelError

#: A test that is right 999 times of 1000 where coverage is as claimed.
P_VALUE = 1e-3


def spd(rng, *shape):
    A = rng.standard_normal((*shape, shape[-1]))
    return A @ np.swapaxes(A, -1, -2) + 0.1 * np.eye(shape[-1])


def kalman_histories(rng, n_runs, n_epochs, trust=1.0):
    """Errors, their covariance, innovations and theirs, of Kalman filters of a randomly pushed point.

    The filter believes the process noise to be `trust` times what it is.
    """
    F, Q = np.array([[1.0, 1.0], [0.0, 1.0]]), 0.3 * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]])
    H, R, P = np.array([[1.0, 0.0]]), np.array([[0.7]]), np.diag([2.0, 1.0])
    x = rng.standard_normal((n_runs, 2)) @ np.linalg.cholesky(P).T
    m = np.zeros_like(x)
    out = []
    for _ in range(n_epochs):
        x = x @ F.T + rng.standard_normal(x.shape) @ np.linalg.cholesky(Q).T
        m, P = m @ F.T, F @ P @ F.T + trust * Q
        nu = x @ H.T + np.sqrt(R) * rng.standard_normal((n_runs, 1)) - m @ H.T
        S = H @ P @ H.T + R
        K = P @ H.T @ np.linalg.inv(S)
        m, P = m + nu @ K.T, P - K @ S @ K.T
        out.append((x, m, np.broadcast_to(P, (n_runs, 2, 2)), nu, np.broadcast_to(S, (n_runs, 1, 1))))
    return [np.stack(column, axis=1) for column in zip(*out, strict=True)]


def campaigns_inside(values, bounds, n_runs):
    """Return how many campaigns of `n_runs` runs have their last average inside, and of how many."""
    averages = np.array([c.run_average(v)[0][-1] for v in values.reshape(-1, n_runs, *values.shape[1:])])
    return int(np.sum((averages >= bounds[0]) & (averages <= bounds[1]))), len(averages)


def test_nees_is_the_quadratic_form_and_ignores_units():
    rng = np.random.default_rng(1)
    truth, mean, P = rng.standard_normal((3, 4, 5)), rng.standard_normal((3, 4, 5)), spd(rng, 3, 4, 5)
    e = mean - truth
    expected = np.einsum("rti,rtij,rtj->rt", e, np.linalg.inv(P), e)
    np.testing.assert_allclose(c.nees(truth, mean, P), expected, rtol=1e-9)
    units = np.array([1e-9, 1.0, 1e7, 3.0, 1e-3])
    scaled = c.nees(truth * units, mean * units, P * np.outer(units, units))
    np.testing.assert_allclose(scaled, expected, rtol=1e-9)
    np.testing.assert_allclose(c.nis(e, P), expected, rtol=1e-9)


def test_distance_is_mahalanobis_and_broadcasts():
    rng = np.random.default_rng(2)
    x, mean, P = rng.standard_normal((6, 1, 3)), rng.standard_normal((4, 3)), spd(rng, 4, 3)
    found = c.distance(x, mean, P)
    assert found.shape == (6, 4)
    exact = mahalanobis(x[5, 0], mean[2], np.linalg.inv(P[2]))
    assert found[5, 2] == pytest.approx(exact, rel=1e-9)
    assert c.distance([3.0], [1.0], [[4.0]]) == 1.0
    assert np.isnan(c.distance([np.nan], [0.0], [[1.0]])) and c.distance([1.0], [0.0], [[0.0]]) == np.inf
    with pytest.raises(ModelError, match=r"covariance \(..., n, n\)"):
        c.distance(np.zeros(3), np.zeros(3), np.eye(2))


def test_nmee_is_signed_and_a_single_run_needs_no_run_axis():
    truth, mean = np.array([[1.0, 2.0], [1.0, 2.0]]), np.array([[3.0, 1.0], [1.0, 2.5]])
    P = np.broadcast_to([[4.0, 0.1], [0.1, 0.25]], (2, 2, 2))
    np.testing.assert_allclose(c.nmee(truth, mean, P), [[1.0, -2.0], [0.0, 1.0]])
    np.testing.assert_allclose(c.nees(truth, mean, P)[1], 0.5**2 * 4.0 / (4.0 * 0.25 - 0.01))


def test_nan_and_covariances_that_are_none():
    truth, mean = np.zeros((4, 2)), np.ones((4, 2))
    P = np.array([np.eye(2), np.full((2, 2), np.nan), [[1.0, 2.0], [2.0, 1.0]], np.zeros((2, 2))])
    np.testing.assert_array_equal(c.nees(truth, mean, P), [2.0, np.nan, np.inf, np.inf])
    np.testing.assert_array_equal(c.nmee(truth, mean, P)[:, 0], [1.0, np.nan, 1.0, np.inf])
    mean[0, 1] = np.nan
    np.testing.assert_array_equal(c.nees(truth, mean, P)[0], np.nan)
    np.testing.assert_array_equal(c.nmee(truth, mean, P)[0], [1.0, np.nan])


def test_run_average_leaves_failed_runs_out_and_counts():
    values = np.array([[1.0, 2.0, np.nan], [3.0, np.nan, np.nan], [5.0, 6.0, np.nan]])
    average, n_runs = c.run_average(values)
    np.testing.assert_array_equal(average, [3.0, 4.0, np.nan])
    np.testing.assert_array_equal(n_runs, [3, 2, 0])
    assert c.fraction_inside(average, (3.5, 9.0)) == 0.5
    assert np.isnan(c.fraction_inside([np.nan], (0.0, 1.0)))
    two_states = np.array([[0.0, 9.0], [0.0, np.inf], [9.0, np.nan]])
    np.testing.assert_allclose(c.fraction_inside(two_states, (-1.0, 1.0)), [2 / 3, 0.0])


def test_bounds_known_values():
    # 25 runs of two states; the textbook's 50 runs of two states: χ² with 100 degrees, [74.2, 129.6]/50
    np.testing.assert_allclose(c.nees_bounds(2, 25), [1.294, 2.857], atol=5e-4)
    np.testing.assert_allclose(c.nees_bounds(2, 50), [1.484, 2.591], atol=1e-3)
    np.testing.assert_allclose(c.nmee_bounds(25), [-0.392, 0.392], atol=5e-4)


@pytest.mark.parametrize("alpha", [0.01, 0.05, 0.3])
def test_bounds_are_quantiles(alpha):
    n_runs = np.array([1, 7, 100])
    chi2 = stats.chi2(3 * n_runs)
    expected = [chi2.ppf(alpha / 2) / n_runs, chi2.ppf(1 - alpha / 2) / n_runs]
    np.testing.assert_allclose(c.nees_bounds(3, n_runs, alpha), expected, rtol=1e-10)
    lower, upper = c.nees_bounds(3, n_runs, alpha, sided=1)
    np.testing.assert_allclose(upper, chi2.ppf(1 - alpha) / n_runs, rtol=1e-10)
    np.testing.assert_array_equal(lower, 0.0)
    np.testing.assert_allclose(
        c.nmee_bounds(n_runs, alpha)[1], stats.norm(0, n_runs**-0.5).ppf(1 - alpha / 2)
    )


def test_kalman_filters_are_inside_95_percent_of_the_time_and_the_printed_intervals_are_wrong():
    n_runs = 25
    x, m, P, nu, S = kalman_histories(np.random.default_rng(5), 1500 * n_runs, 8)
    nees, nmee = c.nees(x, m, P), c.nmee(x, m, P)[..., 1]
    cases = [
        (nees, c.nees_bounds(2, n_runs)),
        (nees, c.nees_bounds(2, n_runs, sided=1)),
        (nmee, c.nmee_bounds(n_runs)),
        (c.nis(nu, S), c.nees_bounds(1, n_runs)),
    ]
    for values, bounds in cases:
        assert stats.binomtest(*campaigns_inside(values, bounds, n_runs), 0.95).pvalue > P_VALUE
    # 002 (65) and (68) as printed
    printed = np.array(c.nees_bounds(2, n_runs)) * np.sqrt(n_runs)
    assert campaigns_inside(nees, printed, n_runs)[0] == 0
    too_wide = campaigns_inside(nmee, (-1.96, 1.96), n_runs)
    assert stats.binomtest(*too_wide, 0.95).pvalue < 1e-9


def test_an_overconfident_filter_falls_outside():
    x, m, P, nu, S = kalman_histories(np.random.default_rng(5), 25 * 100, 8, trust=0.2)
    for values, dim in ((c.nees(x, m, P), 2), (c.nis(nu, S), 1)):
        inside, n = campaigns_inside(values, c.nees_bounds(dim, 25), 25)
        assert inside < 0.5 * n


def test_divergence_criterion():
    limit = stats.chi2(10).ppf(0.9999) / 5
    history = np.full((6, 12), 2.0)
    history[1, 3:8] = limit * (1 + 1e-9)  # just above
    history[2, 3:8] = limit * (1 - 1e-9)  # just below
    history[3, 11] = 5 * limit  # one update that is far enough off
    history[4, 4] = np.inf
    history[5] = np.nan
    np.testing.assert_array_equal(c.diverged(history, 2), [False, True, False, True, True, False])
    # fewer updates than the window: all of them
    short = stats.chi2(6).ppf(0.9999) / 3
    np.testing.assert_array_equal(
        c.diverged(np.outer([short * 1.01, short * 0.99], np.ones(3)), 2), [True, False]
    )
    assert not c.diverged(np.empty(0), 2) and c.diverged(np.full(9, 100.0), 2)


def test_consistent_filters_rarely_count_as_diverged():
    rng = np.random.default_rng(2)
    # 36 windows at 1e-4 each are 0.36 % at most; they overlap, and half of that is a generous least
    independent = np.mean(c.diverged(rng.chisquare(2, (20_000, 40)), 2))
    assert 0.0018 < independent < 0.0036
    # the false alarms that correlation in time adds, as the docstring states them
    x, m, P, *_ = kalman_histories(rng, 4000, 40)
    assert np.mean(c.diverged(c.nees(x, m, P), 2)) == pytest.approx(0.05, abs=0.015)


def test_whiteness():
    *_, nu, S = kalman_histories(np.random.default_rng(8), 3000, 60)
    for lag in (1, 3):
        r = c.whiteness(nu, S, lag)
        low, high = c.nmee_bounds(60 - lag)
        assert abs(np.mean((r > low) & (r < high)) - 0.95) < 0.015
    wrong = c.whiteness(*kalman_histories(np.random.default_rng(8), 500, 60, trust=0.02)[-2:])
    assert np.mean(np.abs(wrong) < high) < 0.5
    # by the formula, with a gap in the measurements: (1·2 + 4·8) / √((1 + 16) (4 + 64)), scale 1/3
    values = 3.0 * np.array([1.0, 2.0, np.nan, 4.0, 8.0])[:, None]
    assert c.whiteness(values, np.full((5, 1, 1), 9.0)) == pytest.approx(34 / np.sqrt(17 * 68))


def test_bad_arguments():
    with pytest.raises(ModelError, match=r"got \(3, 2\), \(4, 2\) and \(4, 2, 2\)"):
        c.nees(np.zeros((3, 2)), np.zeros((4, 2)), np.zeros((4, 2, 2)))
    with pytest.raises(ModelError, match="sided must be 1 or 2"):
        c.nees_bounds(2, 5, sided=3)
    with pytest.raises(ModelError, match="alpha must lie between 0 and 1"):
        c.nmee_bounds(5, alpha=5)
