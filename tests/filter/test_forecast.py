"""Forecasts against closed forms, and that the filter stays where it is."""

import numpy as np
import pytest
from scipy.stats import norm

import sphfilter as sf

WALK = sf.LinearSDE([[0.0]], noise=[[1.0]])
LEVEL = sf.GaussianMeasurement([[1.0]], [[0.1]])
TIMES = np.array([0.25, 0.5, 1.0, 2.0, 4.0])


def walking(model=WALK, **options):
    return sf.SPHFilter(model, LEVEL, x0=[0.0], P0=[[1e-6]], **options)


def test_quantiles_and_events_are_those_of_the_density_and_the_filter_stays():
    flt = walking(window=2)
    ahead = flt.forecast(TIMES, quantiles=[0.001, 0.5, 0.9], events={"high": lambda X: X[:, 0] > 1.0})
    std = np.sqrt(TIMES + 1e-6)
    np.testing.assert_allclose(ahead.quantiles[:, 0], std[:, None] * norm.ppf([0.001, 0.5, 0.9]), atol=1e-5)
    np.testing.assert_allclose(ahead.probability["high"], norm.sf(1.0 / std), atol=2e-4)
    np.testing.assert_allclose(ahead.cov[:, 0, 0], std**2)
    assert (flt.t, flt.density.t, len(flt._steps)) == (0.0, 0.0, 1) and not ahead.flagged.any()
    assert ahead.quantile_error.shape == (5, 1, 3) and ahead.probability_error["high"].shape == (5,)
    assert "5 times to t = 4, 1 states, events high" in repr(ahead)
    assert flt.forecast(3.0).quantiles.shape == (1, 1, 3)


def test_a_bent_density_has_the_tails_of_many_paths():
    model = sf.SDE.from_expressions(["x"], ["x - x**3"], [["0.7"]])
    flt = sf.SPHFilter(model, LEVEL, x0=[0.4], P0=[[0.05]])
    ahead = flt.forecast([1.0, 3.0], quantiles=[0.01, 0.5, 0.99], events={"left": lambda X: X[:, 0] < 0.0})
    start = np.random.default_rng(1).normal(0.4, np.sqrt(0.05), (40_000, 1))
    drawn = sf.simulate(model, None, start, [0.0, 1.0, 3.0], rng=2)[0][:, 1:, 0]
    levels = np.quantile(drawn, [0.01, 0.5, 0.99], axis=0).T
    np.testing.assert_allclose(ahead.quantiles[:, 0], levels, atol=0.05)
    np.testing.assert_allclose(ahead.probability["left"], (drawn < 0.0).mean(axis=0), atol=0.008)


@pytest.mark.parametrize("height", [0.6, 2.0])
def test_first_passages_of_brownian_motion_are_those_of_its_mirror(height):
    events = {"numbers": lambda X: X[:, 0] - height, "booleans": lambda X: X[:, 0] > height}
    ahead = walking().forecast(TIMES, events=events)
    exact = 2.0 * norm.sf(height / np.sqrt(TIMES))
    for name, most in (("numbers", 0.004), ("booleans", 0.02)):
        off = np.abs(ahead.first_passage[name] - exact)
        assert off.max() < most and (off < 4.0 * ahead.first_passage_error[name] + 5e-4).all()
        assert (np.diff(ahead.first_passage[name]) >= 0.0).all()


def test_first_passages_in_discrete_time_are_seen_after_every_step():
    walk = sf.DiscreteModel.from_matrices([[1.0]], [[1.0]])
    ahead = walking(walk).forecast([1.0, 3.0, 8.0], events={"high": lambda X: X[:, 0] > 2.0})
    x = np.linspace(-20.0, 2.0, 2201)  # where it has not been higher
    p, exact = norm.pdf(x), []
    for step in range(1, 9):
        if step > 1:
            p = norm.pdf(x[:, None] - x) @ p * 0.01
        exact.append(1.0 - np.trapezoid(p, x))
    off = ahead.first_passage["high"] - np.array(exact)[[0, 2, 7]]
    assert np.abs(off).max() < 0.004


def test_a_smooth_state_passes_between_looks():
    model = sf.SDE.from_expressions(["x", "v"], ["v", "u - v"], [["0"], ["0.7"]], inputs=["u"])
    flt = sf.SPHFilter(
        model, sf.GaussianMeasurement([[1.0, 0.0]], [[0.1]]), x0=[0.0, 0.0], P0=np.diag([0.01, 0.3])
    )
    ahead = flt.forecast([1.0, 2.0], events={"far": lambda X: X[:, 0] - 0.5}, inputs=[[0.2], [0.4]])
    rng, h = np.random.default_rng(0), 4e-3
    X = rng.multivariate_normal([0.0, 0.0], np.diag([0.01, 0.3]), 50_000)
    hit, exact = X[:, 0] > 0.5, []
    for k in range(500):
        X = X + h * np.stack([X[:, 1], (0.2 if k < 250 else 0.4) - X[:, 1]], axis=1)
        X[:, 1] += 0.7 * np.sqrt(h) * rng.standard_normal(len(X))
        hit |= X[:, 0] > 0.5
        exact += [hit.mean()] if k in (249, 499) else []
    np.testing.assert_allclose(ahead.first_passage["far"], exact, atol=0.01)


def test_modes_have_forecasts_but_no_first_passages():
    modes = {"rest": WALK, "up": sf.LinearSDE([[0.0]], [1.0], noise=[[1.0]])}
    flt = sf.JumpMarkovFilter(sf.JumpMarkovModel(modes, [[-0.5, 0.5], [0.5, -0.5]]), LEVEL, [0.0], [[0.1]])
    ahead = flt.forecast([0.5, 1.0], events={"high": lambda X: X[:, 0] > 1.0})
    assert ahead.mean[1, 0] == pytest.approx(0.5, abs=0.02) and 0.2 < ahead.probability["high"][1] < 0.4
    with pytest.raises(sf.ModelError, match="first passages are told of models without modes"):
        ahead.first_passage["high"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"times": [-1.0]}, "before the filter's own time 0"),
        ({"times": [2.0, 1.0]}, "run backwards"),
        ({"times": [1.0], "quantiles": [0.5, 1.0]}, "probabilities between 0 and 1"),
        ({"times": [1.0], "events": {"high": 2.0}}, "must be a function of states"),
        ({"times": [1.0], "events": {"high": lambda X: X > 2.0}}, r"array \(2, 1\) for 2 states"),
        ({"times": [1.0], "inputs": [[1.0]]}, "the model has none"),
    ],
)
def test_what_is_wrong_is_said(options, said):
    with pytest.raises(sf.ModelError, match=said):
        walking().forecast(**options)
