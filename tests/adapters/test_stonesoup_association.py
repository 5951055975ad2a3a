"""Gates, data association and evidence in Stone Soup on our densities."""

import numpy as np
import pytest
from stonesoup_cases import GRID, at, duffing, gaussian, off, on_grid, position, seen

import sphfilter as sf

pytest.importorskip("stonesoup")

from stonesoup.dataassociator.neighbour import GlobalNearestNeighbour, NearestNeighbour
from stonesoup.dataassociator.probability import JPDA, PDA
from stonesoup.gater.distance import DistanceGater
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.hypothesiser.probability import PDAHypothesiser
from stonesoup.measures import Mahalanobis
from stonesoup.models.transition.linear import ConstantVelocity
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.types.hypothesis import SingleDistanceHypothesis
from stonesoup.types.multihypothesis import MultipleHypothesis
from stonesoup.types.track import Track
from stonesoup.updater.kalman import KalmanUpdater

from sphfilter.adapters.stonesoup import EvidenceHypothesiser, SPHPredictor, SPHUpdater
from sphfilter.model.paths import advance


@pytest.fixture(scope="module")
def two_wells():
    """A prediction that has spread over both wells."""
    return SPHPredictor(duffing()).predict(gaussian(mean=(0.0, 0.0)), at(3))


def _likelihood(z, variance=0.2):
    return np.exp(-0.5 * (z - GRID[:, 0]) ** 2 / variance) / np.sqrt(2 * np.pi * variance)


def test_evidence_is_the_integral(two_wells):
    updater = SPHUpdater(position())
    for z in (-4.0, 0.0, 3.0):
        evidence, _, _ = on_grid(two_wells.density, _likelihood(z))
        found = updater.log_evidence(two_wells, seen(z, seconds=3))
        assert found == pytest.approx(np.log(evidence), abs=5e-3)


@pytest.mark.parametrize("variance", [0.2, 0.01, 0.002])
@pytest.mark.parametrize("prob_detect", [0.5, 0.98])
def test_association_is_the_mixture_on_one_lattice(two_wells, variance, prob_detect):
    """P_D l_i / lambda for each detection and 1 - P_D for none, times the density, summed over a grid."""
    predictor, updater, clutter = SPHPredictor(duffing()), SPHUpdater(position(variance)), 0.1
    hypothesiser = EvidenceHypothesiser(predictor, updater, clutter, prob_detect, prob_gate=1)
    detections = {seen(2.6, seconds=3), seen(-1.0, seconds=3)}
    track = Track([gaussian(mean=(0.0, 0.0))])
    hypotheses = PDA(hypothesiser).associate({track}, detections, at(3))[track]
    posterior = updater.update(hypotheses)
    likelihoods = {z: _likelihood(z, variance) for z in (2.6, -1.0)}
    each = {z: prob_detect * likelihood / clutter for z, likelihood in likelihoods.items()}
    total, mean, cov = on_grid(two_wells.density, 1.0 - prob_detect + sum(each.values()))
    assert max(off(posterior, mean, cov)) < 0.012
    assert abs(posterior.info.log_evidence) < 0.01
    for hypothesis in hypotheses:
        if hypothesis:
            part, _, _ = on_grid(two_wells.density, each[hypothesis.measurement.state_vector[0]])
        else:
            part = 1.0 - prob_detect
        assert float(hypothesis.probability) == pytest.approx(part / total, abs=2e-3)
    merged = _gaussian_merge(updater, hypotheses)
    assert posterior.density.entropy() < merged - 0.1  # what merging into one Gaussian would forget


def _gaussian_merge(updater, hypotheses):
    """Entropy of the Gaussian that has the moments of the mixture, as PDA merges it."""
    cov = np.asarray(updater.update(hypotheses).covar)
    return 0.5 * np.linalg.slogdet(2 * np.pi * np.e * cov)[1]


