"""Measurements that find the state where a prediction has no particles: the prediction is repeated."""

import numpy as np
import pytest
from density_cases import duffing, position, text

import sphfilter as sf
from reference_filters.grid import GridFilter
from sphfilter import consistency
from sphfilter.errors import PropagationError
from sphfilter.filter import update_again

DUFFING = duffing(1.6)
SADDLE, SIDE = ([0.5, 0.0], np.eye(2)), ([3.0, 0.0], np.diag([0.2, 1.0]))


def filtered(start, R, n_particles=100, **options):
    """A filter after two seconds on the oscillator with two wells."""
    flt = sf.SPHFilter(DUFFING, position(2, R), *start, n_particles=n_particles, **options)
    flt.predict(2.0)
    return flt


def referee(start, R, z):
    grid = GridFilter(DUFFING, position(2, R), *start, size=192)
    grid.predict(2.0)
    grid.update([z])
    return grid


def away(x, grid):
    """Distance of a mean from the grid's, in posterior standard deviations."""
    return consistency.distance(x, grid.x, grid.P)


@pytest.mark.parametrize(
    ("start", "z", "R"), [(SADDLE, -7.0, 0.05), (SADDLE, 9.0, 0.2), (SIDE, -6.2, 0.05), (SIDE, -6.5, 0.05)]
)
def test_a_posterior_in_the_tail_is_found_by_predicting_again(start, z, R):
    flt, grid = filtered(start, R, 150), referee(start, R, z)
    once, told = sf.update(flt.density, flt.measurement, [z])
    info = flt.update([z])
    assert told.extrapolated > 0.05
    assert "prediction repeated on" not in told.status
    assert info.status.startswith("prediction repeated on")
    assert info.extrapolated < 0.2 * told.extrapolated
    assert away(flt.x, grid) < 0.05 < away(once.mean(), grid)
    assert info.log_evidence == pytest.approx(grid.log_likelihood, abs=0.05)


def test_the_prior_kept_is_the_one_that_was_used():
    flt, grid = filtered(SADDLE, 0.2), GridFilter(DUFFING, position(2, 0.2), *SADDLE, size=192)
    coarse = flt.x.copy()
    grid.predict(2.0)
    flt.update([9.0])
    assert away(flt.x_prior, grid) < 0.01
    assert not np.array_equal(flt.x_prior, coarse)
    assert flt.density.n_particles <= 100


def test_measurements_near_the_prediction_and_known_tails_repeat_nothing(monkeypatch):
    """The tails of a Gaussian and a linear model are known, however far out."""
    flt = filtered(SIDE, 0.2)
    linear = text(["x", "v"], ["v", "-x - 0.3*v"], [["0"], ["1"]])
    straight = sf.SPHFilter(linear, position(2, 0.01), [0.0, 0.0], np.eye(2), n_particles=100)
    straight.predict(1.0)

    def refuse(*args, **options):
        raise AssertionError("predicted again")

    monkeypatch.setattr(update_again, "predict", refuse)
    assert flt.update([flt.x[0]]).status == "ok"
    assert straight.update([9.0]).extrapolated > 0.5


def test_a_second_sensor_and_a_first_update_have_nothing_to_repeat():
    flt = sf.SPHFilter(DUFFING, position(2, 0.05), *SIDE, n_particles=100)
    assert flt.update([3.1]).status == "ok"
    flt = filtered(SADDLE, 0.2)
    assert flt.update([9.0]).status != "ok"
    assert flt.update([6.9]).status == "ok"


def test_where_repeating_fails_the_first_answer_stands(monkeypatch):
    flt = filtered(SADDLE, 0.2)
    once, told = sf.update(flt.density, flt.measurement, [9.0])

    def refuse(*args, **options):
        raise PropagationError("no")

    monkeypatch.setattr(update_again, "predict", refuse)
    info = flt.update([9.0])
    assert np.array_equal(flt.x, once.mean())
    assert info.extrapolated == told.extrapolated
    assert info.status == told.status
