"""Kalman filters against textbook algebra, joint Gaussians and quadrature."""

import numpy as np
import pytest
from referee_cases import P0, POSITION, X0
from scipy.integrate import solve_ivp
from scipy.stats import multivariate_normal

from reference_filters.closed_forms import linear_moments
from reference_filters.kalman import ExtendedKalmanFilter, KalmanFilter, UnscentedKalmanFilter
from sphfilter.errors import ModelError, PropagationError
from sphfilter.model.likelihood import LikelihoodMeasurement
from sphfilter.model.measurements import GaussianMeasurement
from sphfilter.model.sde import SDE, LinearSDE

A = np.array([[0.0, 1.0], [-1.0, -0.2]])
B = np.array([0.1, -0.3])
OSCILLATOR = LinearSDE(A=A, b=B, noise=[[0.0], [1.0]], spectral_density=[[0.8]])
BOTH = GaussianMeasurement(h=[[1.0, 0.0], [0.5, 1.0]], noise_cov=[[0.4, 0.1], [0.1, 0.3]])
TIMES = np.array([0.0, 0.7, 0.7, 2.0, 3.1])
READINGS = [[1.1, -0.2], [0.6, np.nan], [np.nan, 0.4], None, [-0.9, -1.2]]
FILTERS = [KalmanFilter, ExtendedKalmanFilter, UnscentedKalmanFilter]


def _van_der_pol(x, t):
    return x[1], -0.1 * x[1] * (x[0] ** 2 - 1.0) - x[0]


VAN_DER_POL = SDE(_van_der_pol, 2, noise=[[0.0], [1.0]], spectral_density=[[0.8]])


def _joint_gaussian_answer():
    """Posterior at the last time and log-evidence from the joint Gaussian of the readings, no recursion."""
    mean, cov = X0, P0
    means, covs, Phis = [mean], [cov], []
    S = np.diag([0.0, 0.8])
    for dt in np.diff(TIMES):
        Phis.append(np.column_stack([linear_moments(A, None, S, e, P0, dt)[0] for e in np.eye(2)]))
        mean, cov = linear_moments(A, B, S, mean, cov, dt)
        means.append(mean)
        covs.append(cov)
    T = len(TIMES)
    C = np.zeros((2 * T, 2 * T))
    for i in range(T):
        cross = covs[i]
        for j in range(i, T):
            C[2 * j : 2 * j + 2, 2 * i : 2 * i + 2] = cross
            C[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] = cross.T
            cross = Phis[j] @ cross if j < T - 1 else cross
    H = np.kron(np.eye(T), BOTH.H)
    z = np.concatenate([[np.nan] * 2 if r is None else r for r in READINGS])
    seen = np.isfinite(z)
    S_z = (H @ C @ H.T + np.kron(np.eye(T), BOTH.noise_cov))[np.ix_(seen, seen)]
    innovation = (z - H @ np.concatenate(means))[seen]
    gain = C[-2:] @ H[seen].T @ np.linalg.inv(S_z)
    evidence = multivariate_normal(np.zeros(len(innovation)), S_z).logpdf(innovation)
    return means[-1] + gain @ innovation, C[-2:, -2:] - gain @ H[seen] @ C[:, -2:], evidence


@pytest.mark.parametrize("make", FILTERS)
def test_linear_gaussian_run_equals_the_joint_gaussian(make):
    """Irregular and repeated times, partly and wholly missing readings, correlated noise, an offset."""
    filt = make(OSCILLATOR, BOTH, X0, P0)
    result = filt.run(TIMES, READINGS)
    x, P, evidence = _joint_gaussian_answer()
    tolerance = 1e-10 if make is KalmanFilter else 2e-6
    np.testing.assert_allclose(result.x[-1], x, atol=tolerance)
    np.testing.assert_allclose(result.P[-1], P, atol=tolerance)
    assert filt.log_evidence == pytest.approx(evidence, abs=5 * tolerance)
    assert result.log_evidence.sum() == pytest.approx(filt.log_evidence)
    assert result.log_evidence[3] == 0.0
    assert result.accepted.all()


