"""Ranks of measurements and truths in densities, against closed forms and exact filters."""

from time import perf_counter

import numpy as np
import pytest
from numba import njit
from scipy import stats

import sphfilter as sf
from reference_filters.closed_forms import BenesFilter
from reference_filters.grid import GridFilter
from reference_filters.kalman import KalmanFilter
from reference_filters.particle import ParticleFilter
from sphfilter import consistency
from sphfilter.consistency import p_values
from sphfilter.consistency.ranks import clock, ranked_reading
from sphfilter.density.weighted import WeightedStates, hpd_rank, state_rank
from sphfilter.errors import ModelError

MODEL = sf.SDE.from_expressions(
    states=["x", "v"], drift=["v", "-x - 0.4*v"], noise=[["0"], ["1"]], spectral_density=[[0.5]]
)
POSITION = sf.GaussianMeasurement(h=[[1.0, 0.0]], noise_cov=[[0.3]])
TIMES = np.arange(1.0, 9.0)
X0, P0 = np.array([1.0, 0.0]), np.diag([0.5, 0.8])


def test_the_clock_stands_while_numba_compiles():
    began, wall = clock(), perf_counter()
    njit(lambda x: np.linalg.svd(x)[1].sum())(np.eye(3))
    assert 0 <= clock() - began < 0.5 * (perf_counter() - wall)


def test_ranks_in_a_gaussian_density():
    P = np.array([[0.5, 0.2], [0.2, 0.8]])
    density = sf.initialize(sf.Gaussian(X0, P), n_particles=400)
    X = X0 + np.random.default_rng(0).standard_normal((50, 2)) @ np.linalg.cholesky(P).T * 1.3
    square = consistency.distance(X, X0, P) ** 2
    np.testing.assert_allclose(density.hpd_rank(X), stats.chi2.cdf(square, 2), atol=3e-3)
    assert density.hpd_rank(density.mode())[0] < 1e-3 and density.hpd_rank([30.0, 0.0])[0] > 0.999
    region = density.hpd_region(0.9)
    np.testing.assert_array_equal(region(X), density.hpd_rank(X) <= 0.9)
    expected = stats.norm.cdf(X[0], X0, np.sqrt(np.diag(P)))
    np.testing.assert_allclose(state_rank(density.spread(), X[0]), expected, atol=2e-3)


def test_ranks_count_the_probability_of_what_is_higher():
    log_p = np.log([0.5, 0.3, 0.2])
    X = np.array([[0.0], [1.0], [2.0]])
    spread = WeightedStates(X, np.exp(log_p), lambda Y: np.interp(Y[:, 0], [0, 1, 2], log_p))
    np.testing.assert_allclose(hpd_rank(spread, [[0.0], [1.0], [2.0]]), [0.0, 0.5, 0.8])
    np.testing.assert_allclose(
        state_rank(spread, np.array([1.0])), [0.65]
    )  # half of what is at the state itself
    assert np.isnan(hpd_rank(WeightedStates(spread.X, spread.w), [[0.0]])).all()


def test_a_reading_in_its_prediction():
    rng = np.random.default_rng(1)
    X = X0 + rng.standard_normal((200_000, 2)) @ np.linalg.cholesky(P0).T
    spread = WeightedStates(X, np.full(len(X), 1 / len(X)))
    both = sf.GaussianMeasurement(h=np.eye(2), noise_cov=[[0.3, 0.1], [0.1, 0.2]])
    pit, y, S = ranked_reading(spread, both, [1.7, np.nan], 0.0)
    np.testing.assert_allclose(S, P0 + both.noise_cov, atol=0.01)
    np.testing.assert_allclose(y, [0.7, np.nan], atol=0.01)
    np.testing.assert_allclose(pit, [stats.norm.cdf(0.7, scale=np.sqrt(0.8)), np.nan], atol=0.005)


def test_the_rank_of_an_angle_is_counted_from_the_far_side():
    bearing = sf.GaussianMeasurement.from_expressions(["x", "y"], ["atan2(y, x)"], [[0.01]], angles=[0])
    phi = np.pi + 0.2 * np.random.default_rng(2).standard_normal(100_000)
    spread = WeightedStates(np.stack([np.cos(phi), np.sin(phi)], axis=1), np.full(len(phi), 1 / len(phi)))
    for z in (np.pi - 0.1, -np.pi + 0.1):
        pit, y, S = ranked_reading(spread, bearing, z, 0.0)
        off = (z % (2 * np.pi)) - np.pi
        assert y[0] == pytest.approx(off, abs=3e-3) and S[0, 0] == pytest.approx(0.05, rel=0.02)
        assert pit[0] == pytest.approx(stats.norm.cdf(off / np.sqrt(0.05)), abs=5e-3)


@pytest.mark.parametrize("name", ["sph", "paper", "grid", "pf"])
def test_runs_rank_as_the_exact_filter_does(name):
    truth, z = sf.simulate(MODEL, POSITION, X0, TIMES, rng=3)
    z[2] = np.nan
    make = {
        "sph": lambda: sf.SPHFilter(MODEL, POSITION, X0, P0, n_particles=400),
        "paper": lambda: sf.SPHFilter(
            MODEL, POSITION, X0, P0, n_particles=1000, config=sf.FilterConfig.paper()
        ),
        "grid": lambda: GridFilter(MODEL, POSITION, X0, P0, size=96),
        "pf": lambda: ParticleFilter(MODEL, POSITION, X0, P0, n_particles=40_000, rng=1),
    }[name]
    exact = KalmanFilter(MODEL, POSITION, X0, P0).run(TIMES, z, truth)
    found = make().run(TIMES, z, truth)
    tolerance = {"sph": 2e-3, "grid": 5e-3, "pf": 0.02, "paper": 0.05}[name]
    for key in ("pit", "state_pit", "innovation", "innovation_cov"):
        np.testing.assert_allclose(getattr(found, key), getattr(exact, key), atol=tolerance, err_msg=key)
    assert np.isnan(found.pit[2]).all() and np.isfinite(found.state_pit).all()
    if name == "pf":
        assert np.isnan(found.hpd_rank).all()
    else:
        np.testing.assert_allclose(found.hpd_rank, exact.hpd_rank, atol=2 * tolerance)


