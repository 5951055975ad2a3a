"""Scenarios: what a file may say, what a change does, and the laws of the starts."""

import pickle

import numpy as np
import pytest
from scipy.stats import chi2

from experiments.scene import reading, start
from experiments.scene.files import parse_change
from experiments.scene.filters import factories
from experiments.scene.scenario import Scenario, load_scenario, read_settings, scenario_names
from sphfilter import ConfigError, ExpressionError, FilterConfig, ModelError, SphfilterError, consistency


@pytest.mark.parametrize("name", scenario_names())
def test_every_scenario_builds_and_draws(name):
    scenario = load_scenario(name)
    case = scenario.draw(np.random.default_rng(1))
    n, T = scenario.model.dim, len(scenario.settings.times.grid())
    assert case.truth.shape == (T, n)
    assert case.z.shape == (T, scenario.measurement.dim_z)
    assert np.all(np.linalg.eigvalsh(case.P0) > 0)
    assert len(factories(None, scenario)) == len(scenario.settings.filters.default)
    assert "\n" not in scenario.settings.description
    for figures in scenario.settings.published.values():
        assert len(figures.rms) == len(figures.max_peak) == len(figures.avg_peak) == n


def test_scenarios_of_the_issue_are_there():
    wanted = "linear_underdamped linear_critical van_der_pol duffing cart_linear cart benes"
    assert set(wanted.split()) <= set(scenario_names())


@pytest.mark.parametrize(
    ("name", "dim", "Q", "interval", "end", "n_particles", "n_runs", "kernel"),
    [
        ("van_der_pol", 2, 0.8, 2.5, 100.0, (200, 500), 25, "lucy"),
        ("duffing", 2, 1.6, 2.0, 30.0, (200, 1000), 25, "lucy"),
        ("cart", 4, 0.4, 2.0, 20.0, (5204, 100_000), 10, "gaussian"),
    ],
)
def test_published_parameters(name, dim, Q, interval, end, n_particles, n_runs, kernel):
    """002 Tables 6, 8 and 10; a spectral density Q makes D = Q/2."""
    scenario = load_scenario(name)
    settings = scenario.settings
    D = scenario.model.diffusion(np.zeros((1, dim)), 0.0)[0]
    np.testing.assert_allclose(np.diag(D)[1::2], Q / 2)
    assert (settings.times.interval, settings.times.end) == (interval, end)
    found = settings.filters
    assert (found.sph_paper.n_particles, found.pf.n_particles) == n_particles
    assert found.sph.n_particles == "auto"
    assert settings.runs.published == n_runs
    assert found.sph_paper.config == FilterConfig.paper(kernel=kernel)
    assert found.sph.config == FilterConfig()


def test_drifts_are_those_of_the_paper():
    """002 (36)–(38) at states of no symmetry, by hand."""
    x, v = 0.7, -1.3
    duffing = load_scenario("duffing").model.drift([[x, v]], 0.0)[0]
    np.testing.assert_allclose(duffing, [v, -0.4 * v - x * (-1 + 0.1 * x**2)])
    pol = load_scenario("van_der_pol").model.drift([[x, v]], 0.0)[0]
    np.testing.assert_allclose(pol, [v, -0.1 * v * (x**2 - 1) - x])
    a, b, c, d = state = [0.7, -1.3, 0.4, 2.1]
    cart = load_scenario("cart").model.drift([state], 0.0)[0]
    np.testing.assert_allclose(cart, [b, -2 * a - 0.2 * a**3 - 0.4 * b + c, d, a - 2 * c - 0.4 * d])
    linear = load_scenario("cart_linear")
    assert linear.model.linear
    np.testing.assert_allclose(linear.model.drift([state], 0.0)[0], cart + np.array([0, 0.2 * a**3, 0, 0]))
    assert load_scenario("linear_critical").model.linear


