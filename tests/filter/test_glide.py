"""A record put through a cloud at once: the bits of steps taken one by one, whatever comes between."""

from copy import copy

import numpy as np
import pytest

import sphfilter as sf
from experiments.scene.scenario import load_scenario
from sphfilter.campaign.campaign import draw_case
from sphfilter.filter.glide import Glide


def record(scene, target, n):
    scenario = load_scenario(scene)
    case = draw_case(scenario, 1, 0)

    def made():
        config = sf.FilterConfig(target_error=target)
        known = {"t0": case.t0, "n_particles": "auto", "config": config}
        return sf.SPHFilter(scenario.model, scenario.measurement, case.x0, case.P0, **known)

    return made, np.array(case.times[:n]), np.array(case.z[:n], dtype=float)


NAMES = (
    "x", "P", "x_prior", "P_prior", "log_evidence", "evidence_error", "error", "variance_error",
    "flagged", "innovation", "innovation_cov",
)  # fmt: skip


def step_by_step(flt, times, z):
    found = {name: [] for name in NAMES}
    for t, reading in zip(times, z, strict=True):
        predicted = flt.predict(t=t) if t > flt.t else None
        prior = flt.x, flt.P
        updated = flt.update(reading)
        flagged = updated.flagged or (predicted is not None and predicted.flagged)
        errors = updated.evidence_error, updated.error, updated.variance_error
        values = flt.x, flt.P, *prior, flt.log_likelihood, *errors, flagged, flt.y, flt.S
        for name, value in zip(NAMES, values, strict=True):
            found[name].append(value)
    return found


@pytest.mark.parametrize(
    ("scene", "target", "least"),
    [
        ("van_der_pol", 0.03, 5),
        ("duffing_square", 0.03, 1),
        ("fitzhugh_nagumo", 0.03, 3),
        ("bearings_only", 0.05, 0),
        ("sharp_range", 0.1, 2),
    ],
)
def test_a_record_has_the_bits_of_its_steps(monkeypatch, scene, target, least):
    made, times, z = record(scene, target, 12)
    z[4], times[8] = np.nan, times[7]  # nothing came; two readings at one time are the filter's
    one_by_one, at_once, through = made(), made(), []
    own = Glide._through
    found = step_by_step(one_by_one, times, z)
    monkeypatch.setattr(Glide, "_through", lambda self, *given: noted(own(self, *given), through))
    result = at_once.run(times, z)
    assert len(through) >= least and (scene != "sharp_range" or any(row["flagged"] for row in through))
    same(found, result, one_by_one, at_once)


@pytest.mark.parametrize("scene", ["van_der_pol_sharp", "duffing_square"])
def test_sharp_readings_go_through_compiled_code(monkeypatch, scene):
    made, times, z = record(scene, 0.1, 12)
    made().run(times, z)  # the first that is led piece by piece compiles what leads it
    own, alone = sf.SPHFilter.update, []
    monkeypatch.setattr(sf.SPHFilter, "update", lambda self, *given: alone.append(1) or own(self, *given))
    flt = made()
    result = flt.run(times, z)
    assert len(alone) < 4 and flt._pending is not None
    other = copy(flt)
    flt.measurement = flt.measurement.changed(9.0)  # not the sensor of what was read before
    assert flt._pending is None and other._pending is not None
    for one in (flt, other):
        np.testing.assert_array_equal(one.x, result.x[-1])
        assert one.t == times[-1] and one.log_evidence == pytest.approx(result.log_evidence.sum())


def same(found, result, one_by_one, at_once):
    for name, values in found.items():
        shown = getattr(result, name)
        values = [np.full(shown.shape[1:], np.nan) if value is None else value for value in values]
        np.testing.assert_array_equal(np.array(values, dtype=float), np.asarray(shown, dtype=float))
    np.testing.assert_array_equal(one_by_one.density.x, at_once.density.x)
    np.testing.assert_array_equal(one_by_one.x_prior, at_once.x_prior)
    assert one_by_one.density.needs == at_once.density.needs
    assert one_by_one.log_evidence == at_once.log_evidence


SENSORS = {
    "dense": sf.GaussianMeasurement([[1.0, 0.3], [-0.2, 0.7]], [[0.2, 0.05], [0.05, 0.3]]),
    "angle": sf.GaussianMeasurement([[1.0, 0.3], [-0.2, 0.7]], 0.2 * np.eye(2), angles=[0]),
    "noise of the state": sf.GaussianMeasurement(
        [[1.0, 0.0], [0.0, 1.0]], lambda x: ((0.2 + 0.05 * x[0] ** 2, 0.0), (0.0, 0.3)), dim_z=2
    ),
}


@pytest.mark.parametrize("scene", ["van_der_pol", "cart", "made_up/ring"])
def test_a_record_of_usual_readings_never_comes_up(monkeypatch, scene):
    """From the Gaussian that it begins with, too."""
    made, times, z = record(scene, 0.1, 8)
    at_once, one_by_one, alone = made(), made(), []
    monkeypatch.setattr(sf.SPHFilter, "update", lambda self, *given: alone.append(1))
    found = at_once.run(times, z)
    assert not alone
    monkeypatch.undo()
    expected = step_by_step(one_by_one, times, z)
    np.testing.assert_array_equal(found.x, expected["x"])
    np.testing.assert_array_equal(found.P, expected["P"])


