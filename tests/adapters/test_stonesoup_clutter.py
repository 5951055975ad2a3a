"""A run to its end through clutter, some of it right beside the sensor, and what stands for failed steps."""

import numpy as np
import pytest
from stonesoup_cases import at, failing, gaussian, position, seen

import sphfilter as sf

pytest.importorskip("stonesoup")

from stonesoup.dataassociator.probability import PDA
from stonesoup.deleter.error import CovarianceBasedDeleter
from stonesoup.deleter.multi import CompositeDeleter
from stonesoup.deleter.time import UpdateTimeStepsDeleter
from stonesoup.initiator.simple import SimpleMeasurementInitiator
from stonesoup.models.measurement.nonlinear import CartesianToBearingRange
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, RandomWalk
from stonesoup.types.angle import Bearing
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis, SingleProbabilityHypothesis
from stonesoup.types.multihypothesis import MultipleHypothesis
from stonesoup.types.state import GaussianState

from sphfilter.adapters.stonesoup import (
    EvidenceHypothesiser,
    JumpMarkovPredictor,
    JumpMarkovUpdater,
    SPHPredictor,
    SPHUpdater,
)
from sphfilter.adapters.stonesoup import predictor as predictor_room
from sphfilter.adapters.stonesoup import updater as updater_room

PROB_DETECT, CLUTTER, BESIDE, FAR = 0.9, 20, 3, 60.0
SENSOR = CartesianToBearingRange(
    ndim_state=2, mapping=(0, 1), noise_covar=np.diag([np.radians(1.0) ** 2, 0.2])
)


def scene(n_scans, seed):
    """Scans of wandering targets, of clutter all over and of some within half a metre of the sensor."""
    rng = np.random.default_rng(seed)
    targets, scans, truth = np.array([[-30.0, 20.0], [25.0, 30.0], [5.0, -40.0]]), [], []

    def detection(bearing, distance):
        return Detection([Bearing(bearing), distance], timestamp=at(len(scans)), measurement_model=SENSOR)

    for _ in range(n_scans):
        targets = targets + rng.normal(size=targets.shape)
        found = [
            detection(np.arctan2(y, x) + np.radians(1.0) * rng.normal(), np.hypot(x, y) + 0.4 * rng.normal())
            for x, y in targets[rng.random(3) < PROB_DETECT]
        ]
        found += [detection(b, rng.uniform(0.0, FAR)) for b in rng.uniform(-np.pi, np.pi, CLUTTER)]
        found += [detection(b, rng.uniform(0.02, 0.5)) for b in rng.uniform(-np.pi, np.pi, BESIDE)]
        scans.append((at(len(scans)), set(found)))
        truth.append(targets)
    return scans, truth


@pytest.mark.slow
def test_a_run_through_clutter_beside_the_sensor_goes_to_its_end():
    scans, truth = scene(n_scans=8, seed=4)
    model = CombinedLinearGaussianTransitionModel([RandomWalk(1.0), RandomWalk(1.0)])
    predictor, updater = SPHPredictor(model, n_particles=120), SPHUpdater()
    density = (CLUTTER + BESIDE) / (2.0 * np.pi * FAR)
    associator = PDA(EvidenceHypothesiser(predictor, updater, density, PROB_DETECT, prob_gate=0.99))
    nowhere = GaussianState([0.0, 0.0], np.diag([1.0, 1.0]), timestamp=at(0))
    initiator = SimpleMeasurementInitiator(nowhere)
    deleter = CompositeDeleter([UpdateTimeStepsDeleter(2), CovarianceBasedDeleter(30.0)], intersect=False)
    tracks, likely, stood_in = set(), 0.3, 0
    for time, detections in scans:
        hypotheses, used = associator.associate(tracks, detections, time), set()
        for track in tracks:
            track.append(updater.update(hypotheses[track]))
            stood_in += "a Gaussian stands" in track.state.info.status
            used |= {h.measurement for h in hypotheses[track] if h and h.probability > likely}
        tracks -= deleter.delete_tracks(tracks)
        tracks |= initiator.initiate(detections - used, time)
    assert stood_in, "no clutter was sharper than lattices hold"
    for target in truth[-1]:
        off = [np.linalg.norm(np.ravel(track.state.mean).astype(float) - target) for track in tracks]
        assert min(off) < 3.0, "a target was lost"


LINE = sf.SDE.from_expressions(["x", "v"], ["v", "-sin(x)"], [["0"], ["1"]], [[0.1]])
START = gaussian((0.4, 0.0), (0.1, 0.1))


