"""Polynomials at the nodes of rules: what they miss is seen, and no family is taken that misses it."""

import numpy as np
import pytest

import sphfilter as sf
from reference_filters.closed_forms import BenesFilter
from sphfilter.core.family.basis import basis
from sphfilter.density.family import Family, node_weights


@pytest.mark.parametrize(("n", "degree"), [(1, 4), (1, 6), (2, 4), (2, 5), (2, 6), (3, 4), (3, 5), (3, 6)])
def test_the_misfit_at_the_nodes_is_that_between_them(n, degree):
    """Two-sided and skew densities, against many draws: the median over ten is at least half."""
    rng = np.random.default_rng(0)
    rule, X = basis(n, degree), np.random.default_rng(1).standard_normal((100_000, n))
    seen = []
    for _ in range(10):
        a, b = rng.standard_normal((2, n))

        def log_p(Z, a=a, b=b):
            return -0.5 * np.sum(Z**2, axis=1) + 0.8 * np.log(np.cosh(1.2 * Z @ a)) + 0.3 * np.sin(Z @ b)

        at_nodes = log_p(rule.xi)
        family = Family(np.zeros(n), np.eye(n), at_nodes @ rule.F)
        w = node_weights(rule, family.A, at_nodes)[0]
        p = np.exp(log_p(X) + 0.5 * np.sum(X**2, axis=1))
        off = log_p(X) - family.log_p(X)
        true = np.sqrt(np.average((off - np.average(off, weights=p)) ** 2, weights=p))
        seen.append(np.sqrt(w @ (at_nodes - family.c @ rule.V) ** 2) / true)
    assert np.median(seen) > 0.5


def test_two_humps_are_not_taken_for_one_family():
    """The Benes density begins as one hump and parts: by default it came out 8 % too narrow, unflagged."""
    benes = sf.SDE.from_expressions(["x"], ["tanh(x)"], [["1"]], [[1.0]])
    sensor = sf.GaussianMeasurement([[1.0]], [[1.0]])
    exact = BenesFilter(sensor, 0.5, 0.3, 0.0)
    start = sf.initialize(lambda X: exact.pdf(X[:, 0]), box=[[-4.0, 5.0]])
    flt = sf.SPHFilter(benes, sensor, density=start)
    for t, z in [(0.5, 0.1), (1.0, -0.6), (1.5, 0.3), (2.0, 0.4)]:
        flt.predict(t=t)
        exact.predict(t=t)
        info = flt.update([z])
        exact.update([z])
        off = abs(flt.x[0] - exact.x[0]) / np.sqrt(exact.P[0, 0])
        assert off < max(3.0 * info.error, 1e-3) and off < 0.03
        assert abs(flt.P[0, 0] / exact.P[0, 0] - 1.0) < min(2.0 * max(3.0 * info.error, 1e-3), 0.04)
