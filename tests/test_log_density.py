"""The log-density scheme against exact transitions, Kalman, Benes and the grid referee; and its contract."""

import copy
import pickle

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import multivariate_normal, norm

import sphfilter as sf
from reference_filters.closed_forms import BenesFilter, linear_transition
from reference_filters.grid import GridFilter
from reference_filters.kalman import KalmanFilter
from sphfilter.errors import PropagationError, SphfilterError
from sphfilter.schemes.log_density import paths

#: T4: particles at most by dimension.
COUNTS = {1: 100, 2: 200, 3: 400, 4: 800}
DUFFING = ["v", "-0.4*v - x*(0.1*x**2 - 1)"]


def linear(n):
    """A damped linear model of n states, noise in the last alone from two on."""
    A = {
        1: [[-0.5]],
        2: [[0, 1], [-1, -0.4]],
        3: [[-0.5, 1, 0], [-1, -0.5, 0.3], [0, 0.2, -0.8]],
        4: [[0, 1, 0, 0], [-2, -0.3, 1, 0.1], [0, 0, 0, 1], [1, 0.1, -2, -0.3]],
    }[n]
    noise = np.eye(n)[:, [k for k in range(n) if n != 2 or k == 1]]
    noise = noise[:, [1, 3]] if n == 4 else noise
    return sf.LinearSDE(A=A, noise=noise, spectral_density=0.4 * np.eye(noise.shape[1]))


def position(n, R=0.3):
    return sf.GaussianMeasurement(h=np.eye(1, n), noise_cov=[[R]])


def start(n):
    return np.linspace(1.0, 0.0, n), 0.3 * np.eye(n) + 0.1


def off(x, P, exact_x, exact_P):
    """Norm of the whitened mean error, and of the whitened covariance error over sqrt(n)."""
    whiten = np.linalg.inv(np.linalg.cholesky(exact_P))
    cov = whiten @ P @ whiten.T - np.eye(len(x))
    return np.linalg.norm(whiten @ (x - exact_x)), np.linalg.norm(cov) / np.sqrt(len(x))


def moved(model, mean, cov, t, N, config=None):
    return sf.predict(sf.initialize(sf.Gaussian(mean, cov), N), model, t, config)


def text(states, drift, noise=(("0",), ("1",)), Q=((1.0,),), **parameters):
    return sf.SDE.from_expressions(states, drift, noise, Q, parameters)


def duffing(Q=0.5):
    return text(["x", "v"], DUFFING, Q=[[Q]])


# the noise of a step


@pytest.mark.parametrize("m", range(7))
def test_noise_paths_have_the_moments_of_brownian_motion(m):
    """dW: degree five up to three noises, then three; the area beyond the straight path has variance h/12."""
    rule = paths(m, 5)
    w = np.exp(rule.log_weight)
    assert w.sum() == pytest.approx(1.0)
    assert rule.w.shape == (len(w), 2 * m)
    assert np.allclose(w @ rule.w, 0.0)
    dW, bend = rule.w[:, :m], rule.w[:, m:]
    assert np.allclose((dW * w[:, None]).T @ dW, np.eye(m))
    assert np.allclose((dW * w[:, None]).T @ bend, 0.0)
    if 1 <= m <= 2:
        assert np.allclose((bend * w[:, None]).T @ bend, np.eye(m))
    if 1 <= m <= 3:
        fourth = np.einsum("q,qa,qa,qb,qb->ab", w, *[dW] * 4)
        assert np.allclose(fourth, 1.0 + 2.0 * np.eye(m))


# linear models: everything is known


@pytest.mark.parametrize("t", [0.01, 0.3, 3.0])
def test_log_density_of_ornstein_uhlenbeck(t):
    """Five noise paths a step, the default, know little of the sixth moment: that costs the tail."""
    decay = np.exp(-0.5 * t)
    exact = norm(decay, np.sqrt(decay**2 * 0.4 + 0.4 * (1 - decay**2)))
    for quadrature, inner, outer in ((7, 1e-4, 1e-3), (5, 1e-3, 0.1)):
        config = sf.SolverConfig(scheme={"name": "log_density", "quadrature": quadrature})
        p, info = moved(linear(1), [1.0], [[0.4]], t, 100, config)
        error = np.abs(p.log_density - exact.logpdf(p.x[:, 0]))
        assert error[np.abs(p.x[:, 0] - decay) < 3 * exact.std()].max() < inner
        assert error.max() < outer
        assert np.sqrt(p.mass @ error**2) < 2e-4
        assert info.mass_error < 1e-4


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
    """Steps see the noise of their middle: of second order in their length, a sixteenth of an interval."""
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
    assert found[0] < 2e-2
    assert found[1] < 1e-3


