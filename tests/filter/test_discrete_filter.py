"""Filters of models in discrete time, against Kalman's filter, sums over fine grids and closed forms."""

import datetime
import math

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from scipy import stats

import sphfilter as sf
from reference_filters.discrete import BootstrapFilter, GridOfSteps

F, Q = np.array([[1.0, 0.5], [-0.3, 0.8]]), np.array([[0.1, 0.02], [0.02, 0.2]])
POSITION = sf.GaussianMeasurement([[1.0, 0.0]], [[0.5]])
TIMES = 0.5 * np.arange(1, 16)
GROWTH = sf.DiscreteModel.from_expressions(
    ["x"], ["x/2 + 25*x/(1 + x**2) + 8*cos(1.2*t)"], covariance=[[10.0]]
)
SQUARE = sf.GaussianMeasurement.from_expressions(["x"], ["x**2/20"], [[1.0]])
VOLATILITY = sf.DiscreteModel.from_expressions(["h"], ["a*h"], covariance=[[0.04]], parameters={"a": 0.95})
RETURN = sf.LikelihoodMeasurement(lambda z, X, t: -0.5 * (z[0] ** 2 * np.exp(-X[:, 0]) + X[:, 0]))


def linear(**options):
    return sf.DiscreteModel.from_matrices(F, Q, period=0.5, **options)


def kalman(z):
    """Kalman's filter after each reading of `POSITION`: means, covariances, log-evidence."""
    kf, total = KalmanFilter(2, 1), 0.0
    kf.F, kf.Q, kf.H, kf.R, kf.P = F, Q, POSITION.H, POSITION.noise_cov, np.eye(2)
    means, covs = [], []
    for number in z:
        kf.predict()
        kf.update(number)
        total += kf.log_likelihood
        means.append(kf.x.ravel())
        covs.append(kf.P)
    return np.array(means), np.array(covs), total


def square(z, x):
    return stats.norm.logpdf(z[0], x**2 / 20, 1.0)


@pytest.mark.parametrize("scheme", ["auto", "cloud"])
@pytest.mark.parametrize("dim_known", [True, False])
def test_linear_models_are_kalmans_filter(scheme, dim_known):
    model = linear() if dim_known else sf.DiscreteModel(
        lambda x: (x[0] + 0.5 * x[1], 0.8 * x[1] - 0.3 * x[0]), 2, covariance=Q, period=0.5)  # fmt: skip
    _, z = sf.simulate(model, POSITION, [0.0, 0.0], TIMES, rng=1)
    means, covs, evidence = kalman(z)
    config = sf.FilterConfig(scheme=scheme)
    flt = sf.SPHFilter(model, POSITION, x0=[0.0, 0.0], P0=np.eye(2), config=config)
    found = flt.run(TIMES, z)
    off = np.abs(found.x - means) / np.sqrt(np.diagonal(covs, axis1=1, axis2=2))
    exact = dim_known and scheme == "auto"
    assert off.max() < (1e-12 if exact else 4.0 * max(found.error.max(), 0.01))
    np.testing.assert_allclose(found.P, covs, rtol=0.0, atol=1e-12 if exact else 0.05)
    assert abs(flt.log_evidence - evidence) < (1e-10 if exact else 4.0 * found.total_evidence_error)
    assert not exact or flt.density.gaussian


@pytest.mark.parametrize("seed", [0, 5])
def test_the_growth_model_is_that_of_a_grid_its_far_modes_included(seed):
    times = np.arange(0.0, 26.0)
    _, z = sf.simulate(GROWTH, SQUARE, [0.1], times, rng=seed)
    grid = GridOfSteps(GROWTH, square, (0.1, math.sqrt(2.0)), 45.0, z[1:])
    mean, std = grid.moments(grid.each)
    flt = sf.SPHFilter(GROWTH, SQUARE, x0=[0.1], P0=[[2.0]])
    found = flt.run(times[1:], z[1:])
    assert np.abs((found.x[:, 0] - mean) / std).max() < 0.003
    np.testing.assert_allclose(found.P[:, 0, 0], std**2, rtol=0.01)
    assert abs(flt.log_evidence - grid.log_evidence) < 0.01 and not found.flagged.any()
    points = sf.SPHFilter(GROWTH, SQUARE, x0=[0.1], P0=[[2.0]], config=sf.FilterConfig(scheme="cloud"))
    off = np.abs((points.run(times[1:], z[1:]).x[:, 0] - mean) / std)
    assert np.median(off) < 0.01  # a far mode of a hundredth may be none of its points


