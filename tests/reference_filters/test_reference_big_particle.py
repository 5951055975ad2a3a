"""Average of many particle filters: errors as told, runs kept and continued."""

from types import SimpleNamespace

import numpy as np
import pytest

from reference_filters import big_particle
from reference_filters.big_particle import converged
from reference_filters.kalman import KalmanFilter
from sphfilter.errors import ModelError
from sphfilter.model.measurements import GaussianMeasurement
from sphfilter.model.sde import SDE, LinearSDE

LINEAR = LinearSDE([[0.0, 1.0], [-1.0, -0.4]], None, [[0.0], [1.0]], 0.7)
#: The same, but stepped.
HIDDEN = SDE(lambda x: (x[1], -x[0] - 0.4 * x[1]), 2, [[0.0], [1.0]], 0.7)
POSITION = GaussianMeasurement([[1.0, 0.0]], [[0.3]])
CASE = SimpleNamespace(
    times=np.array([0.7, 1.5, 2.9]), z=np.array([[1.2], [0.1], [-0.8]]),
    x0=np.array([1.0, 0.0]), P0=np.diag([0.3, 0.5]), t0=0.0,
)  # fmt: skip


def test_it_is_the_kalman_filter_within_its_own_errors():
    exact = KalmanFilter(LINEAR, POSITION, CASE.x0, CASE.P0).run(CASE.times, CASE.z)
    found = converged(HIDDEN, POSITION, CASE, n_particles=20_000, n_runs=12)
    for name, error in (("x", "x_error"), ("P", "P_error"), ("log_evidence", "evidence_error")):
        told = getattr(found, error)
        ratio = (getattr(found, name) - getattr(exact, name)) / told
        assert np.abs(ratio).max() < 6.0  # Student's t of 11 degrees, 21 numbers
        assert told.max() < 0.02
    assert abs(found.log_evidence.sum() - exact.log_evidence.sum()) < 6.0 * found.total_error
    # the variance of a mean of n draws is at least P / n
    least = np.sqrt(np.diagonal(exact.P, axis1=1, axis2=2) / found.n_paths)
    assert np.all(found.x_error > 0.4 * least)
    assert found.n_paths == 240_000


def test_runs_are_kept_and_continued(tmp_path, monkeypatch):
    options = {"n_particles": 500, "rng": 3, "cache": tmp_path / "kept"}
    whole = converged(HIDDEN, POSITION, CASE, n_runs=4, n_particles=500, rng=3)
    converged(HIDDEN, POSITION, CASE, n_runs=2, **options)
    found = converged(HIDDEN, POSITION, CASE, n_runs=4, **options)
    np.testing.assert_array_equal(found.P, whole.P)
    np.testing.assert_array_equal(found.evidence_error, whole.evidence_error)

    def never(*args, **kwargs):
        raise AssertionError("a run that was there has been run again")

    monkeypatch.setattr(big_particle, "ParticleFilter", never)
    again = converged(HIDDEN, POSITION, CASE, n_runs=4, **options)
    np.testing.assert_array_equal(again.x, whole.x)
    assert len(list((tmp_path / "kept").iterdir())) == 1
    other = SimpleNamespace(**{**vars(CASE), "z": CASE.z + 1e-9})
    stiffer = SDE(lambda x: (x[1], -x[0] - 0.41 * x[1]), 2, [[0.0], [1.0]], 0.7)
    changes = (HIDDEN, POSITION, other), (stiffer, POSITION, CASE), (
        HIDDEN, GaussianMeasurement([[1.0, 0.0]], [[0.31]]), CASE,
    )  # fmt: skip
    for change in changes:
        with pytest.raises(AssertionError, match="run again"):
            converged(*change, n_runs=2, **options)


def test_one_run_has_no_spread():
    with pytest.raises(ModelError, match="n_runs"):
        converged(HIDDEN, POSITION, CASE, n_particles=100, n_runs=1)
