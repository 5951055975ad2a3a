"""Models that switch in Stone Soup: the filter's own answers from its trackers, clutter, files, refusals."""

import pickle

import numpy as np
import pytest
from density_cases import moving as linear
from stonesoup_cases import Recorded, at, gaussian, seen

import sphfilter as sf
from reference_filters.jump_grid import unsplit_jump_filter

pytest.importorskip("stonesoup")

from stonesoup.dataassociator.neighbour import GNNWith2DAssignment, NearestNeighbour
from stonesoup.dataassociator.probability import JPDA, PDA
from stonesoup.deleter.error import CovarianceBasedDeleter
from stonesoup.deleter.time import UpdateTimeStepsDeleter
from stonesoup.gater.distance import DistanceGater
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.hypothesiser.probability import PDAHypothesiser
from stonesoup.initiator.simple import SinglePointInitiator
from stonesoup.measures import Mahalanobis
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.measurement.nonlinear import CartesianToBearingRange
from stonesoup.serialise import YAML
from stonesoup.tracker.simple import MultiTargetMixtureTracker, MultiTargetTracker, SingleTargetTracker
from stonesoup.types.hypothesis import SingleHypothesis, SingleProbabilityHypothesis
from stonesoup.types.multihypothesis import MultipleHypothesis
from stonesoup.types.track import Track

from sphfilter.adapters.stonesoup import (
    EvidenceHypothesiser,
    JumpMarkovPredictor,
    JumpMarkovState,
    JumpMarkovUpdater,
    SPHPredictor,
    SPHState,
    SPHUpdater,
    extend,
)

RATES = [[-0.1, 0.1], [0.2, -0.2]]
SENSOR = LinearGaussian(1, [0], np.array([[0.04]]))
START = gaussian((0.0,), (0.1,))


def bent():
    drift = {"rest": "-0.5*x**3", "moving": "1 - 0.1*x**3"}
    return sf.JumpMarkovModel(
        {name: sf.SDE.from_expressions(["x"], [f], [["0.2"]]) for name, f in drift.items()}, RATES
    )


def parts(model, sensor=SENSOR, **options):
    """Predictor and updater, with the settings of a filter rather than of a tracker."""
    predictor = JumpMarkovPredictor(model, **{"config": sf.FilterConfig()} | options)
    return predictor, JumpMarkovUpdater(predictor, sensor)


def nearest(predictor, updater, gate=40.0):
    return DistanceHypothesiser(predictor, updater, Mahalanobis(), gate)


def tracked(scans, associator, updater, start):
    """States of the one track of Stone Soup's tracker."""
    initiator, deleter = SinglePointInitiator(start, updater=updater), CovarianceBasedDeleter(1e3)
    for _, tracks in SingleTargetTracker(initiator, deleter, Recorded(scans), associator, updater):
        (track,) = tracks
    assert len(track) == len(scans)
    return track


@pytest.mark.parametrize(
    ("model", "z"),
    [(linear(), [0.1, 2.4, 2.5, 3.4]), (bent(), [0.1, 2.0, -0.5, 2.4])],
    ids=["linear", "bent"],
)
@pytest.mark.parametrize("scored", [nearest, lambda *both: EvidenceHypothesiser(*both, 1e-9, prob_gate=1)])
def test_a_tracker_gives_what_the_filter_gives(model, z, scored):
    """To rounding, through predictions that a reading far out has made again."""
    predictor, updater = parts(model)
    scans = [(at(k), {seen(value, seconds=k)}) for k, value in enumerate(z)]
    states = tracked(scans, NearestNeighbour(scored(predictor, updater)), updater, START)
    flt = sf.JumpMarkovFilter(model, sf.GaussianMeasurement([[1.0]], [[0.04]]), [0.0], [[0.1]])
    repeated = False
    for k, (state, value) in enumerate(zip(states, z, strict=True)):
        if k:
            flt.predict(1.0)
        info = flt.update(value)
        np.testing.assert_allclose(state.mode_probabilities, flt.mode_probabilities, atol=1e-12)
        np.testing.assert_allclose(np.ravel(state.mean), flt.x, atol=1e-12)
        np.testing.assert_allclose(state.covar, flt.P, atol=1e-12)
        assert state.info.log_evidence == pytest.approx(flt.log_likelihood, abs=1e-12)
        assert (state.info.code, state.mode, state.names) == (info.code, flt.mode, model.names)
        np.testing.assert_allclose(state.density.mean(), flt.density.mean(), atol=1e-12)
        repeated |= sf.Code.REPEATED in info.code
    assert repeated
    assert set(state.densities) == set(model.names)