def test_change_of_keys():
    changes = {"times.interval": 3.0, "scheme.kernel": "gaussian", "filters.pf.n_particles": 7}
    changed = load_scenario("duffing", **changes, **{"model.parameters.xi": 0.5})
    assert len(changed.settings.times.grid()) == 10
    assert changed.settings.filters.sph_paper.config == FilterConfig.paper(kernel="gaussian")
    assert changed.settings.filters.sph.config == FilterConfig()
    assert changed.settings.filters.pf.n_particles == 7
    np.testing.assert_allclose(changed.model.drift([[0.0, 1.0]], 0.0), [[1.0, -1.0]])


def test_short_keys_of_the_sph_filters():
    """`scheme` names that of sph; what lies within scheme and acceptance are keys of sph_paper."""
    filters = load_scenario("pendulum", **{"scheme": "cloud", "acceptance.f_edge": 0.5}).settings.filters
    assert filters.sph.config == FilterConfig(scheme="cloud")
    assert filters.sph_paper.config == FilterConfig.paper(f_edge=0.5)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"scheme": "clouds"}, "did you mean 'cloud'"),
        ({"times.intervall": 1.0}, "duffing with times.intervall changed: unknown key times.intervall"),
        ({"scheme.kernal": "lucy"}, "did you mean 'kernel'"),
        ({"scheme.kernel": "lucky"}, "'lucky' is not valid"),
        ({"times.interval": -1.0}, "times.interval = -1.0 is not valid"),
        ({"times.end": 1.0}, "no measurement"),
        ({"times.end.late": 1.0}, "times.end is a value, not a table"),
        ({"start.kind": "gaussian"}, "belong to kind"),
        ({"model.labels": ["one"]}, "each of the 2 states"),
    ],
)
def test_bad_change_says_what_is_wrong(changes, sentence):
    with pytest.raises(ConfigError, match=sentence):
        read_settings("duffing", changes)


def test_bad_models_and_names():
    with pytest.raises(ConfigError, match="did you mean 'duffing'"):
        load_scenario("dufing")
    with pytest.raises(ExpressionError, match="__import__"):
        load_scenario("duffing", **{"model.drift": ["v", "__import__('os').getcwd()"]})
    with pytest.raises(ModelError, match=r"sensor\.h has 3 columns"):
        load_scenario("duffing", **{"sensor.h": [[1.0, 0.0, 0.0]]})
    scenario = load_scenario("duffing", **{"sensor.h": [[0.0, 1.0]]})
    with pytest.raises(ConfigError, match="reads the positions"):
        scenario.draw(np.random.default_rng(0))


