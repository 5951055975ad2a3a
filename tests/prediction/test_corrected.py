"""Moment-corrected SPH against closed forms: moments, log-density, invariances, failures."""

import numpy as np
import pytest
from density_cases import off
from scipy import stats

import sphfilter as sf
from sphfilter.config import CorrectedScheme
from sphfilter.prediction.corrected import propagate

OSCILLATOR = sf.LinearSDE(A=[[0.0, 1.0], [-1.0, -0.1]], noise=[[0.0], [1.0]], spectral_density=[[0.2]])
DUFFING = sf.SDE.from_expressions(["x", "v"], ["v", "-0.4*v - x*(-1 + 0.1*x**2)"], [["0"], ["1"]], [[0.8]])


def gaussian(mean, cov, spacing, radius=5.0, factor=None):
    """Gaussian on the nodes of a lattice that is regular in whitened coordinates."""
    mean, n = np.asarray(mean, dtype=float), len(mean)
    axis = np.arange(-int(radius / spacing), int(radius / spacing) + 1) * spacing
    z = np.stack(np.meshgrid(*[axis] * n, indexing="ij"), axis=-1).reshape(-1, n)
    z = z[(z**2).sum(axis=1) < radius**2]
    L = np.linalg.cholesky(cov) if factor is None else factor
    log_density = stats.multivariate_normal(np.zeros(n), np.eye(n)).logpdf(z) - np.linalg.slogdet(L)[1]
    h = np.full(len(z), 3.5 * spacing * abs(np.linalg.det(L)) ** (1 / n))
    mass = np.exp(log_density - log_density.max())
    return sf.ParticleDensity(x=mean + z @ L.T, mass=mass, h=h, log_density=log_density)


def errors(density, mean, cov):
    """Errors of mean and covariance in units of the reference's own spread."""
    return off(density.mean(), density.cov(), mean, cov)


def random_linear(n, rng):
    A = 0.5 * rng.normal(size=(n, n)) - 0.6 * np.eye(n)
    return sf.LinearSDE(A=A, b=rng.normal(size=n), noise=0.4 * rng.normal(size=(n, max(1, n - 1))))


# --- the scheme ---


@pytest.mark.parametrize(
    ("n", "spacing", "radius"), [(1, 0.2, 5.0), (2, 0.7, 5.0), (3, 0.9, 4.5), (4, 1.1, 4.0)]
)
def test_linear_problems_in_one_to_four_dimensions(n, spacing, radius):
    """Moments are exact but for the steps' error, whatever noise and coupling; log-densities nearly so."""
    rng = np.random.default_rng(n)
    model = random_linear(n, rng)
    root = rng.normal(size=(n, n)) + 2 * np.eye(n)
    start = gaussian(rng.normal(size=n), root @ root.T, spacing, radius)
    density, info = propagate(start, model, 1.0, CorrectedScheme())
    Phi, offset, Qd = model.discretize(1.0)
    mean, cov = Phi @ start.mean() + offset, Phi @ start.cov() @ Phi.T + Qd
    mean_error, cov_error = errors(density, mean, cov)
    assert mean_error < 1e-6
    assert cov_error < 5e-4
    exact = stats.multivariate_normal(mean, cov).logpdf(density.x)
    assert np.sqrt(density.mass @ (density.log_density - exact) ** 2) < 0.06
    assert info.scheme == "corrected"
    assert info.n_evaluations < 60


def test_moment_errors_fall_with_the_tolerance():
    start = gaussian([5.0, 5.0], np.eye(2) / 9, 0.7)
    Phi, offset, Qd = OSCILLATOR.discretize(2.0)
    mean, cov = Phi @ start.mean() + offset, Phi @ start.cov() @ Phi.T + Qd
    found = []
    for tol in (1e-3, 1e-5):
        density, info = propagate(start, OSCILLATOR, 2.0, CorrectedScheme(tol=tol))
        found.append((errors(density, mean, cov)[1], info.n_steps))
    assert found[1][0] < 0.1 * found[0][0]
    assert found[1][1] < 10 * found[0][1]


