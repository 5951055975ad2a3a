"""What users hand in: intervals of time, masked readings, names in any script, times that are sums."""

from datetime import timedelta

import numpy as np
import pytest

import sphfilter as sf


def decay():
    return sf.LinearSDE(A=[[-1.0]], noise=[[1.0]])


def level(k=1):
    return sf.GaussianMeasurement(np.ones((k, 1)), 0.1 * np.eye(k))


def make(**options):
    return sf.SPHFilter(decay(), level(), [1.0], [[0.2]], n_particles=60, **options)


@pytest.mark.parametrize("dt", [timedelta(milliseconds=500), np.timedelta64(500, "ms")])
def test_intervals_of_the_standard_library_and_numpy(dt):
    plain, given, own = make(), make(), make(dt=dt)
    plain.predict(0.5)
    given.predict(dt)
    own.predict()
    assert given.t == own.t == 0.5
    assert plain.P == given.P == own.P
    assert sf.predict(plain.density, decay(), dt)[0].t == 1.0


def test_no_interval_is_not_a_number():
    with pytest.raises(sf.ModelError, match="one finite number"):
        make().predict(np.timedelta64("NaT"))


def test_rounding_is_no_time():
    flt = make()
    for _ in range(3):
        flt.predict(0.1)
    before = flt.density
    assert flt.t > 0.3
    info = flt.predict(t=0.3)
    assert info.n_steps == 0
    assert flt.density is before
    assert np.isfinite(flt.run([0.3, 0.4], [[1.0], [0.9]]).x).all()
    path = sf.propagate(before, decay(), [0.3, 0.5])
    assert path.densities[0] is before
    assert sf.simulate(decay(), None, [1.0], [0.1 + 0.2, 0.3, 0.4], rng=1)[0][0, 0] == pytest.approx(1.0)
    with pytest.raises(sf.ModelError, match="back in time"):
        flt.predict(t=0.29)


def masked(values, mask):
    return np.ma.array(values, mask=mask)


def test_a_masked_reading_did_not_come():
    flt = make()
    info = flt.update(masked([5.0], [True]))
    assert (info.log_evidence, flt.x[0]) == (0.0, pytest.approx(1.0))
    assert flt.update(np.ma.masked).log_evidence == 0.0
    assert flt.update(masked([5], [True])).log_evidence == 0.0  # whole numbers have no NaN
    some = level(2).log_likelihood(masked([1.0, 7.0], [False, True]), [[0.5]])
    assert some == level(2).log_likelihood([1.0, np.nan], [[0.5]])
    assert some == level(2).log_likelihood([1.0, np.ma.masked], [[0.5]])


def test_masked_records():
    times, z = [0.5, 1.0, 1.5], masked([0.9, 8.0, 0.7], [False, True, False])
    expected = make().run(times, [0.9, None, 0.7])
    for record in (z, z[:, None]):
        np.testing.assert_array_equal(make().run(times, record).x, expected.x)
        np.testing.assert_array_equal(sf.smooth(make(), times, record).filtered.x, expected.x)
    likelihood = sf.LikelihoodMeasurement(lambda z, X, t: -(X[:, 0] ** 2))
    flt = sf.SPHFilter(decay(), likelihood, [1.0], [[0.2]], n_particles=60)
    assert flt.update(z[1:2]).log_evidence == 0.0
    assert np.isnan(flt.z).all()


def test_a_sensor_without_a_value_is_told_with_the_state_where():
    sensor = sf.GaussianMeasurement.from_expressions(["x"], ["sqrt(x)"], [[0.1]])
    with pytest.raises(sf.ModelError, match=r"is NaN at the state \[-\d"):
        sf.SPHFilter(decay(), sensor, [0.1], [[1.0]]).update(1.0)


@pytest.mark.parametrize("name", ["µ", "ϕ", "ϵ", "ϑ", "μ"])
def test_names_are_compared_as_python_compares_them(name):
    model = sf.SDE.from_expressions([name], [f"-{name}"], [["1"]])
    assert model.drift([[2.0]], 0.0)[0, 0] == -2.0
    model = sf.SDE.from_expressions(["x"], [f"-{name}*x"], [["1"]], parameters={name: 3.0})
    assert model.drift([[2.0]], 0.0)[0, 0] == -6.0
    assert model.with_parameters(**{name: 1.0}).drift([[2.0]], 0.0)[0, 0] == -2.0
    sensor = sf.GaussianMeasurement.from_expressions([name], [f"{name}**2"], [[0.1]])
    assert sensor.predict([[2.0]])[0, 0] == 4.0


def test_keyword_arguments_find_their_parameter():
    """Python itself reads the micro sign of a keyword as a mu."""
    model = sf.SDE.from_expressions(["x"], ["-µ*x"], [["1"]], parameters={"µ": 3.0})
    assert model.with_parameters(µ=1.0).drift([[2.0]], 0.0)[0, 0] == -2.0
    with pytest.raises(sf.ExpressionError, match="given twice"):
        sf.SDE.from_expressions(["µ"], ["0"], parameters={"μ": 1.0})
