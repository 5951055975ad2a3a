"""The code on the page on models, sensors, kernels and schemes works as it stands there."""

import importlib.util
import re
import textwrap
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import sphfilter as sf
from experiments.scene.scenario import load_scenario
from reference_filters.closed_forms import linear_moments
from sphfilter.core.sph import kernels

PAGE = (Path(sf.__file__).parent / "EXTENDING.md").read_text(encoding="utf-8")


def block(language, start):
    """The piece of code on the page that begins with some text."""
    found = re.findall(rf"^ *```{language}\n(.*?)^ *```", PAGE, re.MULTILINE | re.DOTALL)
    return next(code for code in map(textwrap.dedent, found) if code.startswith(start))


def test_the_model_runs(tmp_path):
    path = tmp_path / "roll.toml"
    path.write_text(block("toml", "description"), encoding="utf-8")
    scene = load_scenario(str(path))
    case = scene.draw(np.random.default_rng(1))
    flt = sf.SPHFilter(scene.model, scene.measurement, case.x0, case.P0, n_particles=200)
    result = flt.run(case.times[:3], case.z[:3])
    error = (result.x - case.truth[:3]) / np.sqrt(np.diagonal(result.P, axis1=1, axis2=2))
    assert np.abs(error).max() < 4.0


def test_the_sensor_gives_prior_times_likelihood():
    exec(block("python", "import numpy"), made := {})
    sensor = made["Distance"](np.array([2.0, 0.0]), 0.3)
    prior = sf.Gaussian([0.0, 0.0], np.diag([1.0, 0.5]))
    posterior, _ = sf.update(sf.initialize(prior, n_particles="auto"), sensor, [1.2])
    X = np.stack(np.meshgrid(*2 * [np.linspace(-6, 6, 601)]), -1).reshape(-1, 2)
    p = np.exp(-(X[:, 0] ** 2) / 2 - X[:, 1] ** 2 + sensor.log_likelihood([1.2], X))
    np.testing.assert_allclose(posterior.mean(), p @ X / p.sum(), atol=0.02)
    assert sensor.sample(X[:3], rng=1).shape == (3, 1)


def test_the_kernel_and_its_slope_fit():
    cases = re.findall(r"if kind == WENDLAND_C6:\n +return (.+)", PAGE)
    shape, slope = (
        sf.SDE.from_expressions(["q"], [re.sub(r"\bs\b", "(1 - q)", expression)]) for expression in cases
    )
    for q in np.linspace(0.01, 0.99, 25):
        rise = shape.jacobian(np.array([q]), 0.0).item()
        assert slope.drift([[q]], 0.0).item() * q == pytest.approx(rise, abs=1e-12)
    names = re.search(r"^ *KINDS = \((.+)\)$", PAGE, re.MULTILINE)[1].replace('"', "").split(", ")
    assert tuple(names[:-1]) == kernels.KINDS


def test_the_scheme_has_the_moments_of_a_linear_model(tmp_path):
    source = tmp_path / "linearised.py"
    source.write_text(block("python", '"""Particles moved'), encoding="utf-8")
    spec = importlib.util.spec_from_file_location("sphfilter.prediction.linearised", source)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    A, g = np.array([[0.0, 1.0], [-1.0, -0.5]]), np.array([[0.0], [1.0]])
    model, mean, cov = sf.LinearSDE(A, noise=g), np.array([1.0, 0.0]), np.diag([0.2, 0.5])
    start = sf.initialize(sf.Gaussian(mean, cov), n_particles=200)
    moved, info = module.propagate(start, model, 1.5, SimpleNamespace(name="linearised", rtol=1e-8), 200)
    m, P = linear_moments(A, np.zeros(2), g @ g.T, mean, cov, 1.5)
    assert moved.t == 1.5 and info.scheme == "linearised"
    np.testing.assert_allclose(moved.mean(), m, atol=1e-3)
    np.testing.assert_allclose(moved.cov(), P, atol=2e-3)
    posterior, _ = sf.update(moved, sf.GaussianMeasurement([[1.0, 0.0]], [[0.1]]), [0.5])
    assert posterior.cov()[0, 0] == pytest.approx(1 / (1 / P[0, 0] + 10.0), rel=0.05)
