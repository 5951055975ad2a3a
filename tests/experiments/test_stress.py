"""Hard and random problems: generators, relations, referees, the judge judged, the pool, the command."""

import os
import time
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from csv_rows import csv_rows
from scipy.integrate import trapezoid
from stress_cases import (
    BreakingFilter,
    NarrowFilter,
    PriorFilter,
    WarningFilter,
    check_right,
    double_well,
    made_with,
    oscillator,
    verdict_of,
)

import sphfilter as sf
from experiments.__main__ import main
from experiments.stress import picture, pool, referees, runs, told
from experiments.stress.equations import Equation
from experiments.stress.hard_cases import chosen, hard_cases
from experiments.stress.hard_systems import line, position
from experiments.stress.problem import Problem
from experiments.stress.random_cases import RandomCase
from experiments.stress.random_sensors import KINDS
from experiments.stress.records import FILTERS, Record, record_of
from experiments.stress.referees import Referee, referee
from experiments.stress.relations import RELATIONS, related
from experiments.stress.verdicts import VERDICTS, judge, relation
from reference_filters.grid import GridFilter
from reference_filters.kalman import KalmanFilter
from sphfilter.errors import ConfigError, SphfilterError


def test_cases_have_unique_names_and_the_same_bits_each_time():
    every = hard_cases(1)
    assert len({case.name for case in every}) == len(set(every)) > 200
    hard = [chosen(seed, ["unstable/growth/5"])[0] for seed in (1, 1, 2)]
    drawn = [RandomCase(*pair) for pair in ((1, 3), (1, 3), (2, 3))]
    for first, again, *others in (hard, drawn):
        one, two = first.problem(), again.problem()
        assert str(one) == str(two) and np.array_equal(one.z[0], two.z[0])
        for other in (case.problem() for case in others):
            assert not np.array_equal(one.z[0], other.z[0])


def test_unknown_cell_is_refused_with_the_nearest_name():
    with pytest.raises(ConfigError, match="did you mean 'outlier'"):
        chosen(1, ["outlyer"])


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
        return KalmanFilter(*problem.start)

    there = related(problem, name, (1, 1))
    assert there is not problem
    found = record_of(there, kalman), record_of(problem, kalman)
    for what in ("x", "P", "log_evidence"):
        last = [np.cumsum(getattr(r, what), axis=0) for r in found]  # order and halves differ within an epoch
        np.testing.assert_allclose(*last, rtol=1e-6, atol=1e-8)
    assert relation(found[1], found[0]) == ("holds", "")


@pytest.mark.parametrize(
    "kind, verdict",
    [(GridFilter, "right"), (PriorFilter, "wrong, silent"), (NarrowFilter, "wrong, silent"),
     (WarningFilter, "wrong, flagged"), (BreakingFilter, "wrong, silent")],
)  # fmt: skip
def test_the_judge_tells_right_from_wrong(kind, verdict):
    problem = double_well()
    found = referee(problem, 1)
    assert found.name == "grid" and found.n_trusted == 4
    # a filter that learns nothing keeps most relations: references must judge, too
    partners = {
        name: record_of(related(problem, name, (1, 1)), made_with(kind)) for name in ("eight", "clock")
    }
    judged = judge(record_of(problem, made_with(kind)), found, partners)
    assert judged.verdict == verdict
    assert set(judged.related.values()) <= {"holds"}
    assert kind is not BreakingFilter or "changed" in judged.sentence


def _record(**changes):
    x, P = np.zeros((3, 1)), np.ones((3, 1, 1))
    quiet = {"told": np.zeros((3, 3)), "flagged": np.zeros(3, dtype=bool)}
    return Record(**({"end": "finished", "x": x, "P": P, "log_evidence": np.zeros(3)} | quiet | changes))


_EXACT = Referee("exact", np.zeros((3, 1)), np.ones((3, 1, 1)), np.zeros(3), np.zeros((3, 3)), 3)
_OFF = {"x": np.array([[0.0], [0.25], [0.0]])}