def test_what_is_left_of_a_miss_is_not_cut_off():
    """A sharp detection, most likely the target's, beside a broad density: its 2 % stay in the posterior.

    Where the lattice of the sharp part ends the broad one has hardly begun. The next step is on as few
    particles as ever.
    """
    predictor, updater = SPHPredictor(duffing(), n_particles=200), SPHUpdater(position(0.01))
    track, scored = Track([gaussian(mean=(0.0, 0.0))]), EvidenceHypothesiser(predictor, updater, 0.1, 0.98, 1)
    hypotheses = scored.hypothesise(track, {seen(2.6, seconds=3)}, at(3))
    posterior = updater.update(hypotheses)
    missed = float(hypotheses[0].probability)
    assert 0.005 < missed < 0.05
    left = predictor.predict(track, at(3)).density.probability(lambda X: X[:, 0] < 1.0)
    found = posterior.density.probability(lambda X: X[:, 0] < 1.0)
    assert found == pytest.approx(missed * left, rel=0.03)
    assert "times the particles" in posterior.info.status and posterior.density.n_particles > 200
    track.append(posterior)
    _, again = scored.hypothesise(track, {seen(3.0, seconds=4)}, at(4))
    assert updater.update(again).density.n_particles <= 200


@pytest.mark.parametrize("seconds", [0.25, 1.0])
def test_sharp_and_broad_at_once_is_predicted_part_by_part(seconds):
    """A posterior that no lattice carries on 200 particles: the sum of its parts', against 100,000 paths."""
    predictor, updater = SPHPredictor(duffing(), n_particles=200), SPHUpdater(position(0.005))
    track, model = Track([gaussian(mean=(0.0, 0.0))]), predictor.transition_model.sde
    scored = EvidenceHypothesiser(predictor, updater, 0.1, 0.8, 1)
    posterior = updater.update(scored.hypothesise(track, {seen(2.6, seconds=3)}, at(3)))
    moved = predictor.predict(posterior, at(3 + seconds))
    X = advance(model, posterior.density.sample(100_000, 1), 0.0, seconds, np.random.default_rng(2))
    assert max(off(moved, X.mean(axis=0), np.cov(X.T))) < 0.03
    assert "predicted apart" in moved.info.status
    assert moved.density.n_particles <= 200 or "on 3 times the particles" in moved.info.status
    right, here = (X[:, 0] > 3.0).mean(), moved.density.probability(lambda X: X[:, 0] > 3.0)
    assert here == pytest.approx(right, abs=0.01)


@pytest.mark.slow
def test_what_one_lattice_cannot_hold_is_flagged():
    """A sensor 400 times sharper than the prediction, as likely clutter as not: the answer tells that."""
    predictor, updater = SPHPredictor(duffing(), n_particles=100), SPHUpdater(position(5e-5))
    track = Track([gaussian(mean=(0.0, 0.0))])
    hypotheses = EvidenceHypothesiser(predictor, updater, 0.1, 0.5, 1).hypothesise(
        track, {seen(2.6, seconds=3), seen(-3.1, seconds=3), seen(0.4, seconds=3)}, at(3)
    )
    info = updater.update(hypotheses).info
    assert info.flagged and sf.Code.FALLBACK in info.code and "too broad for one lattice" in info.status


def test_stone_soups_pda_weights_are_taken_as_given(two_wells):
    """Its PDAHypothesiser scores by Gaussians; the posterior is the mixture with those weights."""
    predictor, updater = SPHPredictor(duffing()), SPHUpdater(position())
    hypothesiser = PDAHypothesiser(predictor, updater, 0.1, prob_detect=0.9, prob_gate=0.99)
    track = Track([gaussian(mean=(0.0, 0.0))])
    for associator in (PDA(hypothesiser), JPDA(hypothesiser)):
        detections = {seen(2.6, seconds=3), seen(-1.0, seconds=3)}
        hypotheses = associator.associate({track}, detections, at(3))[track]
        posterior = updater.update(hypotheses)
        assert posterior.hypothesis is hypotheses and len(hypotheses) == 3
        weight = 0.0
        for hypothesis in hypotheses:
            part = float(hypothesis.probability)
            if hypothesis:
                likelihood = _likelihood(hypothesis.measurement.state_vector[0])
                part = part * likelihood / on_grid(two_wells.density, likelihood)[0]
            weight = weight + part
        _, mean, cov = on_grid(two_wells.density, weight)
        assert max(off(posterior, mean, cov)) < 0.01


