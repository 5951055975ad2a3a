"""Filters with other parameters, of fits too, and comparisons on the data that fits have."""

import pickle

import numpy as np
import pytest
from oscillators import OSCILLATOR, POSITION, START, TIMES, exact, readings

import sphfilter as sf

SENSOR = sf.GaussianMeasurement.from_expressions(
    ["x", "v"], ["k*x"], [["R"]], parameters={"R": 0.2, "k": 1.0}
)


@pytest.fixture(scope="module")
def z():
    return readings(OSCILLATOR, TIMES, START[0], 3)


@pytest.mark.parametrize("settings", [{"n_particles": 100}, {}, {"dt": 0.7, "window": 2}])
def test_a_filter_with_other_parameters_is_one_that_was_made_with_them(z, settings):
    own = sf.SPHFilter(OSCILLATOR, SENSOR, *START, **settings)
    other = own.with_parameters({"c": 0.5}, k=1.1)
    made = sf.SPHFilter(
        OSCILLATOR.with_parameters(c=0.5, k=1.1), SENSOR.with_parameters(k=1.1), *START, **settings
    )
    for filt in (other, made):
        filt.run(TIMES[:3], z[:3])
    assert np.array_equal(other.x, made.x) and other.log_evidence == made.log_evidence
    assert own.t == 0.0 and dict(own.model.parameters) == {"k": 1.0, "c": 0.4, "s": 1.2}
    assert (other.dt, other.adapts, other.n_particles) == (made.dt, made.adapts, made.n_particles)


def test_it_goes_on_from_the_density_now(z):
    own = sf.SPHFilter(OSCILLATOR, POSITION, *START, n_particles=100, window=3)
    own.run(TIMES[:3], z[:3])
    other = own.with_parameters(c=0.9)
    assert other.t == own.t and other.density is own.density and other.log_evidence == 0.0
    with pytest.raises(sf.ModelError, match=r"no parameter 'cc' \(did you mean 'c'\?\)"):
        own.with_parameters(cc=1.0)
    with pytest.raises(sf.ModelError, match="one finite number"):
        own.with_parameters(c=np.nan)
    assert sf.SPHFilter(OSCILLATOR, None, *START).with_parameters(c=1.0).model.parameters["c"] == 1.0


def test_the_filter_of_a_fit_has_the_users_settings_and_its_estimate(z):
    own = sf.SPHFilter(OSCILLATOR, POSITION, *START)
    fit = sf.fit_parameters(own, TIMES, z, {"k": 0.8})
    own.predict(1.0)
    filt = fit.filter
    assert filt.t == 0.0 and filt.adapts and filt is not fit.filter
    assert filt.model.parameters["k"] == fit.estimate["k"]
    assert filt.run(fit.times, fit.measurements).log_evidence.sum() == pytest.approx(
        fit.log_evidence, abs=1e-2
    )
    assert filt.forecast(filt.t + np.array([0.5, 1.0])).mean.shape == (2, 2)
    of_builder = sf.fit_parameters(exact, TIMES, z, {"k": 0.8})
    assert of_builder.filter.run(TIMES, z).log_evidence.sum() == pytest.approx(
        of_builder.log_evidence, rel=1e-12
    )


def test_fits_are_compared_on_their_own_data(z):
    fits = {
        "k": sf.fit_parameters(exact, TIMES, z, {"k": 0.8}),
        "c": sf.fit_parameters(exact, TIMES, z, {"c": 0.5}),
    }
    rivals = fits | {"given": exact({})}
    assert str(sf.compare_models(rivals)) == str(sf.compare_models(rivals, TIMES, z))
    other = sf.fit_parameters(exact, TIMES[:-1], z[:-1], {"k": 0.8})
    with pytest.raises(sf.ModelError, match="'other' was fitted to other measurements"):
        sf.compare_models({"k": fits["k"], "other": other})
    for given in ({}, {"times": TIMES}, {"measurements": z}):
        with pytest.raises(sf.ModelError, match="filters are compared by times and measurements: give both"):
            sf.compare_models({"given": exact({})}, **given)


def test_inputs_are_kept_with_the_data():
    pushed = sf.SDE.from_expressions(["x"], ["u - a*x"], [["1"]], parameters={"a": 0.6}, inputs=["u"])
    level = sf.GaussianMeasurement([[1.0]], [[0.1]])
    times, u = 0.4 * np.arange(1, 21), np.sin(np.arange(20.0))
    z = sf.simulate(pushed, level, x0=[0.0], times=times, rng=3, inputs=u)[1]
    flt = sf.SPHFilter(pushed, level, [0.0], [[0.1]], n_particles=50)
    fit = sf.fit_parameters(flt, times, z, {"a": 0.5}, inputs=u)
    before, known = u.copy(), fit.data
    u[:] = 0.0
    assert np.array_equal(fit.inputs, before)
    found = sf.compare_models({"fitted": fit, "given": flt})
    assert found.data == known and found.log_evidence.max() == pytest.approx(fit.log_evidence)


def test_fits_and_posteriors_go_through_pickle():
    model = sf.SDE.from_expressions(["x"], ["-a*x"], [["1"]], parameters={"a": 0.6})
    level, times = sf.GaussianMeasurement([[1.0]], [[0.1]]), 0.4 * np.arange(1, 11)
    _, z = sf.simulate(model, level, [0.0], np.r_[0.0, times], rng=3)
    fit = sf.fit_parameters(sf.SPHFilter(model, level, [0.0], [[0.1]]), times, z[1:], guess={"a": 0.5})
    again = pickle.loads(pickle.dumps(fit))
    assert dict(again.estimate) == dict(fit.estimate) and again.filter.model.parameters == fit.estimate
    own, other = (one.posterior(n_draws=64) for one in (fit, again))
    posterior = pickle.loads(pickle.dumps(own))
    assert posterior.mean == own.mean and other.mean["a"] == pytest.approx(own.mean["a"])
    with pytest.raises(TypeError):
        posterior.estimate["a"] = 1.0