@pytest.mark.parametrize(
    "changes, verdict, part",
    [
        ({}, "right", ""),
        ({"flagged": np.array([False, True, False])}, "right, flagged", ""),
        ({"x": np.full((3, 1), 0.19)}, "right", ""),
        (_OFF, "wrong, silent", "mean off by 0.25 at epoch 2"),
        (_OFF | {"flagged": np.array([True, False, False])}, "wrong, flagged", "mean"),
        # a flag that comes after the error was too late
        (_OFF | {"flagged": np.array([False, False, True])}, "wrong, silent", "mean"),
        (_OFF | {"end": "refused", "sentence": "no further"}, "wrong, silent", "mean"),
        ({"P": np.full((3, 1, 1), 1.25)}, "wrong, silent", "variance off by 0.25"),
        ({"log_evidence": np.full(3, 0.11)}, "wrong, silent", "evidence off by 0.33 at epoch 3"),
        ({"log_evidence": np.full(3, np.inf)}, "wrong, silent", "evidence"),
        ({"x": np.full((3, 1), np.nan)}, "wrong, silent", "mean"),
        ({"fault": "the masses sum to 0.98"}, "wrong, silent", "masses"),
        ({"end": "refused", "sentence": "no further"}, "refused", "no further"),
        ({"end": "refused", "sentence": "the model blew up"}, "no answer", "blew up"),
        ({"end": "crash", "sentence": "IndexError"}, "crash", "IndexError"),
        ({"end": "timeout", "sentence": "stopped"}, "crash", "stopped"),
    ],
)
def test_verdicts(changes, verdict, part):
    found = judge(_record(**changes), _EXACT)
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
    assert judge(short, _EXACT).verdict == "refused"


def test_a_known_truth_judges_where_no_reference_is_certain():
    uncertain = replace(_EXACT, n_trusted=1, why="noisy")
    assert judge(_record(), uncertain, truth=np.full((3, 1), 4.0)).verdict == "no reference"
    # twenty standard deviations from the truth are absurd without any reference
    assert judge(_record(), uncertain, truth=np.full((3, 1), 20.0)).verdict == "wrong, silent"
    flagged = _record(flagged=np.ones(3, dtype=bool))
    assert judge(flagged, uncertain, truth=np.full((3, 1), 20.0)).verdict == "wrong, flagged"


@pytest.mark.parametrize(
    "P, weights, part",
    [
        (np.eye(2), np.full(4, 0.25), ""),
        (np.eye(2), np.full(4, 0.24), "masses sum to 0.96"),
        (np.diag([1.0, -1.0]), np.ones(1), "variance not positive: -1"),
        (np.array([[1.0, 1.1], [1.1, 1.0]]), np.ones(1), "negative eigenvalue"),
        (np.array([[1.0, np.nan], [np.nan, 1.0]]), np.ones(1), "not finite"),
    ],
)
def test_what_no_filter_may_do_is_seen(P, weights, part, monkeypatch):
    monkeypatch.setattr(KalmanFilter, "_moments", lambda self, belief: (np.zeros(2), P))
    monkeypatch.setattr(KalmanFilter, "_finite_moments", lambda self, belief, *step: (np.zeros(2), P))
    monkeypatch.setattr(KalmanFilter, "weights", weights, raising=False)
    found = record_of(oscillator(), lambda problem: KalmanFilter(*problem.start))
    assert found.end == "finished" and part in found.fault and bool(part) == bool(found.fault)


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


def test_clouds_know_what_their_steps_are_off_by(monkeypatch):
    problem, make = oscillator(), referees._cloud
    good = referees._clouds(problem, 1, 1000)

    def bent(problem, size, tolerance, seed):
        x, P, log_evidence = make(problem, size, tolerance, seed)
        return x + (tolerance is None) * np.sqrt(np.diagonal(P, axis1=1, axis2=2)), P, log_evidence

    monkeypatch.setattr(referees, "_cloud", bent)
    clouds = referees._clouds(problem, 1, 1000)
    assert np.array_equal(clouds.x, good.x)
    assert (clouds.own[0] > 0.25).all() and (good.own[0] < 0.1).all()


def test_a_grid_that_may_have_cut_a_posterior_is_no_reference():
    """Two grids agree here within .02 on a variance that both have wrong by .13."""
    z, times = np.array([[8.0], [4.8]]), np.array([0.2, 0.7])
    about = {"equation": line("decay", 0.5), "readers": (position(1, 0.3),), "z": (z,), "times": times}
    problem = Problem(**about, x0=np.zeros(1), P0=np.eye(1))
    with pytest.raises(SphfilterError, match="tail of its prior"):
        referees._grids(problem, 1)


def test_pool_survives_hangs_and_deaths():
    """Functions of the standard library: the processes then start in no time."""
    got = {}
    pool.run_tasks(time.sleep, [0.0, 60.0, 0.01], 1, lambda task: 1.0, got.__setitem__)
    assert got[0.0] is None and got[0.01] is None
    assert got[60.0].timeout and "1 s" in got[60.0].sentence
    pool.run_tasks(os._exit, [3], 1, lambda task: 60.0, got.__setitem__)
    assert not got[3].timeout and "died" in got[3].sentence


@pytest.fixture
def compiled(monkeypatch):
    """A command that makes no examples first: what is run compiles by itself."""
    monkeypatch.setattr(runs, "_warm_up", lambda *given: None)


