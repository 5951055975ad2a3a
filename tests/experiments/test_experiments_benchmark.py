"""The benchmark: measures against closed forms, references, rows on disk, and the command end to end."""

import json
import time
from dataclasses import replace
from types import SimpleNamespace

import numba
import numpy as np
import pytest
from csv_rows import csv_rows
from numba.core import event

from experiments import __main__ as commands
from experiments.benchmark import expensive, overview, reference, tables
from experiments.benchmark.campaign import Outcome
from experiments.benchmark.counting import drift_evaluations
from experiments.benchmark.densities import Cloud, hellinger, normal, snapshot
from experiments.benchmark.errors import errors, root_mean_square, truth_errors
from experiments.benchmark.frontier import markdown, seconds_for
from experiments.benchmark.measure import _timed, measure
from experiments.benchmark.methods import Method, default_families, label, methods, size_text
from experiments.benchmark.store import Rows
from experiments.benchmark.summary import Line, ReferenceError, fastest_to_reach, particle_law
from experiments.benchmark.told import ratios, sentence, told_and_left
from experiments.benchmark.watch import TooSlow, Watched
from experiments.scene.filters import Factory
from experiments.scene.scenario import load_scenario
from experiments.scene.settings import Particle
from reference_filters.grid_density import GridDensity, fitted_box
from reference_filters.kalman import KalmanFilter
from sphfilter import ConfigError, consistency
from sphfilter.campaign.campaign import draw_case
from sphfilter.errors import PropagationError
from sphfilter.filter.results import FilterResult

_QUICK = ["--quick", "--runs", "2", "--set", "times.end=4"]


def _result(x, P, evidence):
    T, n = x.shape
    blank = np.zeros((T, n)), np.zeros((T, n, n))
    return FilterResult(np.arange(T), *blank, x, P, np.asarray(evidence), np.ones(T, dtype=bool))


# --- measures ---


def test_errors_are_in_standard_deviations_of_the_reference():
    P = np.array([[4.0, 0.0], [0.0, 9.0]])
    exact = _result(np.zeros((2, 2)), np.array([P, P]), [1.0, 2.0])
    found = _result(np.array([[2.0, 3.0], [0.0, 0.0]]), np.array([2 * P, P]), [1.3, 1.6])
    e = errors(found, exact)
    np.testing.assert_allclose(e.mean, 1.0)  # sqrt((1 + 1 + 0) / 2)
    np.testing.assert_allclose(e.worst, np.sqrt(2.0))
    np.testing.assert_allclose(e.cov, np.sqrt(0.5))  # 1 in half the epochs
    np.testing.assert_allclose(e.evidence, np.sqrt((0.09 + 0.16) / 2))
    np.testing.assert_allclose(e.total, 0.1)


def test_truth_errors_against_the_definition():
    P = np.array([np.diag([4.0, 1.0])] * 2)
    rmse, nees = truth_errors(_result(np.zeros((2, 2)), P, [0, 0]), np.array([[2.0, 0.0], [0.0, 2.0]]))
    np.testing.assert_allclose(rmse, [np.sqrt(2.0), np.sqrt(2.0)])
    np.testing.assert_allclose(nees, (1.0 + 4.0) / 2)


def test_root_mean_square_leaves_out_what_is_not_finite():
    assert root_mean_square([3.0, np.nan, 3.0]) == 3.0
    assert np.isnan(root_mean_square([]))


def test_hellinger_distance_of_two_gaussians():
    """H² = 1 - exp(-d²/8) for equal covariances a Mahalanobis distance d apart."""
    cov = np.array([[1.0, 0.6], [0.6, 2.0]])
    mean, other = np.zeros(2), np.array([0.5, -0.7])
    box = fitted_box(mean[None], np.ones(1), cov, 64)
    exact = GridDensity(box, normal(mean, cov).on(box))
    d = consistency.distance(other, mean, cov)
    expected = np.sqrt(1 - np.exp(-(d**2) / 8))
    np.testing.assert_allclose(hellinger(normal(other, cov), exact), expected, rtol=1e-5)
    assert hellinger(normal(mean, cov), exact) < 1e-5
    np.testing.assert_allclose(hellinger(normal(mean + 100.0, cov), exact), 1.0)


