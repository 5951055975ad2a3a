"""Several sensors, each with a rate of its own, in filters, fits, comparison, smoothing and files."""

import math
import pickle

import numpy as np
import pytest

import sphfilter as sf

MODEL = sf.SDE.from_expressions(["x", "v"], ["v", "x - x**3 - 0.3*v"], [["0"], ["0.5"]])
PLACE = sf.GaussianMeasurement([[1.0, 0.0]], [[0.1]])
SPEED = sf.GaussianMeasurement([[0.0, 1.0]], [[0.2]])
ENERGY = sf.GaussianMeasurement.from_expressions(
    ["x", "v"], ["v**2"], [["s*(1 + x**2)"]], parameters={"s": 0.05}
)
COUNTS = sf.LikelihoodMeasurement(lambda z, X, t: z[0] * X[:, 0] - np.exp(X[:, 0]), dim_z=1)
GAUSSIAN, ALL = (
    sf.Sensors({"place": PLACE, "speed": SPEED}),
    sf.Sensors({"place": PLACE, "energy": ENERGY, "counts": COUNTS}),
)
TIMES, Z = ALL.merged(
    {
        "place": ([0.5, 1.0, 1.5], [0.2, 0.3, 0.1]),
        "energy": ([0.75, 1.5], [0.4, 0.2]),
        "counts": ([1.0, 2.0], [1, 2]),
    }
)


def made(sensors, **options):
    return sf.SPHFilter(MODEL, sensors, [0.0, 0.0], np.eye(2), **options)


def test_records_are_put_into_one():
    assert TIMES.tolist() == [0.5, 0.75, 1.0, 1.5, 2.0]
    nan = math.nan
    np.testing.assert_equal(
        Z, [[0.2, nan, nan], [nan, 0.4, nan], [0.3, nan, 1.0], [0.1, 0.2, nan], [nan, nan, 2.0]]
    )
    twice, z = GAUSSIAN.merged({"place": ([1.0, 1.0], [0.1, 0.2]), "speed": ([1.0], [0.3])})
    np.testing.assert_equal((twice, z), ([1.0, 1.0], [[0.1, nan], [0.2, 0.3]]))


def test_names_rows_and_mappings_are_the_same_readings():
    by_row, by_name = made(ALL), made(ALL)
    result = by_row.run(TIMES, Z)
    named = [{name: row[ALL.rows(name)] for name in ALL if np.isfinite(row[ALL.rows(name)])} for row in Z]
    again = made(ALL).run(TIMES, named)
    assert np.array_equal(result.x, again.x)
    for t, row in zip(TIMES, named, strict=True):
        by_name.predict(t=t)
        by_name.update(row)
    assert np.array_equal(by_row.x, by_name.x)
    assert by_row.log_evidence == by_name.log_evidence


def test_readings_of_one_time_may_come_one_by_one():
    together, one_by_one = made(ALL), made(ALL)
    for t, row in zip(TIMES, Z, strict=True):
        for flt in (together, one_by_one):
            flt.predict(t=t)
        together.update(row)
        for name in ALL:
            if np.isfinite(row[ALL.rows(name)]):
                one_by_one.update(row[ALL.rows(name)], name)
    s = np.sqrt(np.diag(together.P))
    assert np.abs((together.x - one_by_one.x) / s).max() < 0.03  # each within .01 of what is right
    assert together.log_evidence == pytest.approx(one_by_one.log_evidence, abs=0.02)


def test_a_reading_of_one_sensor_is_that_of_the_sensor_alone():
    """Likelihoods beside it cost nothing: the closed form stays one."""
    several, alone = made(ALL), made(PLACE)
    several.predict(0.5), alone.predict(0.5)
    info, own = several.update([0.2, math.nan, math.nan]), alone.update(0.2)
    assert np.array_equal(several.x, alone.x)
    assert info.scheme == own.scheme
    assert info.error == own.error


def test_a_reading_of_one_sensor_may_have_a_noise_of_its_own():
    named, given = made(GAUSSIAN), made(GAUSSIAN)
    for flt in (named, given):
        flt.predict(0.5)
    named.update(0.3, "place", R=[[0.5]])
    given.update(0.3, PLACE.changed([[0.5]]))
    assert np.array_equal(named.x, given.x) and np.array_equal(named.P, given.P)


