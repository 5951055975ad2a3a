"""Noises of model and sensor that are correlated: against Kalman's filter of such noises, and many paths."""

import numpy as np
import pytest

import sphfilter as sf

F, G = np.array([[1.0, 0.3], [-0.2, 0.9]]), np.array([[0.5], [1.0]])
Q, H, R = np.array([[0.6]]), np.array([[1.0, 0.0], [0.5, 1.0]]), np.diag([0.4, 0.3])
S = np.array([[0.35, -0.2]])
Z = ([0.3, 0.1], [1.1, -0.4], [0.9, 0.7], [2.0, 0.2])


def kalman(x, C):
    """Means, covariances and log-evidence, with Cov(x', z) = C H^T + G S."""
    log_evidence = 0.0
    for z in Z:
        x, C, shared = F @ x, F @ C @ F.T + G @ Q @ G.T, G @ S
        cross = C @ H.T + shared
        both = H @ C @ H.T + R + H @ shared + (H @ shared).T
        off, gain = z - H @ x, cross @ np.linalg.inv(both)
        log_evidence -= 0.5 * (off @ np.linalg.solve(both, off) + np.linalg.slogdet(2.0 * np.pi * both)[1])
        x, C = x + gain @ off, C - gain @ cross.T
    return x, C, log_evidence


@pytest.mark.parametrize("text", [True, False])
def test_linear_models_are_kalmans_filter_of_correlated_noises(text):
    rows = [f"{a}*x + {b}*y" for a, b in F]
    plain = sf.DiscreteModel.from_expressions(["x", "y"], rows, G.tolist(), Q)
    if not text:
        plain = sf.DiscreteModel(
            lambda x, w: (x[0] + 0.3 * x[1] + 0.5 * w[0], 0.9 * x[1] - 0.2 * x[0] + w[0]),
            dim=2,
            noises=1,
            covariance=Q,
        )
    model, sensor = sf.correlated_noise(plain, sf.GaussianMeasurement(H, R), S)
    assert model.linear is text
    start = np.zeros(3), np.diag([1.0, 0.5, Q[0, 0]])
    config = sf.FilterConfig(target_error=0.01)
    flt = sf.SPHFilter(model, sensor, *start, dt=1.0, config=config)
    flt.run(np.arange(1.0, len(Z) + 1), Z)
    x, C, log_evidence = kalman(np.zeros(2), np.diag([1.0, 0.5]))
    digits = 1e-10 if text else 0.03
    np.testing.assert_allclose((flt.x[:2] - x) / np.sqrt(np.diag(C)), 0.0, atol=digits)
    np.testing.assert_allclose(flt.P[:2, :2] / np.sqrt(np.outer(np.diag(C), np.diag(C))),
                               C / np.sqrt(np.outer(np.diag(C), np.diag(C))), atol=2.0 * digits)  # fmt: skip
    assert flt.log_evidence == pytest.approx(log_evidence, abs=2.0 * digits)


def test_nonlinear_ones_are_many_paths_weighted():
    step = sf.DiscreteModel.from_expressions(["x"], ["x/2 + 2*sin(x)"], covariance=[[0.5]])
    level = sf.GaussianMeasurement.from_expressions(["x"], ["x + x**3/10"], [[0.4]])
    model, sensor = sf.correlated_noise(step, level, [[0.35]])
    flt = sf.SPHFilter(model, sensor, [0.5, 0.0], np.diag([1.0, 0.5]), dt=1.0)
    rng, N, z = np.random.default_rng(1), 400_000, (0.8, 1.9)
    flt.run([1.0, 2.0], z)
    x, log_w = rng.normal(0.5, 1.0, N), np.zeros(N)
    for y in z:
        w = rng.normal(0.0, np.sqrt(0.5), N)
        x = x / 2.0 + 2.0 * np.sin(x) + w
        log_w -= 0.5 * (y - x - x**3 / 10.0 - 0.7 * w) ** 2 / (0.4 - 0.35**2 / 0.5)
    weight = np.exp(log_w - log_w.max())
    weight /= weight.sum()
    mean = weight @ x
    std = np.sqrt(weight @ (x - mean) ** 2)
    assert abs(flt.x[0] - mean) < (0.01 + 4.0 * np.sqrt(np.sum(weight**2))) * std
    assert np.sqrt(flt.P[0, 0]) == pytest.approx(std, rel=0.03)


def test_noises_that_cannot_be_so_correlated_are_refused():
    step, level = sf.DiscreteModel.from_matrices(F, G @ Q @ G.T), sf.GaussianMeasurement(H, R)
    uneven = sf.GaussianMeasurement(lambda x: (x[0],), lambda x: ((1.0 + x[0] ** 2,),), dim_z=1)
    for model, sensor, cross, sentence in (
        (step, level, np.ones((2, 2)), "a smaller one can"),
        (step, level, [[0.1]], "cross"),
        (sf.LinearSDE(F, noise=G), level, S, "takes a DiscreteModel"),
        (step, uneven, S, "matrix"),
    ):
        with pytest.raises(sf.ModelError, match=sentence):
            sf.correlated_noise(model, sensor, cross)
