"""The log-density scheme against exact transitions, Kalman, Benes and the grid referee."""

import numpy as np
import pytest
from density_cases import COUNTS, duffing, linear, moved, off, position, start, text
from scipy.integrate import solve_ivp
from scipy.stats import norm

import sphfilter as sf
from reference_filters.closed_forms import BenesFilter, linear_transition
from reference_filters.grid import GridFilter
from reference_filters.kalman import KalmanFilter

# linear models: everything is known


@pytest.mark.parametrize("t", [0.01, 0.3, 3.0])
@pytest.mark.parametrize("quadrature", [3, 5, 7])
def test_log_density_of_ornstein_uhlenbeck(t, quadrature):
    """Paths are aimed at a Gaussian: three of them find it as well as seven, in its tail too."""
    decay = np.exp(-0.5 * t)
    exact = norm(decay, np.sqrt(decay**2 * 0.4 + 0.4 * (1 - decay**2)))
    config = sf.SolverConfig(scheme={"name": "log_density", "quadrature": quadrature})
    p, info = moved(linear(1), [1.0], [[0.4]], t, 100, config)
    error = np.abs(p.log_density - exact.logpdf(p.x[:, 0]))
    assert error[np.abs(p.x[:, 0] - decay) < 3 * exact.std()].max() < 1e-4
    assert error.max() < 3e-4
    assert np.sqrt(p.mass @ error**2) < 2e-5
    assert info.mass_error < 1e-5


@pytest.mark.parametrize("n", COUNTS)
def test_prediction_of_a_linear_model(n):
    mean, cov = start(n)
    p, info = moved(linear(n), mean, cov, 1.5, COUNTS[n])
    Phi, c, Q = linear(n).discretize(1.5)
    assert max(off(p.mean(), p.cov(), Phi @ mean + c, Phi @ cov @ Phi.T + Q)) < 1e-3
    assert info.mass_error < 1e-2
    assert p.n_particles <= COUNTS[n]
    assert info.status == "ok"


@pytest.mark.parametrize("n", COUNTS)
def test_filter_against_kalman(n):
    """T4: mean and covariance to 1e-3, the evidence of ten measurements to 1e-2 nat."""
    model, sensor, times = linear(n), position(n), np.arange(1.0, 11.0) * 0.5
    _, z = sf.simulate(model, sensor, start(n)[0], np.concatenate([[0.0], times]), rng=n)
    exact = KalmanFilter(model, sensor, *start(n)).run(times, z[1:])
    found = sf.SPHFilter(model, sensor, *start(n), n_particles=COUNTS[n]).run(times, z[1:])
    errors = [off(*step) for step in zip(found.x, found.P, exact.x, exact.P, strict=True)]
    assert np.sqrt(np.mean(np.square(errors), axis=0)).max() < 1e-3
    assert found.log_evidence.sum() == pytest.approx(exact.log_evidence.sum(), abs=1e-2)


def test_pure_transport_along_a_rotation():
    """D = 0: the density turns rigidly, and comes back after a full turn, as exact as its steps."""
    model = sf.LinearSDE(A=[[0.0, 1.0], [-1.0, 0.0]], noise=[[0.0], [0.0]], spectral_density=[[1.0]])
    cov = np.array([[0.5, 0.2], [0.2, 0.2]])
    for tolerance in (3e-4, 1e-5):
        config = sf.SolverConfig(scheme={"name": "log_density", "tolerance": tolerance})
        p, info = moved(model, [2.0, 0.0], cov, 2 * np.pi, 300, config)
        assert max(off(p.mean(), p.cov(), np.array([2.0, 0.0]), cov)) < info.n_steps * tolerance + 1e-3


def test_pure_transport_of_a_nonlinear_drift():
    """x' = -x³ without noise: p(y, t) = p(x0(y)) dx0/dy."""
    model = text(["x"], ["-x**3"], [["0"]])
    p, _ = moved(model, [1.0], [[0.04]], 0.5, 200)
    y = np.linspace(0.35, 0.95, 61)
    factor = 1.0 - y**2
    exact = norm.pdf(y / np.sqrt(factor), 1.0, 0.2) * factor**-1.5
    assert np.allclose(p.pdf(y[:, None]), exact, atol=2e-3 * exact.max())


@pytest.mark.parametrize("rank", [1, 2])
def test_noise_of_deficient_rank(rank):
    """Columns of g that repeat each other count once."""
    g = np.array([[1.0, 2.0, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, rank - 1.0]])
    A = -0.5 * np.eye(3) + 0.2 * np.eye(3, k=1)
    model = sf.LinearSDE(A=A, noise=g, spectral_density=0.2 * np.eye(3))
    p, _ = moved(model, np.ones(3), 0.2 * np.eye(3), 1.0, 400)
    Phi, c, Q = linear_transition(A, None, 0.2 * g @ g.T, 1.0)
    assert max(off(p.mean(), p.cov(), Phi @ np.ones(3) + c, Phi @ (0.2 * np.eye(3)) @ Phi.T + Q)) < 1e-3


