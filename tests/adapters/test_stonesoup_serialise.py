"""Pickle and Stone Soup's YAML: states, predictors, updaters and what they hold, to the last bit."""

import copy
import pickle

import numpy as np
import pytest
from stonesoup_cases import START, at, duffing, gaussian, position, seen

import sphfilter as sf

pytest.importorskip("stonesoup")

from ruamel.yaml.constructor import ConstructorError
from stonesoup.dataassociator.probability import PDA
from stonesoup.models.transition.linear import ConstantVelocity
from stonesoup.serialise import YAML
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.track import Track

from sphfilter.adapters import stonesoup
from sphfilter.adapters.stonesoup import (
    EvidenceHypothesiser,
    SDETransitionModel,
    SPHPredictor,
    SPHStateUpdate,
    SPHUpdater,
    extend,
)
from sphfilter.density.storage import stored


def _through_yaml(value):
    yaml = YAML()
    return yaml.load(yaml.dumps(value))


def _through_pickle(value):
    return pickle.loads(pickle.dumps(value))


def _same(a, b):
    """Are two densities the same arrays?"""
    a, b = stored(a), stored(b)
    assert a.keys() == b.keys()
    for name in a:
        np.testing.assert_array_equal(a[name], b[name])


def _filter():
    return SPHPredictor(duffing(), n_particles=150), SPHUpdater(position(), n_particles=180)


def _steps(predictor, updater, state, seconds):
    for k in seconds:
        prediction = predictor.predict(state, at(k))
        reading = updater.predict_measurement(prediction)
        state = updater.update(SingleHypothesis(prediction, seen(2.5, seconds=k), reading))
    return state


@pytest.mark.parametrize("through", [_through_yaml, _through_pickle])
def test_a_filter_goes_on_to_the_same_bits(through):
    """State, predictor and updater kept between two steps, a track of updates and their predictions."""
    predictor, updater = _filter()
    state = _steps(predictor, updater, gaussian(), [1, 2])
    predictor2, updater2, track = through([predictor, updater, Track([gaussian(), state])])
    assert type(track.state) is SPHStateUpdate and track.state.timestamp == at(2)
    _same(track.state.density, state.density)
    assert not (track.state.mean.flags.writeable or track.state.covar.flags.writeable)
    info = track.state.info
    assert (info.log_evidence, info.accepted, info.status) == (state.info.log_evidence, True, "ok")
    np.testing.assert_array_equal(info.innovation_cov, state.info.innovation_cov)
    assert track.state.hypothesis.prediction.info == state.hypothesis.prediction.info
    _same(track.state.hypothesis.prediction.density, state.hypothesis.prediction.density)
    on, again = _steps(predictor, updater, state, [3, 4]), _steps(predictor2, updater2, track.state, [3, 4])
    _same(on.density, again.density)
    assert predictor2.n_particles == 150 and updater2.n_particles == 180


@pytest.mark.parametrize("through", [_through_yaml, _through_pickle])
def test_an_associator_and_its_associations(through):
    predictor, updater = _filter()
    associator = PDA(EvidenceHypothesiser(predictor, updater, 0.1, 0.9, 0.99))
    track, detections = Track([gaussian()]), {seen(2.5, seconds=1), seen(1.5, seconds=1)}
    posterior = updater.update(associator.associate({track}, detections, at(1))[track])
    associator2, posterior2 = through([associator, posterior])
    _same(posterior.density, posterior2.density)
    weights = [float(h.probability) for h in posterior.hypothesis]
    np.testing.assert_allclose([float(h.probability) for h in posterior2.hypothesis], weights, rtol=1e-12)
    again = updater.update(associator2.associate({track}, detections, at(1))[track])
    np.testing.assert_allclose(again.density.mean(), posterior.density.mean(), atol=1e-12)


@pytest.mark.parametrize(
    "model",
    [
        duffing().with_parameters(c=0.7),
        sf.LinearSDE([[0.0, 1.0], [-1.0, -0.2]], noise=[[0.0], [1.0]], spectral_density=[[0.3]]),
        sf.SDE.from_expressions(["x"], ["sin(x)"], noise=[["1"]], domain=[("periodic", -np.pi, np.pi)]),
        sf.SDE.from_expressions(["x"], ["-x*cos(t)"], diffusion=[["0.1*(1 + x**2)"]]),
    ],
)
def test_models_are_written_as_their_text(model):
    epoch = None if model.autonomous else START
    written = YAML().dumps(SDETransitionModel(model, epoch, seed=7))
    again = YAML().load(written)
    assert dict(again.sde.parameters) == dict(model.parameters) and again.sde.domain == model.domain
    assert (again.epoch, again.seed, type(again.sde)) == (epoch, 7, type(model))
    X = np.random.default_rng(0).normal(size=(5, model.dim))
    np.testing.assert_array_equal(again.sde.drift(X, 0.3), model.drift(X, 0.3))
    np.testing.assert_array_equal(again.sde.diffusion(X, 0.3), model.diffusion(X, 0.3))