def test_log_density_converges_in_the_spacing():
    errors_found = []
    for spacing in (1.0, 0.5):
        start = gaussian([5.0, 5.0], np.eye(2) / 9, spacing)
        density, _ = propagate(start, OSCILLATOR, 2.0, CorrectedScheme())
        Phi, offset, Qd = OSCILLATOR.discretize(2.0)
        exact = stats.multivariate_normal(Phi @ [5.0, 5.0] + offset, Phi @ Phi.T / 9 + Qd).logpdf(density.x)
        errors_found.append(np.sqrt(density.mass @ (density.log_density - exact) ** 2))
    assert errors_found[1] < 0.4 * errors_found[0]
    assert errors_found[1] < 0.02


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_multiplicative_noise_has_exact_moments(degree):
    """dX = a X dt + s X dW: E[X^k] grows as exp((k a + k (k-1) s²/2) t), exactly for k <= degree + 1."""
    a, s, t = 0.1, 0.3, 0.5
    model = sf.SDE.from_expressions(["x"], ["a*x"], [["s*x"]], [[1.0]], {"a": a, "s": s})
    start = gaussian([1.0], [[0.01]], 0.1)
    density, _ = propagate(start, model, t, CorrectedScheme(degree=degree, tol=1e-6))
    for k in range(1, degree + 2):
        growth = np.exp((k * a + k * (k - 1) * s**2 / 2) * t)
        assert density.moment([k]) == pytest.approx(start.moment([k]) * growth, rel=1e-5)


def test_noise_whose_range_turns_with_the_state():
    """g(x) is x turned by a right angle: div D is not zero, and second moments obey dE[x x']/dt = 2 E[D]."""
    model = sf.SDE.from_expressions(["x", "y"], ["0", "0"], [["-y"], ["x"]], [[0.3]])
    start = gaussian([1.0, 0.5], [[0.2, 0.05], [0.05, 0.1]], 0.5)
    density, _ = propagate(start, model, 0.5, CorrectedScheme(tol=1e-6))
    second = lambda p: (p.x * p.mass[:, None]).T @ p.x  # noqa: E731
    S0 = second(start)
    trace, off = np.trace(S0), S0[0, 1]
    # d/dt E[x²] = q E[y²], d/dt E[y²] = q E[x²], d/dt E[xy] = -q E[xy]
    assert np.trace(second(density)) == pytest.approx(trace * np.exp(0.15), rel=1e-6)
    assert second(density)[0, 1] == pytest.approx(off * np.exp(-0.15), rel=1e-6)
    assert density.mean() == pytest.approx(start.mean(), abs=1e-9)


def test_time_dependent_noise_and_drift():
    model = sf.SDE.from_expressions(["x"], ["cos(t)"], [["sqrt(1 + t)"]], [[1.0]])
    start = gaussian([0.0], [[1.0]], 0.2)
    density, _ = propagate(start, model, 1.0, CorrectedScheme())
    assert density.mean()[0] == pytest.approx(np.sin(1.0), abs=1e-6)
    assert density.cov()[0, 0] == pytest.approx(start.cov()[0, 0] + 1.5, rel=1e-4)


def test_a_switch_is_not_stepped_over():
    model = sf.SDE.from_expressions(["x"], ["0"], [["where(t > 5, 2, 0)"]], [[1.0]])
    start = gaussian([1.0], [[1.0]], 0.2)
    density, _ = propagate(start, model, 10.0, CorrectedScheme())
    assert density.cov()[0, 0] == pytest.approx(start.cov()[0, 0] + 20.0, rel=0.03)


def test_without_noise_particles_follow_the_drift():
    model = sf.LinearSDE(A=OSCILLATOR.A)
    start = gaussian([5.0, 5.0], np.eye(2) / 9, 0.7)
    density, info = propagate(start, model, 2.0, CorrectedScheme(tol=1e-6))
    assert density.x == pytest.approx(start.x @ model.discretize(2.0)[0].T, abs=1e-4)
    assert (info.n_evaluations, info.n_searches) == (0, 0)
    assert density.log_density == pytest.approx(start.log_density + 0.2, abs=1e-3)  # minus the trace of A t