def test_kernel_estimate_of_a_cloud_approaches_its_density():
    rng = np.random.default_rng(1)
    cov = np.array([[1.0, 0.6], [0.6, 2.0]])
    box = fitted_box(np.zeros((1, 2)), np.ones(1), cov, 96)
    exact = GridDensity(box, normal(np.zeros(2), cov).on(box))
    distance = []
    for N in (300, 30_000):
        X = rng.multivariate_normal(np.zeros(2), 2 * cov, size=N)
        log_w = -0.25 * np.einsum("ij,jk,ik->i", X, np.linalg.inv(cov), X)  # to the narrower Gaussian
        distance.append(hellinger(Cloud(X, np.exp(log_w) / np.exp(log_w).sum()), exact))
    assert distance[1] < 0.04 < distance[0]


# --- references ---


def test_grid_reference_has_the_error_it_claims(tmp_path):
    """A linear problem that is not said to be one: the Kalman filter knows what the grid's error is."""
    scenario = load_scenario("linear_underdamped", **{"times.end": 3.0})
    case = scenario.draw(np.random.default_rng(2))
    unknown = replace(scenario, settings=replace(scenario.settings, exact=None))
    effort = reference.Effort(error=1e-3, first=0, last=2)
    found = reference.find(unknown, case, effort, tmp_path)
    exact = KalmanFilter(scenario.model, scenario.measurement, case.x0, case.P0).run(case.times, case.z)
    e = errors(found.result, exact)
    assert 0 < e.mean < found.mean < 1e-3
    assert e.cov < found.cov
    assert e.total < found.total
    for i, p in found.densities.items():
        assert hellinger(normal(exact.x[i], exact.P[i]), p) < 1e-3
    assert found.kind.startswith("grid of")


def test_particle_reference_has_the_error_it_claims(tmp_path):
    scenario = load_scenario("cart_linear", **{"times.end": 4.0})
    case = scenario.draw(np.random.default_rng(4))
    unknown = replace(scenario, settings=replace(scenario.settings, exact=None))
    found = reference.find(unknown, case, reference.Effort(n_paths=10_000, n_runs=8), tmp_path)
    exact = KalmanFilter(scenario.model, scenario.measurement, case.x0, case.P0).run(case.times, case.z)
    e = errors(found.result, exact)
    assert found.mean / 3 < e.mean < 3 * found.mean
    assert found.cov / 3 < e.cov < 3 * found.cov
    assert e.total < 3 * found.total
    assert not found.densities


def test_reference_is_read_again_and_belongs_to_its_case(tmp_path, monkeypatch):
    scenario = load_scenario("benes", **{"times.end": 2.0})
    cases = [scenario.draw(np.random.default_rng(seed)) for seed in (1, 2)]
    effort = reference.Effort()
    first = reference.find(scenario, cases[0], effort, tmp_path)
    monkeypatch.setattr(reference, "_exact", lambda *_: pytest.fail("computed twice"))
    again = reference.find(scenario, cases[0], effort, tmp_path)
    np.testing.assert_array_equal(again.result.x, first.result.x)
    assert sorted(again.densities) == sorted(first.densities) == [0, 2, 3]
    for i, p in again.densities.items():
        np.testing.assert_array_equal(p.values, first.densities[i].values)
        np.testing.assert_array_equal(p.box.axes, first.densities[i].box.axes)
    with pytest.raises(pytest.fail.Exception):
        reference.find(scenario, cases[1], effort, tmp_path)


