"""A time budget, by a clock that is told what particles cost."""

import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

import sphfilter as sf
from sphfilter.filter import budget as budget_room
from sphfilter.filter import jump_markov_filter, sph_filter, update_again
from sphfilter.filter.budget import Budget
from sphfilter.model import symbolic
from sphfilter.prediction import automatic, ladder, predict

TEXT = ["x", "v"], ["v", "-0.4*v - x*(-1 + 0.1*x**2)"], [["0"], ["1"]], [[1.6]]
DUFFING = sf.SDE.from_expressions(*TEXT)
POSITION = sf.GaussianMeasurement(h=[[1.0, 0.0]], noise_cov=[[0.2]])
TIMES = np.arange(0.0, 21.0, 2.0)
_, Z = sf.simulate(DUFFING, POSITION, x0=[3.0, 0.0], times=TIMES, rng=1)
PREDICT, UPDATE = 1e-5, 2e-6  # seconds a particle
BUDGET = 5e-3


class Clock:
    """Time that passes only where predictions and updates are made, by their particles."""

    def __init__(self, monkeypatch):
        self.now, self.slower, self.predicted = 0.0, 1.0, []
        monkeypatch.setattr(budget_room, "clock", lambda: self.now)
        for room in (sph_filter, update_again, predict):
            monkeypatch.setattr(room, "predict", self._taking(sf.predict, PREDICT, self.predicted))
        tried = self._taking(automatic.propagate, PREDICT, self.predicted)
        monkeypatch.setattr(ladder, "automatic", SimpleNamespace(propagate=tried))
        monkeypatch.setattr(update_again, "update", self._taking(sf.update, UPDATE, []))
        for name, cost in (("predict_modes", PREDICT), ("update_or_predict_modes_again", UPDATE)):
            verb = getattr(jump_markov_filter, name)
            monkeypatch.setattr(jump_markov_filter, name, self._taking(verb, cost, []))

    def _taking(self, verb, cost, numbers):
        def timed(*args, **options):
            *before, density, info = verb(*args, **options)
            self.now += self.slower * cost * density.n_particles
            numbers.append(density.n_particles)
            return *before, density, info

        return timed


@pytest.fixture
def clock(monkeypatch):
    return Clock(monkeypatch)


def made(budget, n_particles=1000, **options):
    config = sf.FilterConfig(time_budget=budget, **options)
    return sf.SPHFilter(
        DUFFING, POSITION, [3.0, 0.0], np.diag([0.2, 1.0]), n_particles=n_particles, config=config
    )


def steps(flt, until=11, since=1):
    """Infos of predictions and updates."""
    return [
        (flt.predict(t=t), flt.update(z)) for t, z in zip(TIMES[since:until], Z[since:until], strict=True)
    ]


def test_as_many_particles_as_fit(clock):
    flt = made(BUDGET)
    flt.prepare(2.0)
    told = steps(flt)
    took = [predicted.seconds + updated.seconds for predicted, updated in told]
    assert max(took) <= BUDGET
    numbers = [updated.n_particles for _, updated in told]
    affordable = BUDGET / (PREDICT + UPDATE)
    assert affordable * 0.8 < min(numbers) and max(numbers) <= affordable
    assert all(predicted.status == updated.status == "ok" for predicted, updated in told)
    assert flt.n_particles == 1000  # what was asked for stays


def test_as_many_as_asked_for_where_time_is_plenty(clock):
    flt = made(1.0, n_particles=150)
    told = steps(flt)
    assert min(updated.n_particles for _, updated in told) > 100
    plain = made(None, n_particles=150)
    steps(plain)
    np.testing.assert_array_equal(flt.x, plain.x)


def test_a_machine_that_becomes_slow(clock):
    flt = made(BUDGET)
    flt.prepare(2.0)
    steps(flt, 4)
    clock.slower = 1.8
    (first, updated), *later = steps(flt, 10, since=4)
    assert "time budget exceeded" in first.status or "time budget exceeded" in updated.status
    assert max(p.seconds + u.seconds for p, u in later) <= BUDGET
    assert "of 5 ms" in updated.status


