"""Predictor and updater in Stone Soup, against its own Kalman and particle filters."""

import copy

import numpy as np
import pytest
from stonesoup_cases import START, at, duffing, gaussian, off, position, seen

import sphfilter as sf
from sphfilter.errors import UnresolvedError
from sphfilter.filter import sph_filter

pytest.importorskip("stonesoup")

from scipy.stats import multivariate_normal
from stonesoup.models.control.linear import LinearControlModel
from stonesoup.models.measurement.nonlinear import CartesianToBearingRange
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.predictor.particle import ParticlePredictor
from stonesoup.resampler.particle import SystematicResampler
from stonesoup.types.angle import Bearing
from stonesoup.types.array import StateVectors
from stonesoup.types.detection import MissedDetection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.prediction import Prediction
from stonesoup.types.state import GaussianState, ParticleState, State
from stonesoup.types.track import Track
from stonesoup.types.update import Update
from stonesoup.updater.kalman import KalmanUpdater
from stonesoup.updater.particle import ParticleUpdater

from sphfilter.adapters.stonesoup import (
    SDETransitionModel,
    SPHPredictor,
    SPHState,
    SPHStatePrediction,
    SPHStateUpdate,
    SPHUpdater,
)
from sphfilter.adapters.stonesoup import predictor as stonesoup_predictor


def test_linear_filter_is_kalmans():
    """Mean, covariance, innovation and evidence of Stone Soup's own models over ten detections."""
    model, sensor = ConstantVelocity(0.4), position(0.3)
    ours, theirs = SPHPredictor(model, n_particles=200), KalmanPredictor(model)
    our_updater, their_updater = SPHUpdater(sensor), KalmanUpdater(sensor)
    a = b = gaussian()
    rng = np.random.default_rng(3)
    for k in range(1, 11):
        detection = seen(3.0 + k + rng.normal(), seconds=k)
        p, q = ours.predict(a, at(k)), theirs.predict(b, at(k))
        assert max(off(p, np.ravel(q.mean), q.covar)) < 1e-3
        z, w = our_updater.predict_measurement(p), their_updater.predict_measurement(q)
        np.testing.assert_allclose(z.covar, w.covar, rtol=2e-3)
        np.testing.assert_allclose(z.cross_covar, w.cross_covar, rtol=2e-3)
        a = our_updater.update(SingleHypothesis(p, detection, z))
        b = their_updater.update(SingleHypothesis(q, detection, w))
        assert max(off(a, np.ravel(b.mean), b.covar)) < 1e-3
        innovation = float(detection.state_vector[0] - w.state_vector[0])
        expected = multivariate_normal.logpdf(innovation, cov=np.asarray(w.covar))
        assert a.info.log_evidence == pytest.approx(expected, abs=3e-3)


def test_types_are_registered_and_hold_what_stone_soup_asks_for():
    predictor, updater = SPHPredictor(duffing()), SPHUpdater(position())
    prior = SPHState(sf.initialize(sf.Gaussian([3.0, 0.0], np.diag([0.2, 1.0])), 200), START)
    assert isinstance(prior, State) and prior.ndim == 2
    prediction = predictor.predict(Track([prior]), at(1))
    update = updater.update(SingleHypothesis(prediction, seen(2.6, seconds=1)))
    assert type(prediction) is SPHStatePrediction is type(Prediction.from_state(prior))
    assert type(update) is SPHStateUpdate is type(Update.from_state(prior, hypothesis=None))
    assert prediction.prior is prior and prediction.transition_model.sde is predictor.transition_model.sde
    assert update.hypothesis.prediction is prediction and update.timestamp == at(1)
    assert update.mean.shape == (2, 1) and update.covar.shape == (2, 2)
    np.testing.assert_array_equal(update.state_vector[:, 0], update.density.mean())
    with pytest.raises(ValueError, match="read-only"):
        update.state_vector[0] = 0.0


def test_nonlinear_filter_is_that_of_a_large_particle_cloud():
    """Two wells: Stone Soup's particle filter on the same equation and detections."""
    model, n_paths = duffing(), 50_000
    transition = SDETransitionModel(model, seed=5)
    sensor, times = position(), np.arange(0.0, 6.0)
    _, z = sf.simulate(model, sf.GaussianMeasurement([[1.0, 0.0]], [[0.2]]), [3.0, 0.0], times, rng=4)
    X = np.random.default_rng(6).multivariate_normal([3.0, 0.0], np.diag([0.2, 1.0]), n_paths)
    cloud = ParticleState(StateVectors(X.T), log_weight=np.full(n_paths, -np.log(n_paths)), timestamp=START)
    state = gaussian()
    ours, theirs = SPHPredictor(transition, n_particles=400), ParticlePredictor(transition)
    our_updater = SPHUpdater(sensor)
    their_updater = ParticleUpdater(sensor, resampler=SystematicResampler())
    np.random.seed(1)  # noqa: NPY002 - the resampler draws from the global generator
    for k in range(1, len(times)):
        detection = seen(float(z[k, 0]), seconds=k)
        cloud = their_updater.update(SingleHypothesis(theirs.predict(cloud, at(k)), detection))
        state = our_updater.update(SingleHypothesis(ours.predict(state, at(k)), detection))
        assert max(off(state, np.asarray(cloud.mean, dtype=float).ravel(), np.asarray(cloud.covar))) < 0.03


