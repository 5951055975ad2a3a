"""A few Gaussians as a density, and Bayes' rule on them: against closed forms and fine grids."""

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

import sphfilter as sf
from sphfilter.density.as_family import pieces_density
from sphfilter.density.pieces import Pieces, light, merged, nodes, pieces_of
from sphfilter.density.storage import from_bytes, to_bytes
from sphfilter.filter.by_ladder import by_pieces
from sphfilter.filter.reading_at_prior import ReadingAtPrior
from sphfilter.prediction.mixing import _few

WEIGHTS = np.array([0.5, 0.3, 0.2])
MEANS = np.array([[0.0, 1.0], [2.0, -1.0], [-1.5, 0.5]])
ROOTS = np.array([[[0.5, 0.0], [0.2, 0.4]], [[0.3, 0.0], [0.0, 0.9]], [[0.6, 0.0], [-0.5, 0.3]]])
THREE = Pieces(np.log(WEIGHTS), MEANS, ROOTS)
START = sf.initialize(sf.Gaussian(np.zeros(2), np.eye(2)), "auto")
DENSITY = pieces_density(START, THREE)


def pdf(X):
    covs = ROOTS @ ROOTS.transpose(0, 2, 1)
    each = [multivariate_normal(m, c).pdf(X) for m, c in zip(MEANS, covs, strict=True)]
    return WEIGHTS @ np.array(each)


def narrower(one, axis, ratio):
    """Gaussians that together are one, each `ratio` as wide along an axis of its coordinates."""
    s, v = ratio / np.sqrt(1.0 - ratio**2), np.eye(2)[axis]
    centre = 1.7 * s * np.arange(-9, 10)  # their sum ripples by 2 exp(-2 π² / 1.7²) = .002
    log_w = -0.5 * centre**2 / (1.0 + s * s)
    mean = one.mean[0] + np.outer(centre / (1.0 + s * s), one.root[0] @ v)
    root = one.root[0] @ (np.eye(2) - (1.0 - ratio) * np.outer(v, v))
    return Pieces(one.log_w[0] + log_w - logsumexp(log_w), mean, np.repeat(root[None], len(mean), axis=0))


def moments(X, w):
    mean = w @ X
    return mean, (w[:, None] * (X - mean)).T @ (X - mean)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 6])
def test_nodes_are_exact_to_degree_five(n):
    """Averages of x_a^2 x_b^2, x_a^4 and odd powers under the standard normal law."""
    xi, u = nodes(n)
    assert u.min() > 0.0 and u.sum() == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(u @ xi**4, 3.0, atol=1e-10)
    squares = np.einsum("i,ia,ib->ab", u, xi**2, xi**2)
    np.testing.assert_allclose(squares, np.ones((n, n)) + 2.0 * np.eye(n), atol=1e-10)
    np.testing.assert_allclose(u @ (xi**3 * xi[:, :1] ** 2), 0.0, atol=1e-10)