def test_never_fewer_than_a_lattice_needs(clock):
    """Sixty are tried first, in the rehearsal; they prove too few for two wells, so twice as many are."""
    flt = made(1e-4)
    told = steps(flt, 4)
    assert 40 < told[-1][1].n_particles <= 120
    predicted, _ = told[-1]
    assert predicted.status.endswith("of 0.1 ms") and predicted.seconds > 1e-4


def test_too_few_particles_are_remembered_for_a_while():
    budget, info = Budget(1e-9), sf.PredictInfo()
    numbers = []
    for made in (180, 50, 180, 180, *[50] * 20):  # on three times as many as were allowed: once, then twice
        budget.begin(step=True)
        numbers.append(budget.bound(1000, 60))
        budget.end("predict", info, made, repeated=False)
    assert numbers == [60] * 4 + [120] * 19 + [60]


def test_finer_predictions_need_time(clock):
    """A reading far out, where the prediction lost what the posterior hangs on."""
    outcomes = {}
    for budget in (2.5e-3, 1.0):
        flt = made(budget, n_particles=150)
        flt.prepare(2.0)
        flt.predict(2.0)
        before = len(clock.predicted)
        info = flt.update(flt.x[:1] + 5.5 * math.sqrt(flt.P[0, 0]))
        outcomes[budget] = info, len(clock.predicted) - before
    late, repeats = outcomes[2.5e-3]
    assert "no time to repeat the prediction on 3 times the particles" in late.status
    assert late.extrapolated > 0.01 and repeats == 0
    done, repeats = outcomes[1.0]
    assert "prediction repeated on" in done.status and repeats >= 1


def test_the_target_error_waits_for_time(clock):
    late = made(BUDGET, n_particles="auto", target_error=1e-4, density_error=0.01)  # on lattices
    late.prepare(2.0)
    told = steps(late, 3)
    assert any("no time for it" in note for predicted, _ in told for note in predicted.skipped)
    assert max(predicted.seconds + updated.seconds for predicted, updated in told) <= BUDGET
    ample = made(10.0, n_particles="auto", target_error=1e-4, density_error=0.01)
    steps(ample, 3)
    assert ample.n_particles > 3 * late.n_particles


def test_without_a_budget_time_is_told_and_nothing_hangs_on_it(clock, monkeypatch):
    known, usual = (made(None, n_particles=100) for _ in range(2))
    predicted, updated = steps(known, 2)[0]
    assert predicted.seconds > 0.0 and updated.seconds > 0.0
    ticks = itertools.count(0.0, 1e4)
    monkeypatch.setattr(budget_room, "clock", lambda: next(ticks))
    again = steps(usual, 2)[0]
    assert repr(again) == repr((predicted, updated)) and again[0].seconds >= 1e4
    assert np.array_equal(known.density.x, usual.density.x) and known.log_evidence == usual.log_evidence


def test_the_verbs_tell_their_time_too():
    start = sf.initialize(sf.Gaussian([0.0], [[0.5]]), n_particles=60)
    model, sensor = sf.LinearSDE([[-1.0]], noise=[[1.0]]), sf.GaussianMeasurement([[1.0]], [[0.1]])
    moved, predicted = sf.predict(start, model, 1.0)
    _, updated = sf.update(moved, sensor, [0.1])
    _, nothing = sf.update(moved, sensor, None)
    (transient,) = sf.propagate(start, model, [1.0]).infos
    assert min(info.seconds for info in (predicted, updated, nothing, transient)) > 0.0


def test_a_rehearsal_changes_nothing(clock):
    plain, prepared = (made(None, n_particles=120) for _ in range(2))
    prepared.prepare(2.0)
    assert prepared.t == 0.0 and prepared.density is not None
    for one, other in zip(steps(plain, 5), steps(prepared, 5), strict=True):
        assert one[0] == other[0] and one[1].log_evidence == other[1].log_evidence
    np.testing.assert_array_equal(plain.density.x, prepared.density.x)


