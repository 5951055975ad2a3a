"""`SPHFilter` in the place of filterpy's filters: the same loop, its saver, its bank of filters."""

import copy
import pickle

import numpy as np
import pytest
from filterpy.common import Saver
from filterpy.kalman import IMMEstimator, KalmanFilter, MMAEFilterBank

import sphfilter as sf

DT = 0.5
MODEL = sf.LinearSDE(A=[[0.0, 1.0], [-1.0, -0.3]], noise=[[0.0], [1.0]], spectral_density=[[0.4]])
POSITION = sf.GaussianMeasurement(h=[[1.0, 0.0]], noise_cov=[[0.2]])
X0, P0 = np.array([1.0, 0.0]), np.diag([0.5, 0.3])
_, Z = sf.simulate(MODEL, POSITION, x0=X0, times=np.arange(0.0, 4.1, DT), rng=3)


class Labelled(sf.SPHFilter):
    """A filter with attributes of its own, two of them with names that would be refused elsewhere."""

    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self.densities, self.R = [], 3.0


def ours(model=MODEL):
    return sf.SPHFilter(model, POSITION, x0=X0, P0=P0, dt=DT, n_particles=300)


def theirs():
    flt = KalmanFilter(dim_x=2, dim_z=1)
    flt.x, flt.P, flt.H, flt.R = X0.copy(), P0.copy(), np.array([[1.0, 0.0]]), np.array([[0.2]])
    flt.F, _, flt.Q = MODEL.discretize(DT)
    return flt


def followed(flt, readings):
    """A loop that knows nothing of the filter's kind."""
    saver = Saver(flt)
    for z in readings:
        flt.predict()
        flt.update(z)
        saver.save()
    return saver


def test_the_same_loop_with_both():
    """Missing readings too; linear and Gaussian, so both have the same answer."""
    readings = [*Z[1:4], None, *Z[5:]]
    a, b = (followed(flt, readings) for flt in (ours(), theirs()))
    a.to_array()  # theirs stumbles over a missing reading, which has another shape
    for name in ("x", "P", "x_prior", "P_prior", "x_post", "P_post"):
        assert getattr(a, name) == pytest.approx(
            np.reshape(getattr(b, name), np.shape(getattr(a, name))), abs=3e-3
        )
    seen = [k for k, z in enumerate(readings) if z is not None]
    assert a.log_likelihood[seen] == pytest.approx(np.array(b.log_likelihood)[seen], abs=0.01)
    assert np.isnan(a.z[3]).all() and np.isnan(a.y[3]).all() and a.log_likelihood[3] == 0.0
    assert a.y[0] == pytest.approx(b.y[0], abs=2e-3)
    assert a.S[0] == pytest.approx(b.S[0], abs=2e-3)


def test_noise_and_matrix_of_one_reading():
    """``update(z, R, H)``; the next reading has the filter's own again."""
    a, b = ours(), theirs()
    for flt in (a, b):
        flt.predict()
        flt.update(Z[1], 2.0)
        flt.predict()
        flt.update(Z[2], np.array([[0.7]]), np.array([[0.0, 1.0]]))
        flt.predict()
        flt.update(Z[3])
    assert a.x == pytest.approx(b.x, abs=3e-3)
    np.testing.assert_allclose(a.P, b.P, atol=3e-3)
    assert a.likelihood == pytest.approx(b.likelihood, rel=0.01)


def test_a_bank_of_filters():
    """Bayes' rule over models by their evidence; a filter whose predict(0) stood still would not see them."""
    calm = sf.LinearSDE(A=MODEL.A, noise=[[0.0], [1.0]], spectral_density=[[0.01]])
    filters = [ours(), ours(calm)]
    bank = MMAEFilterBank(filters, [0.5, 0.5], dim_x=2)
    alone = [ours(), ours(calm)]
    for z in Z[1:]:
        bank.predict()
        bank.update(z)
        for flt in alone:
            flt.predict(DT)
            flt.update(z)
    evidence = np.exp([flt.log_evidence for flt in alone])
    assert filters[0].t == pytest.approx(4.0)
    assert bank.p == pytest.approx(evidence / evidence.sum(), rel=1e-9)
    assert bank.x == pytest.approx(bank.p @ [flt.x for flt in alone])


def test_what_mixes_filters_is_refused():
    """Interacting multiple models overwrite x and P, which a density has no place for."""
    with pytest.raises(sf.ModelError, match="IMM mixing"):
        bank = IMMEstimator([ours(), ours()], [0.5, 0.5], np.full((2, 2), 0.5))
        bank.predict()


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("R", r"update\(z, R=...\)"),
        ("H", r"update\(z, R, H\)"),
        ("Q", "belongs to the model.*spectral_density=Q"),
        ("F", "LinearSDE"),
        ("B", "write the control into the drift"),
        ("K", "no gain"),
        ("hx", "h=hx"),
        ("x", "the mean of a density filter cannot be overwritten"),
        ("density", "density is what a density filter has found"),
        ("x_prior", "x_prior is what a density filter has found"),
        ("n_particle", "did you mean 'n_particles'"),
        ("measurment", "did you mean 'measurement'"),
    ],
)
def test_names_that_would_do_nothing_are_refused_with_the_one_to_use(name, sentence):
    flt = ours()
    with pytest.raises(sf.ModelError, match=sentence):
        setattr(flt, name, np.eye(2))
    assert not hasattr(flt, name) or name in ("x", "density", "x_prior")


def test_what_may_be_set_and_what_subclasses_carry():
    flt = Labelled(MODEL, POSITION, X0, P0, n_particles=100)
    flt.predict(DT)
    assert (flt.densities, flt.R) == ([], 3.0)
    assert copy.deepcopy(flt).R == pickle.loads(pickle.dumps(flt)).R == 3.0
    with pytest.raises(sf.ModelError, match="IMM mixing"):
        flt.x = X0
    plain = ours()
    plain.predictions, plain.dt, plain.n_particles = "notes", 2.0, 150
    assert (plain.predictions, plain.dt, plain.n_particles) == ("notes", 2.0, 150)
    plain.update(Z[1])
    plain.log_evidence = 0.0
    assert plain.log_evidence == 0.0 != plain.log_likelihood
    with pytest.raises(sf.ModelError, match="n_particles"):
        plain.n_particles = 0
    assert plain.n_particles == 150


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((-1.0,), "noise_cov"),
        ((np.eye(2),), "do not fit"),
        ((None, np.eye(3)[:1]), "3 states"),
        (("loud",), "measurement must be"),
    ],
)
def test_bad_noise_leaves_the_filter_as_it_was(arguments, sentence):
    flt = ours()
    x = flt.x.copy()
    with pytest.raises(sf.ModelError, match=sentence):
        flt.update(Z[1], *arguments)
    assert np.array_equal(flt.x, x)