@pytest.mark.parametrize("sensor", SENSORS)
def test_a_long_record_of_any_sensor_has_the_bits_of_its_steps(sensor):
    made, _, _ = record("van_der_pol", 0.1, 2)
    plain, times = made(), 0.3 * np.arange(1, 81)
    z = np.stack([2.0 * np.cos(times), -2.0 * np.sin(times)], axis=1)
    z[[20, 50]] += 3.0  # far from where it is seen

    def filt():
        config = sf.FilterConfig(target_error=0.1)
        return sf.SPHFilter(plain.model, SENSORS[sensor], [1.0, 0.0], 0.2 * np.eye(2), config=config)

    one_by_one, at_once = filt(), filt()
    found = step_by_step(one_by_one, times, z)
    same(found, at_once.run(times, z), one_by_one, at_once)


def test_a_sensor_is_not_asked_where_no_state_is():
    def h(X, t):
        if not np.isfinite(X).all():
            raise ValueError("asked where no state is")
        return X

    model = sf.SDE.from_expressions(["x"], ["0.8*x**3 - x"], [["1"]], [[0.05]])
    sensor = sf.GaussianMeasurement(h, [[0.1]], vectorized=True)
    flt = sf.SPHFilter(model, sensor, [0.0], [[0.2]], config=sf.FilterConfig(target_error=0.05))
    times = 0.4 * np.arange(1, 16)
    assert np.isfinite(flt.run(times, 0.3 * np.sin(times)[:, None]).x).all()


def noted(rows, through):
    through.extend(rows)
    return rows


def test_a_drift_that_raises_surfaces_as_itself_from_the_middle_of_a_record():
    made, times, z = record("van_der_pol", 0.03, 4)

    def drift(x, t):
        if t > 6.0:
            raise KeyError("no such place")
        return np.stack([x[:, 1], -x[:, 0]], axis=1)

    model = sf.SDE(drift, 2, [[0.0], [1.0]], [[0.5]], vectorized=True)
    flt = sf.SPHFilter(
        model, made().measurement, [1.0, 0.0], np.eye(2), config=sf.FilterConfig(target_error=0.05)
    )
    with pytest.raises(KeyError, match="no such place"):
        flt.run(times, z)


def test_a_ctrl_c_is_one_wherever_it_comes(monkeypatch):
    made, times, z = record("van_der_pol", 0.03, 5)

    def interrupted(self, *given):
        raise SystemError("returned a result with an exception set") from KeyboardInterrupt()

    flt = made()
    monkeypatch.setattr(Glide, "_through", interrupted)
    with pytest.raises(KeyboardInterrupt):
        flt.run(times, z)
    assert flt.t == made().t


def test_what_is_done_stays_done_where_a_reading_is_bad():
    made, times, z = record("van_der_pol", 0.03, 10)
    z[7] = np.inf
    at_once, one_by_one = made(), made()
    with pytest.raises(sf.ModelError, match="infinite"):
        at_once.run(times, z)
    step_by_step(one_by_one, times[:7], z[:7])
    one_by_one.predict(t=times[7])
    assert at_once.t == times[7]
    np.testing.assert_array_equal(at_once.x, one_by_one.x)
    assert at_once.log_evidence == one_by_one.log_evidence


def test_a_filter_with_steps_of_its_own_takes_them():
    made, times, z = record("van_der_pol", 0.03, 8)
    plain, seen = made(), []

    class Own(sf.SPHFilter):
        def update(self, z, *given, **named):
            seen.append(z)
            return super().update(z, *given, **named)

    flt = Own(plain.model, plain.measurement, plain.x, plain.P, t0=plain.t, config=plain.config)
    flt.run(times, z)
    assert len(seen) == len(times)


def test_a_sensor_that_reads_in_its_own_way_is_read_so():
    made, times, z = record("van_der_pol", 0.03, 5)
    plain = made()

    class Off(sf.GaussianMeasurement):
        def predict(self, X, t=0.0):
            return super().predict(X, t) + 1.0

    sensor = Off([[1.0, 0.0]], plain.measurement.noise_cov)
    flt = sf.SPHFilter(plain.model, sensor, plain.x, plain.P, t0=plain.t, config=plain.config)
    shifted, usual = flt.run(times, z + 1.0), plain.run(times, z)
    np.testing.assert_allclose(shifted.x, usual.x, atol=0.1)
    np.testing.assert_allclose(shifted.log_evidence, usual.log_evidence, atol=0.1)


def test_nothing_that_comes_leaves_a_cloud_as_it_was():
    made, times, _ = record("van_der_pol", 0.03, 2)
    flt = made()
    flt.predict(t=times[0])
    before = flt.density
    flt.update(None)
    assert flt.density is before
    flt.update(np.nan)
    assert flt.density is before
