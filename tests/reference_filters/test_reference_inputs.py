"""Inputs of the reference filters: each against the exact recursion, and filters that take none."""

import numpy as np
import pytest

import sphfilter as sf
from reference_filters.boxed_grid import BoxedGridFilter
from reference_filters.closed_forms import BenesFilter
from reference_filters.cumulant import cumulant_moments
from reference_filters.grid import GridFilter
from reference_filters.kalman import ExtendedKalmanFilter, KalmanFilter, UnscentedKalmanFilter
from reference_filters.particle import ParticleFilter

A, Q, R, G, OWN = 0.4, 0.5, 0.3, 0.5, 0.25
MODEL = sf.SDE.from_expressions(["x"], ["-a*x + u"], [["1"]], [[Q]], {"a": A}, inputs={"u": OWN})
SENSOR = sf.GaussianMeasurement.from_expressions(["x"], ["x + g*u"], [[R]], parameters={"g": G}, inputs=["u"])
TIMES, Z, U = [0.5, 0.5, 1.7, 3.0], [1.0, 0.2, None, 2.5], [2.0, 9.0, -1.0, 3.0]
START = [1.0], [[2.0]]


def exact(held, g=G):
    """Mean, standard deviation and log-evidence by the scalar recursion; `held` before each time.

    Over no time too: sensors read what was given last.
    """
    m, P, now, rows = 1.0, 2.0, 0.0, []
    for t, z, u in zip(TIMES, Z, held, strict=True):
        decay = np.exp(-A * (t - now))
        m, P, now = decay * m + u / A * (1 - decay), decay**2 * P + Q / (2 * A) * (1 - decay**2), t
        evidence = 0.0
        if z is not None:
            S, off = P + R, z - m - g * u
            evidence = -0.5 * (off**2 / S + np.log(2 * np.pi * S))
            m, P = m + P / S * off, P - P**2 / S
        rows.append((m, np.sqrt(P), evidence))
    return np.array(rows)


@pytest.mark.parametrize(
    ("make", "allowed"),
    [
        (ExtendedKalmanFilter, 1e-5),
        (UnscentedKalmanFilter, 1e-5),
        (GridFilter, 1e-3),
        (lambda *a: ParticleFilter(*a, n_particles=40_000, rng=1), 0.02),
    ],
)
def test_inputs_are_held_over_intervals(make, allowed):
    filt = make(MODEL, SENSOR, *START)
    found = filt.run(TIMES, Z, inputs={"u": U})
    told = np.column_stack([found.x[:, 0], np.sqrt(found.P[:, 0, 0]), found.log_evidence])
    np.testing.assert_allclose(told, exact(U), atol=3 * allowed)
    again = make(MODEL, SENSOR, *START).run(TIMES, Z)
    told = np.column_stack([again.x[:, 0], np.sqrt(again.P[:, 0, 0]), again.log_evidence])
    np.testing.assert_allclose(told, exact([OWN] * 4), atol=3 * allowed)


@pytest.mark.parametrize("linear", [MODEL, sf.LinearSDE([[-A]], noise=[[np.sqrt(Q)]], B=[[1.0]])])
def test_the_kalman_filter(linear):
    filt = KalmanFilter(linear, sf.GaussianMeasurement([[1.0]], [[R]]), *START)
    found = filt.run(TIMES, Z, inputs=U)
    told = np.column_stack([found.x[:, 0], np.sqrt(found.P[:, 0, 0]), found.log_evidence])
    np.testing.assert_allclose(told, exact(U, g=0.0), rtol=1e-12)


def test_a_prediction_that_fails_leaves_the_inputs():
    filt = ExtendedKalmanFilter(
        sf.SDE.from_expressions(["x"], ["u*x**3"], [["1"]], [[0.1]], inputs=["u"]), SENSOR, *START
    )
    filt.predict(0.1, u=[-0.5])
    with pytest.raises(sf.SphfilterError):
        filt.predict(50.0, u={"u": 30.0})
    assert filt.driven.inputs["u"] == -0.5 and filt.t == 0.1 and filt.model.inputs["u"] == 0.0


def test_noise_of_the_state_is_that_at_the_mean():
    sensor = sf.GaussianMeasurement.from_expressions(["x"], ["x"], [["r*(1 + x**2)"]], parameters={"r": 0.1})
    filt = ExtendedKalmanFilter(MODEL, sensor, *START)
    filt.update([1.5])
    gain = 2.0 / (2.0 + 0.1 * (1 + 1.0**2))
    assert filt.x[0] == pytest.approx(1.0 + gain * 0.5)


def test_filters_without_inputs_say_so():
    boxed = BoxedGridFilter(MODEL, SENSOR, *START, box=[[-9.0, 9.0]])
    with pytest.raises(sf.ModelError, match="BoxedGridFilter takes no inputs; the Kalman filters, Part"):
        boxed.predict(1.0, u=[1.0])
    with pytest.raises(sf.ModelError, match="BenesFilter takes no inputs"):
        BenesFilter(sf.GaussianMeasurement([[1.0]], [[1.0]])).run([1.0], [0.3], inputs=[[1.0]])


def test_moment_equations_take_the_inputs_that_the_model_has():
    pushed = sf.SDE.from_expressions(["x"], ["-a*x + u - x**3"], [["1"]], [[Q]], {"a": A}, inputs=["u"])
    told = pushed.with_parameters(a=0.7).with_inputs([2.0])
    same = sf.SDE.from_expressions(["x"], ["-0.7*x + 2 - x**3"], [["1"]], [[Q]])
    start = sf.Gaussian([0.3], [[0.2]])
    found, own = (cumulant_moments(model, start, [0.0, 0.5, 1.0], 4) for model in (told, same))
    np.testing.assert_allclose(found.mean, own.mean, rtol=1e-12)
    tabled = sf.SDE.from_expressions(["x"], ["-table('f', t)"], [["1"]], tables={"f": ([0.0], [1.0])})
    with pytest.raises(sf.ModelError, match="a table, 'f', is no polynomial"):
        cumulant_moments(tabled, start, [0.0, 0.5], 2)