def test_gaussian_sensors_are_one_matrix():
    as_one = sf.GaussianMeasurement(np.eye(2), np.diag([0.1, 0.2]))
    z = np.array([[0.2, math.nan], [0.1, -0.3], [math.nan, 0.4]])
    ours, theirs = made(GAUSSIAN).run([0.5, 1.0, 1.5], z), made(as_one).run([0.5, 1.0, 1.5], z)
    np.testing.assert_allclose(ours.x, theirs.x, rtol=1e-12)
    np.testing.assert_allclose(ours.innovation, theirs.innovation, rtol=1e-12)


def test_fits_comparison_and_smoothing_take_them():
    times = np.arange(1, 9) * 0.4
    _, z = sf.simulate(MODEL, GAUSSIAN, [0.0, 0.0], np.append(0.0, times), rng=1)
    z = z[1:]
    z[::2, 0] = math.nan
    records = {"place": (times[1::2], z[1::2, 0]), "speed": (times, z[:, 1])}
    np.testing.assert_equal(GAUSSIAN.merged(records)[1], z)
    smoothed = sf.smooth(made(GAUSSIAN), times, z)
    assert np.ptp(smoothed.log_evidence) < 0.05
    other = sf.Sensors({"place": PLACE, "speed": SPEED.changed(noise_cov=4.0)})
    found = sf.compare_models({"right": made(GAUSSIAN), "wrong": made(other)}, times, z)
    assert found.names[0] == "right"
    rows = [dict(zip(GAUSSIAN, row, strict=True)) for row in z]
    assert sf.compare_models({"right": made(GAUSSIAN)}, times, rows).data == found.data


def test_a_mapping_as_any_other():
    assert "place" in ALL and "wind" not in ALL
    assert ALL.get("wind") is None and list(ALL) == ["place", "energy", "counts"]


def test_copies_and_files_keep_them(tmp_path):
    flt = made(ALL)
    flt.run(TIMES[:3], Z[:3])
    flt.save(tmp_path / "filter.npz")
    other = sf.SPHFilter.load(tmp_path / "filter.npz", MODEL, ALL)
    for one in (other, flt):
        one.predict(t=1.5)
        one.update(Z[3])
    assert np.array_equal(other.x, flt.x)
    again = pickle.loads(pickle.dumps(sf.Sensors({"place": PLACE, "energy": ENERGY.with_parameters(s=0.3)})))
    assert dict(again.parameters) == {"s": 0.3}


@pytest.mark.parametrize(
    ("asked", "sentence"),
    [
        (lambda: ALL["energie"], r"no sensor 'energie' \(did you mean 'energy'\?\)"),
        (lambda: made(ALL).update(0.3, "plaec"), "did you mean 'place'"),
        (lambda: made(ALL).update({"wind": 1.0}), "no sensor 'wind'; there are place, energy, counts"),
        (lambda: made(ALL).update([1.0, 2.0]), r"shape \(2,\), but the sensor gives \(3,\)"),
        (lambda: made(PLACE).update({"place": 1.0}), r"Sensors\(\{name: sensor, ...\}\)"),
        (lambda: sf.Sensors({}), "at least one sensor"),
        (lambda: sf.Sensors([PLACE]), "by its name"),
        (lambda: sf.Sensors({1: PLACE}), "names of sensors are texts"),
        (lambda: sf.Sensors({"a": GAUSSIAN}), "sensor 'a' must be"),
        (lambda: ALL.predict([[0.0, 0.0]]), "no noise-free reading"),
        (lambda: ALL.merged({"place": 5}), r"records are \(times, z\)"),
        (lambda: ALL.merged({"place": [1, 2]}), r"records are \(times, z\)"),
        (lambda: ALL.merged({"place": ([1.0], [1.0, 2.0])}), "1 times, but 2 readings"),
        (lambda: sf.Sensors({"a": sf.LikelihoodMeasurement(len)}), "loglik must be|dim_z="),
        (
            lambda: sf.Sensors({"a": PLACE, "b": sf.GaussianMeasurement([[1.0]], [[1.0]])}),
            "different lengths",
        ),
        (lambda: ALL.merged({"place": ([1.0], [[1.0, 2.0]])}), r"shape \(2,\), but the sensor gives \(1,\)"),
        (lambda: sf.Sensors({"a": ENERGY, "b": ENERGY.with_parameters(s=1.0)}), "'s' different values"),
    ],
)
def test_what_does_not_fit_is_said(asked, sentence):
    with pytest.raises(sf.ModelError, match=sentence):
        asked()


def test_a_record_without_readings_has_the_shape_of_the_sensors():
    result = made(GAUSSIAN).run([0.1, 0.2], [None, None])
    assert result.innovation.shape == (2, 2)
    assert result.innovation_cov.shape == (2, 2, 2)