def test_smoothing_is_that_of_a_grid_and_of_kalmans_matrices():
    times = np.arange(0.0, 16.0)
    _, z = sf.simulate(GROWTH, SQUARE, [0.1], times, rng=2)
    grid = GridOfSteps(GROWTH, square, (0.1, math.sqrt(2.0)), 45.0, z[1:])
    mean, std = grid.moments(grid.smoothed())
    found = sf.smooth(sf.SPHFilter(GROWTH, SQUARE, x0=[0.1], P0=[[2.0]], n_particles=150), times[1:], z[1:])
    assert np.abs((found.x[:, 0] - mean) / std).max() < 1e-3 and np.ptp(found.log_evidence) < 1e-3
    _, z = sf.simulate(linear(), POSITION, [0.0, 0.0], TIMES, rng=1)
    kf = KalmanFilter(2, 1)
    kf.F, kf.Q, kf.H, kf.R, kf.P = F, Q, POSITION.H, POSITION.noise_cov, np.eye(2)
    x, P, _, _ = kf.rts_smoother(*kf.batch_filter(z)[:2])
    found = sf.smooth(
        sf.SPHFilter(linear(), POSITION, x0=[0.0, 0.0], P0=np.eye(2), n_particles=300), TIMES, z
    )
    np.testing.assert_allclose(found.x, x[:, :, 0], atol=1e-3)
    np.testing.assert_allclose(found.P, P, atol=1e-3)


def test_stochastic_volatility_and_the_fit_of_its_memory():
    rng, times = np.random.default_rng(3), np.arange(1.0, 81.0)
    truth, _ = sf.simulate(VOLATILITY, None, [0.0], times, rng=3)
    z = np.exp(0.5 * truth) * rng.standard_normal((80, 1))

    def log_likelihood(z, x):
        return RETURN.log_likelihood(z, x[:, None], 0.0)

    grid = GridOfSteps(VOLATILITY, log_likelihood, (0.0, 0.7), 6.0, z, nodes=601)
    mean, std = grid.moments(grid.each)
    flt = sf.SPHFilter(VOLATILITY, RETURN, x0=[0.0], P0=[[0.49]])
    found = flt.run(times, z)
    assert np.abs((found.x[:, 0] - mean) / std).max() < 0.02
    assert abs(flt.log_evidence - grid.log_evidence) < 4.0 * found.total_evidence_error + 0.01
    flt = sf.SPHFilter(VOLATILITY, RETURN, x0=[0.0], P0=[[0.49]])
    fit = sf.fit_parameters(flt, times, z, {"a": 0.8})

    def evidence(a):
        model = VOLATILITY.with_parameters(a=a)
        return GridOfSteps(model, log_likelihood, (0.0, 0.7), 6.0, z, nodes=201).log_evidence

    estimate = fit.estimate["a"]
    assert evidence(estimate) > max(evidence(estimate - 0.01), evidence(estimate + 0.01))


def test_a_map_of_the_noise_is_a_linear_model_in_other_states():
    price = sf.DiscreteModel.from_expressions(["s"], ["s * exp(m + w)"], noises=["w"], covariance=[[0.04]],
                                              parameters={"m": 0.01})  # fmt: skip
    log_price = sf.GaussianMeasurement.from_expressions(["s"], ["log(s)"], [[0.02]])
    z = np.array([[0.1], [0.25], [0.2], [0.45], [0.4]])
    start = sf.initialize(sf.Gaussian([0.0], [[0.09]]), n_particles=400)
    m, P, total = 0.0, 0.09, 0.0
    x = np.exp(start.x)
    exp_start = sf.ParticleDensity(x=x, mass=start.mass, h=start.h * x[:, 0], read_out="cloud")
    flt = sf.SPHFilter(price, log_price, density=exp_start, config=sf.FilterConfig(scheme="cloud"), dt=1.0)
    for number in z:
        flt.predict()
        flt.update(number)
        m, P = m + 0.01, P + 0.04
        S = P + 0.02
        total += stats.norm.logpdf(number[0], m, math.sqrt(S))
        m, P = m + P / S * (number[0] - m), P * 0.02 / S
    assert abs(flt.x[0] / math.exp(m + 0.5 * P) - 1.0) < 0.01
    assert abs(flt.P[0, 0] / ((math.exp(P) - 1.0) * math.exp(2.0 * m + P)) - 1.0) < 0.05
    assert abs(flt.log_evidence - total) < 0.03