@pytest.mark.parametrize("made", [JumpMarkovPredictor, lambda m, **own: SPHPredictor(m.modes["rest"], **own)])
def test_a_prediction_says_what_time_it_took(made):
    """And that this was more than a budget."""
    for budget, late in ((None, False), (1e-9, True), (1e3, False)):
        info = made(linear(), config=sf.FilterConfig(time_budget=budget)).predict(START, at(1)).info
        assert (sf.Code.LATE in info.code) == ("time budget exceeded" in info.status) == late
        assert info.seconds > 0.0


def test_the_predicted_reading_is_that_of_all_modes():
    """Mean and covariance are the filter's innovation; angles of modes apart are averaged as directions."""
    predictor, updater = parts(linear())
    flt = sf.JumpMarkovFilter(linear(), sf.GaussianMeasurement([[1.0]], [[0.04]]), [0.0], [[0.1]])
    flt.predict(1.0)
    flt.update(0.4)
    prediction = predictor.predict(START, at(1))
    reading = updater.predict_measurement(prediction)
    np.testing.assert_allclose(0.4 - np.ravel(reading.mean), flt.y, atol=1e-12)
    np.testing.assert_allclose(reading.covar, flt.S, atol=1e-12)
    np.testing.assert_allclose(reading.cross_covar, prediction.covar, atol=1e-12)
    bearing = CartesianToBearingRange(2, (0, 1), np.diag([0.01, 0.1]))
    apart = {s: sf.LinearSDE(np.zeros((2, 2)), [0.0, v], np.eye(2) / 9) for s, v in (("up", 2), ("down", -2))}
    predictor, updater = parts(sf.JumpMarkovModel(apart, np.zeros((2, 2))), bearing)
    behind = predictor.predict(gaussian((-9.0, 0.0), (0.01, 0.01)), at(1))
    around = updater.predict_measurement(behind)
    assert abs(float(around.mean[0])) == pytest.approx(np.pi, abs=0.01)  # not 0, between π and -π
    assert around.covar[0, 0] == pytest.approx(np.arctan2(2.0, 9.0) ** 2 + 0.01, rel=0.1)


def test_an_association_is_the_sum_of_posteriors_in_every_mode():
    predictor, updater = parts(linear())
    prediction = predictor.predict(START, at(1))
    detections = [seen(z, seconds=1) for z in (0.1, 1.3)]
    b = [0.2, 0.5, 0.3]
    alone = [prediction] + [updater.update(SingleHypothesis(prediction, d)) for d in detections]
    hypotheses = [
        SingleProbabilityHypothesis(prediction, detection, weight)
        for detection, weight in zip([None, *detections], b, strict=True)
    ]
    found = updater.update(MultipleHypothesis(hypotheses))
    means = np.array([np.ravel(state.mean) for state in alone])
    mean = b @ means
    covar = np.einsum("k,kab->ab", b, [s.covar for s in alone]) + np.cov(means.T, aweights=b, ddof=0)
    probabilities = b @ np.array([state.mode_probabilities for state in alone])
    np.testing.assert_allclose(found.mode_probabilities, probabilities, atol=1e-12)
    np.testing.assert_allclose(np.ravel(found.mean), mean, atol=0.01 * np.sqrt(covar[0, 0]))
    np.testing.assert_allclose(found.covar, covar, rtol=0.02)
    X = np.linspace(-1.0, 2.5, 15)[:, None]
    summed = b @ np.array([np.exp(state.modes.logpdf(X)) for state in alone])
    np.testing.assert_allclose(np.exp(found.modes.logpdf(X)), summed, rtol=0.05)
    assert found.info.accepted and found.info.log_evidence == 0.0 and not found.info.flagged
    missed = updater.update(MultipleHypothesis(hypotheses[:1]))
    assert missed.modes is prediction.modes and "no detection was used" in missed.info.reason


