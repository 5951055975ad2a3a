"""Pictures: an Axes in and out, and sentences where none can be drawn."""

import sys

import matplotlib as mpl
import numpy as np
import pytest

import sphfilter as sf

mpl.use("Agg")
import matplotlib.pyplot as plt

MODEL = sf.SDE.from_expressions(
    ["x", "v", "a"], ["v", "a - x", "-k*a"], [["0"], ["0"], ["0.5"]], parameters={"k": 1.0}
)
PLACE = sf.GaussianMeasurement([[1.0, 0.0, 0.0]], [[0.1]])


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def ran():
    flt = sf.SPHFilter(MODEL, PLACE, x0=np.zeros(3), P0=np.eye(3))
    return flt, flt.run([0.5, 1.0, 1.5], [[0.3], [0.1], None])


def test_densities_are_lines_maps_and_pairs(ran):
    flt, _ = ran
    line = flt.plot("v")
    assert line.get_xlabel() == "v" and line.get_title("left") == "t = 1.5"
    x, y = line.lines[0].get_data()
    assert np.trapezoid(y, x) == pytest.approx(1.0, abs=2e-3)
    given = plt.subplots()[1]
    assert flt.plot(["x", "a"], ax=given) is given and given.get_ylabel() == "a" and given.collections
    pairs = flt.plot()
    assert pairs.shape == (3, 3) and pairs[2, 1].get_xlabel() == "v" and not pairs[0, 1].axison
    assert flt.density.plot([1]).get_xlabel() == "x1"


def test_a_map_shades_what_holds_the_probabilities(ran):
    drawn = ran[0].plot(["x", "v"])
    own = ran[0].density.marginal([0, 1])
    levels = sorted(own.hpd_level(part) for part in (0.5, 0.9, 0.99))
    shown = next(c for c in drawn.collections if hasattr(c, "levels")).levels
    np.testing.assert_allclose(shown[:3], levels, rtol=0.1)


def test_results_forecasts_and_fits_are_drawn(ran):
    flt, found = ran
    panels = found.plot(truth=np.zeros((3, 3)), states=MODEL.states)
    assert [panel.get_ylabel() for panel in panels] == ["x", "v", "a"] and len(panels[0].lines) >= 2
    ahead = flt.forecast([2.0, 3.0], events={"far": lambda X: X[:, 0] - 1.0})
    own = plt.subplots(2, 1)[1]
    assert ahead.plot(["v"], ax=own) is own and own[0].get_ylabel() == "v" and len(own[1].lines) == 1
    assert ahead.first_passage and len(ahead.plot("v")[1].lines) == 2
    times = 0.5 * np.arange(1, 13)
    _, z = sf.simulate(MODEL, PLACE, np.zeros(3), times, rng=1)
    fit = sf.fit_parameters(sf.SPHFilter(MODEL, PLACE, x0=np.zeros(3), P0=np.eye(3)), times, z, {"k": 1.0})
    assert fit.plot().get_xlabel() == "k"


def test_what_cannot_be_drawn_is_said(ran, monkeypatch):
    flt, found = ran
    with pytest.raises(sf.ModelError, match="there is no 'y' to be drawn"):
        flt.plot("y")
    with pytest.raises(sf.ModelError, match="the picture takes 3 Axes, got 1"):
        found.plot(ax=plt.subplots()[1])
    with pytest.raises(sf.ModelError, match="names 1 states, but the result has 3"):
        found.plot(states=["x"])
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    with pytest.raises(sf.ModelError, match=r"pip install sphfilter\[plots\]"):
        flt.plot("x")