def test_a_run_has_the_bits_of_the_filter():
    """With an outlier that makes it repeat a prediction, a miss, and an outlier twice."""
    model, sensor = duffing(), sf.GaussianMeasurement([[1.0, 0.0]], [[0.2]])
    flt = sf.SPHFilter(model, sensor, [3.0, 0.0], np.diag([0.2, 1.0]), n_particles=200)
    predictor, updater = SPHPredictor(model, n_particles=200), SPHUpdater(position())
    state, said = gaussian(), []
    for k, z in enumerate([3.2, -1.5, None, 5.5, -3.0, 6.5, 2.0], start=1):
        flt.predict(t=float(k))
        state = predictor.predict(state, at(k))
        if z is not None:
            said.append(flt.update([z]).status)
            state = updater.update(SingleHypothesis(state, seen(z, seconds=k)))
            assert state.info.status == said[-1] and state.info.log_evidence == flt.log_likelihood
        np.testing.assert_array_equal(state.density.x, flt.density.x)
        np.testing.assert_array_equal(state.density.mass, flt.density.mass)
    assert any("prediction repeated" in status for status in said)


def test_a_posterior_too_coarse_to_be_predicted_is_made_again(monkeypatch):
    """A prediction is said to fail on a posterior, as too coarse: as the filter does it."""
    model, sensor = duffing(), sf.GaussianMeasurement([[1.0, 0.0]], [[0.2]])
    flt = sf.SPHFilter(model, sensor, [3.0, 0.0], np.diag([0.2, 1.0]), n_particles=100)
    predictor, updater = SPHPredictor(model, n_particles=100), SPHUpdater(position())
    flt.predict(t=1.0)
    flt.update([3.2])
    state = updater.update(SingleHypothesis(predictor.predict(gaussian(), at(1.0)), seen(3.2, seconds=1.0)))
    coarse, predict = (flt.density, state.density), sf.predict

    def picky(density, *args, **options):
        if any(density is one for one in coarse):
            raise UnresolvedError("too coarse")
        return predict(density, *args, **options)

    for module in (sph_filter, stonesoup_predictor):
        monkeypatch.setattr(module, "predict", picky)
    status = flt.predict(t=2.0).status
    state = predictor.predict(state, at(2.0))
    assert "update before repeated" in status and state.info.status == status
    np.testing.assert_array_equal(state.density.mass, flt.density.mass)


def test_bearings_wrap():
    """A target that crosses the seam of the bearing, and the same scene turned by a right angle."""
    model = CombinedLinearGaussianTransitionModel([ConstantVelocity(0.05), ConstantVelocity(0.05)])
    predictor, found = SPHPredictor(model, n_particles=600), []
    for turned in (False, True):
        noise = np.diag([0.01, 0.25])
        sensor = CartesianToBearingRange(4, (0, 2), noise, translation_offset=np.zeros((2, 1)))
        mean, z = [-10.0, 0.0, 0.3, -0.5], [Bearing(-np.pi + 0.02), 10.2]
        if turned:  # a quarter turn to the left: (x, y) to (-y, x), bearings pi / 2 more
            mean, z = [-0.3, 0.5, -10.0, 0.0], [Bearing(-np.pi + 0.02 + np.pi / 2), 10.2]
        prior = GaussianState(mean, np.diag([0.5, 0.2, 0.5, 0.2]), timestamp=START)
        prediction = predictor.predict(prior, at(1))
        updater = SPHUpdater()
        reading = updater.predict_measurement(prediction, sensor)
        assert isinstance(reading.state_vector[0], Bearing)
        detection = seen(*z, seconds=1, model=sensor)
        posterior = updater.update(SingleHypothesis(prediction, detection, reading))
        x, vx, y, vy = posterior.density.mean()
        found.append([x, vx, y, vy] if not turned else [y, vy, -x, -vx])
        np.testing.assert_allclose(np.sqrt(reading.covar[0, 0]), 0.13, atol=0.02)
        assert posterior.info.accepted
    np.testing.assert_allclose(found[0], found[1], atol=1e-3)
    assert abs(found[0][2] - -0.2) < 0.1


