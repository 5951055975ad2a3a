"""Readings that come late: the same bits as in order, within the steps that are kept."""

import numpy as np
import pytest

import sphfilter as sf

MODEL = sf.SDE.from_expressions(["x", "v"], ["v", "x - x**3 - 0.3*v + a"], [["0"], ["0.5"]], inputs=["a"])
PLACE = sf.GaussianMeasurement([[1.0, 0.0]], [[0.1]])
SPEED = sf.GaussianMeasurement([[0.0, 1.0]], [[0.2]])
TIMES, Z, U = [0.5, 1.0, 1.5, 2.0], [0.1, 0.3, None, 0.8], [0.0, 1.0, -1.0, 0.5]
KEPT = "x", "P", "x_prior", "P_prior", "z", "y", "S", "log_likelihood", "log_evidence", "t", "n_particles"


def made(**options):
    return sf.SPHFilter(MODEL, PLACE, [0.0, 0.0], np.eye(2), **options)


def step(flt, k, at=None):
    flt.predict(t=TIMES[k] if at is None else at, u=[U[k]])


def in_order(late, at, sensor=None, **options):
    """The filter to which nothing came late."""
    flt = made(**options)
    for k, t in enumerate(TIMES):
        if (TIMES[k - 1] if k else 0.0) < at < t:
            step(flt, k, at)
            flt.update(late, sensor)
        step(flt, k)
        flt.update(Z[k])
        if at == t:
            flt.update(late, sensor)
    return flt


def came_late(late, at, sensor=None, **options):
    flt = made(window=10, **options)
    for k in range(len(TIMES)):
        step(flt, k)
        flt.update(Z[k])
    info = flt.update_late(late, at, sensor)
    return flt, info


@pytest.mark.parametrize("options", [{}, {"n_particles": 150}], ids=["auto", "lattice"])
@pytest.mark.parametrize("at", [0.2, 1.0, 1.7, 2.0])
def test_the_same_bits_as_in_order(at, options):
    (late, info), ordered = came_late([0.4], at, **options), in_order([0.4], at, **options)
    for name in KEPT:
        assert np.array_equal(getattr(late, name), getattr(ordered, name), equal_nan=True), name
    assert info.accepted
    late.predict(0.5, u=[0.3]), ordered.predict(0.5, u=[0.3])
    late.update(0.2), ordered.update(0.2)
    assert np.array_equal(late.x, ordered.x)


def test_two_late_readings_and_another_sensor():
    late, _ = came_late([0.4], 1.2, SPEED)
    late.update_late([0.2], 1.7)
    ordered = made()
    for t, z, u, sensor in [
        (0.5, 0.1, 0.0, None),
        (1.0, 0.3, 1.0, None),
        (1.2, 0.4, -1.0, SPEED),
        (1.5, None, -1.0, None),
        (1.7, 0.2, 0.5, None),
        (2.0, 0.8, 0.5, None),
    ]:
        ordered.predict(t=t, u=[u])
        ordered.update(z, sensor)
    assert np.array_equal(late.P, ordered.P)
    assert late.log_evidence == ordered.log_evidence


def test_arrays_of_the_caller_may_change_meanwhile():
    flt, z = made(window=5), np.zeros(1)
    for k in range(3):
        step(flt, k)
        z[:] = 0.1 * k
        flt.update(z)
    flt.update_late(0.3, 0.7)
    ordered = made()
    for t, value, u in [(0.5, 0.0, 0.0), (0.7, 0.3, 1.0), (1.0, 0.1, 1.0), (1.5, 0.2, -1.0)]:
        ordered.predict(t=t, u=[u])
        ordered.update(value)
    assert np.array_equal(flt.x, ordered.x)


@pytest.mark.parametrize(
    ("window", "at", "sentence"),
    [
        (
            2,
            0.9,
            "is of t = 0.9, but the 2 steps that the filter keeps begin at 1: make it with a larger window",
        ),
        (2, 2.5, "has not come to 2.5 yet: predict first"),
        (0, 1.9, "keeps no steps .* make it with window="),
        (9, -0.1, "begin at 0"),
        (9, float("nan"), "t must be"),
    ],
)
def test_outside_of_the_window_is_said(window, at, sentence):
    flt = made(window=window)
    for k in range(len(TIMES)):
        step(flt, k)
    x = flt.x
    with pytest.raises(sf.ModelError, match=sentence):
        flt.update_late(0.3, at)
    assert flt.x is x


def test_what_raises_on_the_way_leaves_the_filter_as_it_was():
    flt = made(window=5)
    for k in range(3):
        step(flt, k)
        flt.update(0.1)
    x, steps = flt.x, flt._steps
    with pytest.raises(sf.ModelError, match="shape"):
        flt.update_late([0.1, 0.2], 0.7)
    assert flt.x is x
    assert flt._steps is steps
    with pytest.raises(sf.ModelError, match="window must be"):
        made(window=-1)


def test_models_that_switch_take_late_readings_too():
    drift = {
        "left": sf.LinearSDE([[0.0]], [-1.0], noise=[[0.2]]),
        "right": sf.LinearSDE([[0.0]], [1.0], noise=[[0.2]]),
    }
    model = sf.JumpMarkovModel(drift, [[-0.3, 0.3], [0.3, -0.3]])
    sensor = sf.GaussianMeasurement([[1.0]], [[0.04]])
    late, ordered = (sf.JumpMarkovFilter(model, sensor, [0.0], [[0.1]], window=w) for w in (3, 0))
    for t, z in ((1.0, 0.8), (2.0, 1.7)):
        late.predict(t=t)
        late.update(z)
    late.update_late(1.4, 1.5)
    for t, z in ((1.0, 0.8), (1.5, 1.4), (2.0, 1.7)):
        ordered.predict(t=t)
        ordered.update(z)
    assert np.array_equal(late.x, ordered.x)
    assert np.array_equal(late.mode_probabilities, ordered.mode_probabilities)
    assert late.log_evidence == ordered.log_evidence


def test_inputs_over_no_time_and_settings_are_taken_again():
    """A sensor may read what is set without moving on; numbers that belong to the state are set again."""
    feels = sf.GaussianMeasurement.from_expressions(["x", "v"], ["v + a"], [[0.1]], inputs=["a"])
    late, ordered = (
        sf.SPHFilter(MODEL, feels, [0.0, 0.0], np.eye(2), n_particles=150, window=w) for w in (5, 0)
    )

    def first(flt):
        flt.predict(t=1.0, u=[1.0])
        flt.predict(0.0, u=[-2.0])
        flt.update(0.3)
        flt.log_evidence = 0.0
        flt.n_particles = 200

    first(late)
    late.predict(t=2.0)
    late.update_late(0.25, 0.5, PLACE)
    ordered.predict(t=0.5, u=[1.0])
    ordered.update(0.25, PLACE)
    first(ordered)
    ordered.predict(t=2.0)
    for name in KEPT:
        assert np.array_equal(getattr(late, name), getattr(ordered, name), equal_nan=True), name


def test_a_filter_from_a_file_begins_a_window_anew(tmp_path):
    flt = made(window=3)
    step(flt, 0)
    flt.save(tmp_path / "filter.npz")
    again = sf.SPHFilter.load(tmp_path / "filter.npz", MODEL, PLACE, window=3)
    for one in (flt, again):
        step(one, 1)
        one.update_late(0.2, 0.7)
    assert np.array_equal(flt.x, again.x)
    with pytest.raises(sf.ModelError, match=r"begin at 0\.5"):
        again.update_late(0.2, 0.3)
    with pytest.raises(sf.ModelError, match="given when the filter is made"):
        flt.window = 5
