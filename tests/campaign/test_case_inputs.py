"""Cases with inputs: filters are told them, campaigns keep them, others are as before."""

import json

import numpy as np
import pytest

import sphfilter as sf
from reference_filters.kalman import KalmanFilter
from sphfilter.campaign.campaign import draw_case
from sphfilter.campaign.one_run import arrays_of, put_through

TIMES = np.array([0.5, 1.0, 2.0])
MODEL = sf.LinearSDE([[-0.5]], noise=[[1.0]], B=[[1.0, 0.5]])
SENSOR = sf.GaussianMeasurement([[1.0]], [[0.2]])


class Driven:
    """A scenario with inputs of its own in every run, or without."""

    name = "driven"

    def __init__(self, scale=1.0):
        self.scale = scale

    def draw(self, rng):
        inputs = None if not self.scale else self.scale * rng.normal(size=(3, 2))
        held = None if inputs is None else np.vstack([[0.0, 0.0], inputs])
        truth, z = sf.simulate(MODEL, SENSOR, rng.normal(size=1), [0.0, *TIMES], rng, inputs=held)
        return sf.Case(TIMES, truth[1:], z[1:], np.zeros(1), np.eye(1), inputs=inputs)


class Plain:
    """A filter whose run takes no inputs."""

    def __init__(self, case):
        self.inner = KalmanFilter(MODEL, SENSOR, case.x0, case.P0)

    def run(self, times, measurements):
        return self.inner.run(times, measurements)


FILTERS = {
    "kf": lambda case, rng: KalmanFilter(MODEL, SENSOR, case.x0, case.P0),
    "plain": lambda case, rng: Plain(case),
}


def test_a_campaign_tells_and_keeps_inputs(tmp_path):
    told = sf.run_campaign(Driven(), FILTERS, n_runs=3, seed=2, folder=tmp_path / "runs")
    assert told.inputs.shape == (3, 3, 2)
    for r in range(3):
        own = KalmanFilter(MODEL, SENSOR, told.x0[r], told.P0[r]).run(TIMES, told.z[r], inputs=told.inputs[r])
        np.testing.assert_array_equal(told.results["kf"].x[r], own.x)
        np.testing.assert_array_equal(draw_case(Driven(), 2, r).inputs, told.inputs[r])
    assert {failure.filter for failure in told.failures} == {"plain"}
    assert "inputs" in told.failures[0].message
    told.save(tmp_path / "all.npz")
    np.testing.assert_array_equal(sf.CampaignResult.load(tmp_path / "all.npz").inputs, told.inputs)
    again = sf.run_campaign(Driven(), FILTERS, n_runs=3, seed=2, folder=tmp_path / "runs")
    np.testing.assert_array_equal(again.inputs, told.inputs)


def test_without_inputs_nothing_is_stored_of_them(tmp_path):
    told = sf.run_campaign(Driven(0.0), FILTERS, n_runs=2, seed=2, folder=tmp_path / "runs")
    assert told.inputs is None and not told.failures
    with np.load(tmp_path / "runs" / "run_00000.npz") as data:
        assert "inputs" not in json.loads(str(data["index"]))["tree"]["case"]
    told.save(tmp_path / "all.npz")
    with np.load(tmp_path / "all.npz") as data:
        assert "inputs" not in json.loads(str(data["index"]))["tree"]
    assert sf.CampaignResult.load(tmp_path / "all.npz").inputs is None


def test_inputs_tell_campaigns_apart(tmp_path):
    sf.run_campaign(Driven(), FILTERS, n_runs=1, seed=2, folder=tmp_path)
    with pytest.raises(sf.ConfigError, match="another campaign"):
        sf.run_campaign(Driven(2.0), FILTERS, n_runs=1, seed=2, folder=tmp_path)


def test_a_case_checks_its_inputs():
    parts = {"times": TIMES, "truth": np.zeros((3, 1)), "z": np.zeros((3, 1)), "x0": [0.0], "P0": [[1.0]]}
    assert sf.Case(**parts, inputs=[1.0, 2.0, 3.0]).inputs.shape == (3, 1)
    assert "inputs" not in arrays_of(sf.Case(**parts)) and "inputs=None" in repr(sf.Case(**parts))
    for wrong in ([1.0, 2.0], np.zeros((3, 1, 1)), [1.0, np.nan, 0.0]):
        with pytest.raises(sf.ModelError, match=r"must be finite and of shape \(3, m\)"):
            sf.Case(**parts, inputs=wrong)


def test_the_first_epochs_alone():
    case = Driven().draw(np.random.default_rng(0))
    assert len(put_through(FILTERS["kf"](case, None), case, first=2).t) == 2
