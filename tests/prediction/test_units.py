"""States in units of their own, up to 1e12 apart: the noise of a small one is not lost beside a large one."""

import numpy as np
import pytest
from scipy.linalg import expm

import sphfilter as sf

A = np.array([[0.0, 1.0, 0.0], [-0.5, -0.3, 0.2], [0.0, 0.1, -0.2]])
D = np.array([[0.2, 0.05, 0.02], [0.05, 0.4, 0.1], [0.02, 0.1, 0.3]])
H, R = np.array([[1.0, 0.0, 1.0]]), np.array([[0.1]])
TIMES, Z = [0.5, 1.0, 1.5], [[1.2], [0.6], [0.1]]
UNITS = [1e-12, 1.0, 1e12], [1.0, 1e-9, 1e3], [1e12, 1e12, 1e-12]
ONE_OF_THEM = UNITS[0], *(pytest.param(unit, marks=pytest.mark.slow) for unit in UNITS[1:])


def model(unit):
    """The same system with states in units of their own."""
    unit = np.asarray(unit)
    f = [" + ".join(f"({c:.17g})*x{j}" for j, c in enumerate(row)) for row in A * unit[:, None] / unit]
    return sf.SDE.from_expressions(["x0", "x1", "x2"], f, diffusion=(D * np.outer(unit, unit)).tolist())


def record(system, unit, sensor=None):
    unit = np.asarray(unit)
    sensor = sensor or sf.GaussianMeasurement(H / unit, R)
    flt = sf.SPHFilter(system, sensor, unit * 1.0, 0.3 * np.diag(unit**2), n_particles=400)
    result = flt.run(TIMES, Z)
    return result.x / unit, result.P / np.outer(unit, unit), result.log_evidence


def kalman():
    x, P, log_evidence, before = np.ones(3), 0.3 * np.eye(3), [], 0.0
    loan = expm(np.block([[-A, 2.0 * D], [np.zeros((3, 3)), A.T]]) * 0.5)
    Phi = loan[3:, 3:].T
    Q = Phi @ loan[:3, 3:]
    for _, z in zip(TIMES, Z, strict=True):
        x, P = Phi @ x, Phi @ P @ Phi.T + Q
        S = (H @ P @ H.T + R)[0, 0]
        y, K = z[0] - (H @ x)[0], (P @ H.T)[:, 0] / S
        before += -0.5 * y**2 / S - 0.5 * np.log(2.0 * np.pi * S)
        log_evidence.append(before)
        x, P = x + K * y, P - S * np.outer(K, K)
    return x, P, log_evidence


@pytest.mark.parametrize("unit", [[1.0, 1.0, 1.0], *UNITS])
def test_a_linear_record_in_any_units(unit):
    """Against a Kalman filter in plain units, by its own formulas."""
    x, P, _ = record(model(unit), unit)
    expected, covariance, _ = kalman()
    std = np.sqrt(np.diag(covariance))
    assert np.abs((x[-1] - expected) / std).max() < 0.01
    np.testing.assert_allclose(P[-1] / np.outer(std, std), covariance / np.outer(std, std), atol=0.02)


@pytest.mark.parametrize("unit", UNITS)
def test_units_change_nothing(unit):
    plain, scaled = record(model(np.ones(3)), np.ones(3)), record(model(unit), unit)
    for one, other in zip(plain, scaled, strict=True):
        np.testing.assert_allclose(one, other, atol=2e-3)


@pytest.mark.parametrize("unit", ONE_OF_THEM)
def test_exact_transitions_in_any_units(unit):
    unit = np.asarray(unit)
    plain = model(np.ones(3)).to_linear().discretize(0.7)
    Phi, offset, Q = model(unit).to_linear().discretize(0.7)
    np.testing.assert_allclose(Phi * unit / unit[:, None], plain[0], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(Q / np.outer(unit, unit), plain[2], rtol=1e-9)
    assert not offset.any()


@pytest.mark.parametrize("unit", ONE_OF_THEM)
def test_a_diffusion_has_noise_in_every_state(unit):
    unit = np.asarray(unit)
    scaled = D * np.outer(unit, unit)
    constant = sf.SDE(lambda x: (0.0, 0.0, 0.0), 3, diffusion=scaled)

    def growing(X, t):
        return np.array([scaled] * len(X)) * (1 + t)

    changing = sf.SDE(lambda X, t: 0.0 * X, 3, diffusion=growing, vectorized=True)
    for system in (constant, changing):
        g = system.noise(np.zeros((1, 3)), 0.0)[0]
        found = 0.5 * g @ system.spectral_density @ g.T
        np.testing.assert_allclose(found / np.outer(unit, unit), D, rtol=1e-12)
        assert system.n_noise == 3


def test_a_clock_bias_in_seconds_beside_metres():
    """Range c b of a bias b of nanoseconds: its random walk adds variance q dt, metres or not."""
    q = np.array([1e-18, 4.0])
    clock = sf.SDE(lambda x: (0.0, 0.0), 2, diffusion=np.diag(q) / 2)
    start = sf.initialize(sf.Gaussian([0.0, 0.0], np.diag([1e-18, 25.0])), 300)
    later, _ = sf.predict(start, clock, 3.0)
    np.testing.assert_allclose(np.diag(later.cov()), [4e-18, 37.0], rtol=2e-3)
