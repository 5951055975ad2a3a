"""The commands end to end on tiny runs: output, files, errors, interruption."""

import json

import numpy as np
import pytest

from experiments import __main__ as commands
from experiments.campaign import work
from experiments.scene.filters import Factory
from experiments.show import plots
from sphfilter.campaign.campaign import CampaignResult

_TINY = ["--runs", "2", "--set", "times.end=6", "--n-particles", "200", "--set", "filters.pf.n_particles=100"]


def _run(*arguments):
    return commands.main([*arguments])


@pytest.fixture
def undrawn(monkeypatch):
    """A command that makes no pictures, for tests that look at its numbers and words."""
    monkeypatch.setattr(plots, "draw", lambda *given: [])


@pytest.fixture(scope="module")
def duffing(tmp_path_factory):
    out = tmp_path_factory.mktemp("duffing")
    arguments = ["--filters", "ekf,pf,sph,sph_paper", "--out", str(out)]
    assert _run("run", "duffing", *_TINY, *arguments) == 0
    return out


def test_run_writes_numbers_settings_and_pictures(duffing):
    campaign = CampaignResult.load(duffing / "campaign.npz")
    for name in ("sph", "sph_paper"):
        assert campaign.results[name].x.shape == (2, 3, 2)
        assert np.all(np.isfinite(campaign.results[name].x))
    assert not campaign.failures
    record = json.loads((duffing / "run.json").read_text())
    assert record["n_runs"] == 2
    assert record["settings"]["times"]["end"] == 6
    used = {name: record["settings"]["filters"][name]["config"] for name in ("sph", "sph_paper")}
    assert (used["sph"]["scheme"], used["sph_paper"]["scheme"]["name"]) == ("auto", "paper")
    assert (used["sph"]["acceptance"]["enabled"], used["sph_paper"]["acceptance"]["enabled"]) == (False, True)
    assert set(record["versions"]) >= {"sphfilter", "numpy", "numba"}
    error = campaign.results["pf"].x - campaign.truth
    np.testing.assert_allclose(record["report"]["filters"]["pf"]["rms_error"],
                               np.sqrt(np.mean(error**2, axis=(0, 1))))  # fmt: skip
    assert (duffing / "consistency.png").stat().st_size > 10_000
    assert list(duffing.glob("history_*.png"))
    assert not list(duffing.glob("unfinished*"))


@pytest.mark.usefixtures("undrawn")
def test_written_scenario_runs_the_same_again(duffing, tmp_path):
    assert _run("run", str(duffing / "scenario.toml"), "--out", str(tmp_path)) == 0
    first, again = (CampaignResult.load(folder / "campaign.npz") for folder in (duffing, tmp_path))
    assert list(again.results) == list(first.results)
    for name, result in first.results.items():
        np.testing.assert_array_equal(again.results[name].x, result.x)
        np.testing.assert_array_equal(again.results[name].log_evidence, result.log_evidence)


def test_run_prints_the_table_beside_the_paper(tmp_path, capsys):
    assert _run("run", "duffing", "--filters", "ekf", *_TINY, "--out", str(tmp_path)) == 0
    said = capsys.readouterr().out
    for text in ("RMS error, position (m)", "(paper)", "2.722", "22.121", "8 of 25", "run 2 of 2 done",
                 "the first time compiles", "drawing history_consistent.png: EKF",
                 "drawing consistency.png", "--runs 25", "campaign.npz"):  # fmt: skip
        assert text in said


@pytest.mark.usefixtures("undrawn")
def test_linear_scenario_is_compared_with_the_exact_filter(tmp_path, capsys):
    assert _run("run", "linear_critical", "--filters", "kf,ekf", *_TINY, "--out", str(tmp_path)) == 0
    assert "Distance from the Kalman filter" in capsys.readouterr().out
    distance = json.loads((tmp_path / "run.json").read_text())["distance"]
    assert set(distance) == {"ekf"}
    # the EKF of a linear model is the Kalman filter, up to its integration error
    assert 0 < distance["ekf"]["mean"] < 1e-4
    assert 0 < distance["ekf"]["cov"] < 1e-4


@pytest.mark.usefixtures("undrawn")
def test_benes_filters_start_from_the_exact_density(tmp_path):
    arguments = ["--filters", "benes,sph,sph_paper,grid", "--runs", "2", "--set", "times.end=2"]
    assert _run("run", "benes", *arguments, "--out", str(tmp_path)) == 0
    distance = json.loads((tmp_path / "run.json").read_text())["distance"]
    assert distance["grid"]["mean"] < 1e-4
    assert max(distance[name]["mean"] for name in ("sph", "sph_paper")) < 0.02
    assert distance["sph"]["cov"] < 0.02  # half of it, and the mean, are asked to be within .01