CLUTTER, DETECTED = 0.2, 0.9  # false detections a unit and scan; probability that the target is seen


def turning():
    """A target that goes up or down, a unit a second."""
    modes = {way: sf.LinearSDE([[0.0]], [v], noise=[[0.2]]) for way, v in (("up", 1.0), ("down", -1.0))}
    return sf.JumpMarkovModel(modes, [[-0.1, 0.1], [0.1, -0.1]])


def course(n_scans=12, turns=(4, 8), width=3.0, seed=6):
    """Readings of a target that turns and turns back, in clutter around it; its places (n_scans,)."""
    rng = np.random.default_rng(seed)
    path = np.cumsum([-1.0 if turns[0] <= k < turns[1] else 1.0 for k in range(n_scans)])
    scans = []
    for k, place in enumerate(path):
        found = [place + 0.2 * rng.normal()] if k == 0 or rng.random() < DETECTED else []
        wrong = rng.poisson(2.0 * width * CLUTTER) if k else 0
        scans.append(np.r_[found, place + rng.uniform(-width, width, wrong)])
    return scans, path


def followed(associator, updater, readings):
    scans = [(at(k), {seen(z, seconds=k) for z in now}) for k, now in enumerate(readings)]
    track = tracked(scans, associator, updater, gaussian((1.0,), (0.1,)))
    return track, np.array([float(state.mean[0]) for state in track])


def test_an_association_of_evidence_is_exact_bayes_for_a_target_that_turns():
    """Against a grid of both modes, whose likelihood is that of a whole scan."""
    readings, path = course()
    predictor, updater = parts(turning())
    associator = PDA(EvidenceHypothesiser(predictor, updater, CLUTTER, DETECTED, prob_gate=1))
    track, means = followed(associator, updater, readings)

    def loglik(z, X, t):
        near = np.exp(-0.5 * (z - X) ** 2 / 0.04) / np.sqrt(2.0 * np.pi * 0.04)
        return np.log(1.0 - DETECTED + DETECTED / CLUTTER * near.sum(axis=1))

    start = updater.update(SingleHypothesis(gaussian((1.0,), (0.1,)), seen(readings[0][0], seconds=0)))
    first = float(start.mean[0]), float(start.covar[0, 0])
    scan = sf.LikelihoodMeasurement(loglik)
    grid = unsplit_jump_filter(
        turning(), scan, *first, range(1, 12), readings[1:], box=(-8.0, 12.0), size=1601
    )
    deviation = np.sqrt(grid[:, 1])
    assert np.sqrt(np.mean(((means[1:] - grid[:, 0]) / deviation) ** 2)) < 0.03
    np.testing.assert_allclose([float(s.covar[0, 0]) for s in track[1:]], grid[:, 1], rtol=0.05)
    np.testing.assert_allclose([s.mode_probabilities for s in track[1:]], grid[:, 3:], atol=0.01)
    assert [track[k].mode for k in (3, 7, 11)] == ["up", "down", "up"]
    assert np.abs((means[1:] - path[1:]) / deviation).max() < 4.0


def by_moments(predictor, updater):
    return PDA(PDAHypothesiser(predictor, updater, CLUTTER, DETECTED, 0.999))


def by_distance(predictor, updater):
    return GNNWith2DAssignment(DistanceGater(nearest(predictor, updater, 3.0), Mahalanobis(), 3.0))


@pytest.mark.parametrize("associator", [by_moments, by_distance])
def test_other_associations_follow_a_target_that_turns(associator):
    """Which one model does not, in the same associator."""
    readings, path = course()
    predictor, updater = parts(turning())
    track, means = followed(associator(predictor, updater), updater, readings)
    assert [track[k].mode for k in (3, 7, 11)] == ["up", "down", "up"]
    one = SPHPredictor(turning().modes["up"]), SPHUpdater(SENSOR)
    _, lost = followed(associator(*one), one[1], readings)
    off, far = (np.sqrt(np.mean((found - path) ** 2)) for found in (means, lost))
    assert off < 0.5 * far


