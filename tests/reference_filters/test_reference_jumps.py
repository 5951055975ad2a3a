"""Referees of models that switch: they agree with each other, and a single mode is a Kalman filter."""

from itertools import pairwise

import numpy as np
import pytest

import sphfilter as sf
from reference_filters.imm import ImmFilter
from reference_filters.jump_grid import JumpGridFilter, unsplit_jump_filter
from reference_filters.jump_particle import JumpParticleFilter
from reference_filters.kalman import KalmanFilter

SENSOR = sf.GaussianMeasurement([[1.0]], [[0.1]])
TIMES, Z = [1.0, 2.0, 3.0, 4.0], [[0.3], None, [1.2], [2.5]]


def drifting(velocity):
    return sf.LinearSDE([[-0.1]], [velocity], noise=[[0.3]])


def model(rates=((-0.4, 0.4), (0.8, -0.8))):
    return sf.JumpMarkovModel({"rest": drifting(0.0), "moving": drifting(1.0)}, rates)


def followed(flt):
    rows = []
    for t, z in zip(TIMES, Z, strict=True):
        flt.predict(t=t)
        flt.update(z)
        rows.append([flt.x[0], flt.P[0, 0], flt.log_evidence, *flt.mode_probabilities])
    return np.array(rows)


def test_the_split_grid_goes_to_the_one_that_is_not_split():
    whole = unsplit_jump_filter(model(), SENSOR, 0.0, 0.2, TIMES, Z, box=(-5.0, 8.0), size=601)

    def off(step):
        grid = JumpGridFilter(model(), SENSOR, [0.0], [[0.2]], box=[[-5.0, 8.0]], size=256, step=step)
        return np.abs(followed(grid) - whole).max()

    errors = [off(step) for step in (0.25, 0.125, 0.0625)]
    assert errors[-1] < 1e-3
    assert all(3.0 < longer / shorter < 5.0 for longer, shorter in pairwise(errors))


def test_particles_agree_with_the_grid():
    whole = unsplit_jump_filter(model(), SENSOR, 0.0, 0.2, TIMES, Z, box=(-5.0, 8.0), size=601)
    found = followed(JumpParticleFilter(model(), SENSOR, [0.0], [[0.2]], n_particles=50_000, rng=3))
    np.testing.assert_allclose(found, whole, atol=0.02)


@pytest.mark.parametrize("kind", ["kalman", "ekf", "ukf"])
def test_interacting_models_without_jumps_of_one_equation_are_a_kalman_filter(kind):
    still = sf.JumpMarkovModel({"one": drifting(1.0), "other": drifting(1.0)}, np.zeros((2, 2)))
    found = followed(ImmFilter(still, SENSOR, [0.0], [[0.2]], kind=kind))
    alone = KalmanFilter(drifting(1.0), SENSOR, [0.0], [[0.2]]).run(TIMES, Z)
    np.testing.assert_allclose(found[:, 0], alone.x[:, 0], atol=1e-5)
    np.testing.assert_allclose(found[:, 1], alone.P[:, 0, 0], rtol=1e-4)
    np.testing.assert_allclose(found[:, 2], np.cumsum(alone.log_evidence), atol=1e-4)
    np.testing.assert_allclose(found[:, 3:], 0.5, atol=1e-9)


def test_interacting_models_are_beside_the_truth():
    whole = unsplit_jump_filter(model(), SENSOR, 0.0, 0.2, TIMES, Z, box=(-5.0, 8.0), size=601)
    found = followed(ImmFilter(model(), SENSOR, [0.0], [[0.2]]))
    off = np.abs(found[:, 3] - whole[:, 3]).max()
    assert 0.02 < off < 0.5