@pytest.mark.parametrize("make", FILTERS)
def test_a_missing_measurement_leaves_no_stale_likelihood(make):
    filt = make(OSCILLATOR, POSITION, X0, P0)
    filt.update([3.0])
    assert filt.log_likelihood == pytest.approx(multivariate_normal(1.0, 0.9).logpdf(3.0))
    x, evidence = filt.x.copy(), filt.log_evidence
    for missing in (None, np.nan, [np.nan]):
        info = filt.update(missing)
        assert filt.log_likelihood == info.log_evidence == 0.0
        np.testing.assert_array_equal(filt.x, x)
        assert filt.log_evidence == evidence
    filt.predict(0.5)
    assert np.isfinite(filt.update([0.3]).log_evidence)


@pytest.mark.parametrize("make", FILTERS)
def test_two_sensors_at_one_time_equal_one_of_both(make):
    together = make(OSCILLATOR, GaussianMeasurement(h=np.eye(2), noise_cov=np.diag([0.4, 0.2])), X0, P0)
    apart = make(OSCILLATOR, POSITION, X0, P0, dt=0.3)
    velocity = GaussianMeasurement(h=[[0.0, 1.0]], noise_cov=[[0.2]])
    together.predict(0.3)
    apart.predict()
    together.update([0.4, -0.9])
    apart.update(0.4)
    apart.update([-0.9], measurement=velocity)
    np.testing.assert_allclose(apart.x, together.x, atol=1e-12)
    np.testing.assert_allclose(apart.P, together.P, atol=1e-12)
    assert apart.log_evidence == pytest.approx(together.log_evidence, abs=1e-12)


def test_kalman_takes_a_nonlinear_sensor_never():
    squared = GaussianMeasurement(h=lambda x: (x[0] ** 2,), noise_cov=[[0.1]])
    with pytest.raises(ModelError, match="matrix"):
        KalmanFilter(OSCILLATOR, squared, X0, P0).update([1.0])
    with pytest.raises(ModelError, match="linear model"):
        KalmanFilter(VAN_DER_POL, POSITION, X0, P0)


def test_gaussian_filters_name_the_sensor_they_cannot_take():
    counts = LikelihoodMeasurement(lambda z, X, t: -((z[0] - X[:, 0]) ** 2), dim_z=1)
    with pytest.raises(ModelError, match="GaussianMeasurement, not LikelihoodMeasurement"):
        ExtendedKalmanFilter(OSCILLATOR, counts, X0, P0).update([1.0])