def test_affine_change_of_the_state():
    """y = B x + c is the same problem: positions agree to rounding, log-densities differ by log |det B|."""
    B, c = np.array([[20.0, 3.0], [-0.1, 0.05]]), np.array([100.0, -4.0])
    back = np.linalg.inv(B)
    f = lambda X: np.column_stack([X[:, 1], -0.4 * X[:, 1] + X[:, 0] - 0.1 * X[:, 0] ** 3])  # noqa: E731
    here = sf.SDE(
        drift=lambda X, t: f(X), dim=2, noise=[[0.0], [1.0]], spectral_density=[[0.8]], vectorized=True
    )
    there = sf.SDE(drift=lambda Y, t: f((Y - c) @ back.T) @ B.T, dim=2, noise=B @ [[0.0], [1.0]],
                   spectral_density=[[0.8]], vectorized=True)  # fmt: skip
    L = np.eye(2) / 2
    one, _ = propagate(gaussian([0.0, 10.0], None, 0.7, factor=L), here, 1.0, CorrectedScheme())
    two, _ = propagate(gaussian(B @ [0.0, 10.0] + c, None, 0.7, factor=B @ L), there, 1.0, CorrectedScheme())
    assert (two.x - c) @ back.T == pytest.approx(one.x, abs=1e-6)
    assert two.log_density == pytest.approx(one.log_density - np.log(abs(np.linalg.det(B))), abs=1e-5)


def test_same_input_same_bits_and_particles_in_any_order():
    start = gaussian([0.0, 10.0], np.eye(2) / 4, 0.8)
    runs = [propagate(start, DUFFING, 0.5, CorrectedScheme())[0] for _ in range(2)]
    np.testing.assert_array_equal(runs[0].x, runs[1].x)
    np.testing.assert_array_equal(runs[0].log_density, runs[1].log_density)
    order = np.random.default_rng(0).permutation(start.n_particles)
    shuffled = sf.ParticleDensity(x=start.x[order], mass=start.mass[order], h=start.h[order])
    mixed, _ = propagate(shuffled, DUFFING, 0.5, CorrectedScheme())
    assert mixed.x == pytest.approx(runs[0].x[order], abs=1e-7)


def test_result_does_not_depend_on_how_the_interval_is_cut():
    start = gaussian([0.0, 10.0], np.eye(2) / 4, 0.7)
    once, _ = propagate(start, DUFFING, 1.0, CorrectedScheme())
    often = start
    for t in (0.25, 0.5, 0.75, 1.0):
        often, _ = propagate(often, DUFFING, t, CorrectedScheme())
    assert errors(often, once.mean(), once.cov()) == pytest.approx((0.0, 0.0), abs=2e-3)
    assert np.sqrt(once.mass @ (often.log_density - once.log_density) ** 2) < 0.01


def test_duffing_against_the_grid():
    """A folding case of 002, two hundred particles: the covariance of plain SPH is wrong by a fifth."""
    from reference_filters.grid import GridFilter

    grid = GridFilter(DUFFING, None, [0.0, 10.0], np.eye(2) / 4, size=128, tol=1e-3)
    grid.predict(3.0)
    start = gaussian([0.0, 10.0], np.eye(2) / 4, 0.63)
    assert start.n_particles < 210
    found = {}
    for degree in (0, 1, 3, 4):
        density, _ = propagate(start, DUFFING, 3.0, CorrectedScheme(degree=degree))
        found[degree] = errors(density, grid.x, grid.P)
    assert found[0][1] > 0.1 > 0.05 > found[1][1]
    assert found[3][1] < 5e-3
    assert found[4][1] < 2e-3
    assert found[4][0] < 1e-3