def test_linear_weights_are_those_of_kalman_and_pda():
    model, sensor = ConstantVelocity(0.4), position(0.3)
    track = Track([gaussian()])
    detections = {seen(3.5, seconds=1), seen(5.0, seconds=1), seen(90.0, seconds=1)}
    predictor, updater = SPHPredictor(model), SPHUpdater(sensor)
    ours = EvidenceHypothesiser(predictor, updater, 0.2, 0.8, 0.99).hypothesise(track, detections, at(1))
    kalman = KalmanPredictor(model), KalmanUpdater(sensor)
    theirs = PDAHypothesiser(*kalman, 0.2, 0.8, 0.99).hypothesise(track, detections, at(1))
    assert len(ours) == len(theirs) == 3  # the one at 90 is outside of the gate
    for hypothesis in theirs:
        same = ours[hypothesis.measurement] if hypothesis else ours[0]
        assert float(same.probability) == pytest.approx(float(hypothesis.probability), abs=2e-3)


def test_evidence_knows_that_there_is_nothing_between_two_modes(two_wells):
    """A reading between the wells is likely for the Gaussian of mean and covariance, not for the density."""
    predictor = SPHPredictor(duffing())
    quiet = duffing().with_parameters(g=-4.0)  # deeper wells
    predictor = SPHPredictor(quiet, n_particles=600)
    updater = SPHUpdater(position(0.02))
    track = Track([gaussian(mean=(0.0, 0.0), variances=(0.5, 0.5))])
    prediction = predictor.predict(track, at(4))
    modes = [prediction.density.probability(lambda X, s=s: s * X[:, 0] > 3) for s in (1, -1)]
    assert min(modes) > 0.4
    detections = {seen(0.0, seconds=4), seen(6.0, seconds=4)}
    args = predictor, updater, 0.05, 0.9
    gaussian_scores = PDAHypothesiser(*args).hypothesise(track, detections, at(4))
    scores = EvidenceHypothesiser(*args).hypothesise(track, detections, at(4))
    middle, mode = sorted(detections, key=lambda d: d.state_vector[0])
    assert gaussian_scores[middle].probability > gaussian_scores[mode].probability
    assert scores[middle].probability < 0.05 < 0.9 < scores[mode].probability


def test_nearest_neighbours_and_gates():
    predictor, updater = SPHPredictor(duffing()), SPHUpdater(position())
    distance = DistanceHypothesiser(predictor, updater, Mahalanobis(), missed_distance=4)
    track = Track([gaussian()])
    near, far, wild = (seen(z, seconds=1) for z in (2.5, 1.0, 40.0))
    for hypothesiser in (distance, DistanceGater(distance, Mahalanobis(), gate_threshold=4)):
        for associator in (NearestNeighbour(hypothesiser), GlobalNearestNeighbour(hypothesiser)):
            chosen = associator.associate({track}, {near, far, wild}, at(1))[track]
            assert chosen.measurement is near
            assert not associator.associate({track}, {wild}, at(1))[track]
            posterior = updater.update(chosen)
            assert posterior.covar[0, 0] < 0.2


def test_refusals_are_sentences(two_wells):
    predictor, updater = SPHPredictor(duffing()), SPHUpdater(position())
    later = predictor.predict(gaussian(), at(4))
    distances = [SingleDistanceHypothesis(p, seen(1.0, seconds=3), 1.0) for p in (two_wells, later)]
    likelihood = sf.LikelihoodMeasurement(lambda z, X, t: -np.abs(z[0] - X[:, 0]))
    for call, sentence in (
        (lambda: updater.update(MultipleHypothesis(distances)), "2 timestamps"),
        (lambda: updater.update(MultipleHypothesis(distances[:1])), "probabilities"),
        (lambda: updater.update(MultipleHypothesis([])), "no hypothesis"),
        (lambda: updater.predict_measurement(two_wells, likelihood), "noise covariance"),
        (lambda: EvidenceHypothesiser(predictor, updater, 0.0), "clutter_spatial_density"),
        (lambda: EvidenceHypothesiser(predictor, updater, 0.1, prob_detect=1.5), "prob_detect"),
    ):
        with pytest.raises(sf.ModelError, match=sentence):
            call()
