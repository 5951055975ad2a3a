"""`SPHFilter` against the exact Kalman filter and Beneš' closed form, and its contract."""

import pickle

import density_cases
import numpy as np
import pytest

import sphfilter as sf
from reference_filters.closed_forms import BenesFilter
from reference_filters.kalman import KalmanFilter

OSCILLATOR = sf.LinearSDE(A=[[0.0, 1.0], [-1.0, -0.1]], noise=[[0.0], [1.0]], spectral_density=[[0.4]])
POSITION = sf.GaussianMeasurement(h=[[1.0, 0.0]], noise_cov=[[0.2]])
X0, P0 = np.array([1.0, 0.0]), np.array([[0.5, 0.1], [0.1, 0.5]])
TIMES = np.arange(1.0, 9.0)


def data(model=OSCILLATOR, measurement=POSITION, x0=X0, times=TIMES, seed=1):
    _, z = sf.simulate(model, measurement, x0, np.concatenate([[0.0], times]), rng=seed)
    return z[1:]


PAPER = sf.FilterConfig.paper(kernel="gaussian")
BOTH = pytest.mark.parametrize("config", [sf.FilterConfig(), PAPER], ids=["default", "paper"])


def sph(n_particles=400, config=PAPER):
    return sf.SPHFilter(OSCILLATOR, POSITION, X0, P0, n_particles=n_particles, config=config)


def off(result, exact):
    """Rms over the run of the mean error in posterior deviations, and of the relative covariance error."""
    errors = density_cases.off(result.x, result.P, exact.x, exact.P)
    return tuple(np.sqrt(np.mean(np.square(errors), axis=1)))


@BOTH
def test_linear_run_against_kalman(config):
    z = data()
    exact = KalmanFilter(OSCILLATOR, POSITION, X0, P0).run(TIMES, z)
    result = sph(1200, config).run(TIMES, z)
    mean_error, cov_error = off(result, exact)
    assert mean_error < 0.05
    assert cov_error < 0.1
    assert result.log_evidence.sum() == pytest.approx(exact.log_evidence.sum(), abs=0.15)
    assert result.accepted.all()


@pytest.mark.slow
def test_error_against_kalman_falls_with_the_number_of_particles():
    z = data()
    exact = KalmanFilter(OSCILLATOR, POSITION, X0, P0).run(TIMES, z)
    counts = [150, 600, 2400]
    settings = {"support_range": (3.2, 3.2), "integrator": "midpoint"}
    config = sf.FilterConfig.paper(kernel="gaussian", **settings)
    found = np.array([off(sph(N, config).run(TIMES, z), exact) for N in counts])
    orders = -2.0 * np.polyfit(np.log(counts), np.log(found), 1)[0]  # dx ~ N^(-1/2)
    assert np.all(orders > 1.0)
    assert np.all(found[-1] < 0.3 * found[0])


@BOTH
def test_benes_filter(config):
    """dx = tanh(x) dt + dW: the exact posterior is a sum of two Gaussians."""
    model = sf.SDE.from_expressions(["x"], ["tanh(x)"], [["1"]], [[1.0]])
    sensor = sf.GaussianMeasurement(h=[[1.0]], noise_cov=[[1.0]])
    exact = BenesFilter(sensor, 0.3, 0.5)
    flt = sf.SPHFilter(
        model,
        sensor,
        density=sf.initialize(lambda X: exact.pdf(X[:, 0]), 200, config=config, box=[[-5, 6]]),
        n_particles=200,
        config=config,
    )
    y = np.linspace(-12, 12, 2001)[:, None]
    for t, z in [(1.0, 0.5), (2.0, -0.4), (3.0, 0.1)]:
        for f in (exact, flt):
            f.predict(t=t)
            f.update([z])
        assert flt.x == pytest.approx(exact.x, abs=0.03)
        assert pytest.approx(exact.P, rel=0.05) == flt.P
        difference = flt.density.pdf(y) - exact.pdf(y[:, 0])
        assert np.linalg.norm(difference) < 0.05 * np.linalg.norm(exact.pdf(y[:, 0]))
    assert flt.log_evidence == pytest.approx(exact.log_evidence, abs=0.03)


