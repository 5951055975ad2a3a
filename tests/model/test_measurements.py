"""Measurements: likelihoods against scipy, missing components, angles, messages."""

import pickle

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from sphfilter.errors import ExpressionError, ModelError
from sphfilter.model.likelihood import LikelihoodMeasurement
from sphfilter.model.measurements import GaussianMeasurement

X = np.random.default_rng(3).normal(size=(5, 3))
H = np.array([[1.0, 0.0, 0.5], [0.0, 2.0, 0.0], [1.0, 1.0, 1.0]])
R = np.array([[0.4, 0.1, 0.0], [0.1, 0.3, -0.05], [0.0, -0.05, 0.6]])


def polar(x):
    return np.arctan2(x[1], x[0]), np.hypot(x[0], x[1])


def never(z, X, t):
    return np.full(len(X), -np.inf)


def test_linear_likelihood_is_the_normal_density():
    sensor = GaussianMeasurement(H, R)
    z = np.array([0.3, -1.0, 0.8])
    expected = [multivariate_normal(H @ x, R).logpdf(z) for x in X]
    np.testing.assert_allclose(sensor.log_likelihood(z, X, 0.0), expected, rtol=1e-12)
    np.testing.assert_allclose(sensor.predict(X, 0.0), X @ H.T)
    np.testing.assert_array_equal(sensor.jacobian(X[0], 0.0), H)
    assert sensor.dim_z == 3


@pytest.mark.parametrize("seen", [[0], [2], [0, 2], [1, 2]])
def test_missing_components_are_left_out(seen):
    z = np.array([0.3, -1.0, 0.8])
    gaps = np.full(3, np.nan)
    gaps[seen] = z[seen]
    sensor = GaussianMeasurement(H, R)
    expected = [multivariate_normal((H @ x)[seen], R[np.ix_(seen, seen)]).logpdf(z[seen]) for x in X]
    np.testing.assert_allclose(sensor.log_likelihood(gaps, X, 0.0), expected, rtol=1e-12)
    assert sensor.observed(gaps).sum() == len(seen)


def test_all_missing():
    sensor = GaussianMeasurement(H, R)
    for z in (None, [np.nan] * 3):
        np.testing.assert_array_equal(sensor.log_likelihood(z, X, 0.0), np.zeros(5))
        assert not sensor.observed(z).any()


@pytest.mark.parametrize("vectorized", [False, True])
def test_functions_of_numpy_are_taken_as_they_are(vectorized):
    sensor = GaussianMeasurement(np.tanh, np.diag([0.1, 0.2, 0.3]), vectorized=vectorized)
    np.testing.assert_allclose(sensor.predict(X, 0.0), np.tanh(X))


def test_function_of_state_and_time():
    compiled = GaussianMeasurement(lambda x, t: (x[0] ** 2, x[1] * t), np.diag([0.1, 0.2]))
    rows = GaussianMeasurement(
        lambda X, t: np.stack([X[:, 0] ** 2, X[:, 1] * t], axis=1), np.diag([0.1, 0.2]), vectorized=True
    )
    for sensor in (compiled, rows):
        np.testing.assert_allclose(sensor.predict(X, 2.0), np.stack([X[:, 0] ** 2, 2 * X[:, 1]], axis=1))
        np.testing.assert_allclose(
            sensor.jacobian(X[0], 2.0), [[2 * X[0, 0], 0, 0], [0, 2, 0]], rtol=1e-8, atol=1e-9
        )
        assert sensor.H is None and sensor.directly_observed is None
    one = GaussianMeasurement(lambda x: x[0] ** 2, 0.3)
    np.testing.assert_allclose(one.log_likelihood(0.5, X), one.log_likelihood([0.5], X))


