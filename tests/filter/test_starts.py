"""What a filter says of its start: a P0 that is singular, lattices too coarse for it, states too many."""

import logging

import numpy as np
import pytest

import sphfilter as sf
from sphfilter.density import initialize
from sphfilter.lattice.level_set import enough_particles


def still(n):
    return sf.LinearSDE(-np.eye(n), noise=np.eye(n))


def test_a_zero_on_the_diagonal_of_p0_names_what_to_give():
    with pytest.raises(sf.ModelError, match=r"P0 is not .* zero .* index 1.* 1e-6 of its scale"):
        sf.SPHFilter(still(2), None, np.zeros(2), np.diag([1.0, 0.0]))
    flt = sf.SPHFilter(still(2), None, np.zeros(2), np.diag([1.0, 1e-12]))
    flt.predict(0.1)
    assert flt.P[1, 1] == pytest.approx(0.5 * (1.0 - np.exp(-0.2)), rel=0.01)


@pytest.mark.parametrize("n", [2, 3, 4, 5])
def test_as_many_as_are_said_to_be_enough_hold_a_gaussian(n):
    held = sf.initialize(sf.Gaussian(np.zeros(n), np.eye(n)), enough_particles(n))
    assert np.trace(held.cov()) / n == pytest.approx(1.0, abs=0.03)


def test_a_lattice_that_loses_variance_says_so_once(caplog):
    initialize._say_what_is_missing.cache_clear()
    with caplog.at_level(logging.WARNING, logger="sphfilter"):
        for _ in range(2):
            coarse = sf.SPHFilter(still(5), None, np.zeros(5), np.eye(5), n_particles=90)
        sf.SPHFilter(still(2), None, np.zeros(2), np.eye(2), n_particles=60)
    (said,) = [record.getMessage() for record in caplog.records]
    assert coarse.P[0, 0] < 0.95
    assert said == (
        f"90 particles hold an initial Gaussian of 5 states with {coarse.P[0, 0]:.2g} of its variance; "
        f'use about {enough_particles(5)}, or n_particles="auto"'
    )


def test_too_many_states_are_refused_with_one_sentence():
    with pytest.raises(sf.ModelError, match=r'"auto" carries densities of up to 12 states, and 13 are more'):
        sf.SPHFilter(still(13), None, np.zeros(13), np.eye(13))


@pytest.mark.parametrize("n", [5, 6])
def test_too_few_particles_are_told_how_many_are_enough(n):
    with pytest.raises(sf.ModelError, match=f"use more particles: .* about {enough_particles(n)}"):
        sf.SPHFilter(still(n), None, np.zeros(n), np.eye(n), n_particles=30)
