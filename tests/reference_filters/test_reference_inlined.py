"""Steps with the drift compiled in: noise, densities, weak orders, functions, and the general way."""

import pickle

import numpy as np
import pytest
from scipy import stats

from reference_filters import _inlined, _lane_noise
from reference_filters._paths import Paths
from reference_filters._weights import linear_log_likelihood, moments_of
from reference_filters.grid import GridFilter
from reference_filters.particle import ParticleFilter
from sphfilter.model.measurements import GaussianMeasurement
from sphfilter.model.sde import SDE, LinearSDE

DRIFT, NOISE = lambda x: (x[1], -x[0] - 0.4 * x[1]), [[0.0], [1.0]]
HIDDEN, EXACT = SDE(DRIFT, 2, NOISE, 0.7), LinearSDE([[0.0, 1.0], [-1.0, -0.4]], None, NOISE, 0.7)


def moved(model, order, n_steps, span, n=2_000_000, x0=(1.0, -0.5), seed=1):
    """Mean and covariance of many paths from one state after equal steps."""
    x = np.repeat(np.array(x0)[:, None], n, axis=1)
    paths = Paths(model, order, step=(span[1] - span[0]) / n_steps * (1 + 1e-9))
    rng = np.random.default_rng(seed)
    found = paths.moved(x, None, np.full(n, 1 / n), span, np.ones(len(x0)), 1.0, rng)
    assert found.n_steps == n_steps
    return found.mean, found.cov


def test_values_of_the_noise_have_the_moments_of_a_normal():
    rare, outer, inner = _lane_noise._RARE, _lane_noise._OUTER, _lane_noise._INNER
    moments = [rare * outer**k + (1.0 - rare) * inner**k for k in (2, 4, 6)]
    np.testing.assert_allclose(moments, [1.0, 3.0, 15.0], rtol=1e-4)
    np.testing.assert_allclose(moments[:2], [1.0, 3.0], rtol=1e-14)


def test_normals_of_single_precision():
    lanes = np.random.default_rng(0).integers(0, 2**64, (3, 256), dtype=np.uint64)
    rows = []
    for _ in range(3000):
        noise = np.empty((4, 256), dtype=np.float32)
        _lane_noise.fill_noise(lanes, noise)
        rows.append(noise.astype(float))
    z = np.stack(rows, axis=1).reshape(4, -1)
    for row in z:
        assert stats.kstest(row, "norm").pvalue > 1e-3
    for power, moment in ((1, 0.0), (2, 1.0), (3, 0.0), (4, 3.0), (6, 15.0), (8, 105.0)):
        spread = np.sqrt((stats.norm.moment(2 * power) - moment**2) / z.size)
        assert abs(np.mean(z**power) - moment) < 4.5 * spread, power
    for f in (lambda v: v, np.square, np.abs):
        off = np.corrcoef(f(z))[np.triu_indices(4, 1)]
        assert np.abs(off).max() < 4.5 / np.sqrt(z.shape[1])


WELLS = SDE.from_expressions(["x", "v"], ["v", "x - 0.1*x**3 - 0.4*v"], noise=NOISE, spectral_density=[[1.6]])
PERIODIC = SDE.from_expressions(["x"], ["0.683*(sin(1.7*x) - x)"], noise=[["0.591"]])


NARROW = {
    "periodic": (PERIODIC, [0.7647], [[2.9146e-4]], 0.0597),
    "wells": (WELLS, [1.0, 0.5], 1e-4 * np.eye(2), 0.1),
}


