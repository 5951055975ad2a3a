"""Inputs of models and sensors, and tables of text: the same in all notations, and where steps stop."""

import math
import pickle

import numpy as np
import pytest

import sphfilter as sf

X = np.array([[0.3, -1.0], [1.2, 0.4]])


def of_time(x, t, u):
    return x[1], -x[0] + u[0] * math.sin(t) + u[1]


def with_parameters(x, t, p, u):
    return x[1], -p[0] * x[0] + u[0] * math.sin(t) + u[1]


def rows(X, t, u):
    return np.stack([X[:, 1], -X[:, 0] + u[0] * math.sin(t) + u[1]], axis=1)


def as_text(parameters=None, k="1"):
    drift = ["v", f"-{k}*x + a*sin(t) + b"]
    return sf.SDE.from_expressions(
        ["x", "v"], drift, [["0"], ["1"]], parameters=parameters, inputs=["a", "b"]
    )


NOISE = [[0.0], [1.0]]
NOTATIONS = {
    "text": as_text,
    "text with parameters": lambda: as_text({"k": 1.0}, "k"),
    "function": lambda: sf.SDE(of_time, 2, NOISE, inputs=["a", "b"]),
    "function with parameters": lambda: sf.SDE(
        with_parameters, 2, NOISE, parameters={"k": 1.0}, inputs={"a": 0, "b": 0}
    ),
    "rows": lambda: sf.SDE(rows, 2, NOISE, inputs=["a", "b"], vectorized=True),
}


@pytest.mark.parametrize("made", NOTATIONS.values(), ids=NOTATIONS)
def test_inputs_mean_the_same_in_every_notation(made):
    model = made()
    assert dict(model.inputs) == {"a": 0.0, "b": 0.0}
    driven = model.with_inputs([2.0, -0.5])
    expected = np.stack([X[:, 1], -X[:, 0] + 2.0 * math.sin(0.7) - 0.5], axis=1)
    np.testing.assert_allclose(driven.drift(X, 0.7), expected, rtol=1e-14)
    np.testing.assert_allclose(model.with_inputs({"b": 1.0}).drift(X, 0.7)[:, 1], -X[:, 0] + 1.0, rtol=1e-14)
    again = pickle.loads(pickle.dumps(driven))
    assert dict(again.inputs) == {"a": 2.0, "b": -0.5}
    assert driven.jacobian(X[0], 0.7) == pytest.approx(np.array([[0.0, 1.0], [-1.0, 0.0]]), abs=1e-6)


def test_a_linear_model_has_its_inputs_exactly():
    A, B = np.array([[0.0, 1.0], [-1.0, -0.3]]), np.array([[0.0], [2.0]])
    model = sf.LinearSDE(A, b=[0.1, 0.0], noise=[[0.0], [1.0]], B=B)
    Phi, offset, _ = model.with_inputs([0.5]).discretize(0.7)
    # a constant drive moves the equilibrium: x_e = -A^-1 (B u + b)
    x_e = -np.linalg.solve(A, (B @ [0.5]) + [0.1, 0.0])
    np.testing.assert_allclose(offset, x_e - Phi @ x_e, atol=1e-14)
    text = sf.SDE.from_expressions(
        ["x", "v"], ["v + 0.1", "-x - 0.3*v + 2*a"], [["0"], ["1"]], inputs={"a": 0.5}
    )
    assert text.linear
    np.testing.assert_allclose(text.to_linear().discretize(0.7)[1], offset, atol=1e-14)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ([1.0], r"\(2,\) is needed: a value for each input: a, b"),
        ({"c": 1.0}, "no input 'c'"),
        ([1.0, math.nan], "NaN or infinity"),
    ],
)
def test_inputs_that_a_model_does_not_have_are_refused(given, sentence):
    with pytest.raises(sf.ModelError, match=sentence):
        as_text().with_inputs(given)


def test_models_without_inputs_say_so():
    model = sf.LinearSDE([[-1.0]], noise=[[1.0]])
    with pytest.raises(sf.ModelError, match=r"the model has no inputs: inputs=\[...\]"):
        model.with_inputs([1.0])


