"""Kernel sums against direct double sums in numpy."""

import numpy as np
import pytest

from sphfilter.core.sph import kernels, neighbors, summation

KIND_NAMES = kernels.KINDS


def particles(N, n, seed=0):
    rng = np.random.default_rng(seed)
    x, m, h = rng.normal(size=(N, n)), rng.uniform(0.5, 1.5, N), rng.uniform(0.3, 0.6, N)
    return x, m / m.sum(), h


def direct(y, x, m, h, kind):
    """W of every particle at every point with the particle's own h, and its gradient."""
    n = x.shape[1]
    C = kernels.normalisation(kind, n)
    d = y[:, None] - x[None]
    q = np.linalg.norm(d, axis=2) / h
    W = C / h**n * np.vectorize(lambda u: kernels.shape(kind, u))(q)
    G = (C / h ** (n + 2) * np.vectorize(lambda u: kernels.slope(kind, u))(q))[..., None] * d
    return W, G


@pytest.mark.parametrize("kind", range(len(KIND_NAMES)))
@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_averaged_density_and_gradient(kind, n):
    x, m, h = particles(60, n)
    h = h / kernels.RADIUS[kind] * 2.0
    support = kernels.RADIUS[kind] * h
    lists = neighbors.neighbor_lists(x, support, support.copy(), 3, neighbors.build_index(x, 1.0, 0))
    rho, grad, r = np.empty(60), np.empty((60, n)), np.empty(lists[1].size)
    summation.density_and_gradient(x, m, h, lists, (kind, kernels.normalisation(kind, n)), rho, grad, r)
    W, G = direct(x, x, m, h, kind)
    averaged = 0.5 * (W + W.T)
    averaged_gradient = 0.5 * (G - G.transpose(1, 0, 2))
    assert rho == pytest.approx(averaged @ m, rel=1e-12)
    assert grad == pytest.approx(np.einsum("ijd,j->id", averaged_gradient, m), abs=1e-11)


@pytest.mark.parametrize("n", [1, 2, 4])
def test_density_at_points_uses_each_particles_own_h(n):
    x, m, h = particles(80, n)
    y = np.random.default_rng(5).normal(size=(40, n))
    out = np.empty(40)
    index = neighbors.build_index(x, 0.5, neighbors.METHODS.index("tree"))
    kernel = (1, kernels.normalisation(1, n))
    summation.sample_density(y, x, m, h, index, kernel, out)
    assert out == pytest.approx(direct(y, x, m, h, 1)[0] @ m, rel=1e-12, abs=1e-15)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_deposit_on_a_lattice_is_the_density_at_its_nodes(n):
    x, m, h = particles(50, n)
    dims = np.array([7, 6, 5][:n])
    origin, spacing = np.full(n, -1.5), np.array([0.5, 0.6, 0.7][:n])
    nodes = origin + np.indices(dims).reshape(n, -1).T * spacing
    out = np.empty(len(nodes))
    summation.deposit(origin, spacing, dims, x, m, h, (0, kernels.normalisation(0, n)), out)
    assert out == pytest.approx(direct(nodes, x, m, h, 0)[0] @ m, rel=1e-12, abs=1e-15)


def test_mixture_conserves_mass():
    """Each kernel integrates to one, so the mixture does: a fine lattice sum shows it."""
    x, m, h = particles(100, 2)
    dims, spacing = np.array([400, 400]), np.array([0.025, 0.025])
    out = np.empty(160_000)
    summation.deposit(np.full(2, -5.0), spacing, dims, x, m, h, (1, kernels.normalisation(1, 2)), out)
    assert out.sum() * 0.025**2 == pytest.approx(1.0, rel=1e-5)


def test_serial_and_parallel_sums_are_the_same_bits():
    x, m, h = particles(500, 2)
    lists = neighbors.neighbor_lists(x, h, h.copy(), 0, neighbors.build_index(x, 0.5, 1))
    results = []
    for sums in (summation.density_and_gradient, summation.density_and_gradient_parallel):
        rho, grad, r = np.empty(500), np.empty((500, 2)), np.empty(lists[1].size)
        sums(x, m, h, lists, (1, kernels.normalisation(1, 2)), rho, grad, r)
        results.append((rho, grad, r))
    for a, b in zip(*results, strict=True):
        np.testing.assert_array_equal(a, b)
