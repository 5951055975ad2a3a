"""Log-density between scattered particles: exactness, smoothing, tails, normalisation."""

import numpy as np
import pytest
from scipy import stats

import sphfilter as sf
from sphfilter.density.interpolant import interpolant, normalised


def cloud(N, n, seed=0):
    """A jittered lattice in whitened coordinates, and the factor that whitens it."""
    rng = np.random.default_rng(seed)
    side = round(N ** (1 / n))
    axis = np.linspace(-3.5, 3.5, side)
    z = np.stack(np.meshgrid(*[axis] * n, indexing="ij"), axis=-1).reshape(-1, n)
    z = z + rng.uniform(-0.15, 0.15, z.shape) * (axis[1] - axis[0])
    factor = np.linalg.cholesky(np.eye(n) + 0.5 * np.ones((n, n)))
    return z @ factor.T, factor, rng


def gaussian_log_p(factor):
    return stats.multivariate_normal(np.zeros(len(factor)), factor @ factor.T).logpdf


@pytest.mark.parametrize(("n", "N"), [(1, 40), (2, 400), (3, 1000), (4, 1296)])
def test_logarithm_of_a_gaussian_is_exact_inside_and_outside(n, N):
    x, factor, rng = cloud(N, n)
    exact = gaussian_log_p(factor)
    log_p = interpolant(x, exact(x), factor)
    inside = 0.5 * rng.normal(size=(50, n)) @ factor.T
    assert log_p(inside) == pytest.approx(np.atleast_1d(exact(inside)), abs=1e-5)
    far = 7.0 * factor[:, 0]
    assert log_p(far)[0] == pytest.approx(exact(far), rel=1e-3)


def test_cubics_are_exact_in_two_dimensions():
    x, factor, rng = cloud(400, 2)
    cubic = lambda X: X[:, 0] ** 3 - 2.0 * X[:, 0] * X[:, 1] ** 2 - X[:, 1] ** 2  # noqa: E731
    inside = 0.8 * rng.normal(size=(50, 2)) @ factor.T
    assert interpolant(x, cubic(x), factor)(inside) == pytest.approx(cubic(inside), abs=1e-4)


def test_values_are_continuous_between_particles():
    x, factor, rng = cloud(400, 2)
    log_p = interpolant(x, gaussian_log_p(factor)(x) + 0.1 * rng.normal(size=len(x)), factor)
    line = np.linspace(-1.0, 1.0, 20_001)[:, None] * [1.0, 0.37]
    assert np.abs(np.diff(log_p(line))).max() < 1e-3


def test_what_single_particles_know_wrong_is_averaged_out():
    x, factor, rng = cloud(400, 2)
    exact = gaussian_log_p(factor)
    log_p = interpolant(x, exact(x) + 0.3 * rng.normal(size=len(x)), factor)
    inside = 0.8 * rng.normal(size=(300, 2)) @ factor.T
    assert np.std(log_p(inside) - exact(inside)) < 0.2


def test_nothing_rises_away_from_the_particles():
    x, factor, _ = cloud(100, 2)
    log_p = interpolant(x, x[:, 0], factor)  # rises to the right
    assert log_p([[1e3, 0.0]])[0] <= x[:, 0].max() + 1e-6


def test_few_particles_get_polynomials_they_can_carry():
    x, factor, _ = cloud(9, 2)
    log_p = interpolant(x, 1.0 + x[:, 0], factor)
    assert log_p(x) == pytest.approx(1.0 + x[:, 0], abs=1e-4)


@pytest.mark.parametrize(("n", "N"), [(1, 40), (2, 400), (3, 1728)])
def test_normalised_density_has_an_integral_of_one(n, N):
    """A wrong constant, as left by a bias of the particles' volumes, is found."""
    x, factor, _ = cloud(N, n)
    exact = gaussian_log_p(factor)
    values = exact(x)
    scale = np.linalg.det(factor) ** (1 / n)
    h = np.full(len(x), 3.5 * scale * 7.0 / (round(N ** (1 / n)) - 1))
    density = sf.ParticleDensity(
        x=x, mass=np.exp(values), h=h, kernel="wendland_c2", log_density=values + 0.3
    )
    assert normalised(density)(np.zeros((1, n)))[0] == pytest.approx(exact(np.zeros(n)), abs=0.02)
