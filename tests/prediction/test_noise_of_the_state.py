"""Noise that depends on the state, carried by the log-density: closed moments, exact densities, relations."""

import numpy as np
import pytest
from density_cases import moved, text
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.stats import norm

import sphfilter as sf

START = np.array([1.0]), np.array([[0.1]])
PAIR = np.array([1.0, 0.0]), 0.1 * np.eye(2)
SENSOR = sf.GaussianMeasurement(h=[[1.0]], noise_cov=[[0.2]])
#: dX = -X dt + .6 sqrt(1 + X²/2) dW has closed moments: m' = -m, (x²)' = -1.82 x² + .36.
WIDENING = [["0.6*sqrt(1 + 0.5*x**2)"]]
TURNING = [["0"], ["0.8*(1 + 0.6*tanh(v))*sqrt(1 + 0.1*x**2)"]]


def on_log_density(model, start, T, n_particles, pieces=1):
    p, info = moved(model, *start, T / pieces, n_particles)
    assert info.scheme == "log_density" and info.status == "ok"
    for k in range(1, pieces):
        p, info = sf.predict(p, model, t=T * (k + 1) / pieces, n_particles=n_particles)
        assert info.scheme == "log_density"
    return p, info


def widened(T=1.0):
    """Mean and variance of the widening noise's density."""
    rest, mean = 0.36 / 1.82, np.exp(-T)
    return mean, rest + (1.1 - rest) * np.exp(-1.82 * T) - mean**2


@pytest.mark.parametrize(("n_particles", "close"), [(50, 1e-4), (100, 2e-5), (200, 1e-5)])
@pytest.mark.parametrize("pieces", [1, 8])
def test_noise_that_widens_outwards(n_particles, close, pieces):
    """In one prediction or eight, and better on more particles."""
    p, info = on_log_density(text(["x"], ["-x"], WIDENING), START, 1.0, n_particles, pieces)
    mean, variance = widened()
    assert p.mean()[0] == pytest.approx(mean, abs=close)
    assert p.cov()[0, 0] == pytest.approx(variance, abs=close)
    assert info.mass_error < 1e-3


@pytest.mark.parametrize(("n_particles", "close"), [(100, 2e-3), (200, 3e-4)])
def test_geometric_brownian_motion(n_particles, close):
    """X = X0 exp(...): its density is an integral over the noise. Errors are parts of its height."""
    p, _ = on_log_density(text(["x"], ["0.1*x"], [["0.3*x"]]), ([2.0], [[0.01]]), 1.0, n_particles)
    w = np.linspace(-8.0, 8.0, 2001)
    weight = norm.pdf(w)
    factor = np.exp(0.1 - 0.045 + 0.3 * w)
    x = p.x[np.abs(p.x[:, 0] - p.mean()[0]) < 3.0 * np.sqrt(p.cov()[0, 0]), 0]
    exact = norm.pdf(x[:, None] / factor, 2.0, 0.1) / factor @ weight / weight.sum()
    assert np.abs(p.pdf(x[:, None]) - exact).max() < close * exact.max()


def test_noise_that_vanishes_on_a_line_it_does_not_reach():
    """Cox, Ingersoll and Ross: moments in closed form."""
    p, _ = on_log_density(text(["x"], ["2 - x"], [["0.3*sqrt(x)"]]), ([1.5], [[0.02]]), 1.0, 200)
    e = np.exp(-1.0)
    mean = 2.0 - 0.5 * e
    variance = 0.02 * e**2 + 0.09 * (1.5 * (e - e**2) + (1.0 - e) ** 2)
    assert p.mean()[0] == pytest.approx(mean, abs=1e-5)
    assert p.cov()[0, 0] == pytest.approx(variance, abs=1e-5)


def test_noise_that_vanishes_in_the_middle_of_the_density():
    """Whoever carries it: a martingale's mean stays."""
    p, info = moved(text(["x"], ["0"], [["x"]]), [0.3], [[0.04]], 0.3, 200)
    assert p.mean()[0] == pytest.approx(0.3, abs=0.05)
    assert info.scheme in ("cloud", "log_density")


def test_noise_that_is_no_number_where_particles_are():
    with pytest.raises(sf.PropagationError, match="blew up"):
        moved(text(["x"], ["0"], [["sqrt(x)"]]), [0.3], [[0.04]], 0.3, 200)


def second_moments(T):
    """Mean and covariance of x' = v, v' = -x - .3 v with noise .6 sqrt(.3 + x²): they close."""

    def rate(t, y):
        m, S = y[:2], y[2:].reshape(2, 2)
        return np.concatenate([A @ m, (A @ S + S @ A.T + np.diag([0.0, 0.36 * (0.3 + S[0, 0])])).ravel()])

    A = np.array([[0.0, 1.0], [-1.0, -0.3]])
    first = np.concatenate([PAIR[0], (PAIR[1] + np.outer(PAIR[0], PAIR[0])).ravel()])
    y = solve_ivp(rate, (0.0, T), first, rtol=1e-10, atol=1e-12).y[:, -1]
    return y[:2], y[2:].reshape(2, 2) - np.outer(y[:2], y[:2])


@pytest.mark.parametrize("pieces", [1, 8])
def test_oscillator_that_is_shaken_where_it_is_bent(pieces):
    model = text(["x", "v"], ["v", "-x - 0.3*v"], [["0"], ["0.6*sqrt(0.3 + x**2)"]])
    mean, cov = second_moments(1.0)
    p, _ = on_log_density(model, PAIR, 1.0, 300, pieces)
    assert np.abs(p.mean() - mean).max() < 2e-3
    assert np.abs(p.cov() - cov).max() < 1e-3


