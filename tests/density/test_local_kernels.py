"""A cloud's density between its points: against grids, and what it says of its own error."""

import pickle

import numpy as np
import pytest
from kernel_widths import clouds_and_grids, distance
from scipy import stats

import sphfilter as sf
from sphfilter.density.cloud import smoothing_length
from sphfilter.density.local_kernels import LocalKernels
from sphfilter.density.moments import moments

CLOUD = sf.FilterConfig(scheme=sf.CloudScheme(n_points=3000))


def cloud(x, mass=None):
    """The density of weighted points."""
    mass = np.full(len(x), 1.0 / len(x)) if mass is None else mass
    h = smoothing_length(mass, moments(x, mass)[1])
    return sf.ParticleDensity(x=x, mass=mass, h=h, kernel="wendland_c2", read_out="cloud")


def test_density_and_its_error_against_grids():
    """The distance at 3,000 points, and what is told of it (three scenes; sixteen more were measured)."""
    left, told = [], []
    for name in ("sharp cycle", "ring", "one state, squared"):
        for (density,), grid in clouds_and_grids(name, (3000,), 2):
            left.append(distance(density, grid))
            told.append(density.pdf_error)
    assert np.mean(left) <= 0.04 and np.max(left) <= 0.1
    ratios = np.array(told) / left
    assert 0.6 < np.median(ratios) < 1.6 and ratios.min() > 0.3 and ratios.max() < 3.0


@pytest.mark.parametrize("n", [1, 2, 4, 6])
def test_gaussian_is_given_back(n):
    """No bias is left where the density is a Gaussian (kernels of one width: .017, .022, .095 and .23)."""
    z = stats.norm.ppf(stats.qmc.Sobol(n, seed=1).random(2048))
    root = np.tril(np.ones((n, n)))
    density, X = cloud(z @ root.T + 3.0), np.random.default_rng(0).standard_normal((2000, n))
    p = np.exp(stats.multivariate_normal(np.zeros(n), np.eye(n)).logpdf(X))
    off = np.sqrt(density.pdf(X @ root.T + 3.0) / p) - 1.0
    assert np.sqrt(0.5 * np.mean(off**2)) < {1: 0.01, 2: 0.015, 4: 0.05, 6: 0.2}[n]


@pytest.mark.parametrize("peaks", [4, 8])
@pytest.mark.parametrize("n", [1, 2])
def test_narrow_peaks_are_as_narrow_as_they_are(peaks, n):
    """Of one scale for all, kernels are .12 to .76 off."""
    z = stats.norm.ppf(stats.qmc.Sobol(n, seed=1).random(2048))
    middle = np.linspace(-2.0, 2.0, peaks)
    rng = np.random.default_rng(0)
    z[:, 0] = 0.02 * z[:, 0] + rng.permutation(np.resize(middle, len(z)))
    density, X = cloud(z), rng.standard_normal((2000, n))
    X[:, 0] = 0.02 * X[:, 0] + np.resize(middle, len(X))
    each = [stats.norm(m, 0.02).pdf(X[:, 0]) for m in middle]
    p = np.mean(each, axis=0) * stats.norm.pdf(X[:, 1:]).prod(axis=1)
    off = np.sqrt(density.pdf(X) / p) - 1.0
    assert np.sqrt(0.5 * np.mean(off**2)) < {1: 0.06, 2: 0.25}[n]


def test_copies_are_no_peaks():
    rng = np.random.default_rng(2)
    once = rng.standard_normal((500, 2))
    one, twice = cloud(once), cloud(np.concatenate([once, once]))
    assert twice.entropy() > one.entropy() - 0.2


def test_moments_gradient_tails_and_bits():
    rng = np.random.default_rng(1)
    x = rng.standard_normal((4000, 2))
    x[:, 1] = 0.3 * x[:, 1] + x[:, 0] ** 2
    mass = np.exp(-rng.random(4000))
    density = cloud(x, mass / mass.sum())
    kernels = density.form.mixture
    S = kernels.root @ kernels.root.transpose(0, 2, 1)
    cov = np.einsum("k,ka,kb->ab", kernels.mass, kernels.z, kernels.z) + np.einsum("k,kab", kernels.mass, S)
    np.testing.assert_allclose(kernels.factor @ cov @ kernels.factor.T, density.cov(), rtol=1e-10)
    np.testing.assert_allclose(density.sample(40_000, 1).mean(axis=0), density.mean(), atol=0.03)
    X, step = x[:50], 1e-4 * np.eye(2)
    slope = [(density.pdf(X + d) - density.pdf(X - d)) / 2e-4 for d in step]
    np.testing.assert_allclose(density.gradient(X), np.transpose(slope), atol=1e-4)
    assert np.isfinite(density.logpdf([[1e6, -1e6]])).all()
    again = pickle.loads(pickle.dumps(density))
    assert np.array_equal(again.logpdf(X), density.logpdf(X))
    assert np.isnan(density.pdf_error)  # nothing tells it


def test_few_equal_and_flat_points():
    rng = np.random.default_rng(2)
    few = rng.standard_normal((20, 3))
    for x in (few, few.repeat(5, axis=0)):
        density = cloud(x)
        assert isinstance(density.form.mixture, LocalKernels) and np.isfinite(density.logpdf(x)).all()
    flat = cloud(np.column_stack([few[:, 0], 2.0 * few[:, 0]]))
    assert not isinstance(flat.form.mixture, LocalKernels) and (flat.pdf(flat.x) > 0.0).all()


@pytest.mark.parametrize("count", [2048, 32_768])
def test_a_heavy_tail_makes_no_other_kernels_wide(count):
    """A lognormal, σ = 1.5: groups of points in its tail spread by more than kernels look about."""
    u = (np.arange(count) + 0.5) / count
    density, p = cloud(np.exp(1.5 * stats.norm.ppf(u))[:, None]), np.array([0.02, 0.1, 0.5, 0.9, 0.99])
    exact = np.exp(1.5 * stats.norm.ppf(p))
    np.testing.assert_allclose(density.quantile(0, p), exact, rtol=0.1, atol=0.04)
    for q, below in zip(exact, p, strict=True):
        assert density.probability(lambda X, q=q: X[:, 0] < q) == pytest.approx(below, abs=0.01)
