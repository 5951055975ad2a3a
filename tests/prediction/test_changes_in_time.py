"""Drift and noise that change in time, over one prediction or many: nothing between the steps is missed."""

import numpy as np
import pytest
from scipy.integrate import quad

import sphfilter as sf

RATE, START = 0.5, sf.Gaussian([0.5], [[0.2]])


def pulse_of_noise(t):
    return 0.2 + 50.0 * np.exp(-(((t - 0.7) / 0.02) ** 2))


def pulse_of_drift(t):
    return 40.0 * (0.4 < t < 0.45)


def sine(t):
    return 20.0 * np.sin(20.0 * np.pi * t)


def exact(T, drift=lambda t: 0.0, noise=lambda t: 0.2, at=()):
    """Mean and variance of dx = (-x/2 + drift) dt + sqrt(noise) dW at time T, by quadrature."""
    options = {"points": [t for t in at if t < T] or None, "limit": 400, "epsabs": 1e-11}
    mean = 0.5 * np.exp(-RATE * T) + quad(lambda t: drift(t) * np.exp(-RATE * (T - t)), 0.0, T, **options)[0]
    variance = quad(lambda t: noise(t) * np.exp(-2.0 * RATE * (T - t)), 0.0, T, **options)[0]
    return mean, 0.2 * np.exp(-2.0 * RATE * T) + variance


def callable_noise():
    def diffusion(x, t):
        return ((0.1 + 25.0 * np.exp(-(((t - 0.7) / 0.02) ** 2)),),)

    return sf.SDE(lambda x: (-RATE * x[0],), 1, diffusion=diffusion)


def callable_drift(f, **options):
    return sf.SDE(lambda X, t: -RATE * X + f(t), 1, [[0.2**0.5]], vectorized=True, **options)


def text(f):
    return sf.SDE.from_expressions(["x"], [f"-0.5*x + {f}"], [["sqrt(0.2)"]])


def text_noise():
    return sf.SDE.from_expressions(["x"], ["-0.5*x"], diffusion=[["0.1 + 25*exp(-((t - 0.7)/0.02)**2)"]])


CASES = {
    "callable noise": (callable_noise, 2.0, {"noise": pulse_of_noise, "at": (0.66, 0.7, 0.74)}),
    "noise": (text_noise, 2.0, {"noise": pulse_of_noise, "at": (0.66, 0.7, 0.74)}),
    "drift": (lambda: callable_drift(pulse_of_drift), 2.0, {"drift": pulse_of_drift, "at": (0.4, 0.45)}),
    "events": (
        lambda: callable_drift(pulse_of_drift, events=[0.4, 0.45]),
        2.0,
        {"drift": pulse_of_drift, "at": (0.4, 0.45)},
    ),
    "text": (
        lambda: text("where(t > 0.4 and t < 0.45, 40, 0)"),
        2.0,
        {"drift": pulse_of_drift, "at": (0.4, 0.45)},
    ),
    "sine": (lambda: callable_drift(sine), 1.0, {"drift": sine}),
    "text sine": (lambda: text("20*sin(20*pi*t)"), 1.0, {"drift": sine}),
}


@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=[pytest.mark.slow] * (case == "drift")) for case in CASES]
)
def test_in_one_go_and_in_eight(case):
    make, T, changes = CASES[case]
    model, mean_and_variance = make(), exact(T, **changes)
    for n in (1, 8):
        density = sf.initialize(START, 100)
        for k in range(n):
            density, _ = sf.predict(density, model, t=T * (k + 1) / n)
        mean, variance = mean_and_variance
        assert abs(density.mean()[0] - mean) < 0.01 * np.sqrt(variance)
        assert density.cov()[0, 0] == pytest.approx(variance, rel=0.01)


def test_steps_are_no_longer_than_allowed():
    model = sf.SDE(lambda x: (-x[0],), 1, [[1.0]], max_step=0.01)
    _, info = sf.predict(sf.initialize(START, 60), model, 1.0)
    assert info.n_steps >= 100


@pytest.mark.parametrize("middle", [0.3, 0.5, 0.79])
def test_clouds_see_a_pulse_of_noise_that_depends_on_the_state(middle):
    """dx = s(t) x dW: E x² grows by exp(∫ s² dt); four steps have one in the pulse, or none."""
    pulse = f"sqrt(0.05 + 2.5*exp(-((t - {middle})/0.0124)**2))"
    model = sf.SDE.from_expressions(["x"], ["0"], [[f"x*{pulse}"]])
    flt = sf.SPHFilter(
        model, None, [1.0], [[0.01]], config=sf.FilterConfig(scheme=sf.CloudScheme(n_points=2048))
    )
    flt.predict(1.0)
    exact = 1.01 * np.exp(0.05 + 2.5 * 0.0124 * np.sqrt(np.pi)) - 1.0
    assert flt.P[0, 0] == pytest.approx(exact, rel=0.04)  # without a look at times: off by 38, 0 and 18 %


def test_what_text_knows_of_time():
    model = sf.SDE.from_expressions(
        ["x"], ["sign(t - a) + sin(2*pi*10*t) + where(x > 0, 1, 0)"], [["1 + abs(t - 3)"]],
        parameters={"a": 0.3}, events=[5.0, 1.0],
    )  # fmt: skip
    np.testing.assert_allclose(model.breaks(0.0, 4.0), [0.3, 1.0, 3.0], rtol=1e-14)
    np.testing.assert_allclose(model.with_parameters(a=2.0).breaks(0.0, 4.0), [1.0, 2.0, 3.0], rtol=1e-14)
    assert model.breaks(3.5, 4.0).size == 0
    assert model.max_step == pytest.approx(0.0125)
    late = sf.SDE.from_expressions(["x"], ["where(t < 2, 1, 0)"], [["1"]])
    for t0, t1 in ((1.0, 2.0), (2.0, 3.0)):  # whose end, or beginning, is the jump
        np.testing.assert_array_equal(late.breaks(t0, t1), [2.0])
    square = sf.SDE.from_expressions(["x"], ["sign(sin(2*pi*t))"], [["1"]])
    np.testing.assert_allclose(square.breaks(0.2, 1.8), [0.5, 1.0, 1.5], rtol=1e-12)


def test_a_model_without_changes_has_no_breaks():
    model = sf.SDE.from_expressions(["x"], ["where(x > 0, -1, 1)"], [["1"]])
    assert model.breaks(0.0, 10.0).size == 0
    assert model.max_step == np.inf
    with pytest.raises(sf.ModelError, match="max_step"):
        sf.SDE(lambda x: (-x[0],), 1, [[1.0]], max_step=0.0)


def test_simulated_paths_see_a_pulse():
    model = text("where(t > 0.4 and t < 0.4001, 20000, 0)")
    paths, _ = sf.simulate(model, None, [0.0], [0.0, 1.0], rng=1, n_paths=2000)
    assert paths[:, 1, 0].mean() == pytest.approx(2.0 * np.exp(-RATE * 0.6), abs=0.05)