def test_steps_inputs_and_files_are_those_of_any_model(tmp_path):
    model = linear(B=[[0.0], [1.0]])
    flt = sf.SPHFilter(model, POSITION, x0=[0.0, 0.0], P0=np.eye(2), window=4)
    flt.predict(1.5, u=[0.3])
    other = sf.SPHFilter(model, POSITION, x0=[0.0, 0.0], P0=np.eye(2))
    for _ in range(3):
        other.predict(0.5, u=[0.3])
    np.testing.assert_allclose(flt.x, other.x)
    np.testing.assert_allclose(flt.P, other.P)
    with pytest.raises(sf.ModelError, match=r"in steps of 0\.5 s, but from t = 1\.5 to 1\.8 there are 0\.6"):
        flt.predict(0.3)
    with pytest.raises(sf.ModelError, match=r"there are 0\.0002 of them"):
        flt.predict(1e-4)
    assert flt.t == 1.5
    growth = sf.SPHFilter(GROWTH, SQUARE, x0=[0.1], P0=[[2.0]], window=3)
    growth.predict(1.0)
    growth.update(4.0)
    growth.predict(1.0)
    growth.save(tmp_path / "filter.npz")
    back = sf.SPHFilter.load(tmp_path / "filter.npz", GROWTH, SQUARE)
    assert back.update(9.0).log_evidence == growth.update(9.0).log_evidence
    with pytest.raises(sf.ModelError, match="no equation that the scheme 'family' could solve"):
        sf.SPHFilter(GROWTH, SQUARE, x0=[0.1], P0=[[2.0]], config=sf.FilterConfig(scheme="family")).predict(
            1.0
        )
    with pytest.raises(sf.ModelError, match="switch at transitions="):
        sf.JumpMarkovModel({"one": GROWTH}, [[0.0]])


def test_noise_too_little_for_sums_becomes_points_and_angles_go_round():
    turning = sf.DiscreteModel.from_expressions(["a"], ["a + 0.4 + 0.1*sin(a)"], [["0.01"]],
                                                domain=[("periodic", -math.pi, math.pi)])  # fmt: skip
    compass = sf.GaussianMeasurement([[1.0]], [[0.01]], angles=[0])
    truth, z = sf.simulate(turning, compass, [3.0], np.arange(0.0, 21.0), rng=5)
    flt = sf.SPHFilter(turning, compass, x0=[3.0], P0=[[0.05]])
    found = flt.run(np.arange(1.0, 21.0), z[1:])
    off = (found.x[:, 0] - truth[1:, 0] + math.pi) % (2.0 * math.pi) - math.pi
    assert np.abs(off / np.sqrt(found.P[:, 0, 0])).max() < 4.0 and np.abs(truth).max() <= math.pi
    still = sf.DiscreteModel.from_expressions(["x"], ["x + 0.3*sin(3*x)"])
    moved, info = sf.predict(sf.initialize(sf.Gaussian([0.0], [[1.0]])), still, 3.0, n_particles="auto")
    X = np.random.default_rng(1).standard_normal(400_000)
    for _ in range(3):
        X = X + 0.3 * np.sin(3.0 * X)
    assert info.scheme == "cloud" and abs(moved.cov()[0, 0] / X.var() - 1.0) < 0.03


def test_a_bootstrap_filter_scatters_about_the_same_answer():
    well = sf.DiscreteModel.from_expressions(
        ["x", "v"], ["x + v/2", "v + (x - x**3 - 0.3*v)/2"], covariance=np.diag([0.02, 0.1]), period=0.5
    )
    sensor = sf.GaussianMeasurement.from_expressions(["x", "v"], ["x**2"], [[0.2]])
    _, z = sf.simulate(well, sensor, [1.0, 0.0], TIMES, rng=3)
    start = [0.5, 0.0], 0.5 * np.eye(2)
    flt = sf.SPHFilter(well, sensor, *start)
    found = flt.run(TIMES, z)
    points = BootstrapFilter(well, sensor, *start, 100_000, rng=2)
    means = points.run(TIMES, z)
    off = np.abs(found.x - means) / np.sqrt(np.diagonal(found.P, axis1=1, axis2=2))
    assert off.max() < 0.03 + 4.0 * found.error.max()
    assert abs(points.log_evidence - flt.log_evidence) < 0.05 + 4.0 * found.total_evidence_error


def test_time_budgets_smooth_densities_and_comparisons():
    for options in ({"time_budget": 0.05}, {"density_error": 0.01}):
        flt = sf.SPHFilter(GROWTH, SQUARE, [0.1], [[2.0]], config=sf.FilterConfig(**options), dt=1.0)
        assert flt.prepare() > 0.0
        for z in (4.0, 9.0, 1.0):
            assert "cloud" not in (flt.predict().scheme, flt.update(z).scheme)
    models = {f"Q = {q}": sf.DiscreteModel.from_matrices([[0.9]], [[q]]) for q in (0.04, 0.3)}
    level = sf.GaussianMeasurement([[1.0]], [[0.5]])
    _, z = sf.simulate(models["Q = 0.04"], level, [0.0], np.arange(0.0, 41.0), rng=2)
    results = [
        sf.SPHFilter(m, level, [0.0], [[0.2]]).run(np.arange(1.0, 41.0), z[1:]) for m in models.values()
    ]
    assert results[0].log_evidence.sum() > results[1].log_evidence.sum()


