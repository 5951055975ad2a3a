"""A time budget, by a clock that is told what particles cost."""

import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

import sphfilter as sf
from sphfilter.filter import budget as budget_room
from sphfilter.filter import sph_filter, update_again
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

    def _taking(self, verb, cost, numbers):
        def timed(*args, **options):
            density, info = verb(*args, **options)
            self.now += self.slower * cost * density.n_particles
            numbers.append(density.n_particles)
            return density, info

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
    late = made(BUDGET, n_particles="auto", target_error=1e-4)
    late.prepare(2.0)
    told = steps(late, 3)
    assert any("no time for it" in note for predicted, _ in told for note in predicted.skipped)
    assert max(predicted.seconds + updated.seconds for predicted, updated in told) <= BUDGET
    ample = made(10.0, n_particles="auto", target_error=1e-4)
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
        budget._costs["predict"].append(took)
    budget._costs["update"].append(0.0)
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
