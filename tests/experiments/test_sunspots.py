"""Sunspots: the data, forecasts against closed forms, evidence of the model against exact evidence."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

import experiments
from experiments.own_data.command import case_of
from experiments.own_data.model_file import load_model
from experiments.scene.filters import factories
from experiments.sunspots import (
    FIRST,
    FoldedMixture,
    Score,
    fold,
    learn,
    load,
    roots,
    score_forecasts,
    score_history,
)
from reference_filters.grid import GridFilter
from reference_filters.kalman import ExtendedKalmanFilter, KalmanFilter
from reference_filters.particle import ParticleFilter
from sphfilter import GaussianMeasurement, SPHFilter
from sphfilter.errors import ConfigError
from sphfilter.files.csv_data import Measurements, read_measurements

SEEN = GaussianMeasurement(h=[[1.0]], noise_cov=[[0.3]])
LEVEL = """
[model]
states = ["x"]
drift = ["a*(20 - x)"]
noise = [["g"]]
spectral_density = [[1.0]]
parameters = { a = 0.4, g = 0.8 }
[sensor]
h = [[1.0]]
noise_cov = [[0.3]]
[start]
mean = [20.0]
cov = [[1.0]]
[filters]
grid = { size = 48, tol = 1e-2 }
"""


@pytest.fixture(scope="module")
def level(tmp_path_factory):
    """An Ornstein-Uhlenbeck process so far from zero that its sign is no question."""
    path = tmp_path_factory.mktemp("model") / "level.toml"
    path.write_text(LEVEL, encoding="utf-8")
    return load_model(path)


@pytest.fixture(scope="module")
def sunspots():
    return load()[0]


@pytest.fixture(scope="module")
def numbers():
    return read_measurements(Path(experiments.__file__).parent / "data" / "sunspots.csv", 1)


def readings(size=40, seed=3):
    rng, x = np.random.default_rng(seed), 20.0
    y = np.empty(size)
    for i in range(size):
        x = 20 + np.exp(-0.4) * (x - 20) + rng.normal(0, np.sqrt(0.8 * (1 - np.exp(-0.8))))
        y[i] = x + rng.normal(0, np.sqrt(0.3))
    return np.arange(size, dtype=float), y


def recursion(y, a=0.4, g=0.8, variance=0.3):
    """Posterior mean and variance after each reading a year, and the evidence; the scalar Kalman filter."""
    m, P, rows, evidence = 20.0, 1.0, [], 0.0
    for i, z in enumerate(y):
        if i:
            m, P = ahead(m, P, 1.0, a, g)
        S = P + variance
        evidence += norm(m, np.sqrt(S)).logpdf(z)
        m, P = m + P / S * (z - m), P - P**2 / S
        rows.append((m, P))
    return rows, evidence


def ahead(m, P, dt, a=0.4, g=0.8):
    decay = np.exp(-a * dt)
    return 20 + decay * (m - 20), decay**2 * P + g**2 / (2 * a) * (1 - decay**2)


class TestData:
    def test_series(self, numbers):
        assert (numbers.time_name, numbers.names) == ("year", ("sunspots",))
        np.testing.assert_array_equal(numbers.times, np.arange(1700, 2009))
        s = numbers.z[:, 0]
        assert s.min() == 0.0 and s.max() == 190.2 and numbers.times[np.argmax(s)] == 1957
        np.testing.assert_allclose([s.mean(), s.std()], [49.752, 40.387], atol=1e-3)
        assert np.sum(numbers.times >= FIRST) == 60

    def test_roots(self, numbers):
        np.testing.assert_array_equal(load()[1].z, roots(numbers).z)
        np.testing.assert_allclose(roots(numbers).z ** 2, numbers.z, rtol=1e-14)
        with pytest.raises(ConfigError, match="number of 1701 is negative"):
            roots(Measurements("year", ("s",), np.array([1700.0, 1701.0]), np.array([[1.0], [-1.0]])))


class TestMixture:
    mixture = FoldedMixture(np.array([0.2, 0.5, 0.3]), np.array([-2.0, 1.0, 4.0]), np.array([0.5, 1.0, 0.7]))

    def test_density_and_distribution_agree(self):
        for y in (0.3, 2.0, 5.0):
            mass, _ = quad(lambda v: np.exp(self.mixture.logpdf(v)), 0, y)
            assert abs(mass - self.mixture.cdf(y)) < 1e-7
        assert abs(self.mixture.cdf(12.0) - 1) < 1e-12

    def test_quantiles_of_draws(self):
        rng = np.random.default_rng(0)
        k = rng.choice(3, size=200_000, p=self.mixture.weights)
        y = np.abs(rng.normal(self.mixture.means[k], self.mixture.std[k]))
        for p in (0.025, 0.5, 0.95):
            assert abs(np.mean(y < self.mixture.quantile(p)) - p) < 4 * np.sqrt(p * (1 - p) / len(y))

    def test_score_is_a_density_of_the_number(self):
        def density(s):
            return np.exp(Score.of([0], [np.sqrt(s)], [self.mixture]).log_score[0])

        total, _ = quad(density, 1e-3, 60, limit=200, points=[0.01, 0.1, 1, 10])
        assert abs(total - (self.mixture.cdf(np.sqrt(60)) - self.mixture.cdf(np.sqrt(1e-3)))) < 1e-6

    def test_calibrated_forecasts_are_covered(self):
        rng = np.random.default_rng(1)
        means = rng.uniform(-3, 3, 2000)
        y = np.abs(rng.normal(means, 0.8))
        made = [FoldedMixture(np.ones(1), np.array([m]), np.array([0.8])) for m in means]
        score = Score.of(np.arange(2000), y, made)
        for got, level in zip(score.coverage, (0.5, 0.9, 0.95), strict=True):
            assert abs(got - level) < 3.5 * np.sqrt(level * (1 - level) / 2000)
        assert abs(np.mean(score.pit) - 0.5) < 3.5 / np.sqrt(12 * 2000)

    def test_history_does_not_depend_on_the_year(self):
        past = np.abs(np.random.default_rng(2).normal(6, 2, 300))
        score = score_history(past, [1, 2, 3], np.array([5.0, 5.0, 9.0]))
        assert score.log_score[0] == score.log_score[1] > score.log_score[2]
        assert abs(np.sqrt(score.median[0]) - np.median(past)) < 0.2


class TestSensor:
    def test_both_signs_are_counted(self):
        sensor = fold(0.4)
        X = np.array([[1.2, 5.0], [-1.2, -3.0]])
        mass, _ = quad(lambda y: np.exp(sensor.log_likelihood([y], X)[0]), 0, 12)
        assert abs(mass - 1) < 1e-9
        values = sensor.log_likelihood([0.7], X)
        assert values[0] == values[1]
        assert abs(np.exp(values[0]) - norm(1.2, np.sqrt(0.4)).pdf([0.7, -0.7]).sum()) < 1e-12

    def test_kalman_takes_the_sign_of_its_prediction(self, level):
        for start in (5.0, -5.0):
            filt = KalmanFilter(level.model, SEEN, [start], [[1.0]])
            learn(filt, 4.0, SEEN, None)
            assert abs(filt.x[0] - (start + (np.copysign(4.0, start) - start) / 1.3)) < 1e-12

    def test_density_counts_the_other_branch(self, sunspots):
        """From a start on both sides, a reading leaves half of the weight on either."""
        filt = GridFilter(sunspots.model, None, [0.0, 0.0], np.diag([30.0, 4.0]), size=64)
        learn(filt, 4.0, None, fold(0.7))
        assert abs(filt.x[0]) < 1e-6 and 3.5 < np.sqrt(filt.P[0, 0]) < 4.2


class TestForecasts:
    def made(self, filt, y, years):
        return score_forecasts(filt, years, y, SEEN, (1, 5), 20.0)

    def exact(self, y, h):
        """Log scores and medians of the numbers y² from 20 on, h years ahead."""
        rows, _ = recursion(y)
        laws = [ahead(*rows[i - h], float(h)) for i in range(20, len(y))]
        means, variances = np.array(laws).T
        return norm(means, np.sqrt(variances + 0.3)).logpdf(y[20:]) - np.log(2 * y[20:]), means**2

    def test_kalman_against_closed_form(self, level):
        years, y = readings()
        made = self.made(KalmanFilter(level.model, SEEN, [20.0], [[1.0]]), y, years)
        for h in (1, 5):
            scores, medians = self.exact(y, h)
            np.testing.assert_array_equal(made[h].year, np.arange(20, 40))
            np.testing.assert_allclose(made[h].log_score, scores, rtol=1e-9)
            np.testing.assert_allclose(made[h].median, medians, rtol=1e-5)

    @pytest.mark.parametrize(("kind", "allowed"), [("grid", 1e-3), ("sph", 0.03), ("pf", 0.05)])
    def test_densities_against_closed_form(self, level, kind, allowed):
        years, y = readings()
        filt = {
            "grid": lambda: GridFilter(level.model, SEEN, [20.0], [[1.0]]),
            "sph": lambda: SPHFilter(level.model, SEEN, [20.0], [[1.0]]),
            "pf": lambda: ParticleFilter(level.model, SEEN, [20.0], [[1.0]], n_particles=40_000, rng=1),
        }[kind]()
        made = self.made(filt, y, years)
        for h in (1, 5):
            assert np.max(np.abs(made[h].log_score - self.exact(y, h)[0])) < allowed

    def test_no_forecast_looks_ahead(self, sunspots, numbers):
        y, years = roots(numbers).z[:80, 0], numbers.times[:80]
        changed = y.copy()
        changed[60:] = 3.0
        start = sunspots.settings.start

        def scores(values):
            filt = ExtendedKalmanFilter(
                sunspots.model, sunspots.measurement, start.mean, np.array(start.cov), 1700.0, rtol=1e-4
            )
            return score_forecasts(filt, years, values, sunspots.measurement, (1, 5), 1740.0)

        before, after = scores(y), scores(changed)
        for h, last in ((1, 1760), (5, 1764)):
            same = before[h].year <= last
            np.testing.assert_array_equal(before[h].median[same], after[h].median[same])
            assert not np.array_equal(before[h].median[~same], after[h].median[~same])

    def test_missing_year_is_no_target(self, level):
        years, y = readings()
        y[30] = np.nan
        made = self.made(KalmanFilter(level.model, SEEN, [20.0], [[1.0]]), y, years)
        assert 30.0 not in made[1].year and np.all(np.isfinite(made[5].log_score)) and len(made[5].year) == 19


def training_evidence(scenario, data, parameters, variance):
    """Log-evidence of the roots y, both signs counted, by the grid filter, which draws nothing."""
    case, grid = case_of(scenario, data), scenario.settings.filters.grid
    model = scenario.model.with_parameters(**parameters)
    filt = GridFilter(model, fold(variance), case.x0, case.P0, case.t0, size=grid.size, tol=grid.tol)
    return float(filt.run(case.times, case.z).log_evidence.sum())


class TestEvidence:
    def test_evidence_of_a_linear_model(self, level):
        years, y = readings()
        data = Measurements("t", ("y",), years, y[:, None])
        got = training_evidence(level, data, {"a": 0.3, "g": 1.0}, 0.5)
        assert abs(got - recursion(y, 0.3, 1.0, 0.5)[1]) < 0.01

    def test_mirror_image_has_the_same_evidence(self, sunspots, numbers):
        y = roots(numbers).z[:12]
        found = []
        for sign in (1.0, -1.0):
            start = sign * np.array(sunspots.settings.start.mean)
            filt = GridFilter(
                sunspots.model, fold(0.75), start, np.diag([4.0, 16.0]), 1700.0, size=64, tol=3e-3
            )
            found.append(filt.run(numbers.times[:12], y).log_evidence.sum())
        assert abs(found[0] - found[1]) < 1e-3

    @pytest.mark.slow
    def test_shipped_parameters_are_the_best_nearby(self, sunspots, numbers):
        data = roots(numbers)
        data = Measurements("year", data.names, data.times[:249], data.z[:249])
        parameters, variance = sunspots.model.parameters, sunspots.measurement.noise_cov[0, 0]
        best = training_evidence(sunspots, data, dict(parameters), variance)
        for factor in (0.93, 1.07):
            assert training_evidence(sunspots, data, dict(parameters), factor * variance) < best
            for name, value in parameters.items():
                other = dict(parameters) | {name: factor * value}
                assert training_evidence(sunspots, data, other, variance) < best, (name, factor)


class TestFilters:
    @pytest.mark.slow
    def test_densities_agree_with_the_referee(self, sunspots):
        """The particle filter within its noise, the SPH filter within its discretisation of 200 particles."""
        scenario, data = sunspots, load()[1]
        case, mean = case_of(scenario, data), {}
        for name, make in factories(["grid", "pf", "sph"], scenario).items():
            filt = make(case, np.random.default_rng(1))
            scores = score_forecasts(filt, data.times, data.z[:, 0], scenario.measurement, (1, 5), FIRST)
            mean |= {(name, h): score.log_score.mean() for h, score in scores.items()}
        for name, h, allowed in (("pf", 1, 0.08), ("pf", 5, 0.06), ("sph", 1, 0.05), ("sph", 5, 0.1)):
            assert abs(mean[name, h] - mean["grid", h]) < allowed, (name, h)