@BOTH
def test_attributes_follow_predict_and_update(config):
    flt = sph(200, config)
    assert flt.x == pytest.approx(X0)
    prior_info = flt.predict(0.5)
    assert prior_info.scheme == ("log_density" if config.scheme == "auto" else "paper")
    assert (flt.t, flt.density.t) == (0.5, 0.5)
    x_prior, P_prior = flt.x.copy(), flt.P.copy()
    info = flt.update([0.7])
    np.testing.assert_array_equal(flt.x_prior, x_prior)
    np.testing.assert_array_equal(flt.P_prior, P_prior)
    np.testing.assert_array_equal(flt.x_post, flt.x)
    assert not np.array_equal(flt.x_prior, flt.x)
    assert flt.log_likelihood == info.log_evidence == flt.log_evidence
    assert flt.y == pytest.approx([0.7 - x_prior[0]], abs=1e-9)
    flt.predict(t=1.0)
    second = flt.update([0.5])
    assert flt.log_evidence == pytest.approx(info.log_evidence + second.log_evidence)


@BOTH
def test_missing_and_irregular_measurements(config):
    times = np.array([0.0, 0.3, 0.3, 1.7, 2.0])
    z = [[1.0], None, [0.8], [np.nan], [0.1]]
    exact = KalmanFilter(OSCILLATOR, POSITION, X0, P0).run(times, z)
    result = sph(800, config).run(times, z)
    np.testing.assert_array_equal(result.t, times)
    np.testing.assert_array_equal(result.log_evidence[[1, 3]], 0.0)
    np.testing.assert_array_equal(result.x[1], result.x_prior[1])
    mean_error, cov_error = off(result, exact)
    assert mean_error < 0.05
    assert cov_error < 0.15


@BOTH
def test_several_sensors(config):
    velocity = sf.GaussianMeasurement(h=[[0.0, 2.0]], noise_cov=[[0.3]])
    flt, exact = sph(800, config), KalmanFilter(OSCILLATOR, POSITION, X0, P0)
    for f in (flt, exact):
        f.predict(0.7)
        f.update([0.9])
        f.update([-1.0], measurement=velocity)
    assert flt.x == pytest.approx(exact.x, abs=0.02)
    assert pytest.approx(exact.P, abs=0.03) == flt.P


@BOTH
def test_predict_without_argument_uses_dt(config):
    flt = sf.SPHFilter(OSCILLATOR, POSITION, X0, P0, n_particles=100, config=config, dt=0.25)
    flt.predict()
    assert flt.t == 0.25


def state_of(flt):
    return flt.t, flt.x.tobytes(), flt.P.tobytes(), flt.density, flt.log_evidence, flt.log_likelihood, flt.z


@pytest.mark.parametrize(
    "step",
    [
        lambda f: f.predict(-1.0),
        lambda f: f.predict(np.nan),
        lambda f: f.update([1.0, 2.0]),
        lambda f: f.update([np.inf]),
        lambda f: f.update(
            [0.0], measurement=sf.LikelihoodMeasurement(lambda z, X, t: np.full(len(X), -np.inf))
        ),
    ],
)
@BOTH
def test_failed_step_leaves_the_filter_as_it_was(config, step):
    flt = sph(150, config)
    flt.predict(0.2)
    flt.update([0.9])
    before = state_of(flt)
    with pytest.raises(sf.SphfilterError):
        step(flt)
    assert state_of(flt) == before


@pytest.mark.parametrize(
    ("config", "message"),
    [(sf.FilterConfig(), "blew up|stopped at t = .* shorter interval"), (PAPER, "blew up")],
    ids=["default", "paper"],
)
def test_failed_predict_of_a_model_that_blows_up(config, message):
    model = sf.SDE(drift=lambda x, t: (x[0] ** 3,), dim=1, noise=[[1.0]], spectral_density=[[0.1]])
    sensor = sf.GaussianMeasurement(h=[[1.0]], noise_cov=[[1.0]])
    flt = sf.SPHFilter(model, sensor, [1.0], [[0.1]], n_particles=50, config=config)
    before = state_of(flt)
    with pytest.raises(sf.PropagationError, match=message):
        flt.predict(10.0)
    assert state_of(flt) == before


@pytest.mark.parametrize("config", [sf.SolverConfig(), "paper", {}])
def test_config_of_another_kind(config):
    with pytest.raises(sf.ConfigError, match="must be a FilterConfig"):
        sf.SPHFilter(OSCILLATOR, POSITION, X0, P0, config=config)