def test_looking_changes_nothing_and_costs_no_truth():
    truth, z = sf.simulate(MODEL, POSITION, X0, TIMES, rng=4)
    blind, seen = (
        sf.SPHFilter(MODEL, POSITION, X0, P0, n_particles=100).run(TIMES, z, t) for t in (None, truth)
    )
    for key in ("x", "P", "x_prior", "P_prior", "log_evidence", "innovation"):
        np.testing.assert_array_equal(getattr(blind, key), getattr(seen, key))
    assert np.isnan(blind.pit).all() and np.isnan(blind.hpd_rank).all()
    flt = sf.SPHFilter(MODEL, POSITION, X0, P0, n_particles=100)
    with pytest.raises(ModelError, match=r"truth must have shape \(8, 2\), a state a time; got \(7, 2\)"):
        flt.run(TIMES, z, truth[1:])
    assert flt.t == 0.0


def test_results_survive_saving(tmp_path):
    truth, z = sf.simulate(MODEL, POSITION, X0, TIMES, rng=5)
    result = KalmanFilter(MODEL, POSITION, X0, P0).run(TIMES, z, truth)
    result.save(tmp_path / "run.npz")
    again = sf.FilterResult.load(tmp_path / "run.npz")
    for key in vars(result):
        np.testing.assert_array_equal(getattr(again, key), getattr(result, key))


def test_a_report_of_one_run_counts_what_came():
    truth, z = sf.simulate(MODEL, POSITION, X0, TIMES, rng=6)
    z[[1, 4]] = np.nan
    result = KalmanFilter(MODEL, POSITION, X0, P0).run(TIMES, z, truth)
    f = sf.report(result, truth).filters["filter"]
    assert f.innovations.n_measurements == 6 and f.innovations.acceptance == 1.0
    square = result.innovation[:, 0] ** 2 / result.innovation_cov[:, 0, 0]
    assert f.innovations.nis == pytest.approx(np.nanmean(square))
    assert np.isnan(f.ranks.hpd_p) and f.verdict.startswith("not judged, that takes 10 runs at least")


def test_rejected_measurements_count_but_not_among_the_used():
    truth, z = sf.simulate(MODEL, POSITION, X0, TIMES, rng=6)
    result = KalmanFilter(MODEL, POSITION, X0, P0).run(TIMES, z, truth)
    result.accepted[3] = False
    f = sf.report(result, truth).filters["filter"].innovations
    square = result.innovation[:, 0] ** 2 / result.innovation_cov[:, 0, 0]
    assert f.acceptance == 7 / 8 and f.n_measurements == 8
    assert f.nis == pytest.approx(square.mean())
    assert f.nis_accepted == pytest.approx(np.delete(square, 3).mean())


def test_components_that_did_not_come_are_no_degrees_of_freedom():
    both = sf.GaussianMeasurement(h=np.eye(2), noise_cov=np.diag([0.3, 0.2]))
    truth, z = sf.simulate(MODEL, both, X0, TIMES, rng=6)
    z[::2, 1] = np.nan
    result = KalmanFilter(MODEL, both, X0, P0).run(TIMES, z, truth)
    squares = []
    for y, S in zip(result.innovation, result.innovation_cov, strict=True):
        seen = np.isfinite(y)
        squares.append(y[seen] @ np.linalg.solve(S[np.ix_(seen, seen)], y[seen]))
    f = sf.report(result, truth).filters["filter"].innovations
    assert f.nis == pytest.approx(np.sum(squares) / 12)


@pytest.mark.slow
def test_exact_ranks_of_a_posterior_with_two_modes_are_uniform():
    """Beneš's problem: the truth is drawn from the filter's own prior, so its HPD rank is uniform."""
    model = sf.SDE.from_expressions(states=["x"], drift=["tanh(x)"], noise=[["1"]], spectral_density=[[1.0]])
    sensor = sf.GaussianMeasurement(h=[[1.0]], noise_cov=[[4.0]])
    rng, times = np.random.default_rng(7), np.arange(1.0, 6.0)
    ranks = {"benes": [], "sph": []}
    start = BenesFilter(sensor, 0.0, 0.0)
    start.predict(t=1.0)
    density = sf.initialize(lambda X: start.pdf(X[:, 0]), box=[[-8.0, 8.0]], t=1.0, n_particles=100)
    for _ in range(150):
        truth, z = sf.simulate(model, sensor, [0.0], np.r_[0.0, times], rng=rng)
        exact = BenesFilter(sensor, 0.0, 0.0)
        ranks["benes"].append(exact.run(times, z[1:], truth[1:]).hpd_rank)
        ranks["sph"].append(
            sf.SPHFilter(model, sensor, density=density).run(times, z[1:], truth[1:]).hpd_rank
        )
    np.testing.assert_allclose(ranks["sph"], ranks["benes"], atol=0.02)
    for found in ranks.values():
        assert p_values.uniform_runs(np.array(found)) > 0.01
