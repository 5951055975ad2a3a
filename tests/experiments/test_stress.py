"""The stress grid: its referees, its judge, its pool, its command, and a reduced walk."""

import csv
import os
import time

import numpy as np
import pytest

import sphfilter as sf
from experiments.__main__ import main
from experiments.show.comparison import moment_errors
from experiments.stress import pool, references, runs
from experiments.stress.cell import Problem, drawn
from experiments.stress.exact import benes_posterior, forced_posterior
from experiments.stress.grid import cells, chosen
from experiments.stress.judge import judge
from experiments.stress.references import Reference, reference
from experiments.stress.runs import METHODS, Outcome, run
from experiments.stress.systems import drift_1d, oscillator, position
from reference_filters.grid import grid_convergence
from sphfilter.errors import ConfigError, PropagationError


def test_cells_have_unique_names_and_the_same_bits_each_time():
    every = cells()
    assert len({cell.name for cell in every}) == len(every) > 200
    cell = chosen(["unstable/growth/5"])[0]
    a, b, c = cell.problem(1), cell.problem(1), cell.problem(2)
    assert np.array_equal(a.z, b.z) and not np.array_equal(a.z, c.z)


def test_unknown_cell_is_refused_with_the_nearest_name():
    with pytest.raises(ConfigError, match="did you mean 'outlier'"):
        chosen(["outlyer"])


def _line(name, k, q, R, seed=3):
    """A problem of one state, for the referees."""
    model, rng = drift_1d(name, q=q, k=k), np.random.default_rng(seed)
    return drawn(rng, model, position(1, R), [0.4], [[0.3]], interval=0.4, step=0.01)


@pytest.mark.parametrize(
    "exact, problem",
    [(forced_posterior, _line("forced", 6.0, 0.6, 0.1)), (benes_posterior, _line("tanh", 1.0, 1.0, 0.3))],
)
def test_closed_forms_agree_with_the_grid(exact, problem):
    x, P, evidence = exact(problem)
    start = (problem.x0, problem.P0)
    grid = grid_convergence(problem.model, problem.measurement, start, problem.times, problem.z).result
    mean, cov = moment_errors(grid.x, grid.P, x, P)
    assert mean.max() < 2e-4 and cov.max() < 2e-4
    np.testing.assert_allclose(grid.log_evidence, evidence, atol=2e-4)


def test_benes_closed_form_holds_far_in_the_tail():
    """Far out tanh is 1: the posterior is that of a drifting Brownian motion."""
    problem = _line("tanh", 1.0, 1.0, 0.5)
    problem.z[:] = 30.0 + problem.times[:, None]
    x, P, _ = benes_posterior(problem)
    model = sf.LinearSDE(A=[[0.0]], b=[1.0], noise=[[1.0]])
    exact = reference(Problem(**{**vars(problem), "model": model}), 0)
    # the start's own weight, cosh(x0), lies at both signs only if the posterior of the start does
    np.testing.assert_allclose(x[3:], exact.x[3:], rtol=1e-6)
    np.testing.assert_allclose(P[3:], exact.P[3:], rtol=1e-6)


def _outcome(reference, shift=0.0, inflate=1.0, **more):
    sd = np.sqrt(reference.P[:, :1, 0])
    P = inflate * reference.P
    about = {"x": reference.x + shift * sd, "P": P, "log_evidence": reference.log_evidence}
    return Outcome(**{"end": "finished", **about, **more})


@pytest.fixture(scope="module")
def exact():
    """Five identical posteriors of one state."""
    truth = np.zeros((5, 1))
    return Reference("exact", np.ones((5, 1)), np.full((5, 1, 1), 4.0), np.zeros(5), truth=truth)


@pytest.mark.parametrize(
    "changes, verdict, part",
    [
        ({}, "ok", ""),
        ({"shift": 0.09}, "ok", ""),
        ({"shift": 0.11}, "wrong", "mean error 0.11"),
        ({"inflate": 1.3}, "wrong", "cov error 0.3"),
        ({"inflate": np.nan}, "wrong", "not finite"),
        ({"inflate": -1.0}, "wrong", "variance"),
        ({"mass": 0.98}, "wrong", "masses"),
        ({"breach": "changed"}, "wrong", "changed"),
        ({"log_evidence": np.full(5, np.inf)}, "wrong", "evidence"),
        ({"shift": 3.0, "rejection": "too far"}, "refused", "too far"),
        ({"end": "refused", "sentence": "too stiff"}, "refused", "too stiff"),
        ({"end": "refused", "sentence": "too stiff", "shift": 1.0}, "wrong", "mean error 1"),
        ({"end": "crashed", "sentence": "IndexError: 3"}, "wrong", "IndexError"),
        ({"end": "timeout", "sentence": "stopped"}, "timeout", "stopped"),
    ],
)
def test_verdicts(exact, changes, verdict, part):
    found = judge(_outcome(exact, **changes), exact)
    assert found.verdict == verdict and part in found.sentence


def test_an_uncertain_reference_does_not_make_a_run_ok(exact):
    uncertain = Reference(**{**vars(exact), "mean_error": 0.05, "why": "noisy"})
    assert judge(_outcome(exact), uncertain).verdict == "no reference"
    # twenty standard deviations from the truth is absurd without any reference
    assert judge(_outcome(exact, shift=20.0), uncertain).verdict == "wrong"