def test_exact_reference_of_the_benes_problem_is_the_exact_density(tmp_path):
    scenario = load_scenario("benes", **{"times.end": 2.0})
    case = scenario.draw(np.random.default_rng(1))
    found = reference.find(scenario, case, reference.Effort(), tmp_path)
    exact = Factory("benes", scenario)(case, None)
    exact.run(case.times, case.z)
    assert hellinger(snapshot(exact), found.densities[3]) < 1e-6
    np.testing.assert_allclose(found.densities[3].mass, 1.0, atol=1e-6)


# --- one competitor ---


def test_kalman_filter_has_no_error_on_a_linear_problem(tmp_path):
    scenario = load_scenario("linear_underdamped", **{"times.end": 3.0})
    case = scenario.draw(np.random.default_rng(2))
    exact = reference.find(scenario, case, reference.Effort(), tmp_path)
    row = measure(methods(["kf"], scenario)[0], case, exact, [1], 10.0)
    assert row["mean"] == row["cov"] == row["total"] == 0.0
    assert row["hellinger"] < 1e-6
    assert len(row["seconds"]) == len(row["cpu_seconds"]) == 5
    assert json.loads(json.dumps(row)) == row


def test_particle_filter_has_less_error_with_more_particles(tmp_path):
    scenario = load_scenario("linear_underdamped", **{"times.end": 3.0})
    case = scenario.draw(np.random.default_rng(2))
    exact = reference.find(scenario, case, reference.Effort(), tmp_path)
    rows = [measure(m, case, exact, [1], 10.0) for m in methods(["pf"], scenario, counts=(100, 10_000))]
    assert rows[1]["mean"] < 0.4 * rows[0]["mean"]
    assert rows[1]["n_used"] == 10_000


def test_boxed_grid_converges_and_gives_its_density(tmp_path):
    scenario = load_scenario("linear_underdamped", **{"times.end": 3.0})
    case = scenario.draw(np.random.default_rng(2))
    exact = reference.find(scenario, case, reference.Effort(), tmp_path)
    rows = [measure(m, case, exact, [1], 10.0) for m in methods(["grid"], scenario)]
    assert rows[-1]["mean"] < 0.1 * rows[0]["mean"]
    assert rows[-1]["mean"] < 1e-3
    assert rows[-1]["hellinger"] < 2e-3


def test_failure_of_a_competitor_is_a_row_of_its_own(tmp_path):
    scenario = load_scenario("linear_underdamped", **{"times.end": 3.0})
    case = scenario.draw(np.random.default_rng(2))
    exact = reference.find(scenario, case, reference.Effort(), tmp_path)
    method = methods(["pf"], scenario, counts=(100,))[0]
    assert measure(method, case, exact, [1], limit=0.0)["failure"].startswith("stopped at t = 0 s")
    broken = replace(method, factory=replace(method.factory, settings=None))
    assert measure(broken, case, exact, [1], 10.0)["failure"].startswith("TypeError")


def test_a_watched_run_stops_at_its_limit():
    scenario = load_scenario("linear_underdamped", **{"times.end": 3.0})
    case = scenario.draw(np.random.default_rng(2))
    filt = Factory("kf", scenario)(case, None)
    with pytest.raises(TooSlow, match="stopped"):
        Watched(filt, limit=0.0).run(case.times, case.z)


def test_what_is_compiled_counts_for_no_limit_and_no_run_time(monkeypatch):
    """As on an empty cache, where the first lattice compiles for half a minute."""
    scenario = load_scenario("linear_underdamped", **{"times.end": 3.0})
    case, predict = scenario.draw(np.random.default_rng(2)), KalmanFilter.predict

    def compiling(self, *args, **options):
        with event.trigger_event("numba:compile", data={"dispatcher": numba.njit(lambda: None)}):
            time.sleep(0.5)
        return predict(self, *args, **options)

    monkeypatch.setattr(KalmanFilter, "predict", compiling)
    method = SimpleNamespace(factory=Factory("kf", scenario))
    *_, wall, _ = _timed(method, case, SimpleNamespace(densities={}), [1], limit=0.4)
    assert wall < 0.4