def test_angles_are_wrapped():
    sensor = GaussianMeasurement(polar, np.diag([0.01, 0.04]), angles=[0])
    np.testing.assert_allclose(sensor.residual([np.pi, 1.0], [-np.pi, 0.0]), [0.0, 1.0], atol=1e-15)
    np.testing.assert_allclose(sensor.residual([3.0, 0.0], [-3.0, 0.0]), [6.0 - 2 * np.pi, 0.0])
    assert sensor.residual([0.0, 0.0], [np.pi, 0.0])[0] == np.pi  # −π is told as π
    # just above and just below the cut the reading is equally likely, and the slope has no jump
    above, below = np.array([[-1.0, 1e-9]]), np.array([[-1.0, -1e-9]])
    a, b = sensor.log_likelihood([3.1, 1.0], above), sensor.log_likelihood([3.1, 1.0], below)
    np.testing.assert_allclose(a, b, atol=1e-5)
    np.testing.assert_allclose(sensor.jacobian([-1.0, 1e-12]), [[0.0, -1.0], [-1.0, 0.0]], atol=1e-8)
    z = sensor.sample(np.repeat(above, 200, axis=0), 0.0, 1)
    assert np.all((z[:, 0] > -np.pi) & (z[:, 0] <= np.pi)) and (z[:, 0] < 0).any() and (z[:, 0] > 0).any()


def test_directly_observed():
    columns, scales = GaussianMeasurement([[0, 0, 2.0], [-1.0, 0, 0]], np.eye(2)).directly_observed
    np.testing.assert_array_equal(columns, [2, 0])
    np.testing.assert_array_equal(scales, [2.0, -1.0])
    for h, cov in [
        (H, R),
        ([[1.0, 0], [2.0, 0]], np.eye(2)),
        ([[1.0, 0], [0, 1.0]], [[1, 0.1], [0.1, 1]]),
        ([[0.0, 0.0]], [[1.0]]),
    ]:
        assert GaussianMeasurement(h, cov).directly_observed is None


def test_samples_have_the_noise_asked_for():
    sensor = GaussianMeasurement(H, R)
    z = sensor.sample(np.tile(X[0], (40_000, 1)), 0.0, np.random.default_rng(0))
    np.testing.assert_allclose(z.mean(axis=0), H @ X[0], atol=5 * np.sqrt(0.6 / 40_000))
    np.testing.assert_allclose(np.cov(z.T), R, atol=0.02)
    assert sensor.sample(X[0], 0.0, 1).shape == (3,)
    np.testing.assert_array_equal(sensor.sample(X, 0.0, 4), sensor.sample(X, 0.0, 4))