class TestQuestions:
    def test_density_and_slope(self):
        X = np.random.default_rng(0).normal(size=(50, 2))
        np.testing.assert_allclose(DENSITY.pdf(X), pdf(X), rtol=1e-12)
        step = 1e-6 * np.eye(2)
        slopes = np.array([(pdf(X + d) - pdf(X - d)) / 2e-6 for d in step]).T
        np.testing.assert_allclose(DENSITY.gradient(X), slopes, atol=1e-8)

    def test_moments(self):
        mean = WEIGHTS @ MEANS
        off = MEANS - mean
        cov = np.einsum(
            "k,kab->ab", WEIGHTS, ROOTS @ ROOTS.transpose(0, 2, 1) + off[:, :, None] * off[:, None]
        )
        np.testing.assert_allclose(DENSITY.mean(), mean, rtol=1e-12)
        np.testing.assert_allclose(DENSITY.cov(), cov, rtol=1e-12)
        assert DENSITY.moment([1, 0]) == pytest.approx(mean[0])
        drawn = DENSITY.form.sample(200_000, np.random.default_rng(1))
        assert DENSITY.moment([2, 1]) == pytest.approx(np.mean(drawn[:, 0] ** 2 * drawn[:, 1]), abs=0.02)

    def test_marginal_and_quantile(self):
        one = DENSITY.marginal([1])
        widths = np.sqrt(np.sum(ROOTS[:, 1] ** 2, axis=1))
        y = np.linspace(-3.0, 3.0, 7)
        exact = WEIGHTS @ norm(MEANS[:, 1:], widths[:, None]).pdf(y)
        np.testing.assert_allclose(one.pdf(y[:, None]), exact, rtol=1e-10)
        for share in (0.01, 0.3, 0.95):
            found = DENSITY.quantile(1, share)
            assert WEIGHTS @ norm(MEANS[:, 1], widths).cdf(found) == pytest.approx(share, abs=3e-4)

    def test_probability_entropy_and_region(self):
        drawn = DENSITY.form.sample(200_000, np.random.default_rng(2))
        inside = np.mean((drawn[:, 0] > 0.5) & (drawn[:, 1] < 0.0))
        assert DENSITY.probability(lambda X: (X[:, 0] > 0.5) & (X[:, 1] < 0.0)) == pytest.approx(
            inside, abs=0.004
        )
        assert DENSITY.entropy() == pytest.approx(-np.mean(np.log(pdf(drawn))), abs=0.01)
        assert np.mean(DENSITY.hpd_region(0.8)(drawn)) == pytest.approx(0.8, abs=0.01)

    def test_files_keep_all_bits(self):
        again = from_bytes(to_bytes(DENSITY))
        for name, part in THREE._asdict().items():
            np.testing.assert_array_equal(getattr(again.pieces, name), getattr(DENSITY.pieces, name))
            assert part.shape == getattr(again.pieces, name).shape
        assert again.read_out == "pieces" and again.error == DENSITY.error


class TestMerging:
    def test_moments_stay(self):
        each = [narrower(THREE.some([k]), axis, 0.4) for k, axis in enumerate([0, 1, 0])]
        many = Pieces(*(np.concatenate(part) for part in zip(*each, strict=True)))
        few, change = merged(many, 0.05)
        assert len(few.log_w) < 0.6 * len(many.log_w) and 0.0 < change < 0.2
        for one, other in zip(few.moments(), many.moments(), strict=True):
            np.testing.assert_allclose(one, other, atol=1e-10)

    def test_what_differs_stays_apart(self):
        few, change = merged(THREE, 0.05)
        assert len(few.log_w) == 3 and change == 0.0

    def test_the_density_changes_as_little_as_it_says(self):
        fine = narrower(pieces_of(np.zeros(2), np.eye(2)), 0, 0.3)
        few, change = merged(fine, 0.1)
        X = np.random.default_rng(3).normal(size=(20_000, 2))
        off = few.log_p(X) - multivariate_normal(np.zeros(2), np.eye(2)).logpdf(X)
        assert np.sqrt(np.mean(off**2)) < 2.0 * max(change, 0.02)


class TestPosterior:
    def test_a_linear_reading_is_kalmans_of_each(self):
        H, R, z = np.array([[1.0, 0.3]]), np.array([[0.2]]), np.array([0.7])
        new, said = by_pieces(DENSITY, ReadingAtPrior.of(DENSITY, sf.GaussianMeasurement(H, R), z), 1e-6)
        S = H @ THREE.cov @ H.T + R
        gain = THREE.cov @ H.T / S
        means = THREE.mean + (gain @ (z - THREE.mean @ H.T)[..., None])[..., 0]
        each = THREE.w * norm((THREE.mean @ H.T)[:, 0], np.sqrt(S[:, 0, 0])).pdf(z)
        order = np.argsort(-each)
        np.testing.assert_allclose(new.pieces.w, (each / each.sum())[order], rtol=1e-12)
        np.testing.assert_allclose(new.pieces.mean, means[order], rtol=1e-12)
        np.testing.assert_allclose(new.pieces.cov, (THREE.cov - gain @ H @ THREE.cov)[order], atol=1e-12)
        assert said["log_evidence"] == pytest.approx(np.log(each.sum()), abs=1e-12)
        assert said["error"] < 1e-6

    def test_what_did_not_come_is_not_read(self):
        both = sf.GaussianMeasurement(np.eye(2), [[0.2, 0.1], [0.1, 0.5]])
        one = sf.GaussianMeasurement([[1.0, 0.0]], [[0.2]])
        asked = [ReadingAtPrior.of(DENSITY, sensor, z) for sensor, z in ((both, [0.7, np.nan]), (one, [0.7]))]
        (new, said), (other, known) = (by_pieces(DENSITY, a, 1e-6) for a in asked)
        np.testing.assert_allclose(new.mean(), other.mean(), rtol=1e-12)
        assert said["log_evidence"] == pytest.approx(known["log_evidence"], abs=1e-12)