def test_tracks_of_several_targets():
    """Two targets, of which one begins to move: GNN and JPDA keep the tracks and tell the modes apart."""
    rng = np.random.default_rng(4)
    places = [(-3.0, 3.0), (-3.0, 3.0), (-3.0, 4.0), (-3.0, 5.0), (-3.0, 6.0)]
    scans = [
        (at(k), {seen(place + 0.2 * rng.normal(), seconds=k) for place in now})
        for k, now in enumerate(places)
    ]
    predictor, updater = parts(linear())
    initiator = SinglePointInitiator(gaussian((0.0,), (20.0,)), updater=updater)
    nearby = GNNWith2DAssignment(nearest(predictor, updater, 4.0))
    tracker = MultiTargetTracker(initiator, UpdateTimeStepsDeleter(2), Recorded(scans), nearby, updater)
    *_, (_, tracks) = tracker
    weighed = initiator.initiate(scans[0][1], at(0))
    associator = JPDA(EvidenceHypothesiser(predictor, updater, 0.01, 0.95))
    for time, detections in scans[1:]:
        for track, hypotheses in associator.associate(weighed, detections, time).items():
            track.append(updater.update(hypotheses))
    for found in (tracks, weighed):
        ends = sorted((float(track.state.mean[0]), track.state.mode) for track in found)
        assert [mode for _, mode in ends] == ["rest", "moving"]
        np.testing.assert_allclose([mean for mean, _ in ends], places[-1], atol=0.5)


def test_a_pickled_track_goes_on_to_the_same_bits():
    predictor, updater = parts(linear(), mode_probabilities={"rest": 1.0})
    scans = [(at(k), {seen(z, seconds=k)}) for k, z in enumerate((0.1, 0.2, 1.1))]
    track = tracked(scans, NearestNeighbour(nearest(predictor, updater)), updater, START)
    assert track[0].mode_probabilities[0] == 1.0
    predicted = predictor.predict(track[0], at(1))
    made = predictor, updater, track, predicted
    on = []
    for predictor, updater, track, predicted in (made, pickle.loads(pickle.dumps(made))):
        one = updater.update(SingleHypothesis(predicted, seen(2.6, seconds=1)))  # predicts again
        other = updater.update(SingleHypothesis(predictor.predict(track, at(3)), seen(2.2, seconds=3)))
        on.append((one, other, track))
    assert sf.Code.REPEATED in on[0][0].info.code
    for mine, theirs in zip(*on, strict=True):
        assert np.array_equal(mine.mode_probabilities, theirs.mode_probabilities)
        assert np.array_equal(mine.mean, theirs.mean) and np.array_equal(mine.covar, theirs.covar)
        assert mine.info == theirs.info and theirs.names == ("rest", "moving")
        assert theirs.hypothesis.prediction.info == mine.hypothesis.prediction.info


def test_a_miss_does_not_forget_the_prediction_before():
    predictor, updater = parts(linear())
    prediction = predictor.predict(START, at(1))
    missed = updater.update(SingleHypothesis(prediction, None))
    again = predictor.predict(missed, at(1))
    assert again.modes is missed.modes is prediction.modes
    far = updater.update(SingleHypothesis(again, seen(3.0, seconds=1)))
    assert sf.Code.REPEATED in far.info.code


def test_sensors_read_the_inputs_of_the_model():
    mode = sf.SDE.from_expressions(["x"], ["u"], [["0.2"]], inputs={"u": 0.5})
    model = sf.JumpMarkovModel({"one": mode, "other": mode}, RATES)
    sensor = sf.GaussianMeasurement.from_expressions(["x"], ["x + 10*u"], [[0.04]], inputs={"u": 0.0})
    predictor, updater = parts(model, sensor)
    reading = updater.predict_measurement(predictor.predict(START, at(1)))
    assert float(reading.mean[0]) == pytest.approx(5.5)