def test_files_of_ones_own(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("description = ")
    with pytest.raises(ConfigError, match="not valid TOML"):
        load_scenario(str(path))
    path.write_text((tmp_path / "mine.toml").read_text() + "'x'\n")
    with pytest.raises(ConfigError, match=r"mine\.toml: model is missing"):
        load_scenario(str(path))


def test_a_wrong_file_is_named_with_its_keys(tmp_path):
    path = tmp_path / "mine.toml"
    with pytest.raises(ConfigError, match=r"the file .*mine\.toml does not exist"):
        load_scenario(str(path))
    text = (reading._FOLDER / "duffing.toml").read_text(encoding="utf-8")
    for old, new, sentence in (
        ("interval", "intervall", r"unknown key times\.intervall \(did you mean 'interval'\?\)"),
        ("h = ", "h = 1 #", r"sensor\.h = 1 is not valid: input should be a list$"),
        ('drift = ["', 'drift = ["y*', "unknown name 'y'"),
    ):
        assert old in text
        path.write_text(text.replace(old, new, 1), encoding="utf-8")
        with pytest.raises(SphfilterError, match=rf"^{path}: .*{sentence}"):
            load_scenario(str(path))


def test_parse_change():
    assert parse_change("scheme.kernel=gaussian") == ("scheme.kernel", "gaussian")
    assert parse_change("times.interval = 2.5") == ("times.interval", 2.5)
    assert parse_change("sensor.noise_cov=[[0.1]]") == ("sensor.noise_cov", [[0.1]])
    with pytest.raises(ConfigError, match="key=value"):
        parse_change("scheme.kernel")


def test_pickle_draws_the_same():
    scenario = load_scenario("duffing")
    again = pickle.loads(pickle.dumps(scenario))
    assert again == scenario
    assert repr(again) == repr(scenario)
    one, two = (s.draw(np.random.default_rng(3)) for s in (scenario, again))
    np.testing.assert_array_equal(one.truth, two.truth)
    np.testing.assert_array_equal(one.z, two.z)


def test_times_between_belong_to_the_same_run():
    scenario = load_scenario("duffing")
    case = scenario.draw(np.random.default_rng(5))
    between = Scenario(scenario.name, scenario.settings, between=True).draw(np.random.default_rng(5))
    measured = np.isfinite(between.z[:, 0])
    np.testing.assert_allclose(between.times[measured], case.times)
    np.testing.assert_array_equal(between.truth[measured], case.truth)
    np.testing.assert_array_equal(between.z[measured], case.z)
    np.testing.assert_array_equal(between.x0, case.x0)
    assert len(between.times) > 5 * len(case.times)


def test_two_point_estimate_by_hand():
    scenario = load_scenario("duffing")
    begin, T0, R, Q = scenario.settings.start, 0.5, 0.2, 1.6
    a = start.acceleration_rms(scenario.model, begin)[1]
    x0, P0 = start.two_point_estimate(scenario.model, scenario.measurement, begin, [1.0], [2.0])
    np.testing.assert_allclose(x0, [2.0, 2.0])
    np.testing.assert_allclose(P0, [[R, R / T0], [R / T0, 2 * R / T0**2 + Q * T0 / 3 + (a * T0 / 2) ** 2]])
    # stationary Duffing: E[(-0.4 v)²] = 0.32, and the force of the wells adds to it
    assert 0.32**0.5 < a < 3.0


def test_two_point_start_is_consistent():
    """The true initial error has the covariance P0 says, over draws of the linear scene (NEES of χ²_4)."""
    scenario = load_scenario("cart_linear", **{"times.end": 2.0, "start.burn_in": 20.0})
    begin, model, sensor = scenario.settings.start, scenario.model, scenario.measurement
    rng, nees = np.random.default_rng(11), []
    for _ in range(400):
        t0 = np.array([0.0])
        truth, _, x0, P0 = start.two_point(model, sensor, begin, 0.0, t0, rng)
        nees.append(consistency.nees(truth[0], x0, P0))
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 4 * 400) / 400
    assert low < np.mean(nees) < high
    assert max(nees) <= chi2.ppf(0.999, 4)


def test_start_far_from_consistent_is_drawn_again():
    scenario = load_scenario("duffing")
    begin = scenario.settings.start
    rng = np.random.default_rng(2)
    for _ in range(50):
        truth, _, x0, P0 = start.two_point(scenario.model, scenario.measurement, begin, 0.0, [0.0], rng)
        assert consistency.nees(truth[0], x0, P0) <= chi2.ppf(0.999, 2)


def test_benes_truth_has_the_moments_of_its_start():
    scenario = load_scenario("benes", **{"times.end": 0.5, "start.mean": [0.4]})
    begin = scenario.settings.start
    rng, x = np.random.default_rng(4), []
    for _ in range(2000):
        truth, _, x0, P0 = start.benes(scenario.model, scenario.measurement, begin, 0.0, [0.0], rng)
        x.append(truth[0, 0])
    assert abs(np.mean(x) - x0[0]) < 4 * np.sqrt(P0[0, 0] / 2000)
    assert abs(np.var(x) / P0[0, 0] - 1) < 4 * np.sqrt(2 / 2000)