def test_errors_told_are_counted_beside_those_made_that_stand_out_of_the_reference(tmp_path):
    """Of three means off by 0, .25 and .01, the reference's own error .01, the second is told to a fifth."""
    off, own = np.array([0.0, 0.25, 0.01]), np.full((3, 3), 0.01)
    record = _record(x=off[:, None], told=np.full((3, 3), 0.05), held=np.array(["family", "cloud", "cloud"]))
    reference = replace(_EXACT, own=own)
    found = told.told_of(oscillator(), record, reference, judge(record, reference))
    assert found == [("mean", "cloud", 2, 0.05, 0.25)]
    shares = ("0.2", "0.2", "0.2", "1", "0")
    lines = [("mean", held, states, "1", *shares) for held, states in (("all", "all"), ("cloud", "all"))]
    assert told.lines(found) == [*lines, ("mean", "cloud", "2", "1", *shares)]
    assert told.draw(tmp_path / "told.png", found).stat().st_size > 10_000


def test_flags_are_counted_of_right_and_of_wrong_readings():
    """Means off by .02, .25 and .02, the last by no good reference: one right, one wrong, neither so said."""
    off, own = np.array([0.02, 0.25, 0.02]), np.full((3, 3), 0.001)
    own[0, 2] = 0.1
    record = _record(x=off[:, None], flagged=np.array([True, False, False]))
    reference = replace(_EXACT, own=own)
    flags = told.flags_of(record, reference, judge(record, reference))
    np.testing.assert_array_equal(flags, [[True, True], [False, False]])
    assert [line[1:] for line in told.flag_lines([flags, flags])] == [("2", "1"), ("2", "0")]


@pytest.mark.parametrize(
    "options, name, reference, n_parts",
    [
        pytest.param(["--random-case", "1:12"], "random", "grid", 4, marks=pytest.mark.slow),
        (["--only", "repeated_times/linear/1", "--methods", "pf1e4"], "stress", "Kalman filter", 2),
    ],
)
@pytest.mark.usefixtures("compiled")
def test_command_writes_its_files_and_resumes(options, name, reference, n_parts, tmp_path, capsys):
    # seconds a run: compiling beside other work has taken more than the minute that is usual
    command = ["stress", *options, "--limit", "1800", "--out", str(tmp_path)]
    assert main(command) == 0
    said = capsys.readouterr().out
    (row,) = csv_rows(tmp_path / f"{name}.csv")
    assert row["reference"] == reference and row["verdict"] == "right" and float(row["mean_error"]) < 0.2
    assert row["seed"] == "1" and row["relations"].count("holds") == n_parts - 2
    text = (tmp_path / f"{name}.md").read_text()
    assert "| all | 1 | 1 | 0" in text and f"sphfilter {sf.__version__}" in text
    assert ("epochs against grid" in said) == (name == "random")
    assert name == "random" or (tmp_path / "stress.png").stat().st_size > 5000
    stamps = [p.stat().st_mtime_ns for p in sorted(tmp_path.rglob("*.npz"))]
    assert main(command) == 0
    assert stamps == [p.stat().st_mtime_ns for p in sorted(tmp_path.rglob("*.npz"))]
    assert len(stamps) == n_parts


def test_command_refuses_what_does_not_go_together(capsys):
    assert main(["stress", "--random", "1", "--only", "units"]) == 1
    assert "choose from the grid" in capsys.readouterr().err
    assert main(["stress", "--filters", "ukf"]) == 1
    assert "no filter 'ukf'" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.usefixtures("compiled")
def test_the_default_filter_is_judged_beside_the_one_of_so_many_particles(tmp_path, capsys):
    assert main(["stress", "--random-case", "1:12", "--out", str(tmp_path)]) == 0
    assert main(["stress", "--random-case", "1:12", "--out", str(tmp_path), "--auto"]) == 0
    assert "auto particles" in capsys.readouterr().out
    (row,) = csv_rows(tmp_path / "random.csv")
    assert row["n_particles"] == "auto" and row["verdict"] == "right"
    assert len(list(tmp_path.rglob("reference.npz"))) == 1  # the same for either
    assert [len(list(tmp_path.rglob(f"{name}.npz"))) for name in ("default", "auto")] == [1, 1]


