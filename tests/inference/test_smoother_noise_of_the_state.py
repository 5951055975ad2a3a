"""Smoothing with noise that depends on the state, against matrices of high order on a grid."""

import numpy as np
import pytest
from density_cases import off
from matrix_smoother import smoothed_by_matrix

import sphfilter as sf
from reference_filters.rts import smooth_linear

LEVEL = sf.GaussianMeasurement(h=[[1.0]], noise_cov=[[0.1]])
POSITION = sf.GaussianMeasurement(h=[[1.0, 0.0]], noise_cov=[[0.1]])
TIMES = 0.7 * np.arange(1, 5)


def by_matrix(drift, diffusion, axes, start, sensor, readings):
    def log_likelihood(z, X):
        return sensor.log_likelihood(z, X, 0.0)

    return smoothed_by_matrix(drift, diffusion, axes, start, log_likelihood, TIMES, readings)


def assert_smoothed(model, sensor, start, readings, n_particles, exact, close):
    """In one interval between readings or in four: errors in standard deviations, parts and nats."""
    for parts in (1, 4):
        times = 0.7 / parts * np.arange(1, 4 * parts + 1)
        z = [readings[k // parts] if k % parts == parts - 1 else None for k in range(4 * parts)]
        found = sf.smooth(sf.SPHFilter(model, sensor, *start, n_particles=n_particles), times, z)
        at = slice(parts - 1, None, parts)
        mean, cov = off(found.x[at], found.P[at], *exact[:2])
        assert mean.max() < close and cov.max() < close
        assert np.abs(found.log_evidence - exact[2]).max() < close


def test_the_matrix_smoother_is_exact_where_there_is_an_exact_one():
    model, start = sf.LinearSDE(A=[[-1.0]], b=[0.3], noise=[[0.6]]), (np.ones(1), 0.2 * np.eye(1))
    z = [[1.3], [0.2], [-0.4], [0.9]]
    axes = [np.linspace(-4.0, 4.0, 161)]
    found = by_matrix(lambda X: 0.3 - X, lambda X: np.full((len(X), 1, 1), 0.18), axes, start, LEVEL, z)
    for value, exact in zip(found, smooth_linear(model, LEVEL, start, TIMES, z), strict=True):
        np.testing.assert_allclose(value, exact, atol=1e-7)


WIDENING, GROWING = [["0.6*sqrt(1 + 0.5*x**2)"]], [["0.4*x"]]


def widening(X):
    return 0.18 + 0.09 * X**2


#: Drift and noise, the interpretation; drift and diffusion of Itô, ends of the axis, and where it starts.
LINES = {
    "ito": ("-x", WIDENING, "ito", lambda X: -X, widening, (-6.0, 7.0), 1.0),
    "stratonovich": ("-x", WIDENING, "stratonovich", lambda X: -0.91 * X, widening, (-6.0, 7.0), 1.0),
    "geometric": ("0.1*x", GROWING, "ito", lambda X: 0.1 * X, lambda X: 0.08 * X**2, (0.02, 9.0), 2.0),
}


@pytest.mark.parametrize("name", LINES)
def test_one_state(name):
    """Measured: 3.1e-5, of the geometric one 3.0e-4, on 200 particles 3.0e-5."""
    f, g, interpretation, drift, D, ends, x0 = LINES[name]
    model = sf.SDE.from_expressions(["x"], [f], g, interpretation=interpretation)
    start, z = (np.array([x0]), np.array([[0.1]])), [[x0 + 0.3], [x0 - 0.8], [x0 - 1.2], [x0]]
    exact = by_matrix(drift, lambda X: D(X)[:, :, None], [np.linspace(*ends, 121)], start, LEVEL, z)
    assert_smoothed(model, LEVEL, start, z, 100, exact, 1e-3)


def shaken(X):
    D = np.zeros((len(X), 2, 2))
    D[:, 1, 1] = 0.18 * (0.3 + X[:, 0] ** 2)
    return D


def crossed(X):
    """Of two noises whose paths do not commute."""
    x, v = X.T
    g = np.zeros((len(X), 2, 2))
    g[:, 0, 0], g[:, 0, 1], g[:, 1, 1] = 0.5 * np.sqrt(1.0 + 0.5 * v**2), 0.2, 0.4 * (1.0 + 0.5 * np.sin(x))
    return 0.5 * g @ g.transpose(0, 2, 1)


PLANES = {
    "shaken where it is bent": (["v", "-x - 0.3*v"], [["0"], ["0.6*sqrt(0.3 + x**2)"]], shaken),
    "two noises": (["-x", "x - v"], [["0.5*sqrt(1 + 0.5*v**2)", "0.2"], ["0", "0.4 + 0.2*sin(x)"]], crossed),
}  # fmt: skip


@pytest.mark.parametrize("name", PLANES)
def test_two_states(name):
    """Measured: 6e-4."""
    f, g, diffusion = PLANES[name]
    model = sf.SDE.from_expressions(["x", "v"], f, g)
    start, z = (np.array([1.0, 0.0]), 0.2 * np.eye(2)), [[1.1], [0.2], [-0.9], [-1.2]]
    axes = [np.linspace(-4.5, 4.5, 51)] * 2
    exact = by_matrix(lambda X: model.drift(X, 0.0), diffusion, axes, start, POSITION, z)
    assert_smoothed(model, POSITION, start, z, 150, exact, 2e-3)


@pytest.mark.slow
def test_three_states_apart():
    """Each is smoothed as if it were alone. Measured: 4e-3, 1.2e-3, the evidence 4.3e-3."""
    f, g, _, drift, D, ends, x0 = LINES["ito"]
    names = ["x", "y", "v"]
    z = np.array([[1.3, 0.4, -0.2], [0.2, 1.0, 0.9], [-0.4, 0.1, 0.0], [0.6, 0.9, -0.8]])
    noise = [[g[0][0].replace("x", name) if name == other else "0" for other in names] for name in names]
    model = sf.SDE.from_expressions(names, [f.replace("x", name) for name in names], noise)
    sensor = sf.GaussianMeasurement(h=np.eye(3), noise_cov=0.1 * np.eye(3))
    found = sf.smooth(sf.SPHFilter(model, sensor, np.full(3, x0), 0.1 * np.eye(3), n_particles=600), TIMES, z)
    alone, axes = (np.array([x0]), np.array([[0.1]])), [np.linspace(*ends, 121)]
    exact = [by_matrix(drift, lambda X: D(X)[:, :, None], axes, alone, LEVEL, z[:, [k]]) for k in range(3)]
    x, P = np.hstack([one[0] for one in exact]), np.zeros((4, 3, 3))
    P[:, range(3), range(3)] = np.hstack([one[1][:, 0] for one in exact])
    mean, cov = off(found.x, found.P, x, P)
    assert mean.max() < 1e-2 and cov.max() < 2e-2
    assert np.abs(found.log_evidence - sum(one[2] for one in exact)).max() < 1e-2