@pytest.mark.slow
def test_evaluations_of_the_drift_are_counted():
    """Four for every Runge-Kutta step of every particle, or as many for each as the steps say."""
    scenario = load_scenario("van_der_pol", **{"times.end": 5.0})
    case = scenario.draw(np.random.default_rng(2))
    settings = Particle(n_particles=500, order=4, step=0.25)
    method = Method("pf4", 500, 1, Factory("pf", scenario, settings))
    one = drift_evaluations(method, scenario, case, n_steps=20)
    assert one >= 500 * 20
    assert one % 500 == 0
    large = Method("pf4", 4000, 1, Factory("pf", scenario, replace(settings, n_particles=4000)))
    np.testing.assert_allclose(drift_evaluations(large, scenario, case, n_steps=20), 8 * one, rtol=0.1)


# --- lines ---


def _line(family, size, seconds, mean, failed=0, threads=1, drift=0.0):
    blank = dict.fromkeys((f for f in Line.__dataclass_fields__), 0.0) | {"told": np.empty((0, 2))}
    return Line(**blank | {"family": family, "series": family, "size": size, "seconds": seconds, "mean": mean,
                           "failed": failed, "threads": threads, "drift": drift})  # fmt: skip


def test_the_fastest_and_the_law():
    lines = [
        _line("ekf", 0, 0.001, 0.3),
        _line("pf", 100, 0.01, 0.1),
        _line("pf", 1000, 0.08, 0.04),
        _line("sph", 200, 0.05, 0.01),
        _line("sph", 400, 0.2, 0.02),
        _line("ukf", 0, 0.0001, 0.001, failed=1),
    ]
    assert fastest_to_reach(lines, 0.05).family == "sph"
    assert fastest_to_reach(lines, 0.005) is None
    np.testing.assert_allclose(particle_law(lines), 1e-4)


def test_the_frontier_lies_between_sizes():
    lines = [_line("sph:cloud", 256, 0.01, 0.1), _line("sph:cloud", 1024, 0.04, 0.025)]
    np.testing.assert_allclose(seconds_for(lines, 0.05), 0.02)
    assert seconds_for(lines, 0.2) == 0.01 and np.isnan(seconds_for(lines, 0.01))
    other = [_line("sph:family", 3, 0.001, 0.06), _line("auto", 33, 0.005, 0.02)]
    told = markdown([SimpleNamespace(scenario="one", lines=lines + other)])
    assert "| one | 0.1 | 10 | **1** | 5 | 5 |" in told and "| one | 0.03 | **33" in told
    assert "0.87 in the geometric mean, 5 at most, 1 of 2 above 2." in told  # and .15
    assert "0.01" not in told and markdown([SimpleNamespace(scenario="one", lines=other[1:])]) == ""


def test_a_rival_is_asked_for_the_error_that_was_left():
    sizes = (1000, 0.01, 0.1), (10_000, 0.16, 0.025)
    rival = [replace(_line("pf4", *size), runs=1, certified=False) for size in sizes]
    np.testing.assert_allclose([overview.seconds_at(rival, e) for e in (0.2, 0.05, 0.005)], [0.0025, 0.04, 4])
    own = replace(_line("auto", 100, 0.02, 0.05), told=np.array([[0.1, 0.05]]), certified=True, runs=1)
    told = overview.markdown([SimpleNamespace(scenario="one", lines=[own, *rival])])
    assert "| one | 0.05, 0.02 s | 0.025 †, 0.16 s |" in told and "| 2 | 2 (2, 2) |" in told
    assert "Asked 0.01: geometric mean of the ratios 2; PF ahead on 0 of 1" in told
    assert overview.markdown([SimpleNamespace(scenario="one", lines=rival)]) == ""


def test_sizes_in_words():
    assert size_text("sph", 1600) == "N = 1,600"
    assert size_text("auto", 300) == "target error 0.0033"
    assert size_text("ekf", 0) == ""


