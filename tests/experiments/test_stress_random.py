"""Random problems: their generator, relations and referees, the judge judged, and fixed seeds."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from random_cases import (
    NarrowFilter,
    PriorFilter,
    WarningFilter,
    double_well,
    made_with,
    oscillator,
    verdict_of,
)
from scipy.integrate import trapezoid

import sphfilter as sf
from experiments.__main__ import main
from experiments.stress.pool import Lost
from experiments.stress.random import command, referees
from experiments.stress.random.equations import Equation
from experiments.stress.random.problems import RandomCase
from experiments.stress.random.readers import KINDS
from experiments.stress.random.records import Record, record_of
from experiments.stress.random.referees import Referee, referee
from experiments.stress.random.relations import RELATIONS, related
from experiments.stress.random.verdicts import judge, relation
from reference_filters.grid import GridFilter
from reference_filters.kalman import KalmanFilter


def test_a_problem_is_made_alone_from_its_seed_and_number():
    first, again, other, seed = (
        RandomCase(number).problem(seed) for number, seed in ((3, 1), (3, 1), (4, 1), (3, 2))
    )
    assert str(first) == str(again) and np.array_equal(first.z[0], again.z[0])
    assert len({str(p) for p in (first, other, seed)}) == 3


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "bearing"])  # which is wrapped
def test_likelihoods_are_densities_of_what_is_sampled(kind):
    """Integrated over the reading they give one, and their mean is that of samples."""
    rng = np.random.default_rng(5)
    paths = rng.normal(0.5, 0.8, (64, 5, 1))
    reader, x = KINDS[kind](rng, paths.reshape(-1, 1), kind), np.array([0.7])
    samples = np.array([reader.sample(x, rng) for _ in range(4000)])
    middle, spread = np.median(samples), max(np.ptp(samples), 1e-9)
    if kind in ("Poisson", "quantised"):
        values = np.unique(samples)
        p = np.exp([reader.sensor.log_likelihood([z], x[None])[0] for z in values])
        assert p.sum() == pytest.approx(1.0, abs=5e-3)
        share = (samples == values[p.argmax()]).mean()
        assert share == pytest.approx(p.max(), abs=0.04)
    else:
        offsets = spread * np.sinh(np.linspace(-9.0, 9.0, 3001)) / 100.0  # fine in the middle, far out
        p = np.exp([reader.sensor.log_likelihood([middle + d], x[None])[0] for d in offsets])
        assert trapezoid(p, offsets) == pytest.approx(1.0, abs=5e-3)
        near = np.abs(offsets) < 0.1 * spread
        share = (np.abs(samples - middle) < 0.1 * spread).mean()
        assert share == pytest.approx(trapezoid(p[near], offsets[near]), abs=0.04)


def test_equations_in_other_coordinates_are_the_same():
    noise = (("0.3", "0"), ("0.5*sqrt(1 + 0.5*x0**2)", "0.2*sin(3.0*t)"))
    equation = Equation(states=("x0", "x1"), drift=("x1 - t*x0", "exp(-x0)*tanh(x1)"), noise=noise)
    T, c, lag = np.array([[2.0, 0.5], [-0.3, 1e-6]]), np.array([0.2, -1.0]), 40.0
    moved = equation.moved(T, c, lag).model
    y, t = np.array([[0.4, 2.0], [-1.0, 0.3]]), 0.7
    x, back = y @ T.T + c, np.linalg.inv(T)
    np.testing.assert_allclose(moved.drift(y, t + lag), equation.model.drift(x, t) @ back.T, rtol=1e-9)
    np.testing.assert_allclose(moved.noise(y, t + lag), back @ equation.model.noise(x, t), rtol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_sensors_in_other_coordinates_and_in_halves_are_the_same(kind):
    rng = np.random.default_rng(8)
    reader = KINDS[kind](rng, rng.standard_normal((80, 2)), kind)
    T, c = np.array([[1e3, 2.0], [-30.0, 1e-3]]), np.array([0.2, -1.0])
    y = np.linalg.solve(T, (rng.standard_normal((6, 2)) - c).T).T
    z = reader.sample(np.array([0.1, 0.4]), rng)
    there, lower = reader.moved(T, c)
    half, constant = reader.halved()
    expected = reader.sensor.log_likelihood(z, y @ T.T + c)
    np.testing.assert_allclose(there.sensor.log_likelihood(z - lower, y), expected, rtol=1e-6, atol=1e-6)
    both = 2.0 * half.sensor.log_likelihood(z, y @ T.T + c) + constant
    np.testing.assert_allclose(both, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", [name for name in RELATIONS if name != "pulse"])
def test_an_exact_filter_keeps_the_relations(name):
    problem = oscillator()

    def kalman(problem):
        return KalmanFilter(problem.model, None, problem.x0, problem.P0, problem.t0)

    there = related(problem, name, 1, 1)
    assert there is not problem
    found = record_of(there, kalman), record_of(problem, kalman)
    for what in ("x", "P", "log_evidence"):
        last = [np.cumsum(getattr(r, what), axis=0) for r in found]  # order and halves differ within an epoch
        np.testing.assert_allclose(*last, rtol=1e-6, atol=1e-8)
    assert relation(found[1], found[0]) == ("holds", "")


@pytest.mark.parametrize(
    "kind, verdict",
    [(GridFilter, "right"), (PriorFilter, "wrong, silent"), (NarrowFilter, "wrong, silent"),
     (WarningFilter, "wrong, flagged")],
)  # fmt: skip
def test_the_judge_tells_right_from_wrong(kind, verdict):
    problem = double_well()
    found = referee(problem, 1)
    assert found.name == "grid" and found.n_trusted == 4
    # a filter that learns nothing keeps most relations: references must judge, too
    partners = {name: record_of(related(problem, name, 1, 1), made_with(kind)) for name in ("eight", "clock")}
    judged = judge(record_of(problem, made_with(kind)), found, partners)
    assert judged.verdict == verdict
    assert set(judged.related.values()) == {"holds"}


def _record(**changes):
    x, P = np.zeros((3, 1)), np.ones((3, 1, 1))
    quiet = {"error": np.zeros(3), "flagged": np.zeros(3, dtype=bool)}
    return Record(**({"end": "finished", "x": x, "P": P, "log_evidence": np.zeros(3)} | quiet | changes))


_EXACT = Referee("exact", np.zeros((3, 1)), np.ones((3, 1, 1)), np.zeros(3), np.zeros((3, 3)), 3)
_OFF = {"x": np.array([[0.0], [0.25], [0.0]])}


@pytest.mark.parametrize(
    "changes, verdict, part",
    [
        ({}, "right", ""),
        ({"flagged": np.array([False, True, False])}, "right, flagged", ""),
        (_OFF, "wrong, silent", "mean off by 0.25 at epoch 2"),
        (_OFF | {"flagged": np.array([True, False, False])}, "wrong, flagged", "mean"),
        # a flag that comes after the error was too late
        (_OFF | {"flagged": np.array([False, False, True])}, "wrong, silent", "mean"),
        (_OFF | {"end": "refused", "sentence": "no further"}, "wrong, silent", "mean"),
        ({"P": np.full((3, 1, 1), 1.25)}, "wrong, silent", "variance off by 0.25"),
        ({"log_evidence": np.full(3, 0.11)}, "wrong, silent", "evidence off by 0.33 at epoch 3"),
        ({"x": np.full((3, 1), np.nan)}, "wrong, silent", "mean"),
        ({"end": "refused", "sentence": "no further"}, "refused", "no further"),
        ({"end": "refused", "sentence": "the model blew up"}, "no answer", "blew up"),
        ({"end": "crash", "sentence": "IndexError"}, "crash", "IndexError"),
        ({"end": "timeout", "sentence": "stopped"}, "crash", "stopped"),
    ],
)
def test_verdicts(changes, verdict, part):
    found = judge(_record(**changes), _EXACT, {})
    assert found.verdict == verdict and part in found.sentence


def test_verdicts_of_relations_and_without_reference():
    base, off, none = _record(), _record(**_OFF), Referee(why="none")
    assert judge(base, none, {"eight": base}).verdict == "no reference"
    found = judge(base, none, {"eight": off})
    assert found.verdict == "wrong, silent" and "relation 'eight': mean off by 0.25" in found.sentence
    flagged = _record(**_OFF, flagged=np.ones(3, dtype=bool))
    assert judge(base, _EXACT, {"eight": flagged}).related == {"eight": "differs, flagged"}
    refused = _record(end="refused", sentence="no further")
    assert judge(base, _EXACT, {"units": refused}).related == {"units": "refused"}
    assert judge(base, _EXACT, {"units": Record("crash", "died")}).verdict == "crash"
    # a sentence that the model blew up is none where a reference goes on
    short = _record(end="refused", sentence="the model blew up", x=base.x[:1], P=base.P[:1],
                    log_evidence=np.zeros(1), flagged=base.flagged[:1])  # fmt: skip
    assert judge(short, _EXACT, {}).verdict == "refused"


def test_a_covariance_without_inverse_judges_nothing():
    P = np.array([[[1.0]], [[0.0]], [[np.nan]]])
    assert referees.errors_of(np.zeros((3, 2)), np.ones((3, 2, 2)), np.zeros(3), Referee()).shape == (3, 0)
    none = Referee("", np.zeros((3, 1)), P, np.zeros(3))
    errors = referees.errors_of(np.zeros((3, 1)), np.ones((3, 1, 1)), np.zeros(3), none)
    assert np.isfinite(errors[:, 0]).all() and np.isnan(errors[:2, 1:]).all()


def test_clouds_know_their_own_error():
    problem = oscillator()
    exact = referee(problem, 1)
    assert exact.name == "Kalman filter"
    clouds = referees._clouds(problem, 1, 10_000)
    errors = referees.errors_of(clouds.x, clouds.P, clouds.log_evidence, exact)
    rms = np.sqrt(np.mean(errors**2, axis=1))
    assert (rms < 3.0 * np.sqrt(np.mean(clouds.own**2, axis=1))).all()
    assert clouds.n_trusted == 5
    few = referees._clouds(problem, 1, 100)
    assert few.n_trusted < 5 and "errors" in few.why


def test_command_writes_its_files_and_resumes(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(command, "_WARM", ())
    run = ["stress", "--random-case", _CASE, "--out", str(tmp_path)]
    assert main(run) == 0
    assert "epochs against grid" in capsys.readouterr().out
    with open(tmp_path / "random.csv", encoding="utf-8") as file:
        (row,) = csv.DictReader(file)
    assert f"{row['seed']}:{row['number']}" == _CASE and row["verdict"] == "right"
    assert row["relations"].count("holds") == 2 and float(row["mean_error"]) < 0.2
    assert "| all | 1 | 1 | 0" in (tmp_path / "random.md").read_text()
    stamps = [p.stat().st_mtime_ns for p in sorted(tmp_path.rglob("*.npz"))]
    assert main(run) == 0
    assert stamps == [p.stat().st_mtime_ns for p in sorted(tmp_path.rglob("*.npz"))] and len(stamps) == 4
    assert main(["stress", "--random", "1", "--only", "units"]) == 1
    assert "choose from the grid" in capsys.readouterr().err


@pytest.mark.slow
def test_the_default_filter_is_judged_beside_the_one_of_so_many_particles(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(command, "_WARM", ())
    for auto in ([], ["--auto"]):
        assert main(["stress", "--random-case", _CASE, "--out", str(tmp_path), *auto]) == 0
    assert "auto particles" in capsys.readouterr().out
    with open(tmp_path / "random.csv", encoding="utf-8") as file:
        (row,) = csv.DictReader(file)
    assert row["n_particles"] == "auto" and row["verdict"] == "right"
    assert len(list(tmp_path.rglob("reference.npz"))) == 1  # the same for either
    assert len(list(tmp_path.rglob("default.npz"))) == 2
    assert main(["stress", "--auto"]) == 1
    assert "goes with" in capsys.readouterr().err


def test_a_process_that_dies_is_a_verdict(tmp_path, capsys, monkeypatch):
    lost = Lost("the process died", timeout=False)

    def all_die(function, tasks, n_jobs, limit, done):
        for task in tasks:
            done(task, lost)

    monkeypatch.setattr(command, "run_tasks", all_die)
    monkeypatch.setattr(command, "_WARM", ())
    assert main(["stress", "--random", "1", "--seed", "1", "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "crash: --random-case 1:0: the process died [2 states" in said
    assert "| 1:0 | 2 |" in (tmp_path / "random.md").read_text()


#: A case that is right and quick, in the words of the command line.
_CASE = "1:12"
#: Cases that take seconds, of all numbers of states.
_QUICK = [2, 3, 5, 10, 11, 12, 14, 15, 16, 28]


@pytest.mark.parametrize("number", _QUICK)
def test_random_problems_are_right_or_flagged(number):
    found = verdict_of(1, number)
    assert found.verdict in ("right", "right, flagged", "no reference"), found.sentence


@pytest.mark.slow
def test_random_problems_are_never_silently_wrong(tmp_path):
    """In processes of their own, since one that crashes or hangs would otherwise end the tests."""
    assert main(["stress", "--random", "60", "--seed", "7", "--out", str(tmp_path), "--jobs", "2"]) == 0
    with open(tmp_path / "random.csv", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    bad = [row for row in rows if row["verdict"] in ("wrong, silent", "crash")]
    assert [(row["number"], row["sentence"]) for row in bad] == []


@pytest.mark.parametrize("number", ["31:30", "43:59"])
def test_problems_that_once_ended_with_a_matrix_error_are_followed(number):
    """A family whose nodes have hardly any weight is none: the next rung goes on."""
    seed, k = map(int, number.split(":"))
    assert record_of(RandomCase(number=k, auto=True).problem(seed)).end == "finished"


def test_a_tail_that_the_next_reading_asks_for_is_not_lost():
    """Cubes read of a state near zero leave a plateau; without its tail a family was off by .12."""
    problem = RandomCase(number=8, auto=True).problem(31)
    own, fine = record_of(problem), record_of(replace(problem, n_particles=800))
    std = np.sqrt(np.diagonal(fine.P, axis1=1, axis2=2))
    assert np.abs((own.x - fine.x) / std).max() < 0.05
    # the first posterior is a family's: of its tail the points that follow know no more, and say half of it
    np.testing.assert_allclose(np.diagonal(own.P, axis1=1, axis2=2), std**2, rtol=0.15)
    for config in (sf.FilterConfig(density_error=0.01), sf.FilterConfig(scheme="cloud")):
        flt = sf.SPHFilter(problem.model, None, problem.x0, problem.P0, t0=problem.t0, config=config)
        for k, t in enumerate(problem.times):
            if t > flt.t:
                flt.predict(t=t)
            for reader, z in zip(problem.readers, problem.z, strict=True):
                flt.update(z[k], reader.sensor)
            np.testing.assert_allclose(np.diag(flt.P), std[k] ** 2, rtol=0.1)
