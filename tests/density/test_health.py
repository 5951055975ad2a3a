"""Health of a cloud: lattices are in order, and each disorder is seen for what it is."""

from dataclasses import replace

import numpy as np
import pytest

import sphfilter as sf

SCHEMES = {"paper": sf.SolverConfig(scheme=sf.PaperScheme(kernel="gaussian")), "default": sf.SolverConfig()}


def lattice(n=2, n_particles=None, scheme="paper", cov=None):
    cov = np.diag(np.linspace(0.5, 1.5, n)) + 0.2 if cov is None else cov
    return sf.initialize(sf.Gaussian(np.arange(n), cov), n_particles or 30 * 4**n, SCHEMES[scheme])


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize(("n", "n_particles"), [(1, 20), (1, 100), (2, 100), (2, 900), (3, 900), (4, 1500)])
def test_a_lattice_of_a_gaussian_is_in_order(n, n_particles, scheme):
    found = sf.health(lattice(n, n_particles, scheme))
    assert found.mixing < 1e-6 and found.rogue == found.rogue_mass == 0.0
    assert found.spacing == pytest.approx(1.0) and found.spreading == pytest.approx(1.0)
    assert found.complaint == "" and found.severity < 0.5


@pytest.mark.parametrize("scheme", SCHEMES)
def test_so_is_one_of_a_density_that_is_bent_and_in_two_pieces(scheme):
    def pdf(X):
        bent = X[:, 1] - 0.5 * X[:, 0] ** 2
        return np.exp(-2.0 * bent**2) * (
            np.exp(-2.0 * (X[:, 0] - 1.5) ** 2) + np.exp(-2.0 * (X[:, 0] + 1.5) ** 2)
        )

    box = [[-4.0, 4.0], [-2.0, 8.0]]
    found = sf.health(sf.initialize(pdf, 600, SCHEMES[scheme], box=box))
    assert found.complaint == "" and found.mixing < 0.05


def test_what_a_smooth_map_leaves_is_in_order():
    before = lattice(2, 600)
    u, v = (before.x - before.mean()).T
    sheared = replace(before, x=np.column_stack([u + v, v + 0.5 * np.sin(u)]))
    found = sf.health(sheared)
    assert found.mixing < 0.02 and found.complaint == "" and found.spacing < 0.9


@pytest.mark.parametrize("a", [0.3, 0.9])
def test_masses_that_alternate_have_mixed_in_proportion(a):
    """On a chessboard of masses smooth polynomials see more than half of what neighbours differ by."""
    before = lattice(2, 900)
    column, row = (np.unique(x.round(9), return_inverse=True)[1] for x in before.x.T)
    found = sf.health(replace(before, mass=before.mass * np.exp(a * (-1.0) ** (row + column))))
    assert found.complaint == "particles have mixed"
    assert 0.5 * a < found.mixing < 0.7 * a


@pytest.mark.parametrize("scheme", SCHEMES)
def test_shuffled_masses_have_mixed(scheme):
    before = lattice(3, 900, scheme)
    mass = np.random.default_rng(1).permutation(before.mass)
    shuffled = replace(before, mass=mass, field=None, moments=None)
    assert sf.health(shuffled).complaint == "particles have mixed"


def test_two_particles_at_a_hundredth_of_the_spacing_have_clumped():
    before = lattice(2, 600)
    x = before.x.copy()
    i, j = np.argsort(((x - before.mean()) ** 2).sum(axis=1))[:2]
    x[j] = x[i] + 0.01 * (x[j] - x[i])
    found = sf.health(replace(before, x=x))
    assert found.complaint == "particles have clumped"
    assert found.spacing == pytest.approx(0.01) and found.mixing < 0.1


def test_particles_far_from_all_others_have_gone_astray():
    before = lattice(2, 600)
    k, N = 60, before.n_particles
    far = before.x.max(axis=0) + before.mean_support * np.column_stack([5 + 3 * np.arange(k), np.zeros(k)])
    mass = np.append(before.mass * (1 - 1e-6), np.full(k, 1e-6 / k))
    away = sf.ParticleDensity(x=np.concatenate([before.x, far]), mass=mass, h=np.full(N + k, before.h[0]))
    found = sf.health(away)
    assert found.complaint == "particles have gone astray"
    assert found.rogue == pytest.approx(k / (N + k)) and found.rogue_mass == pytest.approx(1e-6)
    seen = replace(away, h=np.append(before.h, np.full(k, 1e3)))  # by wide kernels of their own
    assert sf.health(seen).rogue == 0.0


def test_the_effective_number_is_that_of_equal_masses():
    rng = np.random.default_rng(2)
    even = sf.ParticleDensity(x=rng.normal(size=(50, 2)), mass=np.ones(50), h=np.ones(50))
    assert sf.health(even).effective == pytest.approx(50.0)


def disorder(seed=3):
    before = lattice(2, 400)
    rng = np.random.default_rng(seed)
    x = before.x + 0.3 * before.h[:, None] * rng.normal(size=before.x.shape)
    return replace(before, x=x, mass=before.mass * np.exp(0.2 * rng.normal(size=len(x))))


@pytest.mark.parametrize("read_out", ["points", "cloud"])
def test_neither_units_nor_the_order_of_particles_matter(read_out):
    one = replace(disorder(), read_out=read_out)
    order = np.random.default_rng(4).permutation(one.n_particles)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    B = 40.0 * turn if read_out == "points" else np.array([[40.0, 3.0], [0.1, 0.002]])
    grown = abs(np.linalg.det(B)) ** 0.5
    parts = {"x": 7.0 + one.x[order] @ B.T, "mass": one.mass[order], "h": grown * one.h[order]}
    here, there = sf.health(one), sf.health(replace(one, **parts))
    for name in ("mixing", "spacing", "spreading", "rogue", "effective"):
        assert getattr(there, name) == pytest.approx(getattr(here, name), rel=1e-6)


def test_the_seam_of_a_circle_is_no_rim():
    """On a ring of equal particles nothing depends on where the circle was cut."""
    ring, N = [("periodic", 0.0, 1.0)], 40
    x = ((np.arange(N) + np.random.default_rng(5).uniform(0.3, 0.7, N)) / N)[:, None]
    mass = np.exp(np.cos(2 * np.pi * x[:, 0]))
    cloud = sf.ParticleDensity(x=x, mass=mass, h=np.full(N, 0.04), domain=ring)
    turned = replace(cloud, x=(x + 0.4) % 1.0)
    assert sf.health(turned).mixing == pytest.approx(sf.health(cloud).mixing, rel=1e-6)
    assert sf.health(cloud).complaint == ""
    close = replace(cloud, x=np.where(x == x.max(), 1.0 + x.min() - 1e-4, x) % 1.0)  # across the seam
    assert sf.health(close).complaint == "particles have clumped"


def test_a_single_particle_has_no_neighbours_to_compare_with():
    with pytest.raises(sf.ModelError, match="only one"):
        sf.health(sf.ParticleDensity(x=[[0.0]], mass=[1.0], h=[1.0]))