@pytest.mark.slow
def test_oscillator_whose_noise_is_no_polynomial():
    """Against a cloud of many points, good to 3e-4 there."""
    model = text(["x", "v"], ["v", "x - x**3 - 0.3*v"], TURNING)
    config = sf.SolverConfig(scheme=sf.CloudScheme(n_points=2**17))
    fine, _ = moved(model, *PAIR, 1.0, 2000, config)
    p, _ = on_log_density(model, PAIR, 1.0, 300)
    assert np.abs(p.mean() - fine.mean()).max() < 1e-3
    assert np.abs(p.cov() - fine.cov()).max() < 1e-3


@pytest.mark.parametrize("n", [3, 4])
def test_more_states(n):
    """A geometric Brownian motion drives a chain of integrators: first and second moments close."""
    names, drift = [f"x{k}" for k in range(n)], ["-0.2*x0", *(f"x{k} - x{k + 1}" for k in range(n - 1))]
    model = text(names, drift, [["0.3*x0"], *[["0"]] * (n - 1)])
    A = -np.eye(n) + np.eye(n, k=-1)
    A[0, 0] = -0.2
    mean, cov = np.full(n, 1.0), 0.05 * np.eye(n)
    p, _ = on_log_density(model, (mean, cov), 0.5, {3: 1000, 4: 4000}[n])
    noise = np.zeros((n * n, n * n))
    noise[0, 0] = 0.09
    second = (cov + np.outer(mean, mean)).ravel()
    L = np.kron(A, np.eye(n)) + np.kron(np.eye(n), A) + noise
    mean = expm(0.5 * A) @ mean
    cov = (expm(0.5 * L) @ second).reshape(n, n) - np.outer(mean, mean)
    assert np.abs(p.mean() - mean).max() < 2e-3
    assert np.abs(p.cov() - cov).max() < 2e-3


def test_noise_of_state_and_time():
    model = text(["x"], ["-x"], [["0.6*sqrt(1 + 0.5*x**2)*(1 + 0.5*sin(3*t))"]])

    def rate(t, y):
        return [-y[0], -2.0 * y[1] + 0.36 * (1.0 + 0.5 * y[1]) * (1.0 + 0.5 * np.sin(3.0 * t)) ** 2]

    m, second = solve_ivp(rate, (0.0, 1.0), [1.0, 1.1], rtol=1e-10, atol=1e-12).y[:, -1]
    p, _ = on_log_density(model, START, 1.0, 200)
    assert p.mean()[0] == pytest.approx(m, abs=2e-4)
    assert p.cov()[0, 0] == pytest.approx(second - m**2, abs=2e-4)


def widening(x):
    return ((0.6 * np.sqrt(1.0 + 0.5 * x[0] ** 2),),)


#: The same equation: Stratonovich's, by a function, by a numpy function, by D, with Q and two columns.
WRITTEN_OTHERWISE = {
    "stratonovich": lambda: sf.SDE.from_expressions(
        ["x"], ["-1.09*x"], WIDENING, interpretation="stratonovich"
    ),
    "function": lambda: sf.SDE(lambda x: (-x[0],), 1, widening, [[1.0]]),
    "stratonovich function": lambda: sf.SDE(
        lambda x: (-1.09 * x[0],), 1, widening, [[1.0]], interpretation="stratonovich"
    ),
    "rows": lambda: sf.SDE(
        lambda X: -X, 1, lambda X: 0.6 * np.sqrt(1 + 0.5 * X[:, :, None] ** 2), [[1.0]], vectorized=True
    ),
    "D": lambda: sf.SDE.from_expressions(["x"], ["-x"], diffusion=[["0.18*(1 + 0.5*x**2)"]]),
    "Q": lambda: text(["x"], ["-x"], [["2*sqrt(1 + 0.5*x**2)", "x"]], [[0.09, 0.0], [0.0, 0.0]]),
}


@pytest.mark.parametrize("name", WRITTEN_OTHERWISE)
def test_one_equation_written_in_other_ways(name):
    plain, _ = on_log_density(text(["x"], ["-x"], WIDENING), START, 0.2, 60)
    other, _ = on_log_density(WRITTEN_OTHERWISE[name](), START, 0.2, 60)
    assert other.mean()[0] == pytest.approx(plain.mean()[0], abs=2e-6)
    assert other.cov()[0, 0] == pytest.approx(plain.cov()[0, 0], abs=2e-6)


def test_evidence_of_readings_against_a_matrix():
    """Finite volumes of width .02, second order: carried by a matrix exponential."""
    edges = np.linspace(-5.0, 6.0, 551)
    x, dx = 0.5 * (edges[1:] + edges[:-1]), edges[1] - edges[0]
    D, f = 0.18 * (1.0 + 0.5 * x**2), -edges[1:-1]
    leave = 0.5 * f / dx + D[:-1] / dx**2, -0.5 * f / dx + D[1:] / dx**2  # to the right, to the left
    L = np.diag(leave[0], -1) + np.diag(leave[1], 1)
    L -= np.diag(L.sum(axis=0))
    move, p, evidence = expm(0.5 * L), norm.pdf(x, 1.0, np.sqrt(0.1)) * dx, 0.0
    flt = sf.SPHFilter(text(["x"], ["-x"], WIDENING), SENSOR, *START, n_particles=100)
    for z in (1.3, 0.2, -0.4, 0.9):
        p = (move @ p) * norm.pdf(z, x, np.sqrt(0.2))
        evidence += np.log(p.sum())
        p /= p.sum()
        assert flt.predict(0.5).scheme == "log_density"
        flt.update([z])
    assert flt.x[0] == pytest.approx(p @ x, abs=1e-3)
    assert flt.P[0, 0] == pytest.approx(p @ x**2 - (p @ x) ** 2, abs=1e-3)
    assert flt.log_evidence == pytest.approx(evidence, abs=2e-3)
