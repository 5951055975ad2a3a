"""What moment-corrected SPH is made of: the correction by itself, and its kernel sums."""

import numpy as np
import pytest

from sphfilter.core._records import packed
from sphfilter.core.corrected import blocks, march, moment_correction, number_density, pairs
from sphfilter.core.corrected.moment_correction import Diffusion, Polynomials
from sphfilter.core.sph import kernels

# --- the correction ---


def scattered(n, N=80, seed=0):
    rng = np.random.default_rng(seed)
    m = rng.uniform(0.2, 1.0, N)
    return rng.normal(size=(N, n)), m / m.sum(), rng


def functions(N, powers):
    """The polynomials of a correction of N particles."""
    return Polynomials(powers, np.empty((N, len(powers))), np.empty((len(powers), len(powers))))


def test_exponents_are_ordered_by_degree():
    powers = moment_correction.exponents(2, 3)
    assert powers.sum(axis=1).tolist() == [0, 1, 1, 2, 2, 2, 3, 3, 3, 3]
    assert len({tuple(row) for row in powers}) == 10


@pytest.mark.parametrize("n", [1, 2, 3])
def test_basis_gradients_are_those_of_the_functions(n):
    """Central differences, inside and outside the radius beyond which functions are clipped."""
    powers = moment_correction.exponents(n, 4)
    q = len(powers)
    rng = np.random.default_rng(n)
    for scale in (1.0, 9.0):
        z = rng.normal(size=n)
        z *= scale / np.linalg.norm(z)
        phi, dphi, h = np.empty(q), np.empty((q, n)), np.empty((2, n, 5))

        def at(y, h=h):
            phi, dphi = np.empty(q), np.empty((q, n))
            moment_correction.basis(y[None], 0, powers, h, phi, dphi)
            return phi

        moment_correction.basis(z[None], 0, powers, h, phi, dphi)
        steps = 1e-5 * np.eye(n)
        differences = np.stack([(at(z + e) - at(z - e)) / 2e-5 for e in steps], axis=1)
        assert dphi == pytest.approx(differences, abs=2e-8)


def test_basis_is_orthonormal_for_the_normal_distribution():
    nodes, weights = np.polynomial.hermite_e.hermegauss(12)
    z = np.stack(np.meshgrid(nodes, nodes), axis=-1).reshape(-1, 2)
    w = np.outer(weights, weights).ravel() / (2 * np.pi)
    near = np.linalg.norm(z, axis=1) < 5.0
    powers = moment_correction.exponents(2, 3)
    phi, dphi = np.empty((len(z), 10)), np.empty((10, 2))
    for i in range(len(z)):
        moment_correction.basis(z, i, powers, np.empty((2, 2, 4)), phi[i], dphi)
    assert (phi[near].T * w[near]) @ phi[near] == pytest.approx(np.eye(10), abs=2e-3)  # clipped tails


@pytest.mark.parametrize("varies", [False, True])
def test_moment_equations_hold_after_the_correction(varies):
    """E[q . u] = E[D : grad q] for every polynomial q of the degree, whatever u was."""
    n, rows = 3, np.array([0, 2])
    z, m, rng = scattered(n)
    inverse = np.linalg.inv(np.tril(rng.normal(size=(n, n))) + 3 * np.eye(n))
    root = rng.normal(size=(len(z) if varies else 1, n, 2))
    root[:, 1] = 0.0
    D = np.einsum("iab,icb->iac", root, root).reshape(len(root), -1)
    u = rng.normal(size=(len(z), n))
    u[:, 1] = 0.0
    powers = moment_correction.exponents(n, 2)
    diffusion = Diffusion(D, rows, np.ascontiguousarray(inverse))
    assert moment_correction.correct(z, m, diffusion, functions(len(z), powers), u) == 10
    phi, dphi = np.empty(10), np.empty((10, n))
    defect = np.zeros((10, n))
    for i in range(len(z)):
        moment_correction.basis(z, i, powers, np.empty((2, n, 5)), phi, dphi)
        here = D[i if varies else 0].reshape(n, n)
        defect += m[i] * (phi[:, None] * u[i] - dphi @ inverse @ here.T)
    assert np.abs(defect).max() < 1e-8  # the ridge
    assert np.all(u[:, 1] == 0.0)


def test_oblique_noise_stays_in_its_range():
    """The correction of a constant D of rank one is along its range without being projected."""
    z, m, rng = scattered(2)
    g = np.array([[1.0], [2.0]])
    u = rng.normal(size=(len(z), 1)) @ g.T
    powers = moment_correction.exponents(2, 3)
    D = (g @ g.T).reshape(1, -1)
    diffusion = Diffusion(D, np.array([0, 1]), np.eye(2))
    moment_correction.correct(z, m, diffusion, functions(len(z), powers), u)
    assert u[:, 1] == pytest.approx(2.0 * u[:, 0], abs=1e-9)


