"""Predictions that need more particles than they may have, and those that no number of particles saves."""

import re

import numpy as np
import pytest
from density_cases import duffing, off, position, quadrature, text

import sphfilter as sf
from reference_filters.grid import GridFilter
from sphfilter.errors import LatticeError, PropagationError, UnresolvedError
from sphfilter.prediction import automatic
from sphfilter.prediction._shared import carried_off

DUFFING, SENSOR = duffing(1.6), position(2, 1.0)
CUBIC = text(["pos"], ["pos**3"], [["1"]])
START = [0.5, 0.0], np.eye(2)


def start(n_particles=100):
    """Over the saddle between two wells."""
    return sf.initialize(sf.Gaussian(*START), n_particles)


@pytest.fixture(scope="module")
def finer():
    """Two wells on a hundred particles: they lose more than a hundredth of the probability."""
    return sf.predict(start(), DUFFING, 2.0)


@pytest.fixture
def grid():
    exact = GridFilter(DUFFING, SENSOR, *START, size=128)
    exact.predict(2.0)
    return exact


def assert_near(density, x, P, close):
    assert max(off(density.mean(), density.cov(), x, P)) < close
    assert quadrature(density)[1].sum() == pytest.approx(1.0, abs=max(5e-3, density.residual or 0.0))


def test_a_density_finer_than_its_particles_comes_back_on_more_and_says_so(finer):
    density, info = finer
    assert info.status.startswith("on 3 times the particles: prediction from 0 to 2 stopped at")
    assert "lost or gained" in info.status
    assert info.scheme == "log_density"
    assert 100 < density.n_particles <= 300
    assert density.capacity == 100


def test_on_more_particles_the_probability_is_kept(finer, grid):
    density, info = finer
    assert info.mass_error < sf.LogDensityScheme().most_lost
    assert density.mass.sum() == pytest.approx(1.0, abs=1e-12)
    assert_near(density, grid.x, grid.P, 1e-2)


def test_the_next_update_is_back_within_the_particles_allowed(finer, grid):
    density, info = sf.update(finer[0], SENSOR, [1.0])
    grid.update([1.0])
    assert info.accepted
    assert 50 <= density.n_particles <= 100
    assert density.capacity == 100
    assert info.log_evidence == pytest.approx(grid.log_evidence, abs=1e-2)
    assert_near(density, grid.x, grid.P, 1e-2)


def test_the_next_prediction_begins_with_the_particles_allowed(finer):
    """A short interval from a smooth density needs no more than those, or three times as many again."""
    density, _ = sf.predict(finer[0], DUFFING, 0.01)
    assert density.capacity == 100
    assert density.n_particles <= 300
    assert_near(density, finer[0].mean(), finer[0].cov(), 0.05)


def test_a_filter_comes_back_to_its_particles_every_time():
    flt = sf.SPHFilter(DUFFING, SENSOR, *START, n_particles=100)
    for z in (1.0, -0.5, 2.0):
        flt.predict(2.0)
        flt.update([z])
        assert flt.density.n_particles <= 100


def test_a_scheme_asked_for_by_name_is_not_helped():
    config = sf.SolverConfig(scheme=sf.LogDensityScheme())
    with pytest.raises(UnresolvedError, match="lost or gained"):
        sf.predict(start(), DUFFING, 2.0, config)


def test_where_more_particles_would_be_too_many_the_first_refusal_stands(monkeypatch):
    """And no other scheme takes over: it would see no more on as few."""
    monkeypatch.setattr(automatic, "MOST_FINER", 299)
    with pytest.raises(UnresolvedError, match="lost or gained"):
        sf.predict(start(), DUFFING, 2.0, goes_on=False)
    _, info = sf.predict(start(), DUFFING, 2.0)
    assert sf.Code.CLOUD in info.code and "lost or gained" in info.status


# drifts that carry particles to infinity


@pytest.mark.parametrize("x", [[[2.0]], [[0.1], [2.0]], [[0.3], [-2.0]]])
def test_a_drift_to_infinity_is_told_with_its_time_and_state(x):
    """x' = x³ from 2 at one second: infinite an eighth of a second later."""
    told = carried_off(CUBIC, np.array(x), 1.0, 2.0)
    found = re.match(r"the model blew up at t = (\S+) \(.* from 1 to 2\), at the particle pos = (\S+):", told)
    assert float(found[1]) == pytest.approx(1.125, abs=1e-3)
    assert abs(float(found[2])) > 1e4
    assert np.sign(float(found[2])) == np.sign(x[-1][0])
    assert "grows without bound" in told


def test_all_states_of_the_particle_that_is_carried_off_are_named():
    model = text(["calm", "wild"], ["-calm", "wild**3"])
    told = carried_off(model, np.array([[5.0, 0.1], [1.0, 3.0]]), 0.0, 1.0)
    calm, wild = re.search(r"calm = (\S+), wild = (\S+):", told).groups()
    assert float(calm) == pytest.approx(np.exp(-1.0 / 18.0), abs=0.01)
    assert float(wild) > 1e4


def test_nothing_is_told_where_nothing_is_carried_off():
    x = np.array([[2.0], [-1.0]])
    assert carried_off(CUBIC, x, 1.0, 1.1) == ""  # not yet
    assert carried_off(sf.LinearSDE(A=[[3.0]]), x, 0.0, 20.0) == ""  # large, but never infinite


def test_nothing_is_told_of_a_drift_that_cannot_be_followed():
    def fails(X, t):
        if t > 0.1:
            raise ValueError("table ends here")
        return -X

    stiff = text(["x"], ["-1e9*(x - sin(1000*t))"], [["1"]])
    x = np.array([[2.0], [-1.0]])
    assert carried_off(stiff, x, 0.0, 20.0) == ""
    with pytest.raises(ValueError, match="table ends here"):
        carried_off(sf.SDE(fails, 1, [[1.0]], vectorized=True), x, 0.0, 1.0)


def test_a_prediction_over_a_blow_up_says_so_at_once():
    """The lattice is what fails, but no number of particles would help."""
    density = sf.initialize(sf.Gaussian([1.0], [[0.04]]), 100)
    with pytest.raises(PropagationError, match=r"blew up at t = .*pos = .*grows without bound") as raised:
        sf.predict(density, CUBIC, 1.0)
    assert isinstance(raised.value.__cause__, LatticeError | UnresolvedError)
