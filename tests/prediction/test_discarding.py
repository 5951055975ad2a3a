"""Particles whose smoothing lengths do not converge: kept and counted, or dropped and their mass shared."""

import numpy as np
import pytest

import sphfilter as sf

#: Nothing moves but what lies beyond x = 2, which is flung away: there Newton's equation loses its root.
FLUNG = sf.SDE.from_expressions(
    states=["x"], drift=["where(x > 2, 20*(x - 2), 0)"], noise=[[0.0]], spectral_density=[[1.0]]
)


def carried(until=0.5, **scheme):
    fixed = {"kernel": "gaussian", "support_range": (3.6, 3.6), "cfl": "fixed", "dt_max": 0.05}
    config = sf.SolverConfig(scheme=sf.PaperScheme(**fixed | scheme))
    start = sf.initialize(sf.Gaussian([0.0], [[1.0]]), box=[[-3.0, 3.0]], spacing=0.1, config=config)
    return start, *sf.predict(start, FLUNG, until, config)


@pytest.mark.parametrize("smoothing", ["newton", "fixed_point"])
def test_what_is_lost_is_dropped_and_the_rest_stays_where_it_was(smoothing):
    start, moved, info = carried(smoothing=smoothing, discard_unconverged=True)
    lost = start.x[:, 0] > 2.0
    assert info.n_discarded == info.n_smoothing_failed == lost.sum() == 10
    assert info.mass_discarded == pytest.approx(start.mass[lost].sum(), rel=1e-9)
    assert moved.x[:, 0] == pytest.approx(start.x[~lost, 0])
    assert moved.mass == pytest.approx(start.mass[~lost] / start.mass[~lost].sum(), rel=1e-12)
    inner = moved.x[:, 0] < 1.0  # masses grow alike there, and lengths are those from before
    assert moved.h[inner] == pytest.approx(start.h[~lost][inner], rel=1e-3)


@pytest.mark.parametrize("smoothing", ["newton", "fixed_point"])
def test_without_asking_nothing_is_dropped_but_counted(smoothing):
    start, moved, info = carried(smoothing=smoothing)
    assert moved.n_particles == start.n_particles and info.n_discarded == 0 and info.mass_discarded == 0.0
    assert info.n_smoothing_failed > 10  # again and again
    assert moved.mass == pytest.approx(start.mass, rel=1e-12)


def test_a_step_discards_once():
    """With one iteration the edge does not settle either, but a layer a step, not all at once."""
    _, moved, info = carried(smoothing="fixed_point", smoothing_iterations=1, discard_unconverged=True)
    assert 10 < info.n_discarded < 61 - 10
    assert moved.n_particles == 61 - info.n_discarded


def test_when_none_is_left_the_sentence_says_what_to_raise():
    with pytest.raises(sf.PropagationError, match=r"raise smoothing_iterations \(now 2\)"):
        carried(smoothing="newton", smoothing_iterations=2, discard_unconverged=True)


def test_discarding_wants_lengths_that_are_iterated():
    with pytest.raises(
        sf.ConfigError, match='discard_unconverged needs smoothing = "fixed_point" or "newton"'
    ):
        sf.PaperScheme(discard_unconverged=True)


def test_a_cloud_at_rest_stays(tmp_path):
    still = sf.SDE.from_expressions(states=["x"], drift=["0"], noise=[[0.0]], spectral_density=[[1.0]])
    config = sf.SolverConfig(scheme=sf.PaperScheme(cfl="fixed", dt_max=0.1))
    start = sf.initialize(sf.Gaussian([0.0], [[1.0]]), 50, config)
    way = sf.propagate(start, still, [1.0], config)
    assert np.array_equal(way.densities[0].x, start.x)
    way.save(tmp_path / "way.npz")
    assert sf.Trajectory.load(tmp_path / "way.npz").infos == way.infos
