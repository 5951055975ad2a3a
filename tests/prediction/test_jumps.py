"""Drifts that jump: what lattices lose at the jump is not forgotten from one short prediction to the next."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.stats import norm

import sphfilter as sf

NOISE = 0.5
DRIFTS = {
    "-sign(x)": lambda x: -np.sign(x),
    "where(x > 0.5, -3, 1)": lambda x: np.where(x > 0.5, -3.0, 1.0),
    "-0.5*x - 2*sign(x)": lambda x: -0.5 * x - 2.0 * np.sign(x),
}


def moments(drift, T):
    """Mean and variance by finite volumes of width .02, in whose middles the drift jumps."""
    edges = np.linspace(-5.01, 5.01, 502)
    x, dx = 0.5 * (edges[1:] + edges[:-1]), edges[1] - edges[0]
    f, D = drift(edges[1:-1]), 0.5 * NOISE
    L = np.diag(0.5 * f / dx + D / dx**2, -1) + np.diag(-0.5 * f / dx + D / dx**2, 1)
    L -= np.diag(L.sum(axis=0))
    p = expm(T * L) @ norm.pdf(x, 0.3, np.sqrt(0.5)) * dx
    mean = p @ x
    return mean, p @ (x - mean) ** 2


@pytest.mark.parametrize("n_particles", [50, pytest.param(400, marks=pytest.mark.slow)])
@pytest.mark.parametrize("pieces", [1, 4, pytest.param(64, marks=pytest.mark.slow)])
@pytest.mark.parametrize("drift", DRIFTS)
def test_long_and_short_predictions(drift, pieces, n_particles):
    model = sf.SDE.from_expressions(["x"], [drift], [[str(np.sqrt(NOISE))]])
    density = sf.initialize(sf.Gaussian([0.3], [[0.5]]), n_particles)
    for k in range(pieces):
        density, info = sf.predict(density, model, t=(k + 1) / pieces, n_particles=n_particles)
    mean, variance = moments(DRIFTS[drift], 1.0)
    assert abs(density.mean()[0] - mean) < 0.06 * np.sqrt(variance)
    assert density.cov()[0, 0] == pytest.approx(variance, rel=0.16)
    assert info.flagged


def test_a_cloud_finds_out_that_its_steps_are_too_long():
    """A layer far thinner than the noise of a step that would be stable."""
    model = sf.SDE.from_expressions(["x"], ["-2*tanh(30*x)"], [[str(np.sqrt(NOISE))]])
    start = sf.initialize(sf.Gaussian([0.3], [[0.5]]), 200)
    density, _ = sf.predict(start, model, 1.0, sf.SolverConfig(scheme="cloud"))
    mean, variance = moments(lambda x: -2.0 * np.tanh(30.0 * x), 1.0)
    assert abs(density.mean()[0] - mean) < 0.05 * np.sqrt(variance)
    assert density.cov()[0, 0] == pytest.approx(variance, rel=0.1)
