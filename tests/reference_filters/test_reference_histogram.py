"""Knuth's rule against the integral it stands for, and histograms as densities."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import gammaln
from scipy.stats import norm

from reference_filters.histogram import density_histogram, knuth_bins, knuth_log_posterior
from sphfilter.errors import ModelError


def test_the_posterior_is_the_integral_over_the_probabilities_of_the_bins():
    """Two bins: ∫ (2 p)^a (2 (1 - p))^b over Jeffreys' prior 1 / (π √(p (1 - p))); p = sin² s."""

    def exact(a, b):
        return quad(
            lambda s: 2 / np.pi * (2 * np.sin(s) ** 2) ** a * (2 * np.cos(s) ** 2) ** b, 0, np.pi / 2
        )[0]

    for a, b in [(1, 0), (3, 2), (7, 1), (0, 4)]:
        assert knuth_log_posterior([a, b], 2) == pytest.approx(np.log(exact(a, b)), abs=1e-9)
    assert knuth_log_posterior([11], 1) == pytest.approx(0.0, abs=1e-12)  # one bin has nothing to learn


def test_the_bins_of_all_axes_count_together():
    """The formula of 002 (33) with B = Π B_d, term by term, empty bins included."""
    counts = np.random.default_rng(0).poisson(0.7, (6, 5, 4))
    N, B = counts.sum(), 120
    expected = N * np.log(B) + gammaln(B / 2) - B * gammaln(0.5) - gammaln(N + B / 2)
    expected += gammaln(counts + 0.5).sum()
    assert knuth_log_posterior(counts, B) == pytest.approx(expected, rel=1e-12)
    assert knuth_log_posterior(counts[counts > 0], B) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("n", [1, 2])
def test_uniform_samples_need_one_bin(n):
    samples = np.random.default_rng(1).random((20_000, n))
    assert knuth_bins(samples, box=[[0.0, 1.0]] * n) == 1


def test_steps_are_found_in_one_and_two_dimensions():
    """A density of four (by four) levels needs four bins an axis."""
    rng = np.random.default_rng(2)
    levels = np.array([0.1, 0.4, 0.2, 0.3])
    X = (rng.choice(4, (50_000, 2), p=levels) + rng.random((50_000, 2))) / 4
    assert knuth_bins(X[:, 0], box=[[0.0, 1.0]]) == 4
    assert knuth_bins(X, box=[[0.0, 1.0]] * 2) == 4
    found = density_histogram(X, box=[[0.0, 1.0]] * 2)
    np.testing.assert_allclose(found.density, 16 * np.outer(levels, levels), rtol=0.06)
    assert found.density.mean() == pytest.approx(1.0)


def test_a_guess_saves_the_search():
    X = np.random.default_rng(3).standard_normal(30_000)
    best = knuth_bins(X)
    assert 20 < best < 70
    assert knuth_bins(X, near=best) == best
    assert abs(knuth_bins(X, near=best + 15) - best) <= 15


@pytest.mark.parametrize("n", [1, 2, 3])
def test_the_histogram_comes_near_the_density(n):
    X = np.random.default_rng(4).standard_normal((200_000 if n < 3 else 100_000, n))
    found = density_histogram(X)
    exact = norm.pdf(found.centres).prod(axis=1)
    error = found.density.ravel() - exact
    assert np.sqrt((error**2).mean() / (exact**2).mean()) < (0.02, 0.05, 0.15)[n - 1]
    volume = np.prod([e[1] - e[0] for e in found.edges])
    assert found.density.sum() * volume == pytest.approx(1.0, rel=1e-12)
    assert found.density.shape == (len(found.edges[0]) - 1,) * n


def test_what_lies_outside_the_box_is_missing_from_the_density():
    X = np.random.default_rng(5).random((1000, 2))
    found = density_histogram(X, bins=[5, 2], box=[[0.0, 0.5], [0.0, 1.0]])
    assert found.density.shape == (5, 2)
    inside = np.mean(X[:, 0] <= 0.5)
    assert found.density.sum() * 0.1 * 0.5 == pytest.approx(inside)
    np.testing.assert_allclose(found.centres[:3], [[0.05, 0.25], [0.05, 0.75], [0.15, 0.25]])


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: knuth_bins(np.ones(5)), "all the same"),
        (lambda: knuth_bins([[0.1, 0.2]], box=[[1.0, 2.0]] * 2), "none of the samples"),
        (lambda: knuth_bins([0.1, 0.2], box=[[1.0, 0.0]]), "low < high"),
        (lambda: density_histogram(np.eye(2), bins=[2]), "bins has 1 numbers"),
        (lambda: density_histogram(np.eye(2), bins=0), "bins"),
        (lambda: knuth_bins(np.zeros((2, 2, 2))), "samples"),
    ],
)
def test_what_does_not_fit_is_said(call, words):
    with pytest.raises(ModelError, match=words):
        call()