def test_degree_falls_where_particles_cannot_tell_polynomials_apart():
    """On a line, products of the two states are not independent of their squares."""
    x = np.linspace(-2, 2, 40)
    z, m, D = np.column_stack([x, x**2]), np.full(40, 1 / 40), np.eye(2).reshape(1, -1)
    powers, u = moment_correction.exponents(2, 2), np.zeros((40, 2))
    diffusion = Diffusion(D, np.array([0, 1]), np.eye(2))
    used = moment_correction.correct(z, m, diffusion, functions(40, powers), u)
    assert used == 3
    assert np.isfinite(u).all()


# --- kernel sums ---


MANY = blocks.PARALLEL_FROM + 7  # particles that threads share


@pytest.mark.parametrize("expected", [1.0, 1e3])
@pytest.mark.parametrize(("n", "N"), [(1, 150), (2, 150), (3, 150), (3, MANY)])
def test_pairs_are_all_found_once(n, N, expected):
    z, _, rng = scattered(n, N)
    reach = rng.uniform(0.3, 0.9, len(z)) * (150 / N) ** (1 / n)
    (order, start, neighbors), nearest = pairs.pair_lists(z, reach, expected)
    rows = np.repeat(order, np.diff(start))
    found = sorted(tuple(sorted(pair)) for pair in zip(rows.tolist(), neighbors.tolist(), strict=True))
    r = np.linalg.norm(z[:, None] - z[None], axis=2)
    i, j = np.nonzero(np.triu(r < np.maximum(reach[:, None], reach[None]), 1))
    assert found == sorted(zip(i.tolist(), j.tolist(), strict=True))
    seen = np.isin(np.arange(len(z)), [k for pair in found for k in pair])
    np.fill_diagonal(r, np.inf)
    within = seen & (r.min(axis=1) < reach.min())
    assert np.array_equal(nearest[within], r.argmin(axis=1)[within])


@pytest.mark.parametrize("kind", [0, 3])
@pytest.mark.parametrize(("n", "N"), [(1, 50), (2, 50), (4, 50), (2, MANY)])
def test_sums_against_direct_ones(kind, n, N):
    z, m, rng = scattered(n, N)
    h = rng.uniform(0.8, 1.2, N) / kernels.RADIUS[kind] * 2.0 * (50 / N) ** (1 / n)
    C, K = kernels.normalisation(kind, n), kernels.RADIUS[kind]
    lists, _ = pairs.pair_lists(z, K * h, 20.0)
    sums = rho, grad, number = number_density.Sums(np.empty(N), np.empty((N, n)), np.empty(N))
    number_density.density_sums(z, m, h, lists, (kind, C), sums)
    mean = 0.5 * (h[:, None] + h[None])
    d = z[:, None] - z[None]
    q = np.linalg.norm(d, axis=2) / mean
    W = C / mean**n * np.vectorize(lambda a: kernels.shape(kind, a))(q)
    G = (C / mean ** (n + 2) * np.vectorize(lambda a: kernels.slope(kind, a))(q))[..., None] * d
    assert rho == pytest.approx(W @ m, rel=1e-12)
    assert number == pytest.approx(W.sum(axis=1), rel=1e-12)
    assert grad == pytest.approx(np.einsum("ijd,j->id", G, m), rel=1e-10, abs=1e-12)


@pytest.mark.parametrize(("guess", "N"), [(0.05, 60), (1.0, 60), (20.0, 60), (1.0, MANY)])
def test_smoothing_lengths_solve_their_equation(guess, N):
    """sum_j W(r_ij, h_i) h_i^n = eta^n, from any start and on clouds of any units."""
    rng = np.random.default_rng(3)
    x = rng.normal(size=(N, 2)) * [1.0, 50.0]
    cloud = march.Cloud(x, np.full(N, 1 / N), np.full(N, guess))
    C = kernels.normalisation(3, 2)
    options = packed(march.Options(3, C, 3.5, 1, 0.07, 1e-4, np.inf, 10))
    assert march.settle(march.parts().search, cloud, options, 1e-8)
    L = np.linalg.cholesky(np.cov(x.T, bias=True))
    z, h = x @ np.linalg.inv(L).T, cloud.h / np.sqrt(np.linalg.det(L))
    r = np.linalg.norm(z[:, None] - z[None], axis=2) / h[:, None]
    total = C * np.vectorize(lambda a: kernels.shape(3, a))(r).sum(axis=1)
    assert total == pytest.approx(np.full(N, 3.5**2), rel=1e-6)
