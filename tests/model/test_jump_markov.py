"""Models that switch between modes: what they take, their chains, and paths drawn from them."""

import numpy as np
import pytest
from density_cases import drifting
from scipy.linalg import expm

import sphfilter as sf

RATES = [[-0.5, 0.3, 0.2], [1.0, -1.2, 0.2], [0.0, 2.0, -2.0]]


def three():
    return sf.JumpMarkovModel({"a": drifting(0.0), "b": drifting(1.0), "c": drifting(-2.0)}, RATES)


def test_the_chain_of_modes():
    model = three()
    np.testing.assert_allclose(model.transition(0.7), expm(0.7 * np.array(RATES)), atol=1e-14)
    assert model.stationary @ np.array(RATES) == pytest.approx(np.zeros(3), abs=1e-12)
    assert model.stationary.sum() == pytest.approx(1.0)
    still = sf.JumpMarkovModel(model.modes, np.zeros((3, 3)))
    assert still.stationary.tolist() == [1.0 / 3.0] * 3
    slow = sf.JumpMarkovModel({"a": drifting(0.0), "b": drifting(1.0)}, [[-1e-9, 1e-9], [3e-9, -3e-9]])
    assert slow.stationary == pytest.approx([0.75, 0.25])


def chain(rates):
    return sf.JumpMarkovModel({f"m{i}": drifting(0.1 * i) for i in range(len(rates))}, rates)


def test_groups_of_modes_that_hardly_exchange_have_their_stationary_probabilities():
    for e in (1e-6, 1e-13):
        rates = [[-1 - e, 1, e, 0], [1, -1 - e, 0, e], [3 * e, 0, -1 - 3 * e, 1], [0, 3 * e, 1, -1 - 3 * e]]
        np.testing.assert_allclose(chain(rates).stationary, [0.375, 0.375, 0.125, 0.125], rtol=1e-12)


def test_long_after_equal_probabilities_a_chain_is_where_it_cannot_leave():
    rates = np.zeros((6, 6))  # 0 and 1 are left; 2 and 3 are exchanged; 4 and 5 last
    rates[0, [1, 2]], rates[1, [0, 4]], rates[2, 3], rates[3, 2] = (2.0, 1.0), (1.0, 3.0), 1.0, 4.0
    rates -= np.diag(rates.sum(axis=1))
    long_after = np.full(6, 1.0 / 6.0) @ expm(200.0 * rates)
    np.testing.assert_allclose(chain(rates).stationary, long_after, atol=1e-12)
    assert chain([[0.0, 0.0], [0.5, -0.5]]).stationary.tolist() == [1.0, 0.0]


def test_an_input_of_several_modes_has_one_value():
    def of(value):
        return sf.SDE.from_expressions(["x"], ["a - x"], [["1"]], [[0.2]], inputs={"a": value})

    with pytest.raises(sf.ModelError, match=r"'B' .* 'a' different values, 5 and 1"):
        sf.JumpMarkovModel({"A": of(1.0), "B": of(5.0)}, np.zeros((2, 2)))
    model = sf.JumpMarkovModel({"A": of(1.0), "B": of(1.0)}, np.zeros((2, 2))).with_inputs({"a": 2.0})
    assert [mode.inputs["a"] for mode in model.modes.values()] == [2.0, 2.0]


def test_times_in_a_mode_are_exponential_and_jumps_go_where_the_rates_say():
    model = three()
    step = 0.02
    modes = sf.simulate_modes(model, None, [0.0], step * np.arange(40_001), rng=1).modes
    ends = np.flatnonzero(np.diff(modes)) + 1
    lengths, of = np.diff(ends) * step, modes[ends[:-1]]
    for k, rate in enumerate(-np.diag(RATES)):
        own = lengths[of == k]
        assert own.mean() == pytest.approx(1.0 / rate, rel=5.0 / np.sqrt(len(own)), abs=2.0 * step)
        assert own.std() == pytest.approx(1.0 / rate, rel=10.0 / np.sqrt(len(own)), abs=2.0 * step)
    followed = modes[ends[1:]][of == 0]
    assert np.mean(followed == 1) == pytest.approx(0.6, abs=5.0 * np.sqrt(0.24 / len(followed)))


def test_paths_have_the_moments_of_the_model():
    model = sf.JumpMarkovModel({"rest": drifting(0.0), "moving": drifting(1.0)}, [[-0.5, 0.5], [1.0, -1.0]])
    paths = sf.simulate_modes(model, None, [0.0], [0.0, 2.0], rng=2, n_paths=4000, mode="rest")
    assert np.mean(paths.modes[:, 1]) == pytest.approx(model.transition(2.0)[0, 1], abs=0.033)
    times = np.linspace(0.0, 2.0, 2001)
    moved = np.trapezoid([model.transition(t)[0, 1] for t in times], times)  # time spent in motion
    assert paths.truth[:, 1, 0].mean() == pytest.approx(moved, abs=0.045)


def test_simulate_takes_them_too():
    model, sensor = three(), sf.GaussianMeasurement([[1.0]], [[0.1]])
    truth, z = sf.simulate(model, sensor, [0.0], [0.0, 1.0, 2.0], rng=5)
    paths = sf.simulate_modes(model, sensor, [0.0], [0.0, 1.0, 2.0], rng=5)
    assert np.array_equal(truth, paths.truth)
    assert np.array_equal(z, paths.z)
    many, none = sf.simulate(model, None, [0.0], [0.0, 1.0], rng=5, n_paths=7)
    assert many.shape == (7, 2, 1)
    assert none is None


@pytest.mark.parametrize(
    ("modes", "rates", "sentence"),
    [
        ({}, [[0.0]], "mapping of names to models"),
        ({"a": 3}, [[0.0]], "by their names"),
        ({"a": drifting(0.0)}, [[0.0, 0.0]], "from each of 1 modes to each"),
        ({"a": drifting(0.0), "b": drifting(1.0)}, [[1.0, -1.0], [1.0, -1.0]], "from 'a' to 'b'"),
        ({"a": drifting(0.0), "b": drifting(1.0)}, [[0.0, 1.0], [1.0, -1.0]], "must be minus .* -1"),
        (
            {"a": drifting(0.0), "b": sf.LinearSDE(np.zeros((2, 2)), noise=np.eye(2))},
            np.zeros((2, 2)),
            "same states in the same domain",
        ),
    ],
)
def test_what_does_not_fit_is_refused(modes, rates, sentence):
    with pytest.raises(sf.ModelError, match=sentence):
        sf.JumpMarkovModel(modes, rates)


def test_states_in_another_order_are_refused():
    def of(states, drift):
        return sf.SDE.from_expressions(states, drift, [["0"], ["1"]])

    modes = {"one": of(["x", "v"], ["v", "0"]), "other": of(["v", "x"], ["0", "v"])}
    with pytest.raises(sf.ModelError, match="same order"):
        sf.JumpMarkovModel(modes, np.zeros((2, 2)))
    with pytest.raises(sf.ModelError, match="did you mean 'a'"):
        sf.simulate_modes(three(), None, [0.0], [0.0, 1.0], mode="aa")
    with pytest.raises(sf.ModelError, match="simulate takes an SDE"):
        sf.simulate_modes(drifting(0.0), None, [0.0], [0.0, 1.0])
