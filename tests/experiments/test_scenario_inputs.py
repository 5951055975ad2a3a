"""Scenarios with inputs, tables, sensors' parameters and several sensors: drawn, run, kept, read again."""

import json
import pickle
import textwrap
import tomllib

import numpy as np
import pytest

import sphfilter as sf
from experiments.commands import main
from experiments.estimate.problems import problem_of
from experiments.guide import end_of_help
from experiments.scene.filters import factories
from experiments.scene.scenario import load_scenario
from experiments.show import histories
from experiments.show.style import plt
from experiments.sweep.command import Cell
from sphfilter.campaign.one_run import put_through
from sphfilter.errors import ConfigError, SphfilterError

TEXT = """
description = "a cart that is driven"

[model]
states = ["x", "v"]
drift = ["v", "-c*v + a + b"]
noise = [["0"], ["1"]]
spectral_density = [[0.2]]
parameters = { c = 0.4 }
inputs = { b = 0.5, a = 0.0 }

[sensors.gps]
h = [[1.0, 0.0]]
noise_cov = [[0.2]]

[sensors.speed]
h = ["s*v"]
noise_cov = [["r"]]
parameters = { s = 1.0, r = 0.3 }

[times]
interval = 1.0
end = 4.0

[start]
kind = "gaussian"
mean = [0.0, 0.0]
cov = [[0.2, 0.0], [0.0, 0.2]]

[inputs]
a = "8*c*sin(t)"

[filters]
default = ["ekf", "pf"]
"""


@pytest.fixture
def path(tmp_path):
    found = tmp_path / "driven.toml"
    found.write_text(TEXT, encoding="utf-8")
    return found


def test_inputs_are_held_from_the_start_of_each_interval(path):
    scenario = load_scenario(path)
    begins = np.arange(4.0)
    case = scenario.draw(np.random.default_rng(1))
    names = list(scenario.model.inputs)
    np.testing.assert_allclose(case.inputs[:, names.index("a")], 3.2 * np.sin(begins))
    assert np.all(case.inputs[:, names.index("b")] == 0.5)
    between = pickle.loads(pickle.dumps(type(scenario)(scenario.name, scenario.settings, between=True)))
    finer = between.draw(np.random.default_rng(1))
    np.testing.assert_array_equal(finer.truth[19::20], case.truth)
    np.testing.assert_array_equal(finer.inputs[::20], case.inputs)


def test_the_truth_is_driven(path):
    path.write_text(TEXT.replace("[[0.2]]\nparam", "[[1e-12]]\nparam"), encoding="utf-8")
    scenario = load_scenario(path, **{"start.cov": [[1e-12, 0.0], [0.0, 1e-12]]})
    case = scenario.draw(np.random.default_rng(0))
    v = 0.0
    for u, (_, found) in zip(case.inputs.sum(axis=1), case.truth, strict=True):
        v = np.exp(-0.4) * v + u / 0.4 * (1 - np.exp(-0.4))
        assert found == pytest.approx(v, abs=1e-4)


def test_a_burnt_in_start_has_the_models_own_inputs_before(tmp_path):
    text = TEXT[: TEXT.index("[sensors.speed]")] + TEXT[TEXT.index("[times]") :]
    path = tmp_path / "burnt.toml"
    two_point = 'kind = "tpd"\npairs = [[0, 1]]\nburn_in = 5.0'
    path.write_text(text.replace('kind = "gaussian"', two_point), encoding="utf-8")
    scenario = load_scenario(path, **{"start.burn_in": 40.0, "model.spectral_density": [[1e-12]]})
    case = scenario.draw(np.random.default_rng(2))
    assert case.inputs.shape == (4, 2) and case.truth[0, 1] == pytest.approx(0.5 / 0.4, abs=1e-4)


def test_filters_agree_and_a_filter_without_the_inputs_does_not(path):
    scenario = load_scenario(path)
    case = scenario.draw(np.random.default_rng(3))
    made = factories(["ekf", "sph"], scenario)
    ekf, sph = (put_through(make(case, np.random.default_rng(0)), case) for make in made.values())
    np.testing.assert_allclose(sph.x, ekf.x, atol=0.01)
    blind = made["ekf"](case, np.random.default_rng(0)).run(case.times, case.z)
    assert blind.log_evidence.sum() < ekf.log_evidence.sum() - 0.1


