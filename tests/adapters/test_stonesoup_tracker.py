"""Stone Soup's trackers on our densities, with clutter and misses."""

import datetime

import numpy as np
import pytest
from stonesoup_cases import START, Recorded, at, duffing, gaussian, recorded_scene, seen

import sphfilter as sf

pytest.importorskip("stonesoup")

from stonesoup.dataassociator.neighbour import GNNWith2DAssignment, NearestNeighbour
from stonesoup.dataassociator.probability import JPDA, PDA
from stonesoup.deleter.error import CovarianceBasedDeleter
from stonesoup.deleter.time import UpdateTimeStepsDeleter
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.initiator.simple import GaussianParticleInitiator, SinglePointInitiator
from stonesoup.measures import Mahalanobis
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.linear import ConstantVelocity
from stonesoup.predictor.particle import ParticlePredictor
from stonesoup.resampler.particle import SystematicResampler
from stonesoup.tracker.simple import MultiTargetMixtureTracker, MultiTargetTracker, SingleTargetTracker
from stonesoup.types.track import Track
from stonesoup.updater.particle import ParticleUpdater

from sphfilter.adapters.stonesoup import EvidenceHypothesiser, SDETransitionModel, SPHPredictor, SPHUpdater
from sphfilter.model.paths import advance

PROB_DETECT = 0.9


def _track(scans, associator, updater, initiator):
    """States of the one track of a run to the end."""
    tracker = SingleTargetTracker(
        initiator, CovarianceBasedDeleter(100.0), Recorded(scans), associator, updater
    )
    for time, tracks in tracker:
        (track,) = tracks
        assert track.state.timestamp == time
    assert len(track) == len(scans)  # one track throughout
    return list(track)


def _means(states):
    return np.array([np.asarray(state.mean, dtype=float).ravel() for state in states])


def _rmse(states, truth):
    return np.sqrt(np.mean((_means(states) - truth)[1:, 0] ** 2))


def _cloud(scans, clutter, n_paths, rng):
    """The posterior by brute force: paths weighted with (1 - P_D) + P_D sum_i l_i / clutter."""
    model, R = duffing(), np.array([0.2, 4.0])
    z0 = np.ravel(next(iter(scans[0][1])).state_vector)
    P = 1.0 / (1.0 / np.array([0.2, 1.0]) + 1.0 / R)
    X = rng.normal(P * ([3.0, 0.0] / np.array([0.2, 1.0]) + z0 / R), np.sqrt(P), size=(n_paths, 2))
    for k, (_, detections) in enumerate(scans):
        if k:
            X = advance(model, X, 0.0, 1.0, rng)
            weight = np.full(n_paths, 1.0 - PROB_DETECT)
            for detection in detections:
                square = ((X - np.ravel(detection.state_vector)) ** 2 / R).sum(axis=1)
                weight += PROB_DETECT / clutter * np.exp(-0.5 * square) / (2 * np.pi * np.sqrt(R.prod()))
            weight /= weight.sum()
            mean = weight @ X
            yield mean, np.sqrt(weight @ (X - mean) ** 2)
            places = (rng.random() + np.arange(n_paths)) / n_paths * (1.0 - 1e-12)
            X = X[np.searchsorted(np.cumsum(weight), places)]


@pytest.mark.parametrize(
    ("n_scans", "n_paths", "most"),
    [(20, 10_000, 0.05), pytest.param(40, 200_000, 0.02, marks=pytest.mark.slow)],
)
def test_single_target_tracker_with_pda_is_exact_bayes(n_scans, n_paths, most):
    """Scans of 6 false detections each: the tracker's posteriors are those of many weighted paths."""
    scans, _, clutter = recorded_scene(seed=3, n_scans=n_scans)
    predictor, updater = SPHPredictor(duffing(), n_particles=400), SPHUpdater()
    associator = PDA(EvidenceHypothesiser(predictor, updater, clutter, PROB_DETECT, prob_gate=1))
    states = _track(scans, associator, updater, SinglePointInitiator(gaussian(), updater=updater))
    reference = _cloud(scans, clutter, n_paths, np.random.default_rng(1))
    off_mean, ratio = [], []
    for state, (mean, deviation) in zip(states[1:], reference, strict=True):
        off_mean.append((_means([state])[0] - mean) / deviation)
        ratio.append(np.sqrt(np.diag(state.covar)) / deviation)
    assert np.sqrt(np.mean(np.square(off_mean))) < most
    assert np.sqrt(np.mean((np.array(ratio) - 1.0) ** 2)) < most


