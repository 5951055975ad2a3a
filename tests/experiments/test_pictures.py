"""The papers' pictures: the numbers behind them, and that they are drawn."""

from dataclasses import replace
from importlib import import_module

import matplotlib.pyplot as plt
import numpy as np
import pytest

import sphfilter as sf
from experiments.pictures import accuracy, densities, drawing, rejections, transient
from experiments.pictures.names import PICTURES, chosen, names
from experiments.scene.scenario import load_scenario
from sphfilter.errors import ConfigError


@pytest.fixture(autouse=True)
def _close():
    yield
    plt.close("all")


def test_transient_noise_is_that_of_the_transient_tables():
    duffing = load_scenario("duffing")
    D = transient.transient_model(duffing).diffusion(np.zeros((1, 2)), 0.0)[0]
    np.testing.assert_allclose(D, [[0.0, 0.0], [0.0, 0.4]])  # D22 = Ξ of 002 Table 3
    assert duffing.model.spectral_density[0, 0] == 1.6  # the scenario keeps its own
    np.testing.assert_array_equal(transient.start_of(duffing).mean, [0.0, 10.0])


def test_best_support_of_the_paper():
    fit = accuracy.swept(1649, "gaussian", steps=9)
    assert fit.support[np.argmin(fit.error)] == pytest.approx(2.6)  # 002 Fig 10
    # both grids together lie between the two, whatever the numbers of their nodes
    low, high = np.sort([fit.error_particles, fit.error_interstitial], axis=0)
    assert np.all((low <= fit.error) & (fit.error <= high))


def test_references_are_the_exact_gaussian_and_the_grid():
    linear = load_scenario("linear_underdamped")
    model, start = transient.transient_model(linear), transient.start_of(linear)
    times = [0.0, 1.0]
    exact = list(accuracy._references(model, start, times))
    grid = list(accuracy._grid_references(model, start, times))
    for e, g in zip(exact, grid, strict=True):
        assert accuracy.rms_error(g.pdf, e) < 1e-4 * e.pdf(e.mean[None])[0]
        assert e.t == g.t


def test_rms_error_of_a_constant_offset():
    normal = sf.Gaussian([1.0, -2.0], [[2.0, 0.3], [0.3, 0.5]])
    reference = accuracy._Reference(0.0, normal.mean, normal.cov, normal.pdf)
    assert accuracy.rms_error(lambda X: normal.pdf(X) + 0.01, reference) == pytest.approx(0.01)


def test_raw_posterior_is_bayes_on_the_particles():
    prior = sf.initialize(sf.Gaussian([-3.5, 0.0], [[1.0, 0.0], [0.0, 1.0]]), 1000)
    measurement = sf.GaussianMeasurement(h=[[1.0, 0.0]], noise_cov=[[0.1]])
    raw = densities.raw_posterior(prior, measurement)
    assert raw.sum() == pytest.approx(1.0)
    # precision-weighted mean; the cut at Z_T and the lattice leave a per mille
    assert raw @ prior.x[:, 0] == pytest.approx((-3.5 / 1.0 - 4.0 / 0.1) / 11.0, abs=2e-3)


def test_update_and_resampling_figures(tmp_path, monkeypatch):
    monkeypatch.setattr(densities, "_N", 300)
    monkeypatch.setattr(densities, "_TIMES", (0.4, 0.5))
    monkeypatch.setattr(densities, "_Z", 3.5)
    paths, said = drawing.draw("densities", load_scenario("duffing"), tmp_path / "new", 1)
    assert {p.name for p in paths} == {"bayes_update.png", "resampling_t0.4.png", "resampling_t0.5.png"}
    assert all(p.stat().st_size > 20_000 for p in paths)
    assert len(said) == 2


def test_accuracy_figure_shows_what_the_start_changes(monkeypatch):
    monkeypatch.setattr(accuracy, "_N_SUPPORT", 300)
    monkeypatch.setattr(accuracy, "_N_MASSES", 300)
    monkeypatch.setattr(accuracy, "_STEPS", 1)
    monkeypatch.setitem(accuracy._END, "linear_underdamped", 0.1)
    figure = accuracy.initial_accuracy(load_scenario("linear_underdamped"), 1, 1, {}).figures["accuracy"]
    riemann, collocation = (line.get_ydata() for line in figure.axes[1].lines)
    assert collocation[0] < 0.7 * riemann[0]