@pytest.mark.usefixtures("compiled")
def test_a_process_that_dies_is_a_verdict(tmp_path, capsys, monkeypatch):
    lost = pool.Lost("the process died", timeout=False)

    def all_die(function, tasks, n_jobs, limit, done):
        for task in tasks:
            done(task, lost)

    monkeypatch.setattr(runs, "run_tasks", all_die)
    assert main(["stress", "--random", "1", "--seed", "1", "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "crash: --random-case 1:0: the process died [2 states" in said
    assert "| 1:0 | default | 2 |" in (tmp_path / "random.md").read_text()


def test_every_verdict_of_every_filter_can_be_drawn(tmp_path):
    places = [
        {"family": f"{k % 3}", "system": f"{k // 6}", "unit": "s", "level": f"{k % 2}"} for k in range(8)
    ]
    rows = [
        place | {"filter": name, "verdict": verdict}
        for place, verdict in zip(places, VERDICTS, strict=True)
        for name in FILTERS
    ]
    assert picture.draw(tmp_path / "some.png", rows).stat().st_size > 5000


#: Cases of the reduced grid that take a second or less, most with an exact reference.
_WALK = [
    "process_noise/linear", "no_noise/decay", "noise_on_some_rows", "unstable", "dimension/linear_chain/[13]",
    "sensor_noise/linear/100", "interval/linear", "near-singular_start/linear*",
    "badly_scaled_start/linear/1e-06", "units", "outlier/tanh_drift", "outlier/linear/3",
    "missing_data/linear", "long_run/linear", "repeated_times",
]  # fmt: skip
_PAPER = [
    "no_noise/decay/6", "units/states/1e+06", "outlier/linear/20", "unstable/growth/1",
    "missing_data/linear/1", "particles/linear/20", "blow-up/square/0.7",
]  # fmt: skip


@pytest.mark.parametrize("case", chosen(1, _WALK, quick=True), ids=str)
def test_default_filter_is_right_on_hard_cases_or_refuses(case):
    problem = case.problem()
    check_right(problem, record_of(problem), referee(problem, 1))


@pytest.mark.slow
@pytest.mark.parametrize("options", [["--quick", "--filters", "default"], ["--random", "60", "--seed", "7"]])
def test_default_filter_is_never_silently_wrong(options, tmp_path):
    """In processes of their own, since one that crashes or hangs would otherwise end the tests."""
    assert main(["stress", *options, "--out", str(tmp_path), "--jobs", "2"]) == 0
    (path,) = tmp_path.glob("*.csv")
    rows, hard = csv_rows(path), "--quick" in options
    assert len(rows) == (len(chosen(1, quick=True)) if hard else 60)
    bad = [row for row in rows if row["verdict"] in ("wrong, silent", "crash")]
    if hard:  # may take too long, and be far off from where it openly refused a reading
        bad = [row for row in bad if not row["sentence"].startswith("stopped after")]
        told = [row for row in rows if row["verdict"] == "wrong, flagged" and "not used" not in row["said"]]
        bad += [row for row in told if float(row["mean_error"]) > 0.2 or float(row["variance_error"]) > 0.25]
    assert [(row["case"], row["sentence"]) for row in bad] == []


@pytest.mark.parametrize("case", chosen(1, _PAPER), ids=str)
def test_published_scheme_errs_only_in_accuracy(case, monkeypatch):
    """Its covariance is low by the width of its kernels, but it neither crashes nor loses mass."""
    # particles that blow up are no reference either, and take long to find it
    monkeypatch.setattr(referees, "_few_or_many", lambda *given: Referee(why="none"))
    found = verdict_of(case, partial(FILTERS["paper"], seed=1))
    accuracy = found.sentence.startswith(("mean off", "variance off", "evidence off"))
    assert found.verdict != "crash" and (found.verdict != "wrong, silent" or accuracy), found


#: Numbers of random cases that take seconds, of all numbers of states; two are like 5 and 28, and dearer.
_QUICK = [2, 3, 5, 10, 12, 14, 15, 28, *(pytest.param(k, marks=pytest.mark.slow) for k in (11, 16))]


@pytest.mark.parametrize("number", _QUICK)
def test_random_problems_are_right_or_flagged(number):
    found = verdict_of(RandomCase(1, number))
    assert found.verdict in ("right", "right, flagged", "no reference"), found.sentence


@pytest.mark.parametrize("pair", [(31, 30), pytest.param((43, 59), marks=pytest.mark.slow)])
def test_problems_that_once_ended_with_a_matrix_error_are_followed(pair):
    """A family whose nodes have hardly any weight is none: the next rung goes on."""
    assert record_of(replace(RandomCase(*pair).problem(), n_particles="auto")).end == "finished"


def test_a_reading_that_no_peak_explains_is_flagged_on_few_nodes():
    """A quantised sensor without noise: its likelihood is zero at all peaks that are looked for."""
    problem = RandomCase(65537, 4).problem()
    flt = sf.SPHFilter(problem.model, None, problem.x0, problem.P0, t0=problem.t0, n_particles=200)
    flt.predict(t=problem.times[0])
    assert flt.update(problem.z[0][0], problem.readers[0].sensor).flagged


def test_a_tail_that_the_next_reading_asks_for_is_not_lost():
    """Cubes read of a state near zero leave a plateau; without its tail a family was off by .12."""
    problem = replace(RandomCase(31, 8).problem(), n_particles="auto")
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