def test_nearest_neighbour_is_as_good_as_a_particle_filter_on_the_same_detections():
    scans, truth, _ = recorded_scene(seed=0)
    predictor, updater = SPHPredictor(duffing(), n_particles=200), SPHUpdater()
    associator = NearestNeighbour(DistanceHypothesiser(predictor, updater, Mahalanobis(), 3))
    ours = _track(scans, associator, updater, SinglePointInitiator(gaussian(), updater=updater))
    sensor = next(iter(scans[0][1])).measurement_model
    moved = ParticlePredictor(SDETransitionModel(duffing(), seed=1))
    weighted = ParticleUpdater(None, resampler=SystematicResampler())
    initiator = GaussianParticleInitiator(SinglePointInitiator(gaussian(), sensor), number_particles=5000)
    np.random.seed(2)  # noqa: NPY002 - its initiator and resampler draw from the global generator
    nearest = NearestNeighbour(DistanceHypothesiser(moved, weighted, Mahalanobis(), 3))
    theirs = _track(scans, nearest, weighted, initiator)
    assert _rmse(ours, truth) == pytest.approx(_rmse(theirs, truth), rel=0.02)
    bayes = PDA(EvidenceHypothesiser(predictor, updater, 6 / 256, PROB_DETECT))
    weighed = _track(scans, bayes, updater, SinglePointInitiator(gaussian(), updater=updater))
    assert _rmse(weighed, truth) < 0.9 * _rmse(ours, truth)


def test_multi_target_tracker_begins_and_ends_tracks():
    """Two walkers cross; one disappears halfway. Its track ends, the other goes on."""
    rng, sensor = np.random.default_rng(5), LinearGaussian(2, [0], np.array([[0.1]]))
    scans = []
    for k in range(12):
        places = [-5.0 + k, 5.0 - k] if k < 7 else [-5.0 + k]
        scans.append((at(k), {seen(p + 0.3 * rng.normal(), seconds=k, model=sensor) for p in places}))
    predictor, updater = SPHPredictor(ConstantVelocity(0.05), n_particles=100), SPHUpdater()
    associator = GNNWith2DAssignment(DistanceHypothesiser(predictor, updater, Mahalanobis(), 4))
    initiator = SinglePointInitiator(gaussian(mean=(0.0, 0.0), variances=(20.0, 2.0)), updater=updater)
    tracker = MultiTargetTracker(initiator, UpdateTimeStepsDeleter(3), Recorded(scans), associator, updater)
    counts, ends = [], {}
    for _, tracks in tracker:
        counts.append(len(tracks))
        ends |= {track.id: track.state for track in tracks}
    assert counts[:7] == 7 * [2] and counts[-1] == 1 and len(ends) == 2
    (last,) = tracks
    assert abs(last.state.mean[0] - 6.0) < 0.5 and abs(last.state.mean[1] - 1.0) < 0.3


def test_trackers_that_merge_mixtures_themselves():
    """The mixture tracker with JPDA merges posteriors into Gaussians; our predictor starts from them."""
    rng, sensor = np.random.default_rng(7), LinearGaussian(2, [0], np.array([[0.1]]))
    paths = [lambda k: -4.0 + 0.5 * k, lambda k: 4.0 - 0.5 * k]
    predictor, updater = SPHPredictor(ConstantVelocity(0.02), n_particles=100), SPHUpdater()
    associator = JPDA(EvidenceHypothesiser(predictor, updater, 0.01, PROB_DETECT))
    tracks = {Track([gaussian(mean=(path(0), path(1) - path(0)), variances=(0.1, 0.1))]) for path in paths}
    scans = [
        (at(k), {seen(path(k) + 0.3 * rng.normal(), seconds=k, model=sensor) for path in paths})
        for k in range(1, 7)
    ]
    initiator = SinglePointInitiator(gaussian(variances=(20.0, 2.0)), updater=updater)
    tracker = MultiTargetMixtureTracker(
        initiator, UpdateTimeStepsDeleter(3), Recorded(scans), associator, updater
    )
    tracker._tracks = tracks
    for _, now in tracker:
        assert tracks <= now
    ends = sorted(float(track.state.mean[0]) for track in tracks)
    np.testing.assert_allclose(ends, sorted(path(6) for path in paths), atol=0.5)


def test_a_failed_update_leaves_tracker_and_track_as_they_were():
    scans, _, _ = recorded_scene(seed=1, n_scans=3)
    scans.append((at(3), {seen(np.nan, 0.0, seconds=3, model=next(iter(scans[0][1])).measurement_model)}))
    predictor, updater = SPHPredictor(duffing()), SPHUpdater()
    associator = PDA(EvidenceHypothesiser(predictor, updater, 0.02, PROB_DETECT, prob_gate=1))
    initiator = SinglePointInitiator(gaussian(), updater=updater)
    tracker = SingleTargetTracker(
        initiator, CovarianceBasedDeleter(100.0), Recorded(scans), associator, updater
    )
    steps = iter(tracker)
    for _ in range(3):
        _, tracks = next(steps)
    (track,) = tracks
    density = track.state.density
    with pytest.raises(sf.ModelError, match="finite numbers"):
        next(steps)
    assert len(track) == 3 and track.state.density is density
    assert START + datetime.timedelta(seconds=2) == track.timestamp


def test_plotters_draw_the_points_of_a_track():
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    from stonesoup.plotter import Plotter

    track = Track([SPHPredictor(duffing()).predict(gaussian(), at(k)) for k in (1, 2)])
    drawn = Plotter().plot_tracks({track}, [0, 1], uncertainty=True, particle=True)
    points = Track([state.to_particle_state(200, rng=1) for state in track])
    drawn = Plotter().plot_tracks({points}, [0, 1], particle=True)
    assert sum(len(line.get_xdata()) == 200 for line in drawn if hasattr(line, "get_xdata")) == 2
    matplotlib.pyplot.close("all")
