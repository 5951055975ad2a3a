"""Verdicts: filters that are right, too sure, too careful, biased; and Kalman filters with a wrong model."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import sphfilter as sf
from reference_filters.kalman import KalmanFilter
from sphfilter.campaign.campaign import Case, run_campaign
from sphfilter.campaign.report import report
from sphfilter.campaign.verdict import verdict

TIMES = np.arange(1.0, 13.0)


@cache
def oscillator(intensity):
    return sf.SDE.from_expressions(
        states=["x", "v"], drift=["v", "-x - 0.4*v"], noise=[["0"], ["1"]], spectral_density=[[intensity]]
    )


class Oscillator:
    """Truths from the filters' own prior."""

    name = "oscillator"
    model = oscillator(0.5)
    sensor = sf.GaussianMeasurement(h=[[1.0, 0.0]], noise_cov=[[0.3]])

    def draw(self, rng):
        x0, P0 = np.array([1.0, 0.0]), np.diag([0.5, 0.8])
        start = x0 + np.linalg.cholesky(P0) @ rng.standard_normal(2)
        truth, z = sf.simulate(self.model, self.sensor, start, np.r_[0.0, TIMES], rng=rng)
        return Case(TIMES, truth[1:], z[1:], x0, P0)


def kalman(intensity):
    def make(case, rng):
        return KalmanFilter(oscillator(intensity), Oscillator.sensor, case.x0, case.P0)

    return make


class Misread:
    """A Kalman filter whose sensor reads too much, and which has only a run."""

    def __init__(self, case, rng):
        self._filter = kalman(0.5)(case, rng)

    def run(self, times, z):
        return self._filter.run(times, z + 0.5)


@pytest.fixture(scope="module")
def numbers():
    filters = {"right": kalman(0.5), "sure": kalman(0.05), "careful": kalman(3.0)}
    return report(
        run_campaign(Oscillator(), filters, 120, seed=5), referee="right", labels=["position", "velocity"]
    )


def test_the_exact_filter_is_consistent(numbers):
    assert numbers.filters["right"].verdict.startswith(
        "consistent: nothing found against it, NEES in its interval"
    )


def test_a_filter_that_is_too_sure_is_optimistic(numbers):
    f = numbers.filters["sure"]
    assert f.verdict.startswith("optimistic in position and velocity: NEES above its interval in ")
    assert "measurements do not fall as predicted" in f.verdict
    assert "successive innovations are correlated" in f.verdict
    assert f.exits_p < 1e-6 and f.ranks.outside_95 > 0.1 and f.nees_above > 0.5


def test_a_filter_that_is_too_careful_is_pessimistic(numbers):
    verdict = numbers.filters["careful"].verdict
    assert "pessimistic in " in verdict and "NEES below its interval in " in verdict
    assert "optimistic" not in verdict


def test_a_bias_is_named_with_its_size():
    whole = run_campaign(Oscillator(), {"misread": Misread}, 60, seed=6)
    f = report(whole, labels=["position", "velocity"]).filters["misread"]
    assert "biased in position and velocity by +0." in f.verdict
    assert "measurements do not fall as predicted" in f.verdict


def test_verdicts_without_a_referee_do_not_blame_the_shape(numbers):
    f = replace(numbers.filters["right"], nees_inside=0.5, exits_p=np.nan)
    assert verdict(f, ["a", "b"]).startswith(
        "nothing found against it but NEES in its interval in 50% of epochs only"
    )


def test_right_filters_are_faulted_one_time_in_a_hundred_at_most():
    faulted = 0
    for seed in range(25):
        whole = run_campaign(Oscillator(), {"right": kalman(0.5)}, 24, seed=seed)
        faulted += not report(whole).filters["right"].verdict.startswith("consistent")
    assert faulted <= 2
