"""The command that fits parameters, end to end on few measurements."""

import json

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from experiments.commands import main
from experiments.estimate.problems import Build, guess_of, problem_of, rival_of
from experiments.scene.scenario import load_scenario
from reference_filters.kalman import KalmanFilter
from sphfilter.errors import ConfigError


def best_of_others(exact, name, value):
    """Largest of an evidence of w and R, where one of them is held."""
    other, bounds = ("R", (0.01, 2.0)) if name == "w" else ("w", (0.5, 1.5))
    found = minimize_scalar(lambda u: -exact({name: value, other: u}), bounds=bounds, method="bounded")
    return -found.fun


def test_estimate_tells_draws_and_writes(tmp_path, capsys):
    options = ["--set", "times.end=20", "--n-particles", "100", "--seed", "3", "--out", str(tmp_path)]
    assert main(["estimate", "linear_underdamped", "--parameters", "w,R", *options]) == 0
    said = capsys.readouterr().out
    assert "the maximum was found" in said and "standard error" in said and "truth" in said
    record = json.loads((tmp_path / "fit.json").read_text(encoding="utf-8"))
    assert record["truth"] == {"w": 1.0, "R": 0.1} and list(record["estimate"]) == ["w", "R"]
    assert (tmp_path / "profiles.png").stat().st_size > 10_000

    scenario = load_scenario("linear_underdamped", **{"times.end": 20})
    case = scenario.draw(np.random.default_rng(3))

    def exact(p):
        model, sensor = scenario.model.with_parameters(w=p["w"]), scenario.measurement.changed(p["R"])
        return KalmanFilter(model, sensor, case.x0, case.P0).run(case.times, case.z).log_evidence.sum()

    assert record["log_evidence"] == pytest.approx(exact(record["estimate"]), abs=0.01)
    for name, profile in record["profiles"].items():
        value, evidence = np.array(profile["value"]), np.array(profile["log_evidence"])
        assert np.argmax(evidence) == np.argmin(abs(value - record["estimate"][name]))
        assert evidence.min() < record["log_evidence"] - 1.0
        best = [best_of_others(exact, name, v) for v in value]
        assert evidence == pytest.approx(best, abs=0.03)


def test_the_sunspots_problem_counts_both_signs():
    problem = problem_of("sunspots", None, {}, 0)
    assert problem.names == ("w", "mu", "b", "g", "R") and not problem.simulated
    assert len(problem.times) == 249 and guess_of(problem, {})["b"] == problem.values["b"]
    name, rival = rival_of(problem)
    assert name == "linear oscillator" and rival.names == ("w", "c", "g", "R")
    for build in (problem.build, rival.build):
        filt = build({"g": 1.4, "R": 0.7})
        both = filt.measurement.log_likelihood([3.0], np.array([[2.5, 0.0], [-2.5, 0.0]]))
        assert both[0] == pytest.approx(both[1])


def test_a_scenario_gets_enough_measurements_unless_told():
    assert len(problem_of("duffing", None, {}, 1).times) == 60
    problem = problem_of("duffing", ["xi", "R"], {"times.end": 10.0}, 1, 150)
    assert len(problem.times) == 5 and guess_of(problem, {"xi": 0.3}) == {"xi": 0.3, "R": 0.75 * 0.2}
    assert isinstance(problem.build, Build) and problem.build({}).n_particles == 150


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["duffing", "--parameters", "gama"], "did you mean 'gamma'"),
        (["duffing", "--guess", "xi"], "a guess is NAME=VALUE"),
        (["duffing", "--guess", "w=1"], "fitted are xi, gamma, epsilon"),
        (["benes"], "density of its own"),
        (["van_der_pol", "--compare", "--parameters", "R"], "no rival of van_der_pol"),
        (["sunspots", "--set", "times.end=3"], "takes no --set"),
        (["double_well"], "no parameters in its file"),
    ],
)
def test_estimate_refuses_with_a_sentence(arguments, said, tmp_path, capsys):
    assert main(["estimate", *arguments, "--out", str(tmp_path)]) == 1
    assert said in capsys.readouterr().err


def test_unknown_scenarios_are_refused():
    with pytest.raises(ConfigError, match="did you mean 'duffing'"):
        problem_of("dufing", None, {}, 0)