@BOTH
def test_filter_pickles(config):
    flt = sph(150, config)
    flt.predict(0.2)
    again = pickle.loads(pickle.dumps(flt))
    np.testing.assert_array_equal(again.density.x, flt.density.x)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"x0": [0.0]}, r"x0 has shape \(1,\)"),
        ({"x0": [0.0, 0.0, 0.0]}, "a value for each of the model's 2 states"),
        ({"x0": [0.0, np.nan]}, "x0 contains NaN"),
        ({"P0": [1.0, 1.0]}, r"P0 has shape \(2,\), but it must be of shape \(2, 2\); np\.diag\(P0\)"),
        ({"P0": np.ones((2, 3))}, "P0"),
        ({"P0": [[1.0, 2.0], [2.0, 1.0]]}, "P0 is not positive definite"),
        ({"P0": np.zeros((2, 2))}, "P0 is not positive definite"),
        ({"P0": None}, "needs x0 and P0"),
        ({"n_particles": 0}, "n_particles"),
        ({"n_particles": 6}, "n_particles = 6 is too small for 2 states"),
        ({"dt": -1.0}, "dt must be greater than zero"),
        ({"density": 3}, "not both"),
    ],
)
@BOTH
def test_bad_arguments(config, arguments, message):
    with pytest.raises(sf.ModelError, match=message):
        sf.SPHFilter(OSCILLATOR, POSITION, **{"x0": X0, "P0": P0, "config": config, **arguments})


@pytest.mark.parametrize(
    ("model", "measurement", "message"),
    [
        ("x", POSITION, "model must be an SDE or a DiscreteModel, got 'x'"),
        (OSCILLATOR, 3, "measurement must be a GaussianMeasurement or LikelihoodMeasurement, got 3"),
        (OSCILLATOR, sf.GaussianMeasurement([[1.0, 0.0, 0.0]], 0.2), "h is of 3 states, but the state has 2"),
        (OSCILLATOR, sf.GaussianMeasurement(lambda x: (x[2],), 0.2), r"beyond the state \(dim=2\)"),
        (OSCILLATOR, sf.GaussianMeasurement.from_expressions(["x"], ["x"], 0.2), "h is of 1 states"),
    ],
)
def test_parts_that_do_not_fit(model, measurement, message):
    with pytest.raises(sf.ModelError, match=message):
        sf.SPHFilter(model, measurement, X0, P0)
    if model is OSCILLATOR and measurement != 3:  # `update` takes a number for the noise of one reading
        with pytest.raises(sf.ModelError, match=message):
            sph(150).update([0.0], measurement=measurement)


def test_a_filter_without_a_sensor_is_given_one_with_each_measurement():
    flt = sf.SPHFilter(OSCILLATOR, None, X0, P0, n_particles=150)
    assert flt.update([0.9], measurement=POSITION).accepted
    with pytest.raises(sf.ModelError, match=r"measurement must be a GaussianMeasurement .* got None"):
        flt.update([0.9])


@pytest.mark.parametrize(
    ("times", "z", "message"),
    [
        ([1.0, 0.5], [[0.0], [0.0]], "not decreasing"),
        ([-1.0], [[0.0]], "before the filter's own time"),
        ([1.0], [[0.0], [0.0]], "as many measurements as times"),
        ([np.nan], [[0.0]], "finite"),
        (np.array(["2024-01-01"], "M8[ns]"), [[0.0]], "times must be numbers"),
    ],
)
@BOTH
def test_bad_runs(config, times, z, message):
    with pytest.raises(sf.ModelError, match=message):
        sph(150, config).run(times, z)


@BOTH
def test_a_filter_tells_itself_in_a_line(config):
    flt = sph(150, config)
    flt.predict(0.5)
    said = repr(flt)
    name = "auto" if config.scheme == "auto" else "paper"
    particles = f"{flt.density.n_particles} particles (at most 150)"
    for text in ("states=('x0', 'x1'), t=0.5, x=[", "std=[", particles, f"scheme='{name}'"):
        assert text in said


def test_outlying_readings_are_told_by_epoch_whatever_is_missing():
    model, sensor = (
        sf.LinearSDE(-np.eye(2), noise=np.eye(2)),
        sf.GaussianMeasurement(np.eye(2), 0.1 * np.eye(2)),
    )
    z = [[0.1, 0.0], [np.nan, 9.0], [np.nan, np.nan], [0.1, np.nan], [8.0, 0.1]]
    result = sf.SPHFilter(model, sensor, [0.0, 0.0], np.eye(2)).run(np.arange(1.0, 6.0), z)
    assert result.outlying.tolist() == [False, True, False, False, True]
    assert not result.flagged.any() and result.accepted.all()