def test_maps_that_jump_are_right_or_points():
    for jump in (1.0, 3.0):
        model = sf.DiscreteModel(lambda x, t, p: (p[0] if x[0] > 0.1 else -p[0],), 1, covariance=[[1.0]],
                                 parameters={"jump": jump})  # fmt: skip
        flt = sf.SPHFilter(model, SQUARE, x0=[0.0], P0=[[1.0]], dt=1.0)
        info, above = flt.predict(), stats.norm.sf(0.1)
        mean, var = jump * (2.0 * above - 1.0), 1.0 + 4.0 * jump**2 * above * (1.0 - above)
        assert abs(flt.x[0] - mean) / math.sqrt(var) < max(3.0 * info.error, 0.003)
        level, z = sf.GaussianMeasurement([[1.0]], [[0.5]]), [[0.1], [3.0]]
        grid = GridOfSteps(model, lambda z, x: stats.norm.logpdf(z[0], x, 0.5**0.5), (0.0, 1.0), 12.0, z)
        mean, std = grid.moments(grid.smoothed())
        found = sf.smooth(sf.SPHFilter(model, level, x0=[0.0], P0=[[1.0]]), [1.0, 2.0], z)
        assert np.abs((found.x[:, 0] - mean) / std).max() < 0.02


def test_units_and_far_origins_change_nothing():
    found = []
    for unit, origin in ((1.0, 0.0), (1e-9, 0.0), (1e9, 0.0), (1.0, 1e6)):
        model = sf.DiscreteModel(
            lambda x, t, p: (0.5 * (x[0] + p[1]) + 3.0 * p[0] * math.sin((x[0] - p[1]) / p[0]),),
            1, covariance=[[unit**2]], parameters={"unit": unit, "origin": origin},
        )  # fmt: skip
        sensor = sf.GaussianMeasurement([[1.0]], [[0.3 * unit**2]])
        flt = sf.SPHFilter(model, sensor, x0=[origin + unit], P0=[[unit**2]])
        times, z = np.arange(1.0, 6.0), origin + unit * np.array([[1.0], [3.0], [2.0], [4.0], [1.0]])
        flt.run(times, z)
        found.append(
            [(flt.x[0] - origin) / unit, flt.P[0, 0] / unit**2, flt.log_evidence + 5 * math.log(unit)]
        )
        assert flt.predict(1.0).error < 0.01
    np.testing.assert_allclose(found, [found[0]] * 4, rtol=2e-3)


def test_a_map_without_values_somewhere_is_carried_by_points_or_named():
    root = sf.DiscreteModel(lambda x: (math.log(x[0] + 3.0),), 1, covariance=[[1.0]])
    flt = sf.SPHFilter(root, SQUARE, x0=[0.5], P0=[[1.0]], dt=1.0)
    X = np.random.default_rng(1).normal(0.5, 1.0, 200_000)
    assert flt.predict().scheme == "cloud" and abs(flt.x[0] - np.log(X[X > -3.0] + 3.0).mean()) < 0.01
    nowhere = sf.DiscreteModel(lambda x: (math.nan,), 1, covariance=[[1.0]])
    with pytest.raises(sf.PropagationError, match="its steps lead to no finite numbers"):
        sf.SPHFilter(nowhere, SQUARE, x0=[0.5], P0=[[1.0]], dt=1.0).predict()


def test_stone_soup_takes_it():
    stonesoup = pytest.importorskip("stonesoup")
    assert stonesoup
    from stonesoup.types.detection import Detection
    from stonesoup.types.state import GaussianState

    from sphfilter.adapters.stonesoup import SDETransitionModel, SPHPredictor, SPHUpdater

    start = datetime.datetime(2026, 1, 1)
    predictor = SPHPredictor(linear())
    updater = SPHUpdater(POSITION)
    state = GaussianState([[0.0], [0.0]], np.eye(2), timestamp=start)
    _, z = sf.simulate(linear(), POSITION, [0.0, 0.0], TIMES, rng=1)
    means, covs, _ = kalman(z)
    for t, number in zip(TIMES, z, strict=True):
        when = start + datetime.timedelta(seconds=float(t))
        prediction = predictor.predict(state, timestamp=when)
        from stonesoup.types.hypothesis import SingleHypothesis

        state = updater.update(SingleHypothesis(prediction, Detection([[number[0]]], timestamp=when)))
    np.testing.assert_allclose(np.ravel(state.mean), means[-1], atol=1e-4)
    np.testing.assert_allclose(state.covar, covs[-1], atol=1e-3)
    growth = SDETransitionModel(GROWTH, epoch=start)
    one = GaussianState([[1.0]], [[1.0]], timestamp=start)
    moved = growth.function(one, noise=False, time_interval=datetime.timedelta(seconds=2))
    first = GROWTH.transition([[1.0]], 0.0)
    np.testing.assert_allclose(np.ravel(moved), GROWTH.transition(first, 1.0)[0])
