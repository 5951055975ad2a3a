"""Sensors of all kinds in Stone Soup: bearings, own likelihoods, circles, and what is not Gaussian."""

import numpy as np
import pytest
from stonesoup_cases import GRID, START, at, duffing, gaussian, off, on_grid, seen

import sphfilter as sf

pytest.importorskip("stonesoup")

from stonesoup.base import Property
from stonesoup.models.measurement.base import MeasurementModel
from stonesoup.models.measurement.nonlinear import CartesianToBearingRange
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import GaussianState, State
from stonesoup.types.track import Track

from sphfilter.adapters.stonesoup import EvidenceHypothesiser, SPHPredictor, SPHUpdater
from sphfilter.adapters.stonesoup.sensors import ModelMeasurement


def test_bearing_and_range_of_each_detection_are_their_own():
    """Detections bring their sensor along; association with it is that of a grid."""
    model = CartesianToBearingRange(
        ndim_state=2, mapping=(0, 1), noise_covar=np.diag([0.02, 0.3]), translation_offset=np.zeros((2, 1))
    )
    walk = sf.LinearSDE(np.zeros((2, 2)), noise=np.eye(2))
    predictor, updater = SPHPredictor(walk, n_particles=400), SPHUpdater()
    track = Track([gaussian(mean=(-3.0, 0.2), variances=(0.5, 0.5))])
    detections = {seen(3.1, 3.2, seconds=0.5, model=model), seen(-3.0, 4.5, seconds=0.5, model=model)}
    hypotheses = EvidenceHypothesiser(predictor, updater, 0.1, 0.9, 1).hypothesise(track, detections, at(0.5))
    posterior = updater.update(hypotheses)
    weight = np.full(len(GRID), 0.1)
    for detection in detections:
        angle, distance = (float(v) for v in detection.state_vector)
        off_angle = np.angle(np.exp(1j * (angle - np.arctan2(GRID[:, 1], GRID[:, 0]))))
        square = off_angle**2 / 0.02 + (distance - np.hypot(*GRID.T)) ** 2 / 0.3
        weight += 0.9 / 0.1 * np.exp(-0.5 * square) / (2 * np.pi * np.sqrt(0.02 * 0.3))
    _, mean, cov = on_grid(predictor.predict(track, at(0.5)).density, weight)
    assert max(off(posterior, mean, cov)) < 0.01


def test_any_likelihood_is_associated():
    """A sensor without a Gaussian, on the filter's own side of the fence, with gates off."""
    sensor = sf.LikelihoodMeasurement(lambda z, X, t: -np.abs(z[0] - X[:, 0]) / 0.3 - np.log(0.6))
    predictor, updater = SPHPredictor(duffing(), n_particles=400), SPHUpdater(sensor)
    track = Track([gaussian()])
    detections = {seen(2.5, seconds=1), seen(0.5, seconds=1)}
    hypotheses = EvidenceHypothesiser(predictor, updater, 0.1, 0.9, 1).hypothesise(track, detections, at(1))
    posterior = updater.update(hypotheses)
    laplace = [np.exp(-np.abs(z - GRID[:, 0]) / 0.3) / 0.6 for z in (2.5, 0.5)]
    density = predictor.predict(track, at(1)).density
    _, mean, cov = on_grid(density, 0.1 + 9.0 * sum(laplace))
    assert posterior.timestamp == at(1) and at(1) > START
    assert max(off(posterior, mean, cov)) < 0.02


class Exponential(MeasurementModel):
    """A sensor of Stone Soup's that is not Gaussian: z - x_0 > 0 is exponential."""

    scale: float = Property(doc="Mean of the error.")
    ndim_meas = 1

    def function(self, state, noise=False, **kwargs):
        return state.state_vector[:1, :]

    def logpdf(self, state1, state2, **kwargs):
        error = float(state1.state_vector[0]) - np.asarray(state2.state_vector[0, :], dtype=float)
        return np.where(error > 0, -error / self.scale - np.log(self.scale), -np.inf)

    def pdf(self, state1, state2, **kwargs):
        return np.exp(self.logpdf(state1, state2))

    def rvs(self, num_samples=1, **kwargs):
        raise NotImplementedError


def test_a_sensor_that_is_not_gaussian_is_asked_for_its_logpdf():
    predictor, updater = SPHPredictor(duffing(), n_particles=400), SPHUpdater()
    prediction, sensor = predictor.predict(gaussian(), at(1)), Exponential(2, (0,), scale=3.0)
    detection = seen(7.0, seconds=1, model=sensor)
    posterior = updater.update(SingleHypothesis(prediction, detection))
    likelihood = np.where(GRID[:, 0] < 7.0, np.exp((GRID[:, 0] - 7.0) / 3.0) / 3.0, 0.0)
    evidence, mean, cov = on_grid(prediction.density, likelihood)
    assert max(off(posterior, mean, cov)) < 0.01
    assert posterior.info.log_evidence == pytest.approx(np.log(evidence), abs=5e-3)
    with pytest.raises(sf.ModelError, match="noise covariance"):
        updater.predict_measurement(prediction, sensor)


def test_association_on_a_circle():
    """A heading of unknown turns with two detections across its seam, against a sum over the circle."""
    walk = sf.SDE.from_expressions(["a"], ["0.3"], noise=[["0.5"]], domain=[("periodic", -np.pi, np.pi)])
    sensor = sf.GaussianMeasurement([[1.0]], [[0.1]], angles=[0])
    predictor, updater = SPHPredictor(walk, n_particles=100), SPHUpdater(sensor)
    track = Track([GaussianState([2.6], [[0.1]], timestamp=START)])
    detections = {seen(3.1, seconds=1), seen(-2.2, seconds=1)}
    hypothesiser = EvidenceHypothesiser(predictor, updater, 0.2, 0.8, 0.999)
    posterior = updater.update(hypothesiser.hypothesise(track, detections, at(1)))
    angles = np.linspace(-np.pi, np.pi, 2001)[1:, None]
    weight = np.full(len(angles), 1.0 - 0.8 * 0.999)
    for z in (3.1, -2.2):
        error = np.angle(np.exp(1j * (z - angles[:, 0])))
        weight += 0.8 / 0.2 * np.exp(-0.5 * error**2 / 0.1) / np.sqrt(2 * np.pi * 0.1)
    p = predictor.predict(track, at(1)).density.pdf(angles) * weight
    p /= p.sum() * (angles[1] - angles[0])
    np.testing.assert_allclose(posterior.density.pdf(angles), p, atol=0.01 * p.max())
    assert posterior.density.pdf([[np.pi - 0.01]]) > 0.2  # the seam lies in the middle of it


@pytest.mark.parametrize("turned", [0.0, 2.0])
def test_readings_of_many_states_are_those_of_each(turned):
    """Also behind the sensor, where bearings jump from π to -π, and of a sensor that is turned."""
    model = CartesianToBearingRange(
        2, (0, 1), np.diag([0.01, 0.1]), translation_offset=np.array([[0.3], [0.1]])
    )
    model.rotation_offset = np.array([[0.0], [0.0], [turned]])
    X = np.random.default_rng(1).normal(0.0, 2.0, (200, 2)) - [1.0, 0.0]
    sensor = ModelMeasurement(model, START)
    each = [np.ravel(model.function(State(np.c_[x]), noise=False)).astype(float) for x in X]
    np.testing.assert_allclose(sensor.predict(X), each, atol=1e-12)
    np.testing.assert_allclose(sensor.predict(X[0]), each[:1], atol=1e-12)
    assert sensor.angles == (0,)