def test_diffusion_velocity_of_each_particle_is_that_of_the_density():
    """Heat flow: an Ornstein-Uhlenbeck process at rest does not move any of its particles much."""
    model = sf.LinearSDE(A=-np.eye(2), noise=np.sqrt(2.0) * np.eye(2))
    start = gaussian([0.0, 0.0], np.eye(2), 0.4)
    density, _ = propagate(start, model, 2.0, CorrectedScheme())
    core = np.linalg.norm(start.x, axis=1) < 2.0
    assert np.abs(density.x - start.x)[core].max() < 0.05
    assert density.cov() == pytest.approx(start.cov(), abs=2e-4)


def test_mixed_clouds_are_read_from_their_kernels():
    """Two wells for ten seconds: mass over volume is then worse than the kernels, and not used."""
    from reference_filters.grid import GridFilter

    model = sf.SDE.from_expressions(["x", "v"], ["v", "-0.2*v + x - x**3"], [["0"], ["1"]], [[0.4]])
    grid = GridFilter(model, None, [0.0, 0.0], 0.1 * np.eye(2), size=96, tol=2e-3)
    grid.predict(10.0)
    density, info = propagate(gaussian([0.0, 0.0], 0.1 * np.eye(2), 0.4), model, 10.0, CorrectedScheme())
    p = grid.density
    exact = np.log(np.maximum(p.interpolated(density.x, p.coefficients(np.zeros((2, 2)))), 1e-12))
    assert "mixed" in info.status
    assert np.sqrt(density.mass @ (density.log_density - exact) ** 2) < 0.35
    assert errors(density, grid.x, grid.P)[1] < 0.05


def test_one_heavy_particle_is_survived():
    """A posterior of one particle but for its tails: polynomials of high degree would throw those far off."""
    start = gaussian([0.0, 10.0], np.eye(2) / 4, 0.7)
    mass = start.mass.copy()
    mass[np.argmax(mass)] = 2.0
    spike = sf.ParticleDensity(x=start.x, mass=mass, h=start.h)
    density, info = propagate(spike, DUFFING, 2.0, CorrectedScheme())
    assert info.n_steps < 500
    assert np.abs(density.x - density.mean()).max() < 50


# --- failures ---


def test_blow_up_says_when_and_where():
    model = sf.SDE.from_expressions(["x"], ["x**3"], [["1"]], [[0.1]])
    with pytest.raises(sf.PropagationError, match=r"blew up at t = .*x = "):
        propagate(gaussian([1.0], [[0.1]], 0.3), model, 10.0, CorrectedScheme())


def test_undefined_drift_is_named_as_such():
    model = sf.SDE.from_expressions(["x"], ["sqrt(0.5 - t)"], [["1"]], [[0.1]])
    with pytest.raises(sf.PropagationError, match="NaN or infinite"):
        propagate(gaussian([1.0], [[0.1]], 0.3), model, 1.0, CorrectedScheme())


def test_a_cloud_without_volume_is_refused():
    x = np.column_stack([np.arange(20.0), np.arange(20.0)])
    flat = sf.ParticleDensity(x=x, mass=np.ones(20), h=np.ones(20))
    with pytest.raises(sf.PropagationError, match="singular to rounding"):
        propagate(flat, OSCILLATOR, 1.0, CorrectedScheme())


def test_too_many_steps_end_in_a_sentence():
    with pytest.raises(sf.PropagationError, match=r"too many steps.*max_steps \(now 200\)"):
        propagate(gaussian([5.0, 5.0], np.eye(2), 0.8), OSCILLATOR, 100.0, CorrectedScheme(max_steps=200))


def test_an_error_of_a_black_box_surfaces_as_itself():
    def drift(X, t):
        if t > 0.2:
            raise KeyError("table ends here")
        return -X

    model = sf.SDE(drift=drift, dim=1, noise=[[1.0]], vectorized=True)
    with pytest.raises(KeyError, match="table ends here"):
        propagate(gaussian([1.0], [[0.1]], 0.3), model, 1.0, CorrectedScheme())


@pytest.mark.parametrize("changes", [{"degree": 7}, {"tol": 0.0}, {"kernel": "cosine"}, {"suport": 3.0}])
def test_settings_are_checked(changes):
    with pytest.raises(sf.ConfigError, match=next(iter(changes))):
        CorrectedScheme(**changes)