class _Breaking:
    """A filter that spoils its state before it refuses."""

    t, log_evidence, log_likelihood = 0.0, 0.0, 0.0
    x, P = np.zeros(1), np.eye(1)

    def predict(self, *, t):
        self.x = self.x + 1.0
        raise PropagationError("no further")


def test_a_refusal_that_changes_the_filter_is_wrong(monkeypatch):
    monkeypatch.setitem(METHODS, "breaking", lambda problem, seed: _Breaking())
    monkeypatch.setattr(runs, "_masses", lambda filt: np.ones(1))
    problem = _line("forced", 1.0, 0.5, 0.1)
    outcome = run(problem, "breaking")
    assert outcome.end == "refused" and "changed" in outcome.breach
    assert judge(outcome, reference(problem, 0)).verdict == "wrong"


def test_particle_reference_agrees_with_the_kalman_filter(monkeypatch):
    monkeypatch.setattr(references, "_N_PARTICLES", 40_000)
    model, rng = oscillator(), np.random.default_rng(2)
    problem = drawn(rng, model, position(2, 0.2), [1.0, 0.0], np.diag([0.2, 0.4]), interval=0.5)
    found, exact = references._particles(problem, 0), reference(problem, 0)
    assert exact.name == "Kalman filter"
    mean, cov = moment_errors(found.x, found.P, exact.x, exact.P)
    # both are sampled: the claimed error has as few degrees of freedom as there are numbers
    assert np.sqrt(np.mean(mean**2)) < 4 * found.mean_error < 0.1
    assert np.sqrt(np.mean(cov**2)) < 4 * found.cov_error < 0.2


def test_pool_survives_hangs_and_deaths():
    """Functions of the standard library: the processes then start in no time."""
    got = {}
    pool.run_tasks(time.sleep, [0.0, 60.0, 0.01], 1, lambda task: 1.0, got.__setitem__)
    assert got[0.0] is None and got[0.01] is None
    assert got[60.0].timeout and "1 s" in got[60.0].sentence
    pool.run_tasks(os._exit, [3], 1, lambda task: 60.0, got.__setitem__)
    assert not got[3].timeout and "died" in got[3].sentence


@pytest.mark.slow  # the random harness has its own, by default
def test_command_writes_its_files_and_resumes(tmp_path, capsys):
    command = ["stress", "--only", "repeated_times/linear/1", "--methods", "pf1e4", "--out", str(tmp_path)]
    assert main(command) == 0
    text = (tmp_path / "stress.md").read_text()
    assert "| repeated times | 1 / 0 / 0 / 0 / 0 |" in text
    assert (tmp_path / "stress.png").stat().st_size > 5000
    header, line = (tmp_path / "stress.csv").read_text().splitlines()
    assert "Kalman filter" in line and header.startswith("family,system,level")
    stamps = [p.stat().st_mtime_ns for p in sorted(tmp_path.rglob("*.npz"))]
    assert main(command) == 0
    assert stamps == [p.stat().st_mtime_ns for p in sorted(tmp_path.rglob("*.npz"))]
    assert main(["stress", "--filters", "ukf"]) == 1
    assert "no filter 'ukf'" in capsys.readouterr().err


#: Cells of the reduced grid that take a second or less, most with an exact reference.
_WALK = [
    "process_noise/linear",
    "no_noise/decay",
    "noise_on_some_rows",
    "unstable",
    "dimension/linear_chain/[13]",
    "sensor_noise/linear/100",
    "interval/linear",
    "near-singular_start/linear*",
    "badly_scaled_start/linear/1e-06",
    "units",
    "outlier/tanh_drift",
    "outlier/linear/3",
    "missing_data/linear",
    "long_run/linear",
    "repeated_times",
]
_PAPER = [
    "no_noise/decay/6",
    "units/states/1e+06",
    "outlier/linear/20",
    "unstable/growth/1",
    "missing_data/linear/1",
    "particles/linear/20",
    "blow-up/square/0.7",
]


@pytest.fixture
def quick_references(monkeypatch):
    """Leave cells without a reference whose referee takes long: what no run may show is still looked at."""
    monkeypatch.setattr(references, "_N_PARTICLES", 5_000)
    monkeypatch.setattr(references, "_GRID_SECONDS", 4.0)


def _verdict(cell, method):
    problem = cell.problem(1)
    return judge(run(problem, method, 1), reference(problem, 1))


@pytest.mark.parametrize("cell", chosen(_WALK, quick=True), ids=lambda cell: cell.name)
def test_default_scheme_is_never_wrong(cell):
    verdict = _verdict(cell, "default")
    assert verdict.verdict in ("ok", "refused"), verdict


@pytest.mark.slow
def test_default_scheme_is_never_wrong_on_the_reduced_grid(tmp_path):
    """In processes of its own, since a run that hangs would otherwise stop the tests."""
    assert main(["stress", "--quick", "--filters", "default", "--out", str(tmp_path), "--jobs", "2"]) == 0
    with open(tmp_path / "stress.csv", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(chosen(quick=True))
    assert [(row["cell"], row["sentence"]) for row in rows if row["verdict"] == "wrong"] == []


@pytest.mark.usefixtures("quick_references")
@pytest.mark.parametrize("cell", chosen(_PAPER), ids=lambda cell: cell.name)
def test_published_scheme_errs_only_in_accuracy(cell):
    """Its covariance is low by the width of its kernels, but it neither crashes nor loses mass."""
    verdict = _verdict(cell, "paper")
    assert verdict.verdict != "wrong" or verdict.sentence.startswith(("mean error", "cov error")), verdict
