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


def test_controls():
    """``predict(u)``, and ``predict(0)`` for none; theirs has B in discrete time."""
    model = sf.LinearSDE(MODEL.A, noise=[[0.0], [1.0]], spectral_density=[[0.4]], B=[[0.0], [2.0]])
    a, b = ours(model), theirs()
    b.B = model.with_inputs([1.0]).discretize(DT)[1][:, None]
    for z, u in zip(Z[1:4], (0, np.array([1.5]), np.array([-2.0])), strict=True):
        a.predict(u)
        b.predict(np.atleast_1d(u))
        a.update(z)
        b.update(z)
    assert a.t == pytest.approx(3 * DT)
    assert a.x == pytest.approx(b.x, abs=3e-3)
    with pytest.raises(sf.ModelError, match=r"\(1,\) is needed: a value for each input: u0"):
        a.predict(np.array([1.0, 2.0]))
    with pytest.raises(sf.ModelError, match="the model has no inputs"):
        ours().predict(np.array([1.0]))


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
        ("B", r"LinearSDE\(A, B=B\): predict\(dt, u=...\)"),
        ("K", "no gain"),
        ("inv", "SI is its inverse"),
        ("dim_x", "dim_x is what a density filter has found"),
        ("SI", "SI is what a density filter has found"),
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
    assert not hasattr(flt, name) or name in ("x", "density", "x_prior", "dim_x", "SI")


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("K", "SPHFilter has no K: .* no gain"),
        ("R", "its noise_cov"),
        ("H", "h=H"),
        ("Q", "spectral_density=Q"),
        ("F", "LinearSDE"),
        ("B", "inputs of the model"),
        ("inv", "SI is its inverse"),
        ("residual_of", "measurement.predict"),
        ("batch_filter", "the whole record to run"),
        ("rts_smoother", r"sf\.smooth"),
        ("predict_update", r"predict\(dt\), then update\(z\)"),
    ],
)
def test_names_that_are_not_offered_name_what_is(name, sentence):
    flt = ours()
    assert not hasattr(flt, name) and getattr(flt, name, "nothing") == "nothing"
    with pytest.raises(AttributeError, match=sentence) as raised:
        getattr(flt, name)
    assert isinstance(raised.value, sf.ModelError)
    with pytest.raises(AttributeError, match="has no attribute 'densities'"):
        flt.densities  # noqa: B018 - reading it is the test


def test_a_mistyped_argument_is_named():
    with pytest.raises(TypeError, match=r"has no argument 'n_particle' \(did you mean 'n_particles'\?\)"):
        sf.SPHFilter(ours().model, None, [0.0, 0.0], np.eye(2), n_particle=10)
    with pytest.raises(TypeError, match=r"has no argument 'measurment' \(did you mean 'measurement'\?\)"):
        ours().update(0.1, measurment=None)
    with pytest.raises(TypeError, match=r"\(did you mean 'P0'\?\)"):
        sf.SPHFilter(ours().model, None, [0.0, 0.0], p0=np.eye(2))


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda flt: flt.update(Z[1], lambda x: x, lambda x: x), "nothing is linearised"),
        (lambda flt: flt.update(Z[1], HJacobian=np.eye(2), Hx=abs), "HJacobian=: nothing is linearised"),
        (lambda flt: flt.update(Z[1], hx=lambda x: (x[0],)), r"hx=: give update\(z, R, hx\)"),
        (lambda flt: flt.predict(fx=lambda x, dt: x), "fx=: dynamics belong to the model"),
        (lambda flt: flt.predict(Q=np.eye(2)), "Q=: process noise belongs to the model"),
        (lambda flt: sf.SPHFilter(dim_x=2, dim_z=1), r"dim_x=: .* SPHFilter\(model, measurement, x0, P0\)"),
    ],
)
def test_arguments_of_other_filters_are_refused_with_the_ones_to_give(call, sentence):
    with pytest.raises(sf.ModelError, match=sentence):
        call(ours())
    with pytest.raises(TypeError, match=r"has no argument .noise.; it has z"):
        ours().update(Z[1], noise=3.0)


def _inflated(flt):
    flt.P *= 50


def _moved(flt):
    flt.x += 1.0