def test_what_is_not_prepared_prepares_itself(clock):
    flt = made(BUDGET)
    told = steps(flt, 5)
    assert "time budget exceeded" in told[0][0].status  # the rehearsal is part of what the call took
    assert all(p.status == u.status == "ok" and p.seconds + u.seconds <= BUDGET for p, u in told[1:])


@pytest.mark.parametrize(
    "sensor", [None, POSITION, sf.LikelihoodMeasurement(lambda z, X, t: -abs(X[:, 0] - z))]
)
def test_nothing_is_compiled_after_a_rehearsal(monkeypatch, sensor):
    symbolic._compiled.cache_clear()
    model = sf.SDE.from_expressions(*TEXT)  # whose functions nobody has called
    flt = sf.SPHFilter(model, sensor, [3.0, 0.0], np.diag([0.2, 1.0]), n_particles=100)
    assert flt.prepare(2.0) > 0.0

    def compiled(self, signature):
        raise AssertionError(f"{self} was compiled")

    monkeypatch.setattr(Dispatcher, "compile", compiled)
    flt.predict(2.0)
    flt.update(2.0, POSITION if sensor is None else None)
    fallback, _ = sf.predict(flt.density, model, 0.1, sf.FilterConfig(scheme="cloud"))
    assert fallback.t == pytest.approx(2.1)


def test_prepare_wants_an_interval():
    with pytest.raises(sf.ModelError, match="prepare needs dt, the interval between measurements"):
        made(None, n_particles=60).prepare()
    with pytest.raises(sf.ModelError, match="dt must be greater than zero"):
        made(None, n_particles=60).prepare(-1.0)


def test_a_busy_spell_is_forgotten():
    """Steps that only repeat tell no cost; the memory of a busy machine ends all the same."""
    budget, info = Budget(1.0), sf.PredictInfo()
    for took in (50e-3, 1e-3, 1e-3):
        budget._costs["predict"].append((100, took, True))
    budget._costs["update"].append((100, 0.0, True))
    assert budget.bound(10_000, 1) == 20
    for _ in range(5):
        budget.begin(step=True)
        budget.end("predict", info, 100, repeated=True)
    assert budget.bound(10_000, 1) == 1000


def test_a_budget_is_kept_with_the_filter(tmp_path):
    flt = made(0.02, n_particles=80)
    flt.save(tmp_path / "filter.npz")
    again = sf.SPHFilter.load(tmp_path / "filter.npz", DUFFING, POSITION)
    assert again.config.time_budget == 0.02
    with pytest.raises(sf.ConfigError, match="time_budget"):
        sf.FilterConfig(time_budget=0.0)


def test_a_fallback_is_compiled_on_few_particles(monkeypatch):
    """On those of a filter that has many it would take minutes."""
    asked = []

    def noted(density, *arguments):
        asked.append(density.n_particles)
        return sf.predict(density, *arguments)

    monkeypatch.setattr(budget_room, "predict", noted)
    model = sf.SDE.from_expressions(["x", "v"], ["v", "x - x**3 - 0.3*v"], [["0"], ["0.5"]])
    flt = sf.SPHFilter(model, None, [0.0, 0.0], np.eye(2), config=sf.FilterConfig(time_budget=0.05))
    flt.prepare(0.5)
    assert asked and max(asked) < 200


SPRING = sf.SDE.from_expressions(*TEXT[:1], ["v", "-0.4*v - 2*sin(x)"], *TEXT[2:])
SWITCHING = sf.JumpMarkovModel({"wells": DUFFING, "spring": SPRING}, [[-0.1, 0.1], [0.2, -0.2]])


def switching(budget, target=0.01, model=SWITCHING):
    config = sf.FilterConfig(time_budget=budget, target_error=target)
    return sf.JumpMarkovFilter(model, POSITION, [3.0, 0.0], np.diag([0.2, 1.0]), config=config)


