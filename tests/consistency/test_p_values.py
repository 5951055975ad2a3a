"""p-values over correlated runs: right under the null, small where something is wrong."""

import numpy as np
import pytest
from scipy import stats
from scipy.special import ndtr

from sphfilter.consistency import p_values as s
from sphfilter.errors import ModelError


def correlated(rng, n_runs, n_epochs, a):
    """Normals of a run that correlate by `a` from epoch to epoch."""
    e = rng.standard_normal((n_runs, n_epochs))
    for t in range(1, n_epochs):
        e[:, t] = a * e[:, t - 1] + np.sqrt(1 - a * a) * e[:, t]
    return e


@pytest.mark.parametrize(("n_runs", "n_epochs", "a"), [(200, 15, 0.8), (60, 40, 0.5), (100, 1, 0.0)])
def test_p_values_of_what_is_right_are_uniform(n_runs, n_epochs, a):
    rng = np.random.default_rng(1)
    draws = [correlated(rng, n_runs, n_epochs, a) for _ in range(150)]
    for p_values in ([s.uniform_runs(ndtr(e)) for e in draws], [s.same_mean(e, 0.0) for e in draws]):
        refused = np.sum(np.array(p_values) < 0.05)
        assert stats.binomtest(int(refused), 150, 0.05).pvalue > 1e-3
    # epochs taken for independent would be refused far too often
    naive = np.mean([s.uniform_epochs(ndtr(e)) < 0.05 for e in draws])
    assert (naive > 0.2) == (a > 0)


def test_ranks_that_are_wrong_are_refused():
    e = correlated(np.random.default_rng(2), 100, 20, 0.5)
    assert s.uniform_runs(ndtr(e)) > 0.01
    for wrong in (ndtr(1.6 * e), ndtr(0.6 * e), ndtr(e + 0.4), np.full_like(e, 0.99)):
        assert s.uniform_runs(wrong) < 1e-4
    assert s.same_mean(e + 0.3, 0.0) < 1e-6
    assert s.uniform_epochs(np.random.default_rng(0).random(500) ** 2) < 1e-4


def test_few_runs_and_unknown_ranks_are_not_judged():
    ranks = np.random.default_rng(3).random((30, 5))
    whole = s.uniform_runs(ranks)
    assert np.isnan(s.uniform_runs(ranks[:9])) and np.isnan(s.same_mean(ranks[:9], 0.5))
    failed = np.concatenate([ranks, np.full((4, 5), np.nan)])
    assert s.uniform_runs(failed) == whole and s.same_mean(failed, 0.5) == s.same_mean(ranks, 0.5)
    assert np.isnan(s.uniform_runs(np.full((30, 5), np.nan))) and np.isnan(s.uniform_epochs([np.nan] * 9))
    with pytest.raises(ModelError, match=r"\(runs, epochs\), got shape \(5,\)"):
        s.uniform_runs(ranks[0])


def test_histogram_and_holm_by_hand():
    np.testing.assert_allclose(s.histogram([0.05, 0.95, 0.99, np.nan], 2), [1 / 3, 2 / 3])
    # .004 < .01/2, then .02 > .01; alone each would have to be below .01
    np.testing.assert_array_equal(s.holm([0.02, 0.004, np.nan]), [False, True, False])
    np.testing.assert_array_equal(s.holm([0.004, 0.009]), [True, True])
    np.testing.assert_array_equal(s.holm([0.006, 0.009]), [False, False])


def test_no_worse_than_the_referee():
    assert s.more_exits(3, 3, 40) > 0.4
    assert s.more_exits(12, 3, 40) < 0.01
    # a referee without an exit is lucky: one in twenty is right
    assert s.more_exits(4, 0, 40) == pytest.approx(stats.binom.sf(3, 40, 0.05))
