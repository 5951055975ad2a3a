"""Lattices, trimming, buffer, masses and the initial smoothing length."""

import numpy as np
import pytest
from density_cases import whitened
from scipy import stats

import sphfilter as sf
from sphfilter import consistency
from sphfilter.lattice.regular import Lattice, collocation_masses, fit_support, heaviest, place_gaussian

PAPER = sf.SolverConfig.paper()


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_lattice_stays_within_the_bound_and_near_it(n):
    scheme = sf.PaperScheme()
    bound = {1: 50, 2: 200, 3: 800, 4: 3000}[n]
    place = place_gaussian(np.zeros(n), np.eye(n), bound, scheme)
    assert 0.8 * bound <= place.kept.sum() <= bound
    assert 0 < place.core.sum() < place.kept.sum()


def test_ellipsoid_and_buffer_are_those_of_002():
    """(39) and (42): the core ends at Z_T, the buffer round(Lambda k_R) layers farther out."""
    scheme = sf.PaperScheme(buffer_ratio=1.5, support_range=(2.6, 2.6))
    place = place_gaussian(np.zeros(2), np.eye(2), 1245, scheme)
    nodes, dx = place.lattice.nodes, place.lattice.spacing[0]
    radius = np.linalg.norm(nodes, axis=1)
    z_core = np.sqrt(stats.chi2.ppf(0.995, 2))
    assert radius[place.core].max() < z_core <= radius[place.core].max() + dx
    assert radius[place.kept].max() < z_core + 4 * dx <= radius[place.kept].max() + dx


def test_correlated_gaussian_is_trimmed_along_its_own_axes():
    cov = np.array([[1.0, 0.95], [0.95, 1.0]])
    place = place_gaussian(np.zeros(2), cov, 400, sf.PaperScheme(buffer_ratio=0.0))
    nodes = place.lattice.nodes[place.kept]
    assert np.max(consistency.distance(nodes, np.zeros(2), cov)) ** 2 < stats.chi2.ppf(0.995, 2)
    assert np.corrcoef(nodes.T)[0, 1] > 0.8


def test_anisotropy_widens_the_spacing_of_long_axes():
    cov = np.diag([100.0, 1.0])
    square = place_gaussian(np.zeros(2), cov, 300, sf.PaperScheme()).lattice
    stretched = place_gaussian(np.zeros(2), cov, 300, sf.PaperScheme(anisotropy=4.0)).lattice
    assert square.spacing[0] == pytest.approx(square.spacing[1])
    assert stretched.spacing[0] == pytest.approx(4.0 * stretched.spacing[1])


def test_points_carry_the_covariance_up_to_the_cut():
    """A cut at Z scales the covariance by F_{n+2}(Z²)/F_n(Z²)."""
    config = sf.SolverConfig.paper(buffer_ratio=0.0)
    density = sf.initialize(sf.Gaussian(np.zeros(2), np.eye(2)), 2000, config)
    z2 = stats.chi2.ppf(0.995, 2)
    factor = stats.chi2.cdf(z2, 4) / stats.chi2.cdf(z2, 2)
    assert np.diag(density.cov()) == pytest.approx([factor, factor], rel=2e-3)
    assert density.represented_mass == pytest.approx(0.995, abs=1e-3)


def test_support_sweep_finds_its_minimum():
    lattice = Lattice(np.full(2, -4.0), np.full(2, 0.4), np.array([21, 21]))
    gaussian = sf.Gaussian(np.zeros(2), np.eye(2))
    values, between = gaussian.pdf(lattice.nodes), gaussian.pdf(lattice.half_shifted().nodes)
    everywhere = np.ones(len(values), bool), np.ones(len(between), bool)
    scheme = sf.PaperScheme(support_range=(1.2, 4.0), support_steps=15)
    fit = fit_support(lattice, values * lattice.cell_volume, values, between, *everywhere, scheme)
    best = np.argmin(fit.error)
    assert 0 < best < 14
    assert fit.h == pytest.approx(fit.support[best] * 0.4)
    combined = (fit.error_particles**2 * 441 + fit.error_interstitial**2 * 400) / 841
    assert fit.error == pytest.approx(np.sqrt(combined))


@pytest.mark.parametrize("kernel", ["lucy", "gaussian", "wendland_c2"])
def test_collocation_reproduces_the_density_at_the_particles(kernel):
    config = sf.SolverConfig.paper(kernel=kernel, buffer_ratio=0.5, masses="collocation")
    gaussian = sf.Gaussian([0.0, 0.0], np.eye(2))
    density = sf.initialize(gaussian, 500, config)
    inner = np.linalg.norm(density.x, axis=1) < 2.0
    assert density.pdf(density.x[inner]) == pytest.approx(gaussian.pdf(density.x[inner]), rel=0.02)
    plain = sf.initialize(gaussian, 500, sf.SolverConfig.paper(kernel=kernel, buffer_ratio=0.5))
    worst = np.abs(plain.pdf(density.x[inner]) / gaussian.pdf(density.x[inner]) - 1).max()
    assert worst > 0.02  # so that the line above can fail