@pytest.fixture(scope="module")
def short_duffing():
    scenario = load_scenario("duffing", **{"times.end": 4.0})
    paper = replace(scenario.settings.filters.sph_paper, n_particles=60)
    filters = replace(scenario.settings.filters, sph_paper=paper)
    return replace(scenario, settings=replace(scenario.settings, filters=filters))


def test_rates_count_refused_measurements(short_duffing, monkeypatch):
    def factory(scenario, coverage):
        return _Refusing([coverage == rejections._NARROW, False], fails=coverage == rejections._WIDE)

    monkeypatch.setattr(rejections, "_factory", factory)
    coverages = [rejections._NARROW, rejections.Coverage(0.995, 0.9995), rejections._WIDE]
    results, refused, rates = rejections.rejection_rates(short_duffing, coverages, 1, 3)
    assert list(results) == coverages
    assert list(rates.values()) == [(3, 6), (0, 6), (0, 0)]  # a filter that failed refused nothing
    assert refused[rejections._NARROW].tolist() == [[True, False]] * 3


class _Refusing:
    """Factory and filter in one, with a given verdict on every measurement."""

    def __init__(self, refused, fails):
        self.refused, self.fails = refused, fails

    def __call__(self, case, rng):
        return self

    def run(self, times, z):
        if self.fails:
            raise RuntimeError("no such luck")
        return _nothing(times, ~np.array(self.refused))

    def runs(self, n):
        """What a campaign of n runs has of it."""
        return _nothing(np.arange(2.0), np.tile(~np.array(self.refused), (n, 1)))


def _nothing(times, accepted):
    x, P, none = (np.zeros(accepted.shape + more) for more in ((2,), (2, 2), ()))
    return sf.FilterResult(t=times, x_prior=x, P_prior=P, x=x, P=P, log_evidence=none, accepted=accepted)


def test_interval_of_a_rate_is_wilsons():
    share, low, high = rejections._interval(rejections.Rate(2, 75))
    z = 1.959963984540054
    centre = (2 + z**2 / 2) / (75 + z**2)
    half = z / (75 + z**2) * np.sqrt(2 * 73 / 75 + z**2 / 4)
    assert (share, low, high) == pytest.approx((2 / 75, centre - half, centre + half))


def test_core_radius():
    assert rejections.Coverage(0.995, 0.9995).z_t(2) == pytest.approx(np.sqrt(-2 * np.log(0.005)))


def test_coverage_reaches_the_filter(short_duffing):
    coverage = rejections.Coverage(0.99, 0.998, 0.5)
    config = rejections._factory(short_duffing, coverage).settings.config
    found = (config.scheme.represented_mass, config.scheme.domain_mass, config.acceptance.f_edge)
    assert found == coverage


def test_rejection_figure(short_duffing, tmp_path):
    (path,), said = drawing.draw("rejections", short_duffing, tmp_path, 1, 1)
    assert path.stat().st_size > 20_000
    assert said[0].count(" of 2 with Z_T") == 4


def test_names_of_pictures():
    assert chosen("duffing", None) == ("densities",)
    assert chosen("duffing", "none") == ()
    assert chosen("duffing", "rejections, densities") == ("rejections", "densities")
    assert names("benes") == ()
    with pytest.raises(ConfigError, match="densities"):
        chosen("duffing", "densitys")
    with pytest.raises(ConfigError, match="benes has no picture 'support'"):
        drawing.draw("support", load_scenario("benes"), None, 1)


def test_every_picture_is_where_its_name_says():
    for pictures in PICTURES.values():
        for module, function in pictures.values():
            assert callable(getattr(import_module(f"experiments.pictures.{module}"), function))


def test_runs_that_a_campaign_has_are_not_run_again(short_duffing, monkeypatch):
    asked = []

    def factory(scenario, coverage):
        asked.append(coverage)
        return _Refusing([False, False], fails=False)

    monkeypatch.setattr(rejections, "_factory", factory)
    own, known = rejections.Coverage(0.995, 0.9995), _Refusing([True, True], fails=False).runs(3)
    _, refused, rates = rejections.rejection_rates(short_duffing, [own, rejections._WIDE], 1, 3, {own: known})
    assert asked == [rejections._WIDE]
    assert refused[own].all() and rates[own] == (6, 6) and rates[rejections._WIDE] == (0, 6)