def test_tables_show_what_auto_was_asked_for():
    lines = [
        replace(_line(family, size, seconds, mean), rmse=np.zeros(2), schemes={}, failure="")
        for family, size, seconds, mean in (("auto", 100, 0.1, 0.006), ("sph", 200, 0.2, 0.004))
    ]
    outcome = Outcome("duffing", lines, ReferenceError("exact", 0.0, 0.0, 0.0, 0.0), [])
    headings, cells = tables.rows(outcome)
    assert [row[headings.index("N")] for row in cells] == ["target 0.01", "200"]
    said = " ".join(tables.sentences(outcome))
    assert "Error 0.01: SPH filter, target error 0.01, in 0.1 s." in said
    assert "in place of N stands the error" in said


def test_errors_told_are_held_against_errors_left():
    rows = [
        {"told": [0.02, 0.01, 0.0], "left": [0.01, 0.02, 0.03]},  # the last tells nothing
        {"told": [0.01, np.nan], "left": [0.05, 0.01]},
    ]
    found = told_and_left(rows)
    np.testing.assert_array_equal(found, [[0.02, 0.01], [0.01, 0.02], [0.01, 0.05]])
    line = replace(_line("auto", 100, 0.1, 0.006), told=found)
    np.testing.assert_allclose(ratios(line), np.quantile([2.0, 0.5, 0.2], [0.1, 0.5, 0.9]))
    said = sentence(line)
    assert said.startswith("Target error 0.01: the error told is 0.5 times the error left")
    assert "67% of 3 errors" in said
    assert sentence(_line("ekf", 0, 0.1, 0.1)) == ""


def test_who_wins_depends_on_the_cost_of_the_drift():
    lines = [_line("pf4", 1000, 0.01, 0.02, drift=1e6), _line("sph", 200, 0.1, 0.01, drift=1e4)]
    line, seconds, more = expensive.fastest(lines, 0.0, 0.02)
    assert (line.family, seconds, more) == ("pf4", 0.01, 1.0)
    line, seconds, _ = expensive.fastest(lines, 1e-6, 0.02)
    assert line.family == "sph"
    np.testing.assert_allclose(seconds, 0.11)
    line, seconds, more = expensive.fastest(lines[:1], 0.0, 0.01)  # four times the particles halve the error
    assert (more, seconds) == (4.0, 0.04)
    assert expensive.fastest(lines[1:], 0.0, 0.001) is None


# --- competitors and rows ---


def test_competitors_of_a_scenario():
    van_der_pol, cart = load_scenario("van_der_pol"), load_scenario("cart")
    assert "grid" in default_families(van_der_pol)
    assert "grid" not in default_families(cart)
    assert default_families(load_scenario("linear_underdamped"))[-1] == "kf"
    made = methods(default_families(van_der_pol), van_der_pol)
    assert len({m.key for m in made}) == len(made)
    assert {m.threads for m in made} == {1, 2}
    assert label("pf4, 2 threads") == "particle filter, weak order 4, 2 threads"


def test_paper_has_the_kernels_of_its_tables():
    made = [methods(["paper"], load_scenario(name))[0] for name in ("duffing", "cart")]
    assert [m.factory.settings.config.scheme.kernel for m in made] == ["lucy", "gaussian"]


@pytest.mark.parametrize("name", ["ekff", "sph:no_such_scheme"])
def test_unknown_competitors_are_refused(name):
    with pytest.raises(ConfigError):
        methods([name], load_scenario("duffing"))


def test_rows_are_of_what_they_were_made_of(tmp_path):
    rows = Rows(tmp_path)
    rows.write("s", "pf-100", 0, "abc", {"mean": np.nan, "seconds": [1.0]})
    assert rows.read("s", "pf-100", 0, "abc")["seconds"] == [1.0]
    assert rows.read("s", "pf-100", 0, "other") is None
    assert rows.read("s", "pf-100", 1, "abc") is None
    assert not list(tmp_path.rglob("*.part"))


