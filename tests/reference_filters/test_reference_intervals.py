"""Student's intervals: table values, coverage, the normalised pivot."""

import numpy as np
import pytest

from reference_filters.intervals import interval_factor, mean_interval, pivot, standard_error
from sphfilter.errors import ModelError


def test_factors_of_the_table():
    """t quantiles of any textbook; 000 (143) has .714 for the first, rounded down."""
    assert interval_factor(10) == pytest.approx(2.262157 / np.sqrt(10), rel=1e-6)
    assert interval_factor(10) == pytest.approx(0.715, abs=5e-4)
    assert interval_factor(2, 0.99) == pytest.approx(63.656741 / np.sqrt(2), rel=1e-7)
    assert interval_factor(100_000) * np.sqrt(100_000) == pytest.approx(1.959964, rel=1e-4)


def test_two_groups_by_hand():
    """One degree of freedom is Cauchy's law: its quantile at level 1/2 is 1, the ends are the values."""
    low, high = mean_interval([[1.0, 5.0], [3.0, 5.0]], 0.5)
    np.testing.assert_allclose(low, [1.0, 5.0], rtol=1e-12)
    np.testing.assert_allclose(high, [3.0, 5.0], rtol=1e-12)
    np.testing.assert_allclose(standard_error([[1.0], [3.0]]), 1.0)


@pytest.mark.parametrize(("groups", "level"), [(3, 0.95), (10, 0.95), (10, 0.5)])
def test_coverage_is_the_level(groups, level):
    values = np.random.default_rng(groups).standard_normal((groups, 40_000)) * 3.0 + 7.0
    low, high = mean_interval(values, level)
    found = np.mean((low <= 7.0) & (high >= 7.0))
    assert abs(found - level) < 4.5 * np.sqrt(level * (1 - level) / 40_000)
    np.testing.assert_array_equal(np.abs(pivot(values, 7.0, level)) <= 1.0, (low <= 7.0) & (high >= 7.0))


def test_the_pivot_is_one_at_the_ends_and_has_the_sign_of_what_is_missing():
    values = np.random.default_rng(1).standard_normal((10, 4, 3))
    low, high = mean_interval(values)
    np.testing.assert_allclose(pivot(values, low), 1.0, rtol=1e-12)
    np.testing.assert_allclose(pivot(values, high), -1.0, rtol=1e-12)
    agreed = np.zeros((10, 2))
    np.testing.assert_array_equal(pivot(agreed, [0.0, 1.0]), [0.0, -np.inf])


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: mean_interval([[1.0, 2.0]]), "two groups"),
        (lambda: pivot(3.0, 1.0), "two groups"),
        (lambda: interval_factor(10, 95), "between 0 and 1"),
        (lambda: interval_factor(1), "n_groups"),
    ],
)
def test_what_cannot_be_is_said(call, words):
    with pytest.raises(ModelError, match=words):
        call()