def test_a_failed_prediction_goes_on_as_a_gaussian(monkeypatch):
    reference = SPHPredictor(LINE).predict(START, at(0.5))
    monkeypatch.setattr(predictor_room, "predict", failing)
    stands = SPHPredictor(LINE).predict(START, at(0.5))
    assert stands.info.flagged and "a Gaussian stands for the density: nothing holds" in stands.info.status
    np.testing.assert_allclose(np.ravel(stands.mean), np.ravel(reference.mean), atol=0.02)
    np.testing.assert_allclose(stands.covar, reference.covar, atol=0.02)


def test_a_failed_update_goes_on_as_a_gaussian(monkeypatch):
    prediction = SPHPredictor(LINE).predict(START, at(0.5))
    hypothesis = SingleHypothesis(prediction, seen(0.6, seconds=0.5))
    reference = SPHUpdater(position()).update(hypothesis)
    monkeypatch.setattr(updater_room, "update_or_predict_again", failing)
    stands = SPHUpdater(position()).update(hypothesis)
    assert stands.info.flagged and "a Gaussian stands for the posterior: nothing holds" in stands.info.status
    assert stands.info.log_evidence == pytest.approx(reference.info.log_evidence)
    np.testing.assert_allclose(np.ravel(stands.mean), np.ravel(reference.mean), atol=0.02)
    np.testing.assert_allclose(stands.covar, reference.covar, atol=0.02)


def one(word):
    """Predictor and updater of one density."""
    return SPHPredictor(LINE, on_failure=word), SPHUpdater(position(), on_failure=word)


def switching(word):
    """Predictor and updater of a density for every mode."""
    modes = {
        name: sf.LinearSDE([[0.0, 1.0], [-k, 0.0]], noise=0.3 * np.eye(2))
        for name, k in (("a", 0.0), ("b", 1.0))
    }
    predictor = JumpMarkovPredictor(sf.JumpMarkovModel(modes, [[-0.1, 0.1], [0.2, -0.2]]), on_failure=word)
    return predictor, JumpMarkovUpdater(predictor, position())


@pytest.mark.parametrize(
    ("kind", "predicts", "updates", "sums"),
    [
        (one, "predict", "update_or_predict_again", "resolved"),
        (switching, "predict_modes", "update_or_predict_modes_again", "mixture"),
    ],
)
def test_a_step_that_fails_is_left_out_or_raised(kind, predicts, updates, sums, monkeypatch):
    predictor, updater = kind("drop")
    prediction, detection = predictor.predict(START, at(0.5)), seen(0.6, seconds=0.5)
    hypothesis = SingleHypothesis(prediction, detection)
    evidence = updater.log_evidence(prediction, detection)
    several = [SingleProbabilityHypothesis(prediction, each, 0.5) for each in (None, detection)]
    monkeypatch.setattr(updater_room, sums, failing)
    missed = [updater.update(MultipleHypothesis(several))]
    monkeypatch.setattr(updater_room, updates, failing)
    monkeypatch.setattr(predictor_room, predicts, failing)
    predictor, updater = kind("drop")
    missed.append(updater.update(hypothesis))
    for state in missed:
        assert state._carried is prediction._carried and not state.info.accepted and state.info.flagged
        assert "not used: nothing holds it" in state.info.reason
    assert missed[1].info.log_evidence == pytest.approx(evidence, abs=0.05)
    assert updater.log_evidence(prediction, detection) == pytest.approx(evidence, abs=0.05)
    stays = predictor.predict(START, at(0.5))
    assert stays.info.flagged and stays.info.status.startswith("left out")
    assert stays.timestamp == at(0.5) and stays.density.t == 0.5
    np.testing.assert_allclose(np.ravel(stays.mean), [0.4, 0.0], atol=1e-12)
    np.testing.assert_allclose(stays.covar, START.covar, atol=1e-4)
    predictor, updater = kind("raise")
    for call in (lambda: updater.update(hypothesis), lambda: predictor.predict(START, at(0.5))):
        with pytest.raises(sf.PropagationError, match="nothing holds it"):
            call()


@pytest.mark.parametrize("kind", [lambda **o: SPHPredictor(LINE, **o), SPHUpdater])
def test_other_words_are_refused(kind):
    with pytest.raises(sf.ModelError, match="on_failure must be one of 'gaussian', 'drop', 'raise'"):
        kind(on_failure="ignore")