def test_best_support_of_the_paper():
    """A standard normal density of two states on 1649 particles (002 Fig 10)."""
    scheme = sf.SolverConfig.paper(kernel="gaussian", support_steps=9).scheme
    normal = sf.Gaussian([0.0, 0.0], np.eye(2))
    place = place_gaussian(normal.mean, normal.cov, 1649, scheme)
    lattice, core = place.lattice, place.core
    target, between = (normal.pdf(grid.nodes) for grid in (lattice, lattice.half_shifted()))
    mass = target * place.kept * lattice.cell_volume
    fit = fit_support(lattice, mass, target, between, core, between >= target[core].min(), scheme)
    assert fit.support[np.argmin(fit.error)] == pytest.approx(2.6)
    # both grids together lie between the two, whatever the numbers of their nodes
    low, high = np.sort([fit.error_particles, fit.error_interstitial], axis=0)
    assert np.all((low <= fit.error) & (fit.error <= high))


def test_collocation_with_negative_masses_is_refused():
    x = np.linspace(-1, 1, 21)[:, None]
    assert collocation_masses(x, 0.25, np.where(np.arange(21) == 10, 1.0, 1e-9), "lucy") is None


def test_heaviest_keeps_equals_together():
    kept = heaviest(np.array([1.0, 3.0, 1.0, 0.0, 3.0]), 0.8)
    np.testing.assert_array_equal(kept, [True, True, True, False, True])
    np.testing.assert_array_equal(heaviest(np.array([1.0, 3.0, 1.0, 3.0]), 0.7), [False, True, False, True])


@pytest.mark.parametrize("config", [sf.SolverConfig(), PAPER], ids=["default", "paper"])
def test_uniform_and_callable(config):
    box = [[0.0, 1.0], [0.0, 2.0]]
    uniform = sf.initialize(sf.Uniform(box), 400, config)
    assert uniform.mean() == pytest.approx([0.5, 1.0])
    assert np.diag(uniform.cov("points")) == pytest.approx([1 / 12, 4 / 12], rel=0.02)

    def ring(X):
        return np.exp(-((np.linalg.norm(X, axis=1) - 2.0) ** 2) / 0.1)

    density = sf.initialize(ring, 500, config, box=[[-4, 4], [-4, 4]], t=3.0)
    assert density.t == 3.0
    assert density.n_particles <= 500
    assert density.pdf([0.0, 0.0])[0] < 0.05 * density.pdf([2.0, 0.0])[0]


def oblique(gap):
    return np.array([[1.0, 1.0 - gap], [1.0 - gap, 1.0]])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: sf.initialize(sf.Gaussian(np.zeros(4), np.eye(4)), 10, PAPER), "too small for 4 states"),
        (lambda: sf.initialize(sf.Gaussian([0, 0], np.diag([1e6, 1e-6])), 200, PAPER), "rescale the states"),
        (lambda: sf.initialize(sf.Gaussian([0, 0], oblique(1e-10)), 200, PAPER), "rotate or rescale"),
        (lambda: sf.initialize(lambda X: np.ones(len(X)), 100), "box"),
        (lambda: sf.initialize(lambda X: np.ones(3), 100, box=[[0, 1]]), "one finite density"),
        (lambda: sf.initialize(lambda X: np.zeros(len(X)), 100, box=[[0, 1]]), "zero everywhere"),
        (lambda: sf.initialize(sf.Uniform([[0, 1]]), 0), "n_particles"),
        (lambda: sf.Uniform([[1, 0]]), "low < high"),
        (lambda: sf.Gaussian([0, 0], np.eye(3)), "cov"),
        (lambda: sf.Gaussian([0, 0], [[1, 2], [2, 1]]), "positive definite"),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(sf.ModelError, match=message):
        call()


@pytest.mark.parametrize("cov", [np.diag([1e6, 1e-6]), oblique(1e-10)], ids=["scales", "oblique"])
def test_whitened_lattices_take_covariances_the_papers_cannot(cov):
    density = sf.initialize(sf.Gaussian([0.0, 0.0], cov), 200)
    assert whitened(density.cov(), cov) == pytest.approx(np.zeros((2, 2)), abs=1e-3)
    assert density.mean() / np.sqrt(np.diag(cov)) == pytest.approx(np.zeros(2), abs=1e-3)
