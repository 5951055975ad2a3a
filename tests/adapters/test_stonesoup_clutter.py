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
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import GaussianState

from sphfilter.adapters.stonesoup import EvidenceHypothesiser, SPHPredictor, SPHUpdater
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


def test_a_failed_prediction_goes_on_as_a_gaussian_or_stays(monkeypatch):
    reference = SPHPredictor(LINE).predict(START, at(0.5))
    monkeypatch.setattr(predictor_room, "predict", failing)
    stands = SPHPredictor(LINE).predict(START, at(0.5))
    assert stands.info.flagged and "a Gaussian stands for the density: nothing holds" in stands.info.status
    np.testing.assert_allclose(np.ravel(stands.mean), np.ravel(reference.mean), atol=0.02)
    np.testing.assert_allclose(stands.covar, reference.covar, atol=0.02)
    stays = SPHPredictor(LINE, on_failure="drop").predict(START, at(0.5))
    assert stays.info.flagged and stays.info.status.startswith("left out")
    assert stays.timestamp == at(0.5) and stays.density.t == 0.5
    np.testing.assert_allclose(np.ravel(stays.mean), [0.4, 0.0], atol=1e-12)
    with pytest.raises(sf.PropagationError):
        SPHPredictor(LINE, on_failure="raise").predict(START, at(0.5))


def test_a_failed_update_goes_on_as_a_gaussian_or_is_a_miss(monkeypatch):
    prediction = SPHPredictor(LINE).predict(START, at(0.5))
    hypothesis = SingleHypothesis(prediction, seen(0.6, seconds=0.5))
    reference = SPHUpdater(position()).update(hypothesis)
    monkeypatch.setattr(updater_room, "update_or_predict_again", failing)
    stands = SPHUpdater(position()).update(hypothesis)
    assert stands.info.flagged and "a Gaussian stands for the posterior: nothing holds" in stands.info.status
    assert stands.info.log_evidence == pytest.approx(reference.info.log_evidence)
    np.testing.assert_allclose(np.ravel(stands.mean), np.ravel(reference.mean), atol=0.02)
    np.testing.assert_allclose(stands.covar, reference.covar, atol=0.02)
    missed = SPHUpdater(position(), on_failure="drop").update(hypothesis)
    assert missed.density is prediction.density and not missed.info.accepted and missed.info.flagged
    assert "not used: nothing holds" in missed.info.reason
    with pytest.raises(sf.PropagationError):
        SPHUpdater(position(), on_failure="raise").update(hypothesis)


@pytest.mark.parametrize("kind", [lambda **o: SPHPredictor(LINE, **o), SPHUpdater])
def test_other_words_are_refused(kind):
    with pytest.raises(sf.ModelError, match="on_failure must be one of 'gaussian', 'drop', 'raise'"):
        kind(on_failure="ignore")
