"""What leaves a well: against a generator on a fine grid."""

import numpy as np
import pytest
from scipy.linalg import expm

import sphfilter as sf
from sphfilter.prediction.family import escaped

WELLS = sf.SDE.from_expressions(["x"], ["x - x**3"], [["s"]], parameters={"s": 0.25})


def generator(s, low, high, count):
    """Places (K,), and rates (K, K) between cells of dx = (x - x³) dt + s dW that ends at both sides."""
    edges = np.linspace(low, high, count + 1)
    x, h, D = 0.5 * (edges[1:] + edges[:-1]), edges[1] - edges[0], 0.5 * s**2
    u = (edges[1:-1] - edges[1:-1] ** 3) * h / D
    up, down, A = D / h**2 * u / -np.expm1(-u), D / h**2 * u / np.expm1(u), np.zeros((count, count))
    i = np.arange(count - 1)
    A[i + 1, i], A[i, i + 1] = up, down
    np.fill_diagonal(A, -A.sum(axis=0))
    return x, A


def test_the_time_to_the_barrier():
    """Rates of first passages, from a generator whose last cell lets nothing back; four deviations² each."""
    x, A = generator(0.25, 0.0, 2.5, 801)
    A[0, 0] -= 0.5 * 0.25**2 / (x[1] - x[0]) ** 2 * 2.0  # what passes zero is gone
    time = np.linalg.solve(A.T, -np.ones(len(x)))[np.argmin(abs(x - 1.0))]
    density = sf.initialize(sf.Gaussian([1.0], [[0.015]]), 60)
    assert escaped(density, WELLS, 10.0) == pytest.approx(10.0 / time * 4.0 / 0.015, rel=0.03)


def test_what_has_no_other_well_leaves_nothing():
    line = sf.SDE.from_expressions(["x"], ["-x"], [["1"]])
    assert escaped(sf.initialize(sf.Gaussian([0.0], [[0.5]]), 60), line, 10.0) == 0.0
    assert escaped(sf.initialize(sf.Gaussian([0.0], [[1.0]]), 60), WELLS, 10.0) == 0.0  # it has both
    around = sf.Domain(("periodic", -np.pi, np.pi))
    circle = sf.SDE.from_expressions(["x"], ["-sin(x)"], [["1"]], domain=around)
    assert escaped(sf.initialize(sf.Gaussian([0.0], [[0.1]]), 60), circle, 10.0) == 0.0
    still = sf.SDE.from_expressions(["x"], ["x - x**3"], [["1e-3"]])  # a barrier of 5e5 nats
    assert escaped(sf.initialize(sf.Gaussian([1.0], [[0.02]]), 60), still, 10.0) < 1e-100
    plane = sf.LinearSDE(-np.eye(2), noise=np.eye(2))
    assert escaped(sf.initialize(sf.Gaussian([0.0, 0.0], np.eye(2)), 60), plane, 10.0) == 0.0


def test_a_prediction_knows_what_has_left():
    """After ten seconds 6e-4 are in the other well, a tenth of the variance: a family knew of 1e-5."""
    x, A = generator(0.25, -2.0, 2.0, 401)
    p = np.exp(-0.5 * (x - 1.0) ** 2 / 0.01)
    p = expm(10.0 * A) @ (p / p.sum())
    flt = sf.SPHFilter(WELLS, sf.GaussianMeasurement([[1.0]], [[0.15]]), x0=[1.0], P0=[[0.01]])
    flt.predict(t=10.0)
    assert flt.density.probability(lambda X: X[:, 0] < 0.0) == pytest.approx(p[x < 0.0].sum(), rel=0.05)
    assert flt.P[0, 0] == pytest.approx(p @ (x - p @ x) ** 2, rel=0.01)
