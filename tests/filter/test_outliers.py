"""Readings of eight to fifteen deviations: their errors are told, inherited and forgotten."""

import numpy as np
import pytest
from scipy.stats import norm
from tail_grid import filtered_by_tail_grid

import sphfilter as sf
from sphfilter.core.cloud.lineages import pareto_index, unseen

DRIFTS = {
    "-0.7*x + 0.4*cos(x)": lambda x: -0.7 * x + 0.4 * np.cos(x),
    "-tanh(3*x)": lambda x: -np.tanh(3.0 * x),
    "x - x**3": lambda x: x - x**3,
    "-x - x**3": lambda x: -x - x**3,
    "-x + 1.5*sin(2*x)": lambda x: -x + 1.5 * np.sin(2.0 * x),
}
#: Noise, the sensor's variance, a variance of the start, times, readings.
RECORDS = (
    (0.5, 0.2, 0.5, (1.0, 2.0, 3.0, 4.0), (-0.86, -6.0, -2.06, -0.61)),
    (0.6, 0.2, 0.1, (1.0, 1.3, 2.3, 3.3), (0.62, -6.0, -1.11, -0.72)),
    (0.5, 0.04, 0.5, (1.0, 2.0, 3.0, 4.0), (-0.39, -6.0, -0.99, -0.4)),
    (0.7, 0.01, 0.1, (1.0, 1.3, 1.6, 2.6), (-0.98, -5.06, -1.19, 0.15)),
    (0.6, 0.04, 0.5, (0.3, 1.3, 1.6, 2.6), (-1.08, -5.01, -2.61, -0.78)),
)


@pytest.mark.parametrize("target", [0.1, 0.03])
@pytest.mark.parametrize(("text", "record"), list(zip(DRIFTS, RECORDS, strict=True)))
def test_an_outlier_is_flagged_and_what_it_leaves_is_told(text, record, target):
    """What carries it came from the edge of the points before: what they miss, no cloud beside them shows."""
    noise, R, P0, times, z = record
    exact = filtered_by_tail_grid(DRIFTS[text], noise, R, (0.0, P0), times, z, 1000)
    model = sf.SDE.from_expressions(["x"], [text], [[noise]])
    sensor = sf.GaussianMeasurement([[1.0]], [[R]])
    flt = sf.SPHFilter(model, sensor, x0=[0.0], P0=[[P0]], config=sf.FilterConfig(target_error=target))
    for k, (t, reading) in enumerate(zip(times, z, strict=True)):
        flt.predict(t=t)
        info = flt.update([reading])
        off = abs(flt.x[0] - exact[0, k]) / np.sqrt(exact[1, k])
        assert info.flagged or off < 3.0 * target
        if k == 1:
            assert info.flagged
            assert info.error > 0.1
            assert info.evidence_error > 0.3
    assert info.error < 3.0 * target  # two readings later


@pytest.mark.parametrize(("text", "record"), list(zip(DRIFTS, RECORDS, strict=True)))
def test_a_prediction_of_no_time_tells_what_the_reading_did(text, record):
    noise, R, P0, times, z = record
    model = sf.SDE.from_expressions(["x"], [text], [[noise]])
    sensor = sf.GaussianMeasurement([[1.0]], [[R]])
    flt = sf.SPHFilter(model, sensor, x0=[0.0], P0=[[P0]], config=sf.FilterConfig(target_error=0.03))
    for t, reading in zip(times[:2], z[:2], strict=True):
        flt.predict(t=t)
        told = flt.update([reading])
    assert told.flagged
    after = flt.predict(1e-9)
    assert after.flagged
    assert after.error > 0.9 * told.error
    assert after.variance_error > 0.9 * told.variance_error


@pytest.mark.parametrize("n", [2, 3])
def test_what_an_outlier_leaves_is_told_as_a_kalman_filter_knows_it(n):
    """Ten linear models, the third of six readings 7 to 11 deviations off, forced clouds of 1,024 points."""
    sensor, squares = sf.GaussianMeasurement(np.eye(n)[:1], [[0.1]]), np.zeros((6, 2))
    cloud = sf.FilterConfig(scheme=sf.CloudScheme(n_points=1024))
    for seed in range(10):
        rng = np.random.default_rng(seed)
        rates, mixed = rng.uniform(0.3, 1.5, n), 0.3 * rng.standard_normal((n, n))
        model = sf.LinearSDE(mixed - np.diag(rates), noise=np.diag(rng.uniform(0.3, 0.8, n)))
        about = model, sensor, np.zeros(n), 0.5 * np.eye(n)
        flt, exact = sf.SPHFilter(*about, config=cloud), sf.SPHFilter(*about)
        for k in range(6):
            for each in (flt, exact):
                each.predict(1.0)
            far = rng.choice([-1.0, 1.0]) * rng.uniform(7.0, 11.0) if k == 2 else rng.standard_normal()
            z = [exact.x[0] + np.sqrt(exact.P[0, 0] + 0.1) * far]
            told, _ = flt.update(z).error, exact.update(z)
            off = np.linalg.solve(np.linalg.cholesky(exact.P), flt.x - exact.x)
            squares[k] += off @ off / n, told**2
    made, told = np.sqrt(squares.T)
    assert np.all(made < told)
    assert np.all(told < 3.0 * made)


@pytest.mark.parametrize("k", [-0.3, 0.2, 0.5, 0.9, 1.5])
def test_the_index_of_a_tail_is_found(k):
    u = (np.arange(4000)[::-1] + 0.5) / 4000.0
    assert pareto_index((u**-k - 1.0) / k) == pytest.approx(k, abs=0.05)


def test_what_no_lineage_stands_for_follows_the_tail_of_their_weights():
    """Points of a Gaussian, weighted by exp(s y - s² / 2): the mean weight is one, most of it about s."""
    y = norm.ppf((np.arange(4096) + 0.5) / 4096.0)
    made, told = [], []
    for s in (3.0, 3.5, 4.0):
        w = np.exp(s * y - 0.5 * s * s)
        made.append(1.0 - w.mean())
        told.append(unseen(w / w.sum(), w, w.sum() ** 2 / (w @ w)))
    assert all(0.5 * off < of < 8.0 * off for of, off in zip(told, made, strict=True))


@pytest.mark.parametrize(("place", "width"), [(0.0, 0.02), (0.0, 1.0), (2.5, 0.1), (2.5, 1.0), (3.0, 0.5)])
def test_a_reading_that_bounds_the_weights_misses_none(place, width):
    y = norm.ppf((np.arange(4096) + 0.5) / 4096.0)
    w = np.exp(-0.5 * ((y - place) / width) ** 2)
    assert unseen(w / w.sum(), w, w.sum() ** 2 / (w @ w)) == 0.0