def test_ekf_prediction_solves_its_moment_equations():
    def rates(t, y):
        (x, v), P = y[:2], y[2:].reshape(2, 2)
        J = np.array([[0.0, 1.0], [-0.2 * x * v - 1.0, -0.1 * (x**2 - 1.0)]])
        return np.r_[_van_der_pol(y, t), (J @ P + P @ J.T + np.diag([0.0, 0.8])).ravel()]

    filt = ExtendedKalmanFilter(VAN_DER_POL, POSITION, X0, P0, rtol=1e-9)
    filt.predict(2.5)
    y = solve_ivp(rates, (0, 2.5), np.r_[X0, P0.ravel()], rtol=1e-11, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(np.r_[filt.x, filt.P.ravel()], y, atol=1e-7)


def test_ukf_initial_rates_are_gaussian_expectations():
    """Symmetric sigma points integrate the third-degree Van der Pol drift exactly."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(12)
    Y = np.stack(np.meshgrid(nodes, nodes, indexing="ij"), -1).reshape(-1, 2)
    w = np.outer(weights, weights).ravel() / (2 * np.pi)
    F = VAN_DER_POL.drift(X0 + Y @ np.linalg.cholesky(P0).T, 0.0)
    filt = UnscentedKalmanFilter(VAN_DER_POL, POSITION, X0, P0, rtol=1e-10)
    dt = 1e-5
    filt.predict(dt)
    np.testing.assert_allclose((filt.x - X0) / dt, w @ F, atol=1e-4)


def test_multiplicative_noise_enters_the_covariance():
    """dX = -X dt + (1 + X/2) dW: mean and variance equations are closed, so the UKF has them exactly."""
    model = SDE(lambda x, t: (-x[0],), 1, noise=lambda x, t: ((1.0 + 0.5 * x[0],),), spectral_density=[[0.6]])

    def rates(t, y):
        return [-y[0], -2 * y[1] + 0.6 * ((1 + 0.5 * y[0]) ** 2 + 0.25 * y[1])]

    m, var = solve_ivp(rates, (0, 1.5), [0.8, 0.3], rtol=1e-11, atol=1e-12).y[:, -1]
    filt = UnscentedKalmanFilter(model, None, [0.8], [[0.3]], rtol=1e-9)
    filt.predict(1.5)
    assert filt.x[0] == pytest.approx(m, abs=1e-8)
    assert filt.P[0, 0] == pytest.approx(var, abs=1e-8)
    linearised = ExtendedKalmanFilter(model, None, [0.8], [[0.3]])
    linearised.predict(1.5)
    assert 0.25 < linearised.P[0, 0] < var


@pytest.mark.parametrize("make", [ExtendedKalmanFilter, UnscentedKalmanFilter])
def test_angles_are_wrapped_wherever_the_cut_lies(make):
    """A bearing across the ±π cut updates as the same scene turned by 180 degrees, where no cut is near."""
    start, cov, R = np.array([-3.0, 0.05]), np.diag([0.02, 0.03]), 0.01 * np.eye(2)
    model = LinearSDE(A=np.zeros((2, 2)), noise=np.eye(2), spectral_density=R)
    bearing = GaussianMeasurement(lambda x: (np.arctan2(x[1], x[0]), x[0] + x[1]), R, angles=[0])
    upright = GaussianMeasurement(lambda x: (np.arctan2(x[1], x[0]), -x[0] - x[1]), R)
    here, there = make(model, bearing, start, cov), make(model, upright, -start, cov)
    for filt, angle in ((here, -np.pi + 0.02), (there, 0.02)):
        filt.predict(0.1)
        filt.update([angle, -2.9])
        filt.update([angle, np.nan])
    np.testing.assert_allclose(-here.x, there.x, atol=1e-9)
    np.testing.assert_allclose(here.P, there.P, atol=1e-9)
    assert here.log_evidence == pytest.approx(there.log_evidence, abs=1e-7)


def test_a_diverging_filter_says_so_and_stays_as_it_was():
    runaway = SDE(lambda x, t: (x[0] ** 3,), 1, noise=[[1.0]], spectral_density=[[0.1]])
    filt = ExtendedKalmanFilter(runaway, None, [2.0], [[0.1]])
    with pytest.raises(PropagationError, match="blew up"):
        filt.predict(3.0)
    assert filt.t == 0.0
    np.testing.assert_array_equal(filt.x, [2.0])
    np.testing.assert_array_equal(filt.P, [[0.1]])


def test_bad_calls_are_told_what_is_wrong():
    filt = KalmanFilter(OSCILLATOR, None, X0, P0)
    with pytest.raises(ModelError, match="needs dt or t"):
        filt.predict()
    with pytest.raises(ModelError, match="not both"):
        filt.predict(0.1, t=0.1)
    with pytest.raises(ModelError, match="must not decrease"):
        filt.predict(-0.1)
    with pytest.raises(ModelError, match="needs a measurement model"):
        filt.update([1.0])
    with pytest.raises(ModelError, match="positive definite"):
        KalmanFilter(OSCILLATOR, POSITION, X0, -P0)
    with pytest.raises(ModelError, match="kappa"):
        UnscentedKalmanFilter(OSCILLATOR, POSITION, X0, P0, kappa=-2)