def _overwritten(flt):
    flt.P[0, 0] = 3.0


@pytest.mark.parametrize("change", [_inflated, _moved, _overwritten])
def test_moments_changed_in_place_are_refused_and_stay(change):
    flt = ours()
    flt.predict()
    x, P = np.array(flt.x), np.array(flt.P)
    with pytest.raises(sf.ModelError, match="make a new filter with x0 and P0"):
        change(flt)
    assert np.array_equal(flt.x, x) and np.array_equal(flt.P, P)


def test_what_is_computed_from_moments_is_a_plain_array():
    flt = ours()
    copied, P = flt.P.copy(), np.array(flt.P)
    copied *= 2.0
    copied[0, 0] += 1.0
    assert np.array_equal(copied, 2.0 * P + np.diag([1.0, 0.0]))
    assert type(2.0 * flt.P) is type(flt.P @ flt.x) is np.ndarray
    assert repr(flt.x) == repr(pickle.loads(pickle.dumps(flt.x))) == repr(np.array(flt.x))
    out = np.zeros(2)
    assert np.add(flt.x, 1.0, out=out) is out and np.array_equal(out, np.array(flt.x) + 1.0)


def test_columns_stand_for_vectors():
    a = ours()
    b = sf.SPHFilter(MODEL, POSITION, x0=X0[:, None], P0=P0, dt=DT, n_particles=300)
    a.predict(), b.predict()
    a.update(Z[1]), b.update(np.array([Z[1]]).T)
    assert np.array_equal(a.x, b.x) and a.log_evidence == b.log_evidence
    assert b.z.shape == (1,)
    with pytest.raises(sf.ModelError, match=r"shape \(2,\), but the sensor gives \(1,\)"):
        b.update([[1.0], [2.0]])


def test_dimensions_inverse_and_distance_of_the_innovation():
    both = sf.GaussianMeasurement(np.eye(2), [[0.2, 0.05], [0.05, 0.1]])
    flt, reference = sf.SPHFilter(MODEL, both, X0, P0, dt=DT, n_particles=300), theirs()
    reference.dim_z, reference.H, reference.R = 2, np.eye(2), both.noise_cov
    assert (flt.dim_x, flt.dim_z) == (2, 2) and np.isnan(flt.mahalanobis) and np.isnan(flt.SI).all()
    for each in (flt, reference):
        each.predict()
        each.update(np.array([0.4, -0.5]))
    np.testing.assert_allclose(flt.SI, reference.SI, rtol=0.01)
    assert flt.mahalanobis == pytest.approx(reference.mahalanobis, rel=0.01)
    flt.update([0.3, np.nan])
    assert flt.SI[0, 0] == pytest.approx(1.0 / flt.S[0, 0]) and np.isnan(flt.SI[0, 1])
    assert flt.mahalanobis == pytest.approx(abs(flt.y[0]) / flt.S[0, 0] ** 0.5)
    flt.update(None)
    assert np.isnan(flt.mahalanobis)
    counter = sf.LikelihoodMeasurement(lambda z, X, t: -((z[0] - X[:, 0]) ** 2))
    flt.update([0.3], counter)
    assert flt.SI is None and np.isnan(flt.mahalanobis)


def test_a_saver_that_begins_before_the_first_reading():
    flt = ours()
    saver = Saver(flt, save_current=True)
    flt.predict()
    saver.save()
    flt.update(Z[1])
    saver.save()
    saver.to_array()
    assert saver.z.shape == (3, 1) and saver.S.shape == saver.SI.shape == (3, 1, 1)
    assert saver.x.shape == (3, 2) and saver.log_likelihood.shape == (3,)
    assert np.isnan(saver.z[:2]).all() and np.isfinite(saver.z[2]).all()


def test_what_may_be_set_and_what_subclasses_carry():
    flt = Labelled(MODEL, POSITION, X0, P0, n_particles=100)
    flt.predict(DT)
    assert (flt.densities, flt.R) == ([], 3.0)
    assert copy.deepcopy(flt).R == pickle.loads(pickle.dumps(flt)).R == 3.0
    for name, value in {"x": X0, "P": P0}.items():
        with pytest.raises(sf.ModelError, match="IMM mixing"):
            setattr(flt, name, value)
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
