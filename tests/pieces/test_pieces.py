"""A few Gaussians as a density, and Bayes' rule on them: against closed forms and fine grids."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

import sphfilter as sf
from sphfilter.density.as_family import pieces_density
from sphfilter.density.merging import merged
from sphfilter.density.pieces import Pieces, light, nodes, pieces_of
from sphfilter.density.pieces_posterior import Settings, pieces_posterior
from sphfilter.density.splitting import Front, children
from sphfilter.density.storage import from_bytes, to_bytes
from sphfilter.filter.by_pieces import by_pieces
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
        from scipy.stats import norm

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
        fine = children(
            Front(THREE.log_w, THREE.mean, THREE.root, np.arange(3)), np.eye(2)[[0, 1, 0]], np.full(3, 0.4)
        )
        many = Pieces(*fine[:3])
        few, change = merged(many, 0.05)
        assert len(few.log_w) < 0.6 * len(many.log_w) and 0.0 < change < 0.2
        for one, other in zip(few.moments(), many.moments(), strict=True):
            np.testing.assert_allclose(one, other, atol=1e-10)

    def test_what_differs_stays_apart(self):
        few, change = merged(THREE, 0.05)
        assert len(few.log_w) == 3 and change == 0.0

    def test_the_density_changes_as_little_as_it_says(self):
        fine = children(
            Front(*pieces_of(np.zeros(2), np.eye(2)), np.zeros(1, int)), np.eye(2)[:1], np.array([0.3])
        )
        few, change = merged(Pieces(*fine[:3]), 0.1)
        X = np.random.default_rng(3).normal(size=(20_000, 2))
        off = few.log_p(X) - multivariate_normal(np.zeros(2), np.eye(2)).logpdf(X)
        assert np.sqrt(np.mean(off**2)) < 2.0 * max(change, 0.02)


def test_children_together_are_their_parent():
    parent = pieces_of(np.array([1.0, -2.0]), np.array([[2.0, 0.5], [0.5, 1.0]]))
    for ratio in (0.15, 0.4, 0.7):
        front = Front(*parent, np.zeros(1, int))
        made = Pieces(*children(front, np.array([[0.6, 0.8]]), np.array([ratio]))[:3])
        X = parent.mean + np.random.default_rng(0).normal(size=(500, 2)) @ parent.root[0].T
        np.testing.assert_allclose(made.log_p(X), parent.log_p(X), atol=5e-3)


class TestPosterior:
    def test_a_linear_reading_is_kalmans(self):
        H, R, z = np.array([[1.0, 0.3]]), np.array([[0.2]]), np.array([0.7])

        def white(X):
            return (z - X @ H.T) / np.sqrt(R[0, 0])

        mean, cov = np.array([0.4, -0.2]), np.array([[1.0, 0.4], [0.4, 0.8]])
        found = pieces_posterior(pieces_of(mean, cov), white, np.arange(2), Settings(0.1, 0.05, 10**6))
        gain = cov @ H.T / (H @ cov @ H.T + R)
        np.testing.assert_allclose(found.pieces.mean, [mean + gain @ (z - H @ mean)], atol=1e-9)
        np.testing.assert_allclose(found.pieces.cov, [cov - gain @ H @ cov], atol=1e-9)
        assert found.error < 1e-9 and len(found.pieces.log_w) == 1

    @pytest.mark.parametrize(
        ("h", "z", "R"),
        [
            (["x**2 - 1"], [0.5], [[0.05]]),  # two sides
            (["sqrt(x**2 + y**2)"], [1.2], [[0.01]]),  # a ring
            (
                ["sqrt((x+3)**2 + y**2)", "atan2(y, x + 3)"],
                [3.1, 0.2],
                [[0.002, 0.0], [0.0, 0.1]],
            ),  # a banana
        ],
    )
    @pytest.mark.parametrize("target", [0.05, 0.01])
    def test_bent_readings_against_a_fine_grid(self, h, z, R, target):
        sensor = sf.GaussianMeasurement.from_expressions(["x", "y"], h, R)
        new, said = by_pieces(START, ReadingAtPrior.of(START, sensor, z), target, 10**7)
        axis = np.linspace(-6.0, 6.0, 1201)
        X = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
        X = X[np.abs(X).max(axis=1) < 5.5]
        log_p = START.logpdf(X) + sensor.log_likelihood(z, X)
        p = np.exp(log_p)
        evidence = p.sum() * (axis[1] - axis[0]) ** 2
        mean, cov = moments(X, p / p.sum())
        root = np.linalg.inv(np.linalg.cholesky(cov))
        off = np.linalg.norm(root @ (new.mean() - mean)) / np.sqrt(2.0)
        wider = np.abs(root @ new.cov() @ root.T - np.eye(2)).max()
        assert off < max(2.0 * said["error"], 1e-4) and said["error"] < 1.5 * target
        assert wider < 6.0 * target
        assert said["log_evidence"] == pytest.approx(np.log(evidence), abs=4.0 * target)

    def test_what_a_reading_does_not_see_follows(self):
        """Range and bearing of a position whose velocity hangs together with it: against importance draws."""
        rng = np.random.default_rng(0)
        root = np.array([[1.0, 0, 0, 0], [0.6, 0.5, 0, 0], [0.2, 0, 1.0, 0], [0, 0.1, -0.5, 0.4]])
        mean = np.array([3.0, 0.0, 0.5, 0.0])
        sensor = sf.GaussianMeasurement.from_expressions(
            ["x", "u", "y", "v"], ["sqrt(x**2 + y**2)", "atan2(y, x)"], [[0.01, 0.0], [0.0, 0.04]]
        )
        start = sf.initialize(sf.Gaussian(mean, root @ root.T), "auto")
        z = [3.4, 0.1]
        new, said = by_pieces(start, ReadingAtPrior.of(start, sensor, z), 0.01, 10**7)
        X = mean + rng.normal(size=(2_000_000, 4)) @ root.T
        w = np.exp(sensor.log_likelihood(z, X))
        true, cov = moments(X, w / w.sum())
        white = np.linalg.inv(np.linalg.cholesky(cov))
        assert np.linalg.norm(white @ (new.mean() - true)) < 0.02
        np.testing.assert_allclose(white @ new.cov() @ white.T, np.eye(4), atol=0.03)
        assert said["log_evidence"] == pytest.approx(np.log(w.mean()), abs=0.02)

    def test_too_many_nodes_are_refused(self):
        sensor = sf.GaussianMeasurement.from_expressions(["x", "y"], ["sqrt(x**2 + y**2)"], [[1e-4]])
        with pytest.raises(sf.PropagationError, match="more than 500 nodes"):
            by_pieces(START, ReadingAtPrior.of(START, sensor, [1.0]), 0.01, 500)


class TestOnTheLadder:
    TARGET = sf.FilterConfig(target_error=0.025, density_error=0.025)

    def filter(self):
        model = sf.SDE.from_expressions(
            ["x", "u", "y", "v"],
            ["u", "0", "v", "0"],
            [["0", "0"], ["1", "0"], ["0", "0"], ["0", "1"]],
            0.05 * np.eye(2),
        )
        sensor = sf.GaussianMeasurement.from_expressions(
            model.states, ["sqrt(x**2 + y**2)", "atan2(y, x)"], np.diag([0.01, 0.04]), angles=[1]
        )
        return sf.SPHFilter(model, sensor, [10, 0, 5, 0.5], np.diag([4, 0.25, 4, 0.25]), config=self.TARGET)

    def test_a_banana_is_carried_as_pieces(self):
        flt = self.filter()
        for t, z in [(1.0, [11.0, 0.5]), (2.0, [11.2, 0.45]), (3.0, [11.6, 0.6])]:
            moved = flt.predict(t=t)
            info = flt.update(z)
            assert info.rung == "pieces" and info.error < 0.05
            assert moved.rung in ("closed form", "pieces")
        assert flt.density.pieces is not None and flt.density.needs is not None

    def test_files_go_on_with_the_same_bits(self, tmp_path):
        flt = self.filter()
        flt.predict(t=1.0)
        flt.update([11.0, 0.5])
        flt.save(tmp_path / "filter.npz")
        again = sf.SPHFilter.load(tmp_path / "filter.npz", flt.model, flt.measurement)
        for one in (flt, again):
            one.predict(t=2.0)
            one.update([11.2, 0.45])
        np.testing.assert_array_equal(flt.x, again.x)
        np.testing.assert_array_equal(flt.P, again.P)


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
    few, change = _few(many, 0.0, 5e-3)
    assert len(few.log_w) <= 200
    assert change > 5e-3
    np.testing.assert_allclose(few.moments()[1], many.moments()[1], rtol=1e-9)
    assert few.log_p(many.mean) == pytest.approx(many.log_p(many.mean), abs=0.3)