def test_a_campaign_writes_a_scenario_that_runs_again(path, tmp_path, capsys):
    out = tmp_path / "out"
    words = ["--runs", "3", "--filters", "ekf,ukf", "--out", str(out)]
    words += ["--set", "sensors.speed.parameters.r=0.1"]
    assert main(["campaign", str(path), *words]) == 0
    assert "failed" not in capsys.readouterr().err
    found = sf.CampaignResult.load(out / "campaign.npz")
    assert found.inputs.shape == (3, 4, 2) and not found.failures
    again = tomllib.loads((out / "scenario.toml").read_text(encoding="utf-8"))
    assert again["sensors"]["speed"]["parameters"]["r"] == 0.1 and "sensor" not in again
    one, other = load_scenario(out / "scenario.toml"), load_scenario(path)
    cases = [scenario.draw(np.random.default_rng(1)) for scenario in (one, other)]
    np.testing.assert_array_equal(cases[0].truth, cases[1].truth)
    assert json.loads((out / "report.json").read_text(encoding="utf-8"))["settings"]["inputs"]["a"]
    assert main(["campaign", str(path), *words]) == 0  # goes on from its folder


def test_the_picture_of_a_run_shows_the_filters_of_the_campaign(path, monkeypatch):
    """Between the measurements too: its filters run again, with the inputs."""
    scenario = load_scenario(path)
    made, drawn = factories(["ekf"], scenario), []
    campaign = sf.run_campaign(scenario, made, n_runs=1, seed=4)
    monkeypatch.setattr(histories, "_band", lambda ax, result, d, colour: drawn.append(result))
    plt.close(histories.history_figure(scenario, made, campaign, 0))
    np.testing.assert_allclose(drawn[0].x[19::20], campaign.results["ekf"].x[0], atol=1e-5)


def test_inputs_from_a_file(path, tmp_path):
    (tmp_path / "drive.csv").write_text("t,amp\n0,1\n1.5,2\n2.5,3\n", encoding="utf-8")
    table = 'file = "drive.csv"\nvalues = "amp"\nkind = "previous"'
    text = TEXT.replace('[inputs]\na = "8*c*sin(t)"', f"[inputs.a]\n{table}\n")
    path.write_text(text, encoding="utf-8")
    case = load_scenario(path).draw(np.random.default_rng(1))
    names = list(load_scenario(path).model.inputs)
    assert case.inputs[:, names.index("a")].tolist() == [1.0, 1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("[inputs]\na = ", "[inputs]\nab = ", "inputs names 'ab', which is no input of the model"),
        ("c*sin(t)", "x*sin(t)", "an input is a function of t, not of the states"),
        ("c*sin(t)", "d*sin(t)", "inputs.a"),
        ("8*c*sin(t)", "1/t", "is not finite at t = 0"),
        ("[inputs]\na = ", "[input]\na = ", "unknown key input (did you mean 'inputs'?)"),
        ('h = ["s*v"]', 'h = ["s*v"]\nnoise = 1', "unknown key sensors.speed.noise"),
    ],
)
def test_what_is_wrong_is_told(path, old, new, sentence):
    path.write_text(TEXT.replace(old, new), encoding="utf-8")
    with pytest.raises(SphfilterError) as problem:
        load_scenario(path)
    assert sentence in str(problem.value) and str(path) in str(problem.value)


