"""Steps made again on more particles: which rungs a ladder has, and what infos of several steps say."""

from dataclasses import replace

import pytest

import sphfilter as sf
from sphfilter.errors import PropagationError
from sphfilter.prediction.again import MOST_WORK, Ladder


def test_rungs_are_as_many_particles_as_may_be():
    assert [rung.n_particles for rung in Ladder((3, 9, 27), most=5000).rungs(200)] == [600, 1800]
    assert [(rung.level, rung.deeper) for rung in Ladder(deeper=0.5).rungs(10)] == [(1, 0.5), (2, 1.0)]


@pytest.mark.parametrize(("dim", "times"), [(1, (3,)), (2, (3, 9)), (3, (3, 9, 27))])
def test_no_rung_is_finer_than_a_lattice_allows_nor_tried_twice(dim, times):
    assert Ladder((3, 9, 27)).within(dim).times == times


def test_rungs_that_reach_deeper_are_tried_on_as_many_particles():
    assert Ladder((3, 9), deeper=0.7).within(1).times == (3, 3)


def test_the_first_rung_that_holds_is_taken():
    tried = []

    def attempt(rung):
        tried.append(rung.times)
        if rung.times < 9:
            raise PropagationError("too few")
        return "held"

    rung, found = Ladder((3, 9, 27)).climbed(100, attempt)
    assert (rung.times, found, tried) == (9, "held", [3, 9])
    with pytest.raises(PropagationError, match="too few"):
        Ladder((3,)).climbed(100, attempt)


def test_no_rung_is_tried_that_would_be_too_much_work():
    tried = []

    def attempt(rung):
        tried.append(rung.times)
        problem = PropagationError("too few")
        problem.work = 0.2 * MOST_WORK * rung.times / 3
        raise problem

    with pytest.raises(PropagationError, match="too few") as raised:
        Ladder((3, 9, 27)).climbed(100, attempt)
    assert tried == [3, 9]
    assert raised.value.work == pytest.approx(0.6 * MOST_WORK)


def test_errors_that_no_number_of_particles_cures_come_through():
    def defect(rung):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        Ladder().climbed(100, defect)


def test_infos_of_several_steps_say_all_that_was_unusual():
    usual = sf.PredictInfo(scheme="log_density")
    finer = usual.marked(sf.Code.FINER, "on 3 times the particles")
    other = usual.marked(sf.Code.FALLBACK, "not log_density: edges")
    joined = sf.PredictInfo.joined([usual, finer, other])
    assert joined.code == sf.Code.FINER | sf.Code.FALLBACK
    assert joined.status == "on 3 times the particles; not log_density: edges"
    finest = replace(finer, status="on 9 times the particles")
    assert sf.PredictInfo.joined([finer, other, finest]).status.startswith("on 9 times the particles; not")
    assert sf.PredictInfo.joined([usual, usual]).code == sf.Code.OK
    assert sf.PredictInfo.joined([]).status == "ok"
    assert sf.PredictInfo(code=2).code is sf.Code.REPEATED