@pytest.mark.parametrize(
    ("drift", "options", "sentence"),
    [
        (["-k*x"], {"parameters": {"k": 1.0, "kk": 2.0}}, "parameter 'kk' is used by no expression"),
        (["-x"], {"inputs": ["a"]}, "input 'a' is used by no expression"),
        (["-x"], {"tables": {"i": ([0, 1], [0, 1])}}, "table 'i' is used by no expression"),
        (["table('amp', t)"], {"tables": {"amps": ([0, 1], [0, 1])}}, "did you mean 'amps'"),
        (["-a*x"], {"inputs": ["a"], "parameters": {"a": 1.0}}, "'a' is a parameter and an input"),
    ],
)
def test_names_without_a_use_or_a_meaning_are_errors(drift, options, sentence):
    with pytest.raises(sf.SphfilterError, match=sentence):
        sf.SDE.from_expressions(["x"], drift, [["1"]], **options)


def test_tables_interpolate_and_their_slopes_are_known():
    at, values = np.array([-1.0, 0.5, 2.0]), np.array([3.0, 1.0, 4.0])
    model = sf.SDE.from_expressions(["x"], ["table('c', x)"], [["1"]], tables={"c": sf.Table(at, values)})
    x = np.linspace(-2.0, 3.0, 41)
    np.testing.assert_allclose(model.drift(x[:, None], 0.0)[:, 0], np.interp(x, at, values), rtol=1e-13)
    assert model.jacobian([0.0], 0.0) == pytest.approx(-2.0 / 1.5)
    assert model.jacobian([2.5], 0.0) == 0.0
    held = sf.Table(at, values, kind="previous")
    assert held([-5.0, -1.0, 0.49, 0.5, 9.0]).tolist() == [3.0, 3.0, 3.0, 1.0, 4.0]
    step = sf.SDE.from_expressions(["x"], ["-x + table('c', 2*t - 1)"], [["1"]], tables={"c": held})
    np.testing.assert_allclose(step.events, [0.0, 0.75, 1.5])  # where 2 t - 1 is an argument


def test_a_table_of_time_is_stepped_on():
    """x' = -x + i(t) has a closed form for steps of i; one prediction goes over three of them."""
    current = sf.Table([0.0, 0.3, 1.0], [0.0, 2.0, -1.0], kind="previous")
    model = sf.SDE.from_expressions(
        ["x"], ["-x - 0.001*x**3 + table('i', t)"], [["0.3"]], tables={"i": current}
    )
    flt = sf.SPHFilter(model, None, [1.0], [[0.01]])
    flt.predict(1.5)
    parts = sf.SPHFilter(model, None, [1.0], [[0.01]])
    for t in (0.3, 1.0, 1.5):
        parts.predict(t=t)
    x = 1.0
    for span, level in ((0.3, 0.0), (0.7, 2.0), (0.5, -1.0)):
        x = level + (x - level) * math.exp(-span)
    assert flt.x[0] == pytest.approx(x, abs=5e-3)  # the cubic term moves it by 2e-3
    assert flt.x[0] == pytest.approx(parts.x[0], abs=0.01 * math.sqrt(flt.P[0, 0]))


def test_tables_are_read_from_files(tmp_path):
    path = tmp_path / "current.csv"
    path.write_text("time, amp, volt\n0, 1.5, 3\n10, 2.5, 4\n\n", encoding="utf-8")
    table = sf.Table.read(path, "amp")
    assert table(5.0) == 2.0
    assert sf.Table.read(path, "amp", at="volt")(3.5) == 2.0
    with pytest.raises(sf.ModelError, match=r"no column 'amps' \(did you mean 'amp'\?\)"):
        sf.Table.read(path, "amps")
    path.write_text("time,amp\n0,a lot\n", encoding="utf-8")
    with pytest.raises(sf.ModelError, match="no row of numbers"):
        sf.Table.read(path, "amp")
    with pytest.raises(sf.ModelError, match="must rise; 1 is followed by 1"):
        sf.Table([0.0, 1.0, 1.0], [0.0, 1.0, 2.0])


def test_paths_are_drawn_with_inputs():
    model = sf.SDE.from_expressions(["x"], ["-x + u"], [["0.1"]], inputs=["u"])
    times, u = [0.0, 1.0, 2.0], np.array([99.0, 1.0, -2.0])  # the first row has no interval
    drawn, _ = sf.simulate(model, None, [0.0], times, rng=1, n_paths=4000, inputs=u)
    decay = math.exp(-1.0)
    first = 1.0 - decay
    expected = [0.0, first, first * decay - 2.0 * (1.0 - decay)]
    np.testing.assert_allclose(drawn.mean(axis=0)[:, 0], expected, atol=0.005)
    with pytest.raises(sf.ModelError, match="a column for each input"):
        sf.simulate(model, None, [0.0], times, inputs=np.ones((3, 2)))