@pytest.mark.parametrize(("name", "order", "n_steps", "seen"), [
    ("periodic", 4, 1, 0), ("periodic", 4, 2, 0), ("periodic", 4, 8, 0), ("periodic", 2, 1, 0),
    ("periodic", 2, 8, 0), ("wells", 4, 1, 0), ("wells", 4, 2, 0), ("wells", 4, 4, 1),
])  # fmt: skip
def test_a_sharp_reading_after_a_narrow_start(name, order, n_steps, seen):
    """The predicted density is smooth, not a lump for each value of few steps' noise."""
    model, x0, P0, span = NARROW[name]
    grid = GridFilter(model, None, x0, P0, size=400 if model.dim == 1 else 160, tol=1e-4)
    cloud = ParticleFilter(model, None, x0, P0, n_particles=100_000, rng=0, order=order,
                           step=span / n_steps * (1 + 1e-9))  # fmt: skip
    grid.predict(span)
    cloud.predict(span)
    density, particles, P = grid.density, cloud._belief, grid.P[seen, seen]
    for precision in (1e-2, 1e-4):
        sensor = GaussianMeasurement(h=np.eye(model.dim)[[seen]], noise_cov=[[precision * P]])
        for off in (-0.9, 0.0, 0.4, 1.3):
            z = [grid.x[seen] + off * np.sqrt(P)]
            exact = GridFilter(model, sensor, density=density, tol=1e-4)
            told = exact.update(z).log_evidence
            found, info = cloud._updated(particles, np.array(z), sensor)
            sampling = np.sqrt(np.sum(found.w**2))
            np.testing.assert_array_less(np.abs(found.mean - exact.x) / np.sqrt(np.diagonal(exact.P)),
                                         5.0 * sampling + 0.005)  # fmt: skip
            assert abs(info["log_evidence"] - told) < 5.0 * sampling + 0.01


@pytest.mark.parametrize(("order", "low", "high"), [(2, 1.6, 2.6), (4, 2.6, 4.4)])
def test_weak_order_against_the_exact_transition(order, low, high):
    Phi, _, Qd = EXACT.discretize(2.4)
    errors = []
    for n_steps in (2, 4):
        mean, cov = moved(HIDDEN, order, n_steps, (0.0, 2.4))
        errors.append(max(np.abs(mean - Phi @ [1.0, -0.5]).max(), np.abs(cov - Qd).max()))
    assert errors[1] > 4 * Qd.max() / np.sqrt(2_000_000)  # above the sampling error
    assert low < np.log2(errors[0] / errors[1]) < high


@pytest.mark.parametrize("order", [2, 4])
def test_noise_that_changes_with_time(order):
    """dx = −x dt + cos(2 t) dW: the variance is an integral."""
    model = SDE(lambda x: (-x[0],), 1, lambda x, t: ((np.cos(2.0 * t),),), [[1.5]])
    n, t = 400_000, np.linspace(0.0, 1.0, 10_001)
    mean, cov = moved(model, order, 16, (0.0, 1.0), n, [2.0])
    exact = 1.5 * np.trapezoid(np.exp(-2.0 * (1.0 - t)) * np.cos(2.0 * t) ** 2, t)
    assert abs(mean[0] - 2.0 * np.exp(-1.0)) < 4.5 * np.sqrt(exact / n) + 1e-4
    assert abs(cov[0, 0] / exact - 1.0) < 4.5 * np.sqrt(2.0 / n) + 3e-3


def test_correlated_noises_and_their_signs():
    Q = np.array([[0.5, -0.3, 0.1], [-0.3, 0.8, 0.2], [0.1, 0.2, 0.4]])
    g = np.array([[1.0, 0.0, 2.0], [0.5, -1.0, 0.0]])
    model = SDE(lambda x: (0.0 * x[0], 0.0), 2, g, Q)
    n = 400_000
    mean, cov = moved(model, 4, 3, (0.0, 2.0), n, [0.0, 0.0])
    exact = 2.0 * g @ Q @ g.T
    np.testing.assert_allclose(mean, 0.0, atol=4.5 * np.sqrt(exact.max() / n))
    np.testing.assert_allclose(cov, exact, atol=6.5 * exact.max() / np.sqrt(n))


def test_a_noise_switched_on_by_a_parameter_is_not_left_out():
    model = SDE.from_expressions(["x"], ["-x**3"], noise=[["s"]], parameters={"s": 0.0})
    x = np.ones((1000, 1))
    Paths(model.with_parameters(s=1.0)).move(x, 0.0, 0.1, np.ones(1), 1e-2, np.random.default_rng(0))
    assert np.isclose(x.std(), np.sqrt(0.1), rtol=0.25)


def test_a_drift_in_text_and_as_a_function_move_alike():
    text = SDE.from_expressions(["x", "v"], ["v", "-sin(x) - 0.1*v*exp(-x*x)"], noise=[["0"], ["1"]])
    plain = SDE(lambda x: (x[1], -np.sin(x[0]) - 0.1 * x[1] * np.exp(-x[0] * x[0])), 2, NOISE)
    found = [moved(model, 4, 5, (0.0, 1.0), 1000) for model in (text, plain)]
    np.testing.assert_allclose(found[0][0], found[1][0], rtol=1e-11)
    np.testing.assert_allclose(found[0][1], found[1][1], rtol=1e-10)