def test_noise_faster_than_sixteen_steps():
    p, _ = moved(text(["x"], ["0"], [["1 + cos(50*t)"]]), [0.0], [[0.3]], 2.0, 100)
    exact = 0.3 + 1.5 * 2.0 + 2 * np.sin(100.0) / 50 + np.sin(200.0) / 200
    assert p.cov()[0, 0] == pytest.approx(exact, rel=0.05)


def test_noise_that_is_off_at_the_middle_of_the_interval():
    p, _ = moved(text(["x"], ["0"], [["where(t < 0.4, 1, 0)"]]), [0.0], [[0.04]], 1.0, 100)
    assert p.cov()[0, 0] == pytest.approx(0.44, rel=0.1)


def test_noise_whose_rank_changes():
    model = text(["x", "y"], ["0", "0"], [["cos(t)", "0"], ["0", "sin(t)"]], np.eye(2))
    p, _ = moved(model, [0.0, 0.0], 0.04 * np.eye(2), 2 * np.pi, 300)
    assert np.allclose(p.cov(), (0.04 + np.pi) * np.eye(2), rtol=1e-2, atol=1e-2)


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


def test_noise_that_depends_on_the_state_falls_back():
    model = text(["x"], ["-x"], [["sqrt(0.5 + 0.2*x**2)"]])
    mean, cov = np.array([1.0]), np.array([[0.2]])
    p, info = moved(model, mean, cov, 1.0, 200)
    assert info.scheme == "corrected"
    assert info.status == "not log_density: the noise depends on the state"
    m = np.exp(-1.0)  # m' = -m;  (x²)' = -2 x² + 0.5 + 0.2 x²
    second = 0.5 / 1.8 + (0.2 + 1.0 - 0.5 / 1.8) * np.exp(-1.8)
    assert p.mean()[0] == pytest.approx(m, abs=5e-3)
    assert p.cov()[0, 0] == pytest.approx(second - m**2, rel=2e-2)


# refusals


def test_blow_up_is_told():
    with pytest.raises(PropagationError, match=r"x = .*grows without bound|stopped at t"):
        moved(text(["x"], ["x**3"], [["1"]]), [0.0], [[9.0]], 5.0, 100)


def test_too_few_particles_are_told():
    _, info = moved(linear(2), *start(2), 0.1, 200)
    assert info.status == "ok"
    with pytest.raises(SphfilterError, match="particles"):
        moved(linear(4), *start(4), 0.1, 20)


def failing(kind):
    """A black box that fails once it has been asked for a while: in the middle of a prediction."""
    asked = []

    def drift(X, t):
        asked.append(t)
        if len(asked) > 12:
            raise kind("enough")
        return -X

    def divergence(X, t):
        return -np.ones(len(X))

    return sf.SDE(drift=drift, dim=1, noise=[[1.0]], divergence=divergence, vectorized=True)


@pytest.mark.parametrize(("kind", "raised"), [(ValueError, PropagationError), (KeyboardInterrupt,) * 2])
def test_a_prediction_that_fails_leaves_the_filter(kind, raised):
    flt = sf.SPHFilter(failing(kind), position(1), [1.0], [[0.3]], n_particles=60)
    before = flt.density, flt.x, flt.t, flt.log_evidence, flt.x_prior
    content = before[0].x.copy(), before[0].mass.copy(), before[0].field.coefficient.copy()
    with pytest.raises(raised):
        flt.predict(20.0)
    assert flt.density is before[0]
    assert (flt.t, flt.log_evidence) == (0.0, 0.0)
    assert flt.x is before[1]
    assert flt.x_prior is before[4]
    kept = flt.density.x, flt.density.mass, flt.density.field.coefficient
    assert all(np.array_equal(a, b) for a, b in zip(content, kept, strict=True))


# the filter and its density