def moment_equations(A, noise, mean, cov, t):
    """Mean and covariance of dx = A(t) x dt + g(t) dW by a tight integration."""
    n = len(mean)

    def rates(s, y):
        m, P = y[:n], y[n:].reshape(n, n)
        return np.concatenate([A(s) @ m, (A(s) @ P + P @ A(s).T + noise(s) @ noise(s).T).ravel()])

    y0 = np.concatenate([mean, np.ravel(cov)])
    y = solve_ivp(rates, (0, t), y0, rtol=1e-9, atol=1e-10, max_step=0.01).y
    return y[:n, -1], y[n:, -1].reshape(n, n)


def test_drift_and_noise_that_change_with_time():
    model = text(["x", "v"], ["v", "-(1 + sin(2*t))*x - 0.3*v"], [["0"], ["0.6 + 0.5*cos(3*t)"]])
    exact = moment_equations(
        lambda t: np.array([[0.0, 1.0], [-(1 + np.sin(2 * t)), -0.3]]),
        lambda t: np.array([[0.0], [0.6 + 0.5 * np.cos(3 * t)]]),
        np.array([1.0, 0.0]),
        0.3 * np.eye(2),
        2.0,
    )
    p, info = moved(model, [1.0, 0.0], 0.3 * np.eye(2), 2.0, 200)
    assert info.status == "ok"
    assert max(off(p.mean(), p.cov(), *exact)) < 3e-3


def test_noise_whose_direction_turns():
    """Steps see the noise of their middle: of second order in their length."""
    model = text(["x", "y"], ["-x", "-0.5*y"], [["cos(t)"], ["sin(t)"]])
    exact = moment_equations(
        lambda t: np.diag([-1.0, -0.5]),
        lambda t: np.array([[np.cos(t)], [np.sin(t)]]),
        np.zeros(2),
        0.3 * np.eye(2),
        2.0,
    )
    found = []
    for n_parts in (1, 4):
        p = sf.initialize(sf.Gaussian([0.0, 0.0], 0.3 * np.eye(2)), 200)
        for t in np.linspace(0.0, 2.0, n_parts + 1)[1:]:
            p, _ = sf.predict(p, model, t=t)
        found.append(max(off(p.mean(), p.cov(), *exact)))
    assert found[0] < 2e-3
    assert found[1] < found[0] / 8.0


def test_noise_that_swings_fast():
    """Sixteen times in the interval: as many steps as its integral needs."""
    p, _ = moved(text(["x"], ["0"], [["1 + cos(50*t)"]]), [0.0], [[0.3]], 2.0, 100)
    exact = 0.3 + 1.5 * 2.0 + 2 * np.sin(100.0) / 50 + np.sin(200.0) / 200
    assert p.cov()[0, 0] == pytest.approx(exact, rel=1e-3)


def test_noise_that_is_off_at_the_middle_of_the_interval():
    p, _ = moved(text(["x"], ["0"], [["where(t < 0.4, 1, 0)"]]), [0.0], [[0.04]], 1.0, 100)
    assert p.cov()[0, 0] == pytest.approx(0.44, rel=0.02)


def test_noise_whose_rank_changes():
    model = text(["x", "y"], ["0", "0"], [["cos(t)", "0"], ["0", "sin(t)"]], np.eye(2))
    p, _ = moved(model, [0.0, 0.0], 0.04 * np.eye(2), 2 * np.pi, 300)
    assert np.allclose(p.cov(), (0.04 + np.pi) * np.eye(2), rtol=1e-3)


@pytest.mark.parametrize("q", [1e-8, 1e-4, 1e4])
def test_tiny_and_huge_noise(q):
    model = sf.LinearSDE(A=[[0.0, 1.0], [-1.0, -0.4]], noise=[[0.0], [1.0]], spectral_density=[[q]])
    mean, cov = start(2)
    p, info = moved(model, mean, cov, 1.0, 300)
    Phi, c, Q = model.discretize(1.0)
    assert info.scheme == "log_density"
    assert max(off(p.mean(), p.cov(), Phi @ mean + c, Phi @ cov @ Phi.T + Q)) < 5e-3


# nonlinear models


def test_benes_filter():
    """dx = tanh(x) dt + dW: the exact posterior is a sum of two Gaussians; T4 wants 1 % in L2."""
    model = text(["x"], ["tanh(x)"], [["1"]])
    exact = BenesFilter(position(1, 1.0), 0.3, 0.5)
    p0 = sf.initialize(lambda X: exact.pdf(X[:, 0]), 100, box=[[-6, 7]])
    flt = sf.SPHFilter(model, position(1, 1.0), density=p0, n_particles=100)
    y = np.linspace(-14, 14, 2001)
    for t, z in [(1.0, 0.5), (2.0, -0.4), (3.0, 0.1), (4.0, 2.0)]:
        for f in (exact, flt):
            f.predict(t=t)
            f.update([z])
        q = exact.pdf(y)
        assert np.linalg.norm(flt.density.pdf(y[:, None]) - q) < 0.01 * np.linalg.norm(q)
        assert flt.log_evidence == pytest.approx(exact.log_evidence, abs=1e-2)