@pytest.mark.usefixtures("undrawn")
def test_a_filter_that_fails_is_reported_and_the_others_go_on(tmp_path, capsys, monkeypatch):
    make = Factory.__call__

    def failing(self, case, rng):
        if self.name == "ukf":
            raise RuntimeError("no such luck")
        return make(self, case, rng)

    monkeypatch.setattr(Factory, "__call__", failing)
    assert _run("run", "duffing", "--filters", "ekf,ukf", *_TINY, "--out", str(tmp_path)) == 1
    said = capsys.readouterr().out
    assert "UKF failed in 2 of 2 runs" in said
    assert "run 1, UKF: RuntimeError: no such luck" in said


@pytest.mark.usefixtures("undrawn")
def test_interruption_keeps_finished_runs(tmp_path, capsys, monkeypatch):
    make, calls = Factory.__call__, []

    def interrupted(self, case, rng):
        calls.append(self.name)
        if len(calls) == 4:  # one to warm up, then the third run
            raise KeyboardInterrupt
        return make(self, case, rng)

    arguments = ["run", "linear_critical", "--filters", "kf", "--runs", "4", "--out", str(tmp_path)]
    monkeypatch.setattr(Factory, "__call__", interrupted)
    assert _run(*arguments) == 130
    assert "2 of 4 runs are kept" in capsys.readouterr().err
    monkeypatch.setattr(Factory, "__call__", make)
    assert _run(*arguments) == 0
    said = capsys.readouterr().out
    assert "going on from the runs" in said
    assert "run 0 of 4" not in said
    resumed = CampaignResult.load(tmp_path / "campaign.npz")
    assert _run(*arguments[:-1], str(tmp_path / "whole")) == 0
    whole = CampaignResult.load(tmp_path / "whole" / "campaign.npz")
    np.testing.assert_array_equal(resumed.results["kf"].x, whole.results["kf"].x)


def test_interruption_before_the_first_run_leaves_nothing(tmp_path, capsys, monkeypatch):
    def interrupted(self, case, rng):
        raise KeyboardInterrupt

    monkeypatch.setattr(work, "warm_up", lambda *arguments: None)
    monkeypatch.setattr(Factory, "__call__", interrupted)
    assert _run("run", "linear_critical", "--filters", "kf", "--out", str(tmp_path)) == 130
    assert capsys.readouterr().err == "Stopped.\n"
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("undrawn")
def test_runs_that_others_left_are_mentioned(tmp_path, capsys):
    (tmp_path / "unfinished-00000000").mkdir()
    assert _run("run", "linear_critical", "--filters", "kf", "--runs", "1", "--out", str(tmp_path)) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "Interrupted runs of other settings" in said and "unfinished-00000000" in said


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["dufing"], "did you mean 'duffing'"),
        (["duffing", "--filters", "ekff"], "did you mean 'ekf'"),
        (["duffing", "--filters", "kf"], "kf needs a linear model"),
        (["duffing", "--filters", "benes"], "closed form of one problem"),
        (["cart", "--filters", "grid"], "1 or 2 states"),
        (["duffing", "--set", "scheme.kernal=lucy"], "did you mean 'kernel'"),
        (["duffing", "--set", "kernel"], "key=value"),
        (["duffing", "--n-particles", "0"], "n_particles = 0 is not valid"),
        (["duffing", "--filters", "ekf", "--seed", "-1"], "seed must be an integer"),
    ],
)
def test_errors_are_one_sentence_and_an_exit_code(arguments, sentence, tmp_path, capsys):
    assert _run("run", *arguments, "--out", str(tmp_path)) == 1
    said = capsys.readouterr().err
    assert said.startswith("error: ")
    assert sentence in said
    assert "Traceback" not in said


def test_numbers_of_runs_are_checked_at_once(capsys):
    with pytest.raises(SystemExit) as stop:
        _run("run", "duffing", "--runs", "0")
    assert stop.value.code == 2
    assert "at least 1" in capsys.readouterr().err


def test_list_names_every_scenario(capsys):
    assert _run("list") == 0
    said = capsys.readouterr().out
    for name in ("duffing", "van_der_pol", "cart_linear", "benes", "linear_underdamped"):
        assert name in said