def test_modes_have_as_many_points_as_fit(clock):
    """Points of both modes, and of both passes of a reading, cost the same here."""
    plain, ample, flt = switching(None), switching(1e3), switching(0.06)
    flt.prepare(2.0)
    usual, same, told = (steps(each, 6) for each in (plain, ample, flt))
    assert ample.x.tobytes() == plain.x.tobytes() and ample.log_evidence == plain.log_evidence
    assert all(u.status == v.status for (_, u), (_, v) in zip(usual[1:], same[1:], strict=True))
    assert max(predicted.seconds + updated.seconds for predicted, updated in told) <= 0.06
    few, many = (np.array([updated.n_particles for _, updated in each]) for each in (told, usual))
    assert np.all(few < many / 3) and np.all(few > 1000)
    for (_, updated), (_, better) in zip(told, usual, strict=True):
        assert updated.error > better.error
        assert (sf.Code.COARSE in updated.code) == (updated.error > 0.025)  # from 2.5 targets on
    assert sum(sf.Code.COARSE in updated.code for _, updated in told) > 0


def test_modes_under_a_budget_that_nothing_keeps_are_late_on_the_fewest_points(clock):
    told = steps(switching(1e-5), 5)
    assert all(sf.Code.LATE in updated.code for _, updated in told)
    assert (
        max(density.n_particles for _, density in told[1:]) <= 2 * 2 * 256
    )  # modes, and who stayed and came


def test_sums_of_modes_go_to_an_error_that_there_is_time_for(monkeypatch):
    linear = [sf.LinearSDE([[0.0, 1.0], [0.0, 0.0]], [0.0, a], noise=[[0.0], [1.0]]) for a in (0.0, 3.0)]
    model = sf.JumpMarkovModel({"rest": linear[0], "pushed": linear[1]}, [[-0.5, 0.5], [0.5, -0.5]])
    Clock(monkeypatch)
    plain, flt = switching(None, model=model), switching(1e-3, model=model)
    usual, told = steps(plain, 6), steps(flt, 6)
    for (predicted, updated), (finer, better) in zip(told[1:], usual[1:], strict=True):
        assert predicted.n_substeps < finer.n_substeps and updated.error > better.error
    assert np.abs(flt.x - plain.x).max() < 3.0 * told[-1][1].error * np.sqrt(plain.P.diagonal().max())


def test_a_reading_far_out_is_predicted_again_where_there_is_time(clock):
    model, sharp = drifts(), sf.GaussianMeasurement([[1.0]], [[4e-4]])
    for budget, code in ((1e3, sf.Code.REPEATED), (None, sf.Code.REPEATED), (1e-5, sf.Code.LATE)):
        config = sf.FilterConfig(time_budget=budget)
        start = {"mode_probabilities": {"rest": 1.0}, "config": config}
        flt = sf.JumpMarkovFilter(model, sharp, [0.0], [[0.01]], **start)
        flt.predict(1.0)
        info = flt.update([0.7])
        assert code in info.code and info.flagged == (code == sf.Code.LATE)


def drifts():
    modes = {name: sf.LinearSDE([[0.0]], [v], noise=[[0.2]]) for name, v in (("rest", 0.0), ("moving", 1.0))}
    return sf.JumpMarkovModel(modes, [[-0.01, 0.01], [0.01, -0.01]])


def test_a_cloud_has_as_many_points_as_fit(clock):
    """Without n_particles; three states, at a target that asks for tens of thousands."""
    flow = sf.SDE.from_expressions(
        ["x", "y", "z"], ["10*(y - x)", "x*(28 - z) - y", "x*y - 8/3*z"], np.eye(3).astype(str).tolist()
    )
    sensor = sf.GaussianMeasurement(np.eye(3)[:1], [[1.0]])
    numbers = {}
    for budget in (None, 0.05):
        config = sf.FilterConfig(time_budget=budget, target_error=0.003)
        flt = sf.SPHFilter(flow, sensor, [-6.0, -9.0, 20.0], np.eye(3), config=config)
        told = [(flt.predict(0.3), flt.update(z)) for z in ([-7.0], [-5.0], [-8.0], [-9.0])]
        numbers[budget] = [predicted.seconds + updated.seconds for predicted, updated in told[1:]], flt
    took, flt = numbers[0.05]
    assert max(took) <= 0.05 and 256 <= flt.density.n_particles < numbers[None][1].density.n_particles / 4