def test_states_show_their_density():
    predictor, _ = parts(linear())
    state = predictor.predict(SPHState(sf.initialize(sf.Gaussian([0.0], [[0.1]]), 100), at(0)), at(2))
    assert state.ndim == 1 and state.density is state.density
    other = JumpMarkovState.from_state(state, target_type=JumpMarkovState)
    assert type(other) is JumpMarkovState and other.modes is state.modes
    with pytest.raises(ValueError, match="read-only"):
        state.mean[0] = 1.0


def merging(predictor, updater):
    """Run a tracker that makes Gaussians of posteriors."""
    scans = [(at(k), {seen(0.1 * k, seconds=k)}) for k in range(3)]
    associator = PDA(EvidenceHypothesiser(predictor, updater, 0.01))
    initiator = SinglePointInitiator(START, updater=updater)
    tracker = MultiTargetMixtureTracker(
        initiator, UpdateTimeStepsDeleter(2), Recorded(scans), associator, updater
    )
    return list(tracker)


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: SPHPredictor(linear()), "JumpMarkovPredictor"),
        (lambda: JumpMarkovPredictor(sf.LinearSDE([[0.0]], noise=[[0.2]])), "SPHPredictor takes others"),
        (lambda: JumpMarkovPredictor(linear(), on_failure="gaussian"), "one of 'drop', 'raise'"),
        (lambda: SPHPredictor(linear().modes["rest"], n_particles="auto"), "takes a bound of the particles"),
        (lambda: JumpMarkovPredictor(linear(), n_particles="many"), "n_particles"),
        (lambda: JumpMarkovPredictor(linear(), mode_probabilities=[0.5, 0.6]), "sum to one"),
        (
            lambda: JumpMarkovPredictor(linear()).predict(gaussian(), at(1)),
            "of 2 numbers, those of the model of 1",
        ),
        (lambda: parts(linear(), {"rest": SENSOR})[1].predict_measurement(START), "measurement_model"),
        (lambda: JumpMarkovUpdater(SPHPredictor(linear().modes["rest"])), "predictor must be"),
        (lambda: merging(*parts(linear())), "merged densities of modes into a Gaussian"),
        (lambda: JumpMarkovState("modes", ("rest",)), "takes ModeDensities"),
    ],
)
def test_what_does_not_fit_is_refused(call, sentence):
    with pytest.raises(sf.SphfilterError, match=sentence):
        call()


def test_modes_of_time_and_states_of_others_are_refused():
    timed = sf.SDE.from_expressions(["x"], ["sin(t)"], [["0.2"]])
    with pytest.raises(sf.ModelError, match=r"modes \['on'\] may depend on time"):
        JumpMarkovPredictor(sf.JumpMarkovModel({"on": timed, "off": linear().modes["rest"]}, RATES))
    state = JumpMarkovPredictor(linear()).predict(START, at(1))
    renamed = sf.JumpMarkovModel(dict(zip("ab", linear().modes.values(), strict=True)), RATES)
    hypothesis = SingleHypothesis(state, seen(0.6, seconds=1))
    for call, sentence in (
        (lambda: JumpMarkovPredictor(renamed).predict(state, at(2)), "modes .'rest', 'moving'., the model"),
        (lambda: SPHUpdater(SENSOR).update(hypothesis), "JumpMarkovUpdater"),
        (lambda: SPHPredictor(linear().modes["rest"]).predict(state, at(2)), "JumpMarkovPredictor"),
    ):
        with pytest.raises(sf.ModelError, match=sentence):
            call()


def test_yaml_holds_no_models_that_switch():
    yaml = YAML()
    extend(yaml)
    predictor = JumpMarkovPredictor(linear())
    for value, kind in (
        (predictor, "JumpMarkovModel"),
        (Track([predictor.predict(START, at(1))]), "Mode|Jump"),
    ):
        with pytest.raises(sf.ModelError, match=f"YAML holds no ({kind})"):
            yaml.dumps(value)