@pytest.mark.parametrize("command", ["run", "campaign", "benchmark", "estimate", "sweep", "converge"])
@pytest.mark.parametrize(
    ("key", "told"),
    [("model.parameters.gama", "did you mean 'gamma'?"), ("sensor.parameters.r", "leave it out")],
)
def test_commands_refuse_parameters_that_are_not_there(command, key, told, tmp_path, capsys):
    assert main([command, "duffing", "--set", f"{key}=1.0", "--out", str(tmp_path)]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert f"no parameter {key.rpartition('.')[2]!r}" in said or "is used by no expression" in said
    assert told in said


def test_transient_refuses_parameters_that_are_not_there(tmp_path, capsys):
    words = ["transient", "duffing_full", "--set", "model.parameters.kk=1.0", "--out", str(tmp_path)]
    assert main(words) == 1
    assert "The parameter 'kk' is used by no expression (did you mean 'k'?)" in capsys.readouterr().err


def test_estimate_builds_filters_with_parameters_of_model_and_sensors(path):
    problem = problem_of(path, ["c", "s", "r"], {}, 0, n_particles=100)
    assert problem.values == {"c": 0.4, "s": 1.0, "r": 0.3} and problem.inputs.shape == (60, 2)
    filt = problem.build({"s": 2.0, "r": 0.7, "c": 0.1})
    assert dict(filt.measurement.parameters) == {"s": 2.0, "r": 0.7}
    assert dict(filt.model.parameters) == {"c": 0.1}
    text = TEXT[: TEXT.index("[sensors.gps]")] + TEXT[TEXT.index("[sensors.speed]") :]
    text = text.replace("[sensors.speed]", "[sensor]").replace("r = 0.3", "R = 0.3").replace('"r"', '"R"')
    path.write_text(text)
    problem = problem_of(path, ["R"], {}, 0, n_particles=100)
    assert dict(problem.build({"R": 0.5}).measurement.parameters) == {"s": 1.0, "R": 0.5}


@pytest.mark.slow
def test_estimate_fits_parameters_of_sensors_with_the_inputs(path, tmp_path):
    out = tmp_path / "out"
    words = ["--parameters", "c,r", "--set", "times.end=30", "--n-particles", "80", "--no-profile"]
    assert main(["estimate", str(path), *words, "--out", str(out)]) == 0
    record = json.loads((out / "fit.json").read_text(encoding="utf-8"))
    assert record["truth"] == {"c": 0.4, "r": 0.3}
    for name, error in record["standard_error"].items():
        assert abs(record["estimate"][name] - record["truth"][name]) < 4 * error, name
    keys = {"c": "model.parameters.c", "r": "sensors.speed.parameters.r"}
    found = {keys[name]: value for name, value in record["estimate"].items()}
    fitted = load_scenario(path, **{"times.end": 30}, **found)
    case = load_scenario(path, **{"times.end": 30}).draw(np.random.default_rng(0))
    filt = factories(["ekf"], fitted)["ekf"](case, np.random.default_rng(0))
    assert record["log_evidence"] == pytest.approx(put_through(filt, case).log_evidence.sum(), abs=0.02)


def test_estimate_names_the_nearest_parameter_of_a_sensor(path):
    with pytest.raises(ConfigError, match=r"no parameter 'rr' .did you mean 'r'"):
        problem_of(path, ["rr"], {}, 0)


def test_a_sweep_scales_the_noise_of_all_sensors(path):
    settings = load_scenario(path).settings
    changes = Cell(2.0, 1.0, 0.5).changes(settings)
    assert changes["sensors.gps.noise_cov"] == [[0.1]]
    speed = load_scenario(path, **changes).measurement["speed"]
    assert speed.covariance([[0.0, 0.0]]).tolist() == [[[0.15]]]


def test_the_help_of_run_shows_inputs_that_can_be_run(path, tmp_path):
    (tmp_path / "drive.csv").write_text("t,amp\n0,1\n9,2\n", encoding="utf-8")
    text = end_of_help("run")
    lines = textwrap.dedent(text[text.index("  [inputs]") : text.index("The truth")]).splitlines()
    as_table = ["[inputs.a]", *(line.lstrip("# ") for line in lines[3:])]
    for shown in (lines, as_table):
        text = TEXT.replace('[inputs]\na = "8*c*sin(t)"', "\n".join(shown))
        path.write_text(text, encoding="utf-8")
        assert load_scenario(path).draw(np.random.default_rng(0)).inputs.shape == (4, 2)
