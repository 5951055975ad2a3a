"""Distances from a reference, example runs and sentences, on made-up campaigns."""

import io

import matplotlib.pyplot as plt
import numpy as np
import pytest
from rich.console import Console

from experiments.scene.scenario import load_scenario
from experiments.show import histories
from experiments.show.campaign_tables import result_table, sentences
from experiments.show.comparison import distances, reference_name
from sphfilter import FilterResult
from sphfilter.campaign.campaign import CampaignResult
from sphfilter.campaign.report import report


def _result(x, P, log_evidence=0.0, accepted=True):
    R, T, n = x.shape
    P = np.broadcast_to(P, (R, T, n, n)).copy()
    return FilterResult(t=np.arange(1.0, T + 1), x_prior=x, P_prior=P, x=x, P=P,
                        log_evidence=np.full((R, T), log_evidence),
                        accepted=np.full((R, T), accepted))  # fmt: skip


def _campaign(results, n_runs=4, n_epochs=15):
    zero = np.zeros((n_runs, n_epochs, 2))
    return CampaignResult(scenario="duffing", seed=1, times=np.arange(1.0, n_epochs + 1), truth=zero,
                          z=zero[..., :1], x0=zero[:, 0], P0=np.tile(np.eye(2), (n_runs, 1, 1)), t0=0.0,
                          results=results, run_time={k: np.full(n_runs, 0.5) for k in results},
                          failures=[])  # fmt: skip


def test_distance_by_hand():
    """In units of the reference: a shift of two deviations along one axis, a variance 1.5 times right."""
    P = np.diag([4.0, 9.0])
    x = np.zeros((3, 5, 2))
    shifted = x + np.array([4.0, 0.0])
    found = distances({"kf": _result(x, P, -1.0), "sph": _result(shifted, np.diag([4.0, 13.5]), -1.25)}, "kf")
    assert set(found) == {"sph"}
    assert found["sph"].mean == pytest.approx(2.0)
    assert found["sph"].cov == pytest.approx(0.5 / np.sqrt(2))
    assert found["sph"].evidence == pytest.approx(0.25)


def test_distance_is_the_same_in_other_units():
    rng = np.random.default_rng(0)
    B = np.array([[2.0, 0.3], [-5.0, 0.1]])
    x, y = rng.normal(size=(2, 3, 2)), rng.normal(size=(2, 3, 2))
    P, S = np.diag([1.0, 2.0]), np.diag([2.0, 1.0])
    here = distances({"kf": _result(x, P), "pf": _result(y, S)}, "kf")["pf"]
    there = distances({"kf": _result(x @ B.T, B @ P @ B.T), "pf": _result(y @ B.T, B @ S @ B.T)}, "kf")["pf"]
    assert there.mean == pytest.approx(here.mean)
    assert there.cov == pytest.approx(here.cov)


def test_distance_leaves_failed_runs_out():
    x = np.zeros((2, 3, 2))
    y = x + np.array([1.0, 0.0])
    y[1] = np.nan
    found = distances({"kf": _result(x, np.eye(2)), "pf": _result(y, np.eye(2))}, "kf")["pf"]
    assert found.mean == pytest.approx(1.0)
    nothing = distances({"kf": _result(x, np.eye(2)), "pf": _result(x * np.nan, np.eye(2))}, "kf")["pf"]
    assert np.isnan(nothing.mean)


def test_reference_is_the_exact_filter_or_the_grid():
    linear, duffing = load_scenario("linear_critical"), load_scenario("duffing")
    assert reference_name(linear, ["kf", "grid", "sph"]) == "kf"
    assert reference_name(linear, ["sph"]) is None
    assert reference_name(duffing, ["kf", "grid", "sph"]) == "grid"


def test_examples_show_the_ekf_keep_and_lose_the_truth():
    x = np.zeros((4, 15, 2))
    x[:, :, 0] = np.array([0.1, 0.2, 0.3, 50.0])[:, None]
    campaign = _campaign({"ekf": _result(x, np.eye(2)), "sph": _result(0 * x, np.eye(2))})
    assert histories.example_runs(campaign) == {"consistent": 1, "diverged": 3}
    campaign = _campaign({"ekf": _result(x[:3], np.eye(2))}, n_runs=3)
    assert histories.example_runs(campaign) == {"consistent": 1}
    campaign = _campaign({"sph": _result(x, np.eye(2)), "pf": _result(0 * x, np.eye(2))})
    assert histories.example_runs(campaign)["diverged"] == 3


def test_the_time_of_a_loss_is_that_of_the_largest_error():
    x = np.zeros((4, 15, 2))
    x[3, 6:, 0], x[3, 8, 0] = 20.0, 50.0
    campaign = _campaign({"ekf": _result(x, np.eye(2)), "sph": _result(0 * x, np.eye(2))})
    assert histories.losses(campaign, 3) == {"ekf": 9.0}
    assert histories.losses(campaign, 2) == {}


def test_limits_follow_an_estimate_that_strayed_but_not_forever():
    _, ax = plt.subplots()
    for strayed, limits in ((None, (-0.4, 1.4)), ([0.5, 3.0], (-0.4, 3.4)), ([-1e9, 0.5], (-4.4, 1.4))):
        histories._frame(ax, np.array([0.0, 1.0]), None if strayed is None else np.array(strayed))
        assert ax.get_ylim() == pytest.approx(limits)
    plt.close("all")


def test_sentences_say_what_went_wrong():
    scenario = load_scenario("duffing")
    x = np.zeros((4, 15, 2))
    lost = x.copy()
    lost[2] = 40.0
    numbers = report(_campaign({
        "ekf": _result(lost, np.eye(2)),
        "ukf": _result(x * np.nan, np.eye(2)),
        "pf": _result(x + 1.0, np.eye(2)),
        "sph": _result(x + 1.1, np.eye(2), accepted=False),
    }))  # fmt: skip
    said = " ".join(sentences(numbers, scenario))
    assert "EKF lost the truth in 1 of 4 runs" in said
    assert "UKF failed in 4 of 4 runs" in said
    assert "SPH rejected 60 of the measurements (100.0%)" in said
    assert "+10.0 % (position), +10.0 % (velocity)" in said
    assert "the paper's 13.3 s on its machine: a ratio of 27" in said
    assert "PF lost" not in said


def test_bad_luck_of_the_exact_filter_is_not_held_against_the_others():
    scenario = load_scenario("linear_critical")
    x = np.zeros((4, 15, 2))
    x[2] = 40.0
    numbers = report(_campaign({"kf": _result(x, np.eye(2)), "sph": _result(x, np.eye(2))}))
    said = " ".join(sentences(numbers, scenario))
    assert "KF is exact" in said
    assert "lost the truth" not in said


def test_table_has_the_rows_of_the_paper():
    scenario = load_scenario("duffing")
    numbers = report(_campaign({"ekf": _result(np.full((4, 15, 2), 0.123), np.eye(2))}))
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(result_table(numbers, scenario))
    text = console.export_text()
    for row in (
        "Max peak error, position (m)",
        "Avg peak error, velocity (m/s)",
        "RMS error, velocity (m/s)",
    ):
        assert row in text
    assert "0.123" in text
    assert "2.722" in text