def test_a_sensor_reads_the_inputs_of_the_model():
    """z = v + a, as an accelerometer reads what drives it."""
    model = sf.SDE.from_expressions(["v"], ["-v + a"], [["0.3"]], inputs=["a"])
    feels = sf.GaussianMeasurement.from_expressions(["v"], ["v + a"], [[0.05]], inputs=["a"])
    plain = sf.GaussianMeasurement([[1.0]], [[0.05]])
    u, times, z = np.array([0.5, -1.0, 2.0]), np.array([0.4, 0.8, 1.2]), np.array([1.1, -0.4, 2.6])
    read = sf.SPHFilter(model, feels, [0.0], [[1.0]]).run(times, z, inputs=u)
    less = sf.SPHFilter(model, plain, [0.0], [[1.0]]).run(times, z - u, inputs=u)
    # one is known to be linear, the other is not: within what is asked of a step, .01 standard deviations
    np.testing.assert_allclose(read.x, less.x, atol=1e-3)
    np.testing.assert_allclose(read.log_evidence, less.log_evidence, atol=1e-3)


def test_inputs_of_the_first_time_and_of_repeated_ones_are_read():
    model = sf.LinearSDE([[-1.0]], noise=[[1.0]], B=[[1.0]])
    sensor = sf.GaussianMeasurement.from_expressions(["x"], ["x + 10*u0"], [[0.01]], inputs=["u0"])
    times, u = [0.0, 0.0, 1.0, 1.0], [[1.0], [2.0], [3.0], [4.0]]
    truth, z = sf.simulate(model, sensor, [0.0], times, rng=1, inputs=u)
    result = sf.SPHFilter(model, sensor, [0.0], [[1.0]]).run(times, z, inputs=u)
    assert np.abs(result.x - truth).max() < 0.4  # readings tell .1
    again = sf.SPHFilter(model, sensor, [0.0], [[1.0]]).run(times, z, inputs={"u0": [1, 2, 3, 4]})
    assert np.array_equal(again.x, result.x)


@pytest.mark.parametrize(
    ("argument", "options", "stops"),
    [("t + d", {"parameters": {"d": 3.0}}, [2.0, 2.002]), ("t**2", {}, [math.sqrt(5.0), math.sqrt(5.002)])],
)
def test_a_spike_in_a_table_of_a_function_of_time_is_stepped_on(argument, options, stops):
    spike = sf.Table([0.0, 5.0, 5.002], [0.0, 500.0, 0.0], kind="previous")
    drift = [f"table('i', {argument})"]
    model = sf.SDE.from_expressions(["x"], drift, [["0.1"]], tables={"i": spike}, **options)
    np.testing.assert_allclose(model.breaks(0.1, 9.0), stops, rtol=1e-12)
    flt = sf.SPHFilter(model, None, [0.0], [[0.1]])
    flt.predict(9.0)
    assert flt.x[0] == pytest.approx(500.0 * (stops[1] - stops[0]), rel=1e-6)


@pytest.mark.parametrize(
    "record", [{"a": [1.0]}, [[1.0, 2.0]] * 2, [None, [1.0]], 5, {"b": [1.0, 2.0]}, "ab"], ids=str
)
def test_records_of_inputs_that_do_not_fit_are_refused(record):
    model = sf.SDE.from_expressions(["x"], ["-x + a"], [["1"]], inputs=["a"])
    with pytest.raises(sf.ModelError, match="input"):
        sf.SPHFilter(model, None, [0.0], [[1.0]]).run([1.0, 2.0], [None, None], inputs=record)


@pytest.mark.parametrize("u", [True, "2", 1j, np.ma.masked, [[1.0, 2.0]], [None]], ids=str)
def test_inputs_that_are_no_numbers_are_refused(u):
    model = sf.SDE.from_expressions(["x"], ["-x + a"], [["1"]], inputs=["a"])
    with pytest.raises(sf.ModelError, match=r"^u "):
        sf.SPHFilter(model, None, [0.0], [[1.0]]).predict(1.0, u=u)


def test_noise_may_divide_by_an_input_that_is_still_zero():
    model = sf.SDE.from_expressions(["x"], ["-x"], [["1/u"]], inputs=["u"])
    assert model.with_inputs(u=2.0).diffusion([[0.0]], 0.0)[0, 0, 0] == 0.125
