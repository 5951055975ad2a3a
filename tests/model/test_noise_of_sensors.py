"""Sensors with parameters, and noise that depends on the state."""

import math
import pickle

import numpy as np
import pytest

import sphfilter as sf

TIMES = np.arange(1, 21) * 0.4
OU = sf.LinearSDE([[-1.0]], noise=[[1.0]])
TEXT = sf.GaussianMeasurement.from_expressions(
    ["x"], ["x + b"], [["s*(1 + x**2)"]], parameters={"s": 0.05, "b": 0.0}
)


def h(x, t, p):
    return (x[0] + p[1],)


def R(x, t, p):
    return ((p[0] * (1.0 + x[0] ** 2),),)


def h_rows(X, t, p):
    return X + p[1]


def R_rows(X, t, p):
    return p[0] * (1.0 + X[:, :1, None] ** 2)


FUNCTION = sf.GaussianMeasurement(h, R, dim_z=1, parameters={"s": 0.05, "b": 0.0})
ROWS = sf.GaussianMeasurement(h_rows, R_rows, dim_z=1, parameters={"s": 0.05, "b": 0.0}, vectorized=True)
_, Z = sf.simulate(OU, TEXT, [0.0], np.append(0.0, TIMES), rng=3)
Z = Z[1:]


def on_a_grid(s, b=0.0):
    """Log-evidence and last mean, by Chapman and Kolmogorov's integral on 1201 points."""
    X = np.linspace(-4.5, 4.5, 1201)
    step, decay = X[1] - X[0], math.exp(-0.4)
    q = 0.5 * (1.0 - decay**2)
    kernel = np.exp(-((X[:, None] - decay * X) ** 2) / (2.0 * q)) * step / math.sqrt(2.0 * math.pi * q)
    p, total = np.exp(-(X**2)) / math.sqrt(math.pi), 0.0
    for z in Z[:, 0]:
        noise = s * (1.0 + X**2)
        p = kernel @ p * np.exp(-0.5 * (z - X - b) ** 2 / noise) / np.sqrt(2.0 * math.pi * noise)
        total += math.log(p.sum() * step)
        p /= p.sum() * step
    return total, (X * p).sum() * step


@pytest.mark.parametrize("sensor", [TEXT, FUNCTION, ROWS], ids=["text", "function", "rows"])
def test_noise_of_the_state_is_what_a_grid_makes_of_it(sensor):
    config = sf.FilterConfig(target_error=0.003)
    flt = sf.SPHFilter(OU, sensor.with_parameters(s=0.1), [0.0], [[0.5]], config=config)
    result = flt.run(TIMES, Z)
    log_evidence, mean = on_a_grid(0.1)
    assert result.log_evidence.sum() == pytest.approx(log_evidence, abs=0.01)
    assert flt.x[0] == pytest.approx(mean, abs=0.01 * math.sqrt(flt.P[0, 0]))


def test_one_sensor_in_three_notations():
    X, z = np.array([[0.3], [-1.4], [2.0]]), [0.8]
    expected = TEXT.log_likelihood(z, X)
    noise = 0.05 * (1.0 + X[:, 0] ** 2)
    np.testing.assert_allclose(
        expected, -0.5 * (0.8 - X[:, 0]) ** 2 / noise - 0.5 * np.log(2.0 * math.pi * noise), rtol=1e-12
    )
    for sensor in (FUNCTION, ROWS, pickle.loads(pickle.dumps(TEXT)), pickle.loads(pickle.dumps(FUNCTION))):
        np.testing.assert_allclose(sensor.log_likelihood(z, X), expected, rtol=1e-12)
        np.testing.assert_allclose(sensor.covariance(X), TEXT.covariance(X), rtol=1e-12)


def test_readings_are_drawn_with_the_noise_of_their_state():
    texts = [["s*(1 + x**2)", "0.5*s"], ["0.5*s", "s"]]
    two = sf.GaussianMeasurement.from_expressions(["x"], ["x", "2*x"], texts, parameters={"s": 0.05})
    z = two.sample(np.full((100_000, 1), 1.0), rng=1)
    np.testing.assert_allclose(z.mean(axis=0), [1.0, 2.0], atol=0.003)
    np.testing.assert_allclose(np.cov(z.T), [[0.1, 0.025], [0.025, 0.05]], atol=0.002)


def test_parameters_of_a_sensor_are_fitted():
    flt = sf.SPHFilter(OU, TEXT, [0.0], [[0.5]])
    fit = sf.fit_parameters(flt, TIMES, Z, {"s": 0.1}, bounds={"s": (1e-3, None)})
    s = np.array([-0.02, 0.0, 0.02]) + fit.estimate["s"]
    sides = np.array([on_a_grid(value)[0] for value in s])
    left = (sides[2] - sides[0]) / 0.04  # slope of the log-evidence at the estimate
    assert abs(left) * fit.standard_error["s"] < 0.1
    assert fit.log_evidence == pytest.approx(sides[1], abs=0.02)
    with pytest.raises(sf.ModelError, match=r"no parameter 'bb' \(did you mean 'b'\?\); they have: s, b"):
        sf.fit_parameters(flt, TIMES, Z, {"bb": 0.1})


def test_a_noise_that_is_none_says_where():
    bad = sf.GaussianMeasurement.from_expressions(["x"], ["x"], [["x"]])
    with pytest.raises(sf.ModelError, match="noise_cov is not positive definite at the state"):
        bad.log_likelihood([0.0], np.array([[1.0], [-1.0]]))


@pytest.mark.parametrize(
    ("made", "sentence"),
    [
        (lambda: sf.GaussianMeasurement(h, R, parameters={"s": 1.0, "b": 0.0}), "give dim_z="),
        (lambda: TEXT.with_parameters(c=1.0), "no parameter 'c'"),
        (
            lambda: sf.GaussianMeasurement.from_expressions(["x"], ["x"], [["0.1"]], parameters={"c": 1.0}),
            "parameter 'c' is used by no expression",
        ),
        (lambda: sf.GaussianMeasurement.from_expressions(["x"], ["x", "x"], [["x"]]), "2 rows of 2"),
    ],
)
def test_sensors_that_do_not_fit_are_refused(made, sentence):
    with pytest.raises(sf.SphfilterError, match=sentence):
        made()