def test_order_of_convergence_against_the_grid():
    """Duffing from a Gaussian to a bent density; time steps are kept finer than the lattice."""
    mean, cov, t = np.array([0.5, 1.0]), np.diag([0.3, 0.3]), 1.0
    exact = GridFilter(duffing(), None, mean, cov, size=128, tol=1e-4)
    exact.predict(t)
    counts = [100, 200, 400, 800]
    fine = {"name": "log_density", "tolerance": 2e-5, "noise_share": 0.15, "reach": 5.0}
    found = []
    for N in counts:
        p, _ = moved(duffing(), mean, cov, t, N, sf.SolverConfig(scheme=fine))
        found.append(sum(off(p.mean(), p.cov(), exact.x, exact.P)))
    assert -np.polyfit(np.log(counts), np.log(found), 1)[0] > 1.5
    assert found[-1] < 2e-3


def test_two_wells_against_the_grid():
    """From the saddle into both wells of Duffing: the density's L2 error falls with the particles."""
    mean, cov = np.array([0.0, 0.0]), np.diag([0.3, 0.3])
    exact = GridFilter(duffing(), None, mean, cov, size=128)
    exact.predict(3.0)
    X, _ = exact.density.support()
    q = exact.density.pdf(X)
    found = []
    for N in (400, 1600):
        config = sf.SolverConfig(scheme=sf.LogDensityScheme(most_lost=0.1))  # as it is, with so few too
        p, _ = sf.predict(sf.initialize(sf.Gaussian(mean, cov), N), duffing(), 3.0, config)
        found.append(np.linalg.norm(p.pdf(X) - q) / np.linalg.norm(q))
    assert found[1] < 0.01
    assert found[1] < found[0] / 8.0  # order 1.5 in N
    assert max(off(p.mean(), p.cov(), exact.x, exact.P)) < 5e-3


def substituted(B, c):
    """The Duffing model in the coordinates y = B x + c, as text."""
    inverse = np.linalg.inv(B)
    x, v = (f"({r[0]:.17g}*(a - ({c[0]:.17g})) + {r[1]:.17g}*(b - ({c[1]:.17g})))" for r in inverse)
    f = [v, f"-0.4*{v} - {x}*(0.1*{x}**2 - 1)"]
    drift = [f"{row[0]:.17g}*({f[0]}) + {row[1]:.17g}*({f[1]})" for row in B]
    return text(["a", "b"], drift, [[f"{k:.17g}"] for k in B[:, 1]], [[0.5]])


@pytest.mark.parametrize(
    ("B", "c", "close"),
    [
        ([[1.0, 0.0], [0.0, 1.0]], [1000.0, -50.0], 1e-6),
        ([[1e3, 0.0], [0.0, 1e-4]], [0.0, 0.0], 1e-6),
        ([[2.0, 0.0], [-1.5, 0.3]], [1.0, 2.0], 1e-6),
        ([[0.0, 1.0], [1.0, 0.0]], [0.0, 0.0], 5e-3),
        ([[0.8, -1.7], [2.1, 0.4]], [3.0, -1.0], 5e-3),
    ],
    ids=["shift", "units", "triangular", "permutation", "general"],
)
def test_affine_changes_of_coordinates(B, c, close):
    """The lattice is whitened: exactly the same for lower triangular B, to discretisation error otherwise."""
    B, c = np.array(B), np.array(c)
    mean, cov, z = np.array([0.5, 1.0]), np.array([[0.4, 0.1], [0.1, 0.3]]), 0.9
    plain = sf.SPHFilter(duffing(), position(2), mean, cov, n_particles=400)
    sensor = sf.GaussianMeasurement(h=np.eye(1, 2) @ np.linalg.inv(B), noise_cov=[[0.3]])
    other = sf.SPHFilter(substituted(B, c), sensor, B @ mean + c, B @ cov @ B.T, n_particles=400)
    offset = (np.eye(1, 2) @ np.linalg.inv(B) @ c)[0]
    for f, reading in ((plain, z), (other, z + offset)):
        f.predict(1.0)
        f.update([reading])
    assert max(off(other.x, other.P, B @ plain.x + c, B @ plain.P @ B.T)) < close
    assert other.log_evidence == pytest.approx(plain.log_evidence, abs=close)


@pytest.mark.parametrize(("n_particles", "close"), [(50, 5e-4), (100, 1e-4)])
def test_noise_that_feels_the_drift_bend_leaves_no_error_of_first_order(n_particles, close):
    """One state in two wells, where paths of two noise modes alone were 1.6e-3 and 8e-4 off."""
    wells, sensor = text(["x"], ["x - x**3"], [["0.6"]]), position(1, 1.0)
    grid = GridFilter(wells, sensor, [0.5], [[0.5]], size=256)
    grid.predict(1.5)
    density, _ = sf.predict(sf.initialize(sf.Gaussian([0.5], [[0.5]]), n_particles), wells, 1.5)
    assert max(off(density.mean(), density.cov(), grid.x, grid.P)) < close
