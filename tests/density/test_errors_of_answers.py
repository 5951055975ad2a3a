"""Errors of answers: as large as what is wrong, whatever was asked."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

import sphfilter as sf

MODEL = sf.LinearSDE([[0.0, 1.0], [-1.0, -0.5]], noise=[[0.0], [1.0]], spectral_density=[[0.5]])
SENSOR = sf.GaussianMeasurement([[1.0, 0.0]], [[0.3]])


def after_readings(t0=0.0, **options):
    flt = sf.SPHFilter(MODEL, SENSOR, x0=[0.0, 0.0], P0=np.eye(2), t0=t0, **options)
    for z in (0.3, -0.4, 1.1, 0.9):
        flt.predict(0.7)
        flt.update([z])
    return flt.density


def questions(mean, cov):
    """Functions of a density, and what a Gaussian answers."""
    at, s = mean[0], np.sqrt(cov[0, 0])
    quadrant = 0.25 + np.arcsin(cov[0, 1] / np.sqrt(cov[0, 0] * cov[1, 1])) / (2.0 * np.pi)
    area = 2.0 * np.pi * np.sqrt(np.linalg.det(cov))
    return {
        "tail": (lambda p: p.probability(lambda X: X[:, 0] > at + s), norm.sf(1.0)),
        "far tail": (lambda p: p.probability(lambda X: X[:, 0] > at + 2.5 * s), norm.sf(2.5)),
        "quadrant": (lambda p: p.probability(lambda X: (mean < X).all(axis=1)), quadrant),
        "quantile": (lambda p: p.quantile(0, 0.95), at + norm.ppf(0.95) * s),
        "moment": (lambda p: p.moment([1, 1], central=True), cov[0, 1]),
        "entropy": (lambda p: p.entropy(), np.log(area) + 1.0),
        "level": (lambda p: p.hpd_level(0.9), 0.1 / area),
        "mean": (lambda p: p.mean(), mean),
    }


def test_a_clouds_answers_are_off_by_what_is_told():
    exact = after_readings()
    asked = questions(exact.mean(), exact.cov())
    squares = {name: np.zeros(2) for name in asked}
    for draw in range(6):
        config = sf.FilterConfig(scheme=sf.CloudScheme(n_points=1024))
        density = after_readings(t0=float(draw), config=config)
        for name, (question, right) in asked.items():
            told, made = density.error_of(question), question(density) - right
            squares[name] += np.mean(np.square(told)), np.mean(np.square(made))
    for name, (told, made) in squares.items():
        # a mean of one linear model is told two to three times too large itself
        assert 0.5 < np.sqrt(told / made) < 5.0, name


def test_a_gaussian_that_may_be_off_answers_by_its_derivatives():
    density = replace(sf.initialize(sf.Gaussian([1.0, -2.0], [[4.0, 0.0], [0.0, 0.25]]), "auto"), error=0.01)
    np.testing.assert_allclose(density.error_of(lambda p: p.mean()), [0.02, 0.005], rtol=0.02)
    np.testing.assert_allclose(
        density.error_of(lambda p: np.diag(p.cov())), [4.0 * 0.01 * 2**0.5, 0.25 * 0.01 * 2**0.5], rtol=0.05
    )
    error = density.error_of(lambda p: p.probability(lambda X: X[:, 0] > 3.0))
    assert isinstance(error, float)
    assert error == pytest.approx(norm.pdf(1.0) * 0.01 * np.sqrt(1.5), rel=0.3)
    assert density.error_of(lambda p: p.quantile(0, [0.1, 0.5, 0.9])).shape == (3,)
    assert replace(density, error=0.0).error_of(lambda p: p.mean()[0]) == 0.0
    assert np.isnan(replace(density, error=np.nan).error_of(lambda p: p.mean()[0]))
    one = density.marginal([1])
    assert one.error_of(lambda p: p.mean()[0]) == pytest.approx(0.005, rel=0.02)
    tiny = replace(density, error=1e-6)  # by which no state of a few thousand crosses a line
    assert tiny.error_of(lambda p: p.probability(lambda X: X[:, 0] > 3.0)) == pytest.approx(
        1e-4 * error, rel=0.3
    )


def test_of_kernels_nothing_tells_an_error():
    density = sf.initialize(sf.Gaussian([0.0], [[1.0]]), 50, sf.FilterConfig.paper())
    assert density.read_out in ("points", "mixture")
    assert np.isnan(density.error_of(lambda p: p.mean()[0]))


def test_an_angle_is_off_the_short_way_round():
    circle = [("periodic", -np.pi, np.pi)]
    model = sf.SDE.from_expressions(["a"], ["0"], [["1"]], [[0.2]], domain=circle)
    sensor = sf.GaussianMeasurement.from_expressions(["a"], ["cos(a)", "sin(a)"], 0.2 * np.eye(2))
    config = sf.FilterConfig(scheme=sf.CloudScheme(n_points=1024))
    flt = sf.SPHFilter(model, sensor, [3.1], [[0.3]], config=config)
    flt.predict(0.5)
    flt.update([-1.0, 0.1])

    def off(p):
        return (p.mean() - flt.x + np.pi) % (2.0 * np.pi) - np.pi

    assert 0.0 < flt.density.error_of(off)[0] < 0.05