def test_predictions_are_kept_by_value_not_by_state():
    """A state that is changed in place is predicted anew, though Stone Soup would find it in its cache."""
    predictor, state = SPHPredictor(duffing()), gaussian()
    first = predictor.predict(state, at(1))
    assert predictor.predict(state, at(1)).density is first.density  # the hypothesisers' questions are free
    state.state_vector[0] = -3.0
    second = predictor.predict(state, at(1))
    np.testing.assert_allclose(second.density.mean(), -first.density.mean(), atol=1e-3)
    predictor.transition_model = duffing().with_parameters(c=4.0)
    assert predictor.predict(state, at(1)).density.cov()[1, 1] < 0.5 * second.density.cov()[1, 1]


def test_time_dependence_follows_the_timestamps():
    """A forced drift: starting later is another prediction, and the same one where the epoch is later too."""
    model = sf.SDE.from_expressions(["x"], ["2*cos(t)"], noise=[["1"]], spectral_density=[[0.1]])
    with pytest.raises(sf.ModelError, match="epoch="):
        SPHPredictor(model)
    for begin, end in ((0.0, 1.0), (2.0, 3.5)):
        state = GaussianState([0.0], [[0.5]], timestamp=at(begin))
        moved = SPHPredictor(SDETransitionModel(model, epoch=START)).predict(state, at(end))
        expected = 2.0 * (np.sin(end) - np.sin(begin))
        np.testing.assert_allclose(moved.density.mean(), [expected], atol=2e-3)
        assert moved.density.t == end
        again = SPHPredictor(SDETransitionModel(model, epoch=at(begin))).predict(state, at(end))
        np.testing.assert_allclose(again.density.mean(), [2.0 * np.sin(end - begin)], atol=2e-3)


def test_a_miss_and_no_time_leave_the_density():
    predictor, updater = SPHPredictor(duffing()), SPHUpdater(position())
    prediction = predictor.predict(gaussian(), at(1))
    missed = updater.update(SingleHypothesis(prediction, MissedDetection(timestamp=at(1))))
    assert missed.density is prediction.density and missed.info.log_evidence == 0.0
    assert predictor.predict(missed, at(1)).density is prediction.density


def test_failures_are_sentences_and_change_nothing():
    predictor, updater = SPHPredictor(duffing()), SPHUpdater(position())
    prior = SPHState(sf.initialize(sf.Gaussian([3.0, 0.0], np.diag([0.2, 1.0])), 200), START)
    before = prior.density
    model = sf.SDE.from_expressions(["x", "v"], ["v", "x**5"], noise=[["0"], ["1"]])
    wild = SPHPredictor(model, on_failure="raise")
    for call, sentence in (
        (lambda: predictor.predict(prior, at(-1)), "back in time"),
        (lambda: predictor.predict(prior), "timestamp"),
        (lambda: predictor.predict(prior, at(1), control_input=1.0), "no control_input: .* drift of the SDE"),
        (lambda: SPHPredictor(duffing(), LinearControlModel(np.eye(2))), "no control_model"),
        (lambda: predictor.predict(prior.to_particle_state(10, 0), at(1)), "GaussianState"),
        (lambda: updater.update(SingleHypothesis(prior, seen(np.nan, seconds=0))), "MissedDetection"),
        (lambda: updater.update(SingleHypothesis(prior, seen(1.0, 2.0, seconds=0))), "1 finite numbers"),
        (lambda: SPHUpdater().update(SingleHypothesis(prior, seen(1.0, seconds=0))), "measurement_model"),
        (lambda: SPHState([1.0, 2.0]), "ParticleDensity"),
        (lambda: SPHPredictor(None), "SDETransitionModel"),
        (lambda: SPHPredictor(duffing(), n_particles=-1).predict(prior, at(1)), "n_particles"),
    ):
        with pytest.raises(sf.ModelError, match=sentence):
            call()
    with pytest.raises(sf.PropagationError, match="blew up"):
        wild.predict(prior, at(50))
    with pytest.raises(sf.ModelError, match="ParticleDensity"):
        prior.density = None
    assert prior.density is before and prior.timestamp == START
    prior.density = predictor.predict(prior, at(1)).density
    np.testing.assert_array_equal(prior.mean[:, 0], prior.density.mean())


def test_particle_state_has_the_moments():
    state = copy.deepcopy(SPHPredictor(duffing()).predict(gaussian(), at(1)))
    particles = state.to_particle_state(50_000, rng=1)
    assert (
        max(off(state, np.asarray(particles.mean, dtype=float).ravel(), np.asarray(particles.covar))) < 0.02
    )
    again = state.to_particle_state(50_000, rng=1)
    np.testing.assert_array_equal(particles.state_vector, again.state_vector)