def test_light_parts_are_those_without_which_mass_and_variance_stay():
    rng = np.random.default_rng(3)
    w = np.sort(rng.dirichlet(np.full(60, 0.1)))[::-1]
    means, covs = rng.normal(0.0, 3.0, (60, 2)), np.eye(2) * rng.gamma(1.0, 1.0, (60, 1, 1))
    means[-1], w[-1] = [4e3, 0.0], 1e-6  # hardly any of the probability, most of the variance
    w /= w.sum()
    out = light(w, means, covs, 1e-3)
    assert out.any() and not out[-1]
    assert w[out].sum() < 1e-3
    every, some = (np.cov(means[k].T, aweights=w[k], bias=True) for k in (np.ones(60, bool), ~out))
    np.testing.assert_allclose(np.diag(some), np.diag(every), rtol=4e-3)
    np.testing.assert_array_equal(light(w, 1e3 * means, 1e6 * covs, 1e-3), out)


def test_a_sum_of_too_many_gaussians_is_merged_further_and_that_is_told():
    rng = np.random.default_rng(5)
    root = 0.5 * np.exp(rng.normal(0.0, 0.5, (600, 1, 1))) * np.eye(2)
    many = Pieces(np.zeros(600), rng.normal(0.0, 2.0, (600, 2)), root).normalised()
    few, change = _few(many, 5e-3, 1.0)
    assert len(few.log_w) <= 200
    assert change > 5e-3
    np.testing.assert_allclose(few.moments()[1], many.moments()[1], rtol=1e-9)
    assert few.log_p(many.mean) == pytest.approx(many.log_p(many.mean), abs=0.3)


def test_a_reading_that_only_one_part_explains_leaves_the_others_out():
    apart = Pieces(np.log([0.5, 0.5, 1e-9]), np.array([[0.0], [80.0], [0.1]]), np.ones((3, 1, 1)))
    density = pieces_density(sf.initialize(sf.Gaussian([0.0], [[1.0]]), "auto"), apart)
    asked = ReadingAtPrior.of(density, sf.GaussianMeasurement([[1.0]], [[1e-4]]), [0.0])
    new, said = by_pieces(density, asked, 0.01)
    assert new.gaussian and new.mean()[0] == pytest.approx(0.0, abs=1e-6)  # one is no sum
    assert said["log_evidence"] == pytest.approx(
        np.log(0.5) + norm.logpdf(0.0, 0.0, np.sqrt(1.0001)), abs=1e-6
    )


def test_a_sum_of_modes_goes_on_by_a_linear_model():
    """A filter of one linear model carries on what a filter of modes knows: each Gaussian by itself."""
    modes = {name: sf.LinearSDE([[0.0]], [v], noise=[[0.2]]) for name, v in (("left", -1.0), ("right", 1.0))}
    switching = sf.JumpMarkovModel(modes, [[-0.1, 0.1], [0.1, -0.1]])
    flt = sf.JumpMarkovFilter(switching, None, x0=[0.0], P0=[[0.1]])
    flt.predict(2.0)
    start = flt.density
    one = sf.SPHFilter(sf.LinearSDE([[-0.5]], noise=[[0.3]]), None, density=start)
    assert one.predict(1.0).scheme == "pieces"
    own, flow, Q = start.pieces, np.exp(-0.5), 0.09 * -np.expm1(-1.0)
    X = np.linspace(-3.0, 3.0, 61)[:, None]
    each = norm.pdf(X, flow * own.mean[:, 0], np.sqrt(flow**2 * own.cov[:, 0, 0] + Q))
    np.testing.assert_allclose(one.density.pdf(X), each @ own.w, atol=2e-3)