# --- the command ---


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("benchmark")
    arguments = ["--filters", "ekf,pf,kf", "--counts", "100,2000", "--out", str(out)]
    assert commands.main(["benchmark", "linear_underdamped", *_QUICK, *arguments]) == 0
    return out


def test_command_writes_numbers_tables_and_pictures(folder):
    rows = {(row["family"], row["size"]): row for row in csv_rows(folder / "benchmark.csv")}
    assert set(rows) == {("ekf", "0"), ("pf", "100"), ("pf", "2000"), ("kf", "0")}
    assert float(rows["kf", "0"]["mean"]) == 0
    assert float(rows["pf", "2000"]["mean"]) < 0.6 * float(rows["pf", "100"]["mean"])
    assert float(rows["ekf", "0"]["mean"]) < 1e-4
    assert all(float(row["seconds"]) > 0 for row in rows.values())
    text = (folder / "benchmark.md").read_text()
    assert "| PF, order 2 | 2,000 |" in text
    assert "The reference is exact." in text
    record = json.loads((folder / "benchmark.json").read_text())
    assert set(record["versions"]) >= {"sphfilter", "numpy", "numba"}
    assert record["machine"]["end"]["cores"] >= 1
    for measure_name in ("mean", "cov", "total"):
        assert (folder / f"frontier_{measure_name}.png").stat().st_size > 10_000


def test_command_goes_on_from_what_is_there(folder, monkeypatch, capsys):
    from experiments.benchmark import campaign

    monkeypatch.setattr(campaign, "measure", lambda *_: pytest.fail("measured twice"))
    arguments = ["--filters", "ekf,pf,kf", "--counts", "100,2000", "--out", str(folder)]
    assert commands.main(["benchmark", "linear_underdamped", *_QUICK, *arguments]) == 0
    assert "PF, order 2" in capsys.readouterr().out


@pytest.mark.slow
def test_command_tells_who_wins_with_an_expensive_drift(tmp_path, capsys):
    arguments = ["--filters", "ekf,pf4", "--counts", "200", "--limit", "1", "--out", str(tmp_path)]
    assert commands.main(["benchmark", "expensive", *_QUICK, "--set", "times.end=5", *arguments]) == 0
    said = capsys.readouterr().out
    assert "van_der_pol with an expensive drift" in said
    rows = csv_rows(tmp_path / "expensive.csv")
    at_the_same_error = [float(row["seconds"]) for row in rows if row["error"] == "0.1"]
    assert at_the_same_error == sorted(at_the_same_error)
    assert (tmp_path / "expensive.png").stat().st_size > 10_000


def test_a_scenario_without_reference_is_told(tmp_path, capsys, monkeypatch):
    def none(*_):
        raise PropagationError("no reference")

    monkeypatch.setattr(reference, "_exact", none)
    arguments = ["--filters", "kf", "--out", str(tmp_path)]
    assert commands.main(["benchmark", "linear_underdamped", *_QUICK, *arguments]) == 1
    said = capsys.readouterr()
    assert "no reference" in said.out
    assert "nothing was measured" in said.err


def test_unknown_competitor_is_one_sentence(tmp_path, capsys):
    assert commands.main(["benchmark", "duffing", "--filters", "ekff", "--out", str(tmp_path)]) == 1
    assert "did you mean 'ekf'" in capsys.readouterr().err


def test_a_reference_older_than_some_fields_of_a_result_is_read(tmp_path):
    scenario = load_scenario("linear_underdamped", **{"times.end": 2.0})
    case = draw_case(scenario, 1, 0)
    found = reference.find(scenario, case, reference.Effort(), tmp_path)
    (path,) = tmp_path.iterdir()
    with np.load(path) as data:
        older = {name: data[name] for name in data if name != "result_pit"}
    np.savez_compressed(path, **older)
    again = reference.find(scenario, case, reference.Effort(), tmp_path)
    np.testing.assert_array_equal(again.result.x, found.result.x)
    assert np.isnan(again.result.pit).all()