def test_likelihood_measurement():
    def poisson(z, X, t):
        rate = np.exp(X[:, 0])
        return z[0] * np.log(rate) - rate

    sensor = LikelihoodMeasurement(poisson, dim_z=1, sample=lambda X, t, rng: rng.poisson(np.exp(X[:, 0])))
    np.testing.assert_allclose(sensor.log_likelihood(2, X, 0.0), 2 * X[:, 0] - np.exp(X[:, 0]))
    np.testing.assert_array_equal(sensor.log_likelihood(None, X, 0.0), np.zeros(5))
    assert sensor.sample(X, 0.0, 1).shape == (5, 1) and sensor.sample(X[0], 0.0, 1).shape == (1,)
    assert sensor.H is None and sensor.directly_observed is None


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: GaussianMeasurement([[1.0]], [[0.0]]), "not positive definite"),
        (lambda: GaussianMeasurement([[1.0]], [[-1.0]]), "not positive definite"),
        (lambda: GaussianMeasurement([[1.0]], [[1.0, 2.0]]), "must be square"),
        (lambda: GaussianMeasurement([[1.0]], [[np.nan]]), "NaN"),
        (lambda: GaussianMeasurement([[1.0, 0], [0, 1.0]], [[1.0]]), "do not fit"),
        (
            lambda: GaussianMeasurement([[1.0, 0]], np.eye(2)),
            r"h of shape \(1, 2\) and noise_cov of shape \(2, 2\) do not fit",
        ),
        (
            lambda: GaussianMeasurement(H, [1.0, 1.0, 1.0]),
            r"noise_cov has shape \(3,\).*np\.diag\(noise_cov\)",
        ),
        (lambda: GaussianMeasurement([[1.0]], [[1.0]], angles=True), r"such as angles=\[0\], got True"),
        (lambda: GaussianMeasurement([[1.0]], [[1.0]], angles=0), r"such as angles=\[0\], got 0"),
        (
            lambda: LikelihoodMeasurement(lambda z, x: 1.0),
            r"function of \(z, X, t\), but its arguments are \(z, x",
        ),
        (lambda: GaussianMeasurement([[1.0]], [[1.0]], angles=[1]), "angles names component 1"),
        (lambda: GaussianMeasurement(lambda x: [x[0]], [[1.0]]), "h returns a List; it must return a tuple"),
        (lambda: GaussianMeasurement(polar, [[1.0]]), r"h returns 2 value\(s\), but 1"),
        (lambda: GaussianMeasurement(polar, np.eye(2)).predict(np.ones((3, 1))), "reads beyond the state"),
        (lambda: GaussianMeasurement(H, R).predict(np.ones((3, 2))), "h is of 3 states, but the state has 2"),
        (lambda: GaussianMeasurement(H, R).observed([1.0]), "measurement has shape"),
        (lambda: GaussianMeasurement(H, R).observed([1.0, np.inf, 0.0]), "infinite; use NaN"),
        (lambda: GaussianMeasurement(H, R).log_likelihood("abc", X), "3 numbers"),
        (lambda: LikelihoodMeasurement(1.0), "must be a function"),
        (lambda: LikelihoodMeasurement(lambda z, X, t: 0.0).log_likelihood(1.0, X), r"\(5,\) is needed"),
        (lambda: LikelihoodMeasurement(lambda z, X, t: np.nan * X[:, 0]).log_likelihood(1, X), "nan at"),
        (lambda: LikelihoodMeasurement(lambda z, X, t: X[:, 0], dim_z=2).log_likelihood(1.0, X), "shape"),
        (lambda: LikelihoodMeasurement(lambda z, X, t: X[:, 0]).sample(X), "cannot be simulated"),
    ],
)
def test_messages(make, says):
    with pytest.raises(ModelError, match=says):
        make()


def test_pickling():
    for sensor in (GaussianMeasurement(H, R), GaussianMeasurement(polar, np.eye(2), angles=[0])):
        copy = pickle.loads(pickle.dumps(sensor))
        z = np.ones(sensor.dim_z)
        np.testing.assert_array_equal(copy.log_likelihood(z, X), sensor.log_likelihood(z, X))


def test_a_sensor_in_text_reads_what_the_formula_says():
    text = GaussianMeasurement.from_expressions(
        ["x", "y"], ["atan2(y, x)", "t + sqrt(x**2 + y**2)"], [[0.1, 0.0], [0.0, 0.2]], angles=[0]
    )
    X = np.random.default_rng(0).normal(size=(5, 2))
    expected = np.column_stack([np.arctan2(X[:, 1], X[:, 0]), 2.0 + np.hypot(*X.T)])
    for sensor in (text, pickle.loads(pickle.dumps(text))):
        np.testing.assert_allclose(sensor.predict(X, 2.0), expected, atol=1e-14)
        assert sensor.angles == (0,)
        assert sensor.H is None


MATRICES = [
    (["a*x - v"], [["s**2"]], [[2.0, -1.0]], [[0.09]]),
    (
        ["2*(x + a*v) - 2*x", "x"],
        [["s", "0"], ["0", 0.5]],
        [[0.0, 4.0], [1.0, 0.0]],
        [[0.3, 0.0], [0.0, 0.5]],
    ),
    (["x + a"], [["s"]], None, [[0.3]]),
    (["a*x*v"], [["s"]], None, [[0.3]]),
    (["a*t*x"], [["s"]], None, [[0.3]]),
    (["abs(a*x)"], [["s"]], None, [[0.3]]),
    (["a*x"], [["s*(1 + x**2)"]], None, None),
    (["a*x"], [["s*(1 + t)"]], None, None),
]