def test_settings_and_own_sensors_are_written_too():
    sensor = sf.GaussianMeasurement.from_expressions(["x", "v"], ["atan2(v, x)"], [[0.1]], angles=[0])
    matrix = sf.GaussianMeasurement([[1.0, 0.0]], [[0.2]])
    config = sf.FilterConfig(scheme="cloud", exact_linear=True)
    X = np.array([[1.0, 2.0], [-1.0, 0.1]])
    for given in (sensor, matrix):
        again = _through_yaml(SPHUpdater(given, config=config))
        assert again.config == config and again.measurement_model.angles == given.angles
        np.testing.assert_array_equal(again.measurement_model.predict(X), given.predict(X))
    again = _through_yaml(SPHPredictor(ConstantVelocity(0.3), config=config))
    np.testing.assert_array_equal(again.transition_model.sde.A, [[0.0, 1.0], [0.0, 0.0]])
    assert again.config == config


def _pull(x, t):
    return (-x[0],)


def test_what_is_code_is_refused_with_a_sentence():
    for value in (
        SPHPredictor(sf.SDE(_pull, 1, noise=[[1.0]])),
        SPHUpdater(sf.GaussianMeasurement(_pull, [[1.0]])),
        SPHUpdater(sf.LikelihoodMeasurement(lambda z, X, t: -X[:, 0])),
    ):
        with pytest.raises(sf.ModelError, match="Python function"):
            YAML().dumps(value)
    predictor = _through_pickle(SPHPredictor(sf.SDE(_pull, 1, noise=[[1.0]])))
    assert predictor.transition_model.sde.dim == 1


@pytest.mark.parametrize(
    "text",
    [
        "!sphfilter.ParticleDensity bm9uZQ==",
        '!sphfilter.SDE \'{"states": ["x"], "drift": ["__import__(1)"]}\'',
        '!sphfilter.SDE \'{"states": ["x"]}\'',
        "!sphfilter.FilterConfig 'scheme = 1'",
        "!sphfilter.adapters.stonesoup.os.system\n- command: ls",
        "!sphfilter.adapters.stonesoup.predictor.SPHPredictor\n- particles: 3",
    ],
)
def test_files_that_are_wrong_are_refused(text):
    with pytest.raises(ConstructorError, match="while reading"):
        YAML().load(text)


@pytest.mark.parametrize(
    ("room", "name"),
    [
        ("jump_markov_predictor", "JumpMarkovPredictor"),
        ("jump_markov_updater", "JumpMarkovUpdater"),
        ("jump_markov_states", "JumpMarkovStateUpdate"),
    ],
)
def test_pickles_of_before_find_what_has_moved(room, name):
    """By the opcode that pickles name a class with."""
    pickled = f"csphfilter.adapters.stonesoup.{room}\n{name}\n.".encode()
    assert pickle.loads(pickled) is getattr(stonesoup, name)


def test_without_the_entry_point_yaml_is_taught():
    """As in a checkout that is on the path and not installed."""
    yaml = YAML()
    extend(yaml)
    assert yaml.load(yaml.dumps(SPHPredictor(duffing()))).n_particles == 200


def test_a_pickled_state_is_small_and_does_not_grow_with_its_track():
    """Neither polynomials, which are fitted again, nor what the prior came from, are in it."""
    predictor, updater = _filter()
    early, late = (_steps(predictor, updater, gaussian(), range(1, k)) for k in (3, 7))
    sizes = [len(pickle.dumps(state)) for state in (early, late)]
    plain = late.density.field.coefficient.nbytes + late.density.field.tail.nbytes
    assert sizes[1] < 1.5 * sizes[0] and len(pickle.dumps(late.density)) < plain
    again = _through_pickle(late)
    _same(again.hypothesis.prediction.prior.density, late.hypothesis.prediction.prior.density)
    assert late.hypothesis.prediction.prior.hypothesis is not None  # here it is all there
    assert copy.copy(late.hypothesis.prediction).prior is late.hypothesis.prediction.prior
