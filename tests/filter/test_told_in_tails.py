"""Readings in tails of predictions: what steps of a cloud, and a family that was, get wrong there is told."""

import numpy as np
import pytest

import sphfilter as sf
from reference_filters.grid import GridFilter
from sphfilter.info import may_be_off


def off(flt, grid):
    return np.sqrt(np.mean((flt.x - grid.x) ** 2 / np.diag(grid.P)))


@pytest.mark.parametrize("z", [-3.4, 3.0])
def test_a_cloud_tells_what_its_steps_get_wrong_of_a_tail_and_takes_more(z):
    model = sf.SDE.from_expressions(["x", "v"], ["v", "x - x**3 - 0.3*v"], [["0"], ["1"]], [[0.25]])
    sensor, start = sf.GaussianMeasurement([[1.0, 0.0]], [[0.04]]), ([0.3, 0.0], 0.1 * np.eye(2))
    grid = GridFilter(model, sensor, *start, size=160, tol=1e-4)
    flt = sf.SPHFilter(model, sensor, *start, config=sf.FilterConfig(target_error=0.03))
    for each in (flt, grid):
        each.predict(t=2.0)
    info, exact = flt.update([z]), grid.update([z]).log_evidence
    # of usual steps .29 and .15, told .022 and .032
    assert info.rung == "cloud" and off(flt, grid) < 0.12
    assert off(flt, grid) < 3.0 * info.error
    assert abs(info.log_evidence - exact) < 3.0 * info.evidence_error


@pytest.mark.parametrize("z", [1.03, 0.98, -1.0])
def test_a_lattice_that_follows_a_family_tells_what_that_got_wrong_of_a_tail(z):
    model = sf.SDE.from_expressions(["x"], ["-0.3*x/sqrt(1 + x**2)"], [["0.0642"]], [[1.0]])
    sensor, start = sf.GaussianMeasurement(lambda x: np.tanh(x), [[0.0032]]), ([0.2], [[2.64]])
    grid = GridFilter(model, sensor, *start, size=600, tol=1e-5)
    grid.predict(t=2.95)
    grid.update([z])
    flt = sf.SPHFilter(model, sensor, *start)
    rungs = [flt.predict(t=t).rung for t in (0.7375, 1.475, 2.2125, 2.95)]
    info = flt.update([z])
    assert rungs == ["family", "lattice", "lattice", "lattice"]
    made = off(flt, grid), abs(flt.P[0, 0] / grid.P[0, 0] - 1.0)
    for told, error in zip((info.error, info.variance_error), made, strict=True):
        assert error / 3.0 < told < 3.0 * error


@pytest.mark.parametrize("dt", [0.1, 1.0, 3.0])
def test_a_lattice_forgets_an_error_as_its_drift_does(dt):
    """An Ornstein-Uhlenbeck process leaves exp(-a t) of a shift; none was left from t = 1 / 2a on."""
    a, Q, P = 0.8, 0.3, 0.5
    config = sf.SolverConfig(scheme="log_density", exact_linear=False)
    prior = sf.initialize(sf.Gaussian([1.0], [[P]]), 60, config=config).noted(error=1.0)
    model = sf.LinearSDE([[-a]], noise=[[1.0]], spectral_density=[[Q]])
    decay = np.exp(-2.0 * a * dt)
    left = np.sqrt(P * decay / (P * decay + Q * (1.0 - decay) / (2.0 * a)))
    assert sf.predict(prior, model, dt, config)[1].error == pytest.approx(left, rel=0.01)


def test_a_family_too_narrow_for_its_nodes_is_left_for_points():
    model = sf.SDE.from_expressions(
        ["x", "y"], ["0.15 - 0.3*x", "0.1*x**2 - 0.2*y"], [["0.4", "0"], ["0", "0.4"]]
    )
    sensor = sf.GaussianMeasurement.from_expressions(["x", "y"], ["y/x"], [[1.0]])
    flt = sf.SPHFilter(model, sensor, [0.6, 0.5], 0.2 * np.eye(2))
    assert flt.predict(1.0).rung == "family" and flt.update(2.68796750077932).rung == "cloud"


def test_an_error_that_says_nothing_is_said_to_be_none():
    assert may_be_off(0.1) == "the mean may be off by 0.3 standard deviations"
    assert may_be_off(1e27) == may_be_off(np.nan) == "how far the mean is off is not known"


def test_points_that_the_few_steps_of_a_shadow_throw_out_tell_nothing():
    model = sf.SDE.from_expressions(["x", "v"], ["v", "0.845*(1 - x**2)*v - x"], [["0"], ["1"]], [[0.1]])
    sensor = sf.GaussianMeasurement([[0.0, 1.0]], [[0.5]])
    flt = sf.SPHFilter(model, sensor, [-1.0, 0.0], np.diag([6.25, 0.92]))
    for t in (0.13, 0.26, 0.39):  # of a shadow of fewer steps .34 was told
        assert flt.predict(t=t).error < 0.02 and flt.update([0.1]).error < 0.02
