"""Elementary functions of models in text are the C library's, to rounding, everywhere."""

import numpy as np
import pytest

import sphfilter as sf
from sphfilter.core.elementary import FAST

NAMES = "sin", "cos", "exp", "log", "tanh"
WILD = [
    0.0, -0.0, 5e-324, 1e-310, 1e-300, -1e-9, 0.25, 1e5, -3e7, np.inf, -np.inf, np.nan, 708.5, -707.5,
    800.0, -800.0,
]  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_numbers_are_those_of_the_c_library(name):
    rng = np.random.default_rng(0)
    wide = rng.uniform(-30.0, 30.0, 3000), rng.uniform(-700.0, 700.0, 300), rng.normal(0.0, 1e-3, 300)
    x = np.concatenate(wide)
    x = np.exp(x) if name == "log" else x
    own = np.array([getattr(FAST, name)(v) for v in x])
    atol = 0.0 if name in ("exp", "log", "tanh") else 3e-16
    np.testing.assert_allclose(own, getattr(np, name)(x), rtol=2e-15, atol=atol)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_wild_arguments_have_the_c_librarys_values(name):
    own = np.array([getattr(FAST, name)(v) for v in WILD])
    np.testing.assert_allclose(own, getattr(np, name)(np.array(WILD)), rtol=2e-15, atol=1e-9)


def test_angles_that_mean_nothing_have_bounded_values():
    values = [getattr(FAST, name)(x) for name in ("sin", "cos") for x in (1e16, -3e200, 1e300)]
    assert np.all(np.abs(values) <= 1.0)


def test_a_drift_in_text_is_that_of_a_function():
    text = sf.SDE.from_expressions(
        ["x", "v"], ["v", "-sin(x) - tanh(v)*exp(-x*x) + cos(1e7*x)"], [["0"], ["1"]]
    )
    plain = sf.SDE(
        lambda x: (x[1], -np.sin(x[0]) - np.tanh(x[1]) * np.exp(-x[0] * x[0]) + np.cos(1e7 * x[0])),
        2,
        noise=np.array([[0.0], [1.0]]),
    )
    X = np.random.default_rng(1).normal(size=(200, 2))
    np.testing.assert_allclose(text.drift(X, 0.0), plain.drift(X, 0.0), rtol=1e-12, atol=1e-14)