def test_a_drift_in_python_goes_the_general_way():
    rows = SDE(lambda X: np.stack(DRIFT(X.T), axis=1), 2, NOISE, 0.7, vectorized=True)
    assert _inlined.fits(HIDDEN)
    assert not _inlined.fits(rows)
    n = 100_000
    for order in (2, 4):
        mean, cov = moved(rows, order, 12, (0.0, 1.0), n)
        Phi, _, Qd = EXACT.discretize(1.0)
        np.testing.assert_allclose(mean, Phi @ [1.0, -0.5], atol=4.5 * np.sqrt(Qd.max() / n) + 2e-3)
        np.testing.assert_allclose(cov, Qd, atol=6.5 * Qd.max() / np.sqrt(n) + 2e-3)


def test_the_likelihood_of_a_linear_sensor_in_one_pass():
    R = [[0.5, 0.2], [0.2, 0.3]]
    sensor = GaussianMeasurement(h=[[1.0, 0.0], [0.5, -2.0]], noise_cov=R)
    filt = ParticleFilter(HIDDEN, sensor, [0.0, 0.0], np.eye(2), n_particles=601, rng=0)
    for z in ([0.3, -1.0], [np.nan, 2.0]):
        found = filt._log_likelihood(filt._belief.x, np.array(z), sensor)
        np.testing.assert_allclose(found, sensor.log_likelihood(z, filt.particles), rtol=1e-12)
    out = np.empty(3)
    linear_log_likelihood(np.eye(1, 3), np.ones((1, 1)), np.array([2.0]), -1.0, out)
    np.testing.assert_allclose(out, [-1.5, -3.0, -3.0])


def test_moments_in_blocks():
    rng = np.random.default_rng(3)
    x, w = rng.standard_normal((3, 1000)) + 1e6, rng.exponential(size=1000)
    w[256:512] = 0.0
    w /= w.sum()
    mean, cov = moments_of(x, w)
    np.testing.assert_allclose(mean, x @ w, rtol=1e-14)
    np.testing.assert_allclose(cov, np.cov(x, aweights=w, bias=True), rtol=1e-9)


def test_a_prediction_tells_the_moments_of_its_cloud():
    for mode in ("always", "ess"):
        filt = ParticleFilter(HIDDEN, GaussianMeasurement(h=[[1.0, 0.0]], noise_cov=[[4.0]]), [0.0, 0.0],
                              np.eye(2), n_particles=700, rng=0, resampling=mode)  # fmt: skip
        filt.update([1.0])
        filt.predict(0.7)
        np.testing.assert_allclose(filt.x, filt.weights @ filt.particles, rtol=1e-12)
        cov = np.cov(filt.particles.T, aweights=filt.weights, bias=True)
        np.testing.assert_allclose(filt.P, cov, rtol=1e-11)


def test_a_copy_goes_on_to_the_same_bits_and_takes_no_addresses_along():
    model = SDE.from_expressions(["x", "v"], ["v", "-x**3"], noise=NOISE)
    filt = ParticleFilter(model, None, [0.0, 0.0], np.eye(2), n_particles=300, rng=0)
    filt.predict(1.0)
    stored = pickle.dumps(filt)
    assert str(filt._paths._addresses[0]).encode() not in stored and b"_addresses" not in stored
    again = pickle.loads(stored)
    for own in (filt, again):
        own.predict(0.5)
    np.testing.assert_array_equal(filt.particles, again.particles)


@pytest.mark.parametrize("Q", [(0.05, 0.005), (0.005, 0.05), (3.0, 3.0)])
def test_noises_of_any_densities_move_the_states_they_belong_to(Q):
    """The root of a diagonal spectral density may have its columns in another order."""
    model = SDE.from_expressions(["x", "y"], ["-sin(x)", "-sin(y)"], [["1", "0"], ["0", "1"]], np.diag(Q))
    filt = ParticleFilter(model, None, [0.0, 0.0], 1e-6 * np.eye(2), n_particles=40_000, rng=1)
    filt.predict(t=0.05)
    np.testing.assert_allclose(np.diag(filt.P), np.array(Q) * (1.0 - np.exp(-0.1)) / 2.0, rtol=0.04)