@pytest.mark.parametrize(("h", "noise", "H", "R"), MATRICES)
def test_a_text_that_says_a_matrix_is_known_as_one(h, noise, H, R):
    values = {"a": 2.0, "s": 0.3}
    first = GaussianMeasurement.from_expressions(["x", "v"], h, noise, parameters=values | {"a": 5.0})
    sensor = first.with_parameters(a=2.0)  # another value is another matrix
    for known, expected in ((sensor.H, H), (sensor.noise_cov, R)):
        assert (known is None) == (expected is None)
        assert known is None or np.allclose(known, expected, rtol=0.0, atol=1e-15)
    if H is not None:
        assert first.H.tolist() != H and sensor.changed(noise_cov=2.0).H.tolist() == H
        assert sensor.changed(h=[[1.0, 0.0]] * len(H)).noise_cov.tolist() == sensor.noise_cov.tolist()
        same = GaussianMeasurement(H, R)
        np.testing.assert_allclose(
            sensor.log_likelihood([0.3] * len(H), X[:, :2]), same.log_likelihood([0.3] * len(H), X[:, :2])
        )


def test_a_text_whose_values_are_no_covariance_says_so_when_it_is_asked():
    sensor = GaussianMeasurement.from_expressions(["x"], ["x"], [["s"]], parameters={"s": 0.0})
    assert sensor.noise_cov is None and sensor.H is None
    with pytest.raises(ModelError, match="not positive definite at the state"):
        sensor.log_likelihood([0.3], [[0.1]])
    assert sensor.with_parameters(s=0.5).H.tolist() == [[1.0]]


@pytest.mark.parametrize(
    ("states", "h", "error", "said"),
    [
        (["x", "y"], ["xx"], ExpressionError, "did you mean 'x'"),
        (["x", "y"], "x", ModelError, "lists of text"),
    ],
)
def test_a_wrong_text_of_a_sensor_is_refused(states, h, error, said):
    with pytest.raises(error, match=said):
        GaussianMeasurement.from_expressions(states, h, [[1.0]])


def test_a_sensor_in_text_knows_its_number_of_states():
    sensor = GaussianMeasurement.from_expressions(["x"], ["x**2"], [[1.0]])
    with pytest.raises(ModelError, match="h is of 1 states, but the state has 2"):
        sensor.predict(np.ones((3, 2)))


@pytest.mark.parametrize(
    ("sensor", "said"),
    [
        (GaussianMeasurement([[1.0, 0.0]], 0.2), "GaussianMeasurement(h=[[1.0, 0.0]], noise_cov=[[0.2]])"),
        (
            GaussianMeasurement(polar, np.eye(2), angles=[0]),
            "h=polar, noise_cov=[[1.0, 0.0], [0.0, 1.0]], angles=[0]",
        ),
        (GaussianMeasurement.from_expressions(["x"], ["x**2"], [[1.0]]), "h=['x**2']"),
        (LikelihoodMeasurement(never, dim_z=2), "LikelihoodMeasurement(loglik=never, dim_z=2)"),
    ],
)
def test_a_sensor_tells_what_it_is(sensor, said):
    assert said in repr(sensor)


@pytest.mark.parametrize("name, value", [("noise_cov", [[4.0]]), ("H", None), ("angles", (0,))])
def test_what_likelihoods_follow_from_stays_as_it_is(name, value):
    with pytest.raises(ModelError, match=r"changed\(noise_cov="):
        setattr(GaussianMeasurement([[1.0, 0.0]], [[0.2]]), name, value)