def test_the_same_bits_twice():
    def run():
        flt = sf.SPHFilter(duffing(), position(2), [0.5, 1.0], 0.3 * np.eye(2), n_particles=200)
        result = flt.run([0.5, 1.0, 1.5], [[0.9], None, [np.nan]])
        return result, flt.density

    (first, p), (second, q) = run(), run()
    for name in ("x", "P", "log_evidence"):
        assert np.array_equal(getattr(first, name), getattr(second, name))
    assert np.array_equal(p.log_density, q.log_density)
    assert first.log_evidence[1] == first.log_evidence[2] == 0.0


def test_prediction_in_parts():
    """One interval or three: the same density to the error of the scheme."""
    p, _ = moved(duffing(), [0.5, 1.0], 0.3 * np.eye(2), 1.2, 400)
    q = sf.initialize(sf.Gaussian([0.5, 1.0], 0.3 * np.eye(2)), 400)
    for _ in range(3):
        q, _ = sf.predict(q, duffing(), 0.4)
    assert max(off(q.mean(), q.cov(), p.mean(), p.cov())) < 3e-3


def test_an_empty_interval_is_skipped():
    p = sf.initialize(sf.Gaussian([0.5, 1.0], 0.3 * np.eye(2)), 200)
    q, info = sf.predict(p, duffing(), 0.0)
    assert q is p
    assert info.n_evaluations == 0
    assert "empty" in info.skipped[0]


@pytest.fixture(scope="module")
def bent():
    return moved(duffing(), [0.5, 1.0], 0.3 * np.eye(2), 1.0, 300)[0]


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda p: pickle.loads(pickle.dumps(p))])
def test_copies_of_a_density(bent, copied):
    other = copied(bent)
    X = bent.x[::5] + 0.03
    assert np.array_equal(other.logpdf(X), bent.logpdf(X))
    assert np.array_equal(other.cov(), bent.cov())
    assert not other.x.flags.writeable
    after = [sf.predict(p, duffing(), 0.2)[0].mean() for p in (bent, other)]
    assert np.array_equal(*after)


def quadrature(p, n_nodes=400):
    """Nodes and weights over six deviations around a density of two states."""
    u = np.linspace(-6, 6, n_nodes)
    root = np.linalg.cholesky(p.cov())
    X = p.mean() + np.stack(np.meshgrid(u, u, indexing="ij"), axis=-1).reshape(-1, 2) @ root.T
    w = p.pdf(X) * (u[1] - u[0]) ** 2 * np.prod(np.diag(root))
    return X, w


def test_the_pdf_integrates_to_one_and_agrees_with_the_read_outs(bent):
    X, w = quadrature(bent)
    assert w.sum() == pytest.approx(1.0, abs=2e-3)
    mean = w @ X / w.sum()
    assert max(off(mean, (X - mean).T @ ((X - mean) * w[:, None]), bent.mean(), bent.cov())) < 1e-2
    first = np.unique(X[:, 0])
    edge = 0.5 * (first[220] + first[221])  # between two rows of the quadrature
    right = w[X[:, 0] > edge].sum() / w.sum()
    assert bent.probability(lambda Y: Y[:, 0] > edge) == pytest.approx(right, abs=3e-3)
    assert bent.moment([2, 1]) == pytest.approx(w @ (X[:, 0] ** 2 * X[:, 1]), rel=1e-2)


def test_samples_have_the_moments_of_the_density(bent):
    drawn = bent.sample(40_000, rng=1)
    assert drawn.shape == (40_000, 2)
    assert max(off(drawn.mean(axis=0), np.cov(drawn.T), bent.mean(), bent.cov())) < 0.02
    assert np.array_equal(bent.sample(5, rng=3), bent.sample(5, rng=3))


def test_the_far_tail_falls_like_a_gaussian():
    p, _ = moved(linear(2), *start(2), 1.0, 300)
    Phi, c, Q = linear(2).discretize(1.0)
    mean, cov = start(2)
    exact = multivariate_normal(Phi @ mean + c, Phi @ cov @ Phi.T + Q)
    root = np.linalg.cholesky(exact.cov)
    for angle in np.linspace(0, 2 * np.pi, 9):
        X = exact.mean + 20.0 * root @ [np.cos(angle), np.sin(angle)]
        assert p.logpdf(X)[0] == pytest.approx(exact.logpdf(X), rel=0.05)
    huge = p.logpdf(np.array([[1e100, 0.0], [-1e200, 1e200]]))
    assert np.all(np.isfinite(huge))
    assert np.all(huge < -1e190)
