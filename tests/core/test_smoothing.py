"""Smoothing lengths: the three rules keep rho h^n, and Newton finds the root where there is one."""

import numpy as np
import pytest

from sphfilter.core._records import packed
from sphfilter.core.domain import unseen
from sphfilter.core.sph import kernels, neighbors, smoothing, summation
from sphfilter.core.sph.state import Cloud, Near, Options, Work

KIND = 1
MODES = smoothing.SMOOTHING


def rule(mode, kind, constant, iterations):
    """Options of a march, of which these matter here."""
    numbers = dict.fromkeys(Options._fields, 0) | {
        "kernel": kind,
        "normalisation": constant,
        "smoothing": MODES.index(mode),
        "smoothing_tolerance": 1e-5,
        "smoothing_iterations": iterations,
    }
    return packed(Options(**numbers))


def squeezed(mode, sweeps=1, factor=0.8, kind=KIND, support=2.6, iterations=30):
    """A lattice in 2-D with equal masses, contracted by `factor`, and its h brought up to date."""
    x = np.ascontiguousarray(np.indices((12, 12)).reshape(2, -1).T, dtype=float)
    N = len(x)
    h = np.full(N, support / kernels.RADIUS[kind])
    cloud = Cloud(x, np.full(N, 1.0 / N), h, np.empty(N), np.empty(N))
    kernel = (kind, kernels.normalisation(kind, 2))
    reach = np.full(N, 8.0)
    lists = neighbors.neighbor_lists(x, reach, reach.copy(), 0, neighbors.build_index(x, 2.0, 0))
    grad, r = np.empty((N, 2)), np.empty(lists[1].size)
    summation.density_and_gradient(x, cloud.m, h, lists, kernel, cloud.rho, grad, r)
    cloud.invariant[:] = cloud.rho * h**2
    h0 = h.copy()
    x *= factor
    failed, settled = 0, np.ones(N, bool)
    none = np.empty((N, 2))
    work = Work(grad, none, np.empty((1, 4)), none, reach.copy(), reach, h0, settled)
    near, options = Near(unseen(x, cloud.m, h), lists, r), rule(mode, *kernel, iterations)
    for _ in range(sweeps):
        summation.density_and_gradient(x, cloud.m, h, lists, kernel, cloud.rho, grad, r)
        failed = smoothing.update_smoothing(summation.DENSITY.address, cloud, near, work, options)
    assert failed == np.sum(~settled)
    return cloud, h0, failed


@pytest.mark.parametrize(("mode", "sweeps"), [("proportional", 60), ("fixed_point", 1), ("newton", 1)])
def test_contraction_scales_h_with_the_lattice(mode, sweeps):
    """h / dx is the same before and after an affine contraction: rho h^n is kept exactly then."""
    cloud, h0, failed = squeezed(mode, sweeps)
    assert failed == 0
    assert cloud.h == pytest.approx(0.8 * h0, rel=1e-5)


def test_fixed_keeps_h():
    cloud, h0, _ = squeezed("fixed")
    np.testing.assert_array_equal(cloud.h, h0)


def test_lagged_update_uses_the_density_of_the_evaluation_before():
    cloud, _, _ = squeezed("proportional", 1)
    expected = np.sqrt(cloud.invariant / cloud.rho)
    assert cloud.h == pytest.approx(expected, rel=1e-12)


def test_newton_keeps_h_and_says_so_where_no_root_exists():
    """A particle so far out that its own kernel would have to fill the sum: the lagged h stays, flagged."""
    cloud, h0, failed = squeezed("newton", 1, factor=20.0, support=1.05)
    assert failed == len(cloud.h)
    np.testing.assert_array_equal(cloud.h, h0)


def test_one_sweep_of_the_fixed_point_goes_half_the_way():
    """000 (112) damped: the geometric mean of h and (rho0 h0^n / rho)^(1/n)."""
    cloud, h0, failed = squeezed("fixed_point", iterations=1)
    before, _, _ = squeezed("fixed")  # whose density is that of the contracted lattice with the old h
    assert cloud.h == pytest.approx(np.sqrt(h0 * np.sqrt(cloud.invariant / before.rho)), rel=1e-12)
    assert failed == len(h0)


@pytest.mark.parametrize(("mode", "few"), [("fixed_point", (1, 2, 4, 8)), ("newton", (1, 2))])
def test_iterations_are_limited_and_come_nearer(mode, few):
    errors = []
    for iterations in (*few, 30):
        cloud, h0, failed = squeezed(mode, iterations=iterations)
        errors.append(np.abs(cloud.h / (0.8 * h0) - 1.0).max())
        assert (failed == 0) == (iterations == 30)
    assert errors == sorted(errors, reverse=True) and errors[0] > 1e-2 > 1e-5 > errors[-1]


@pytest.mark.parametrize("kind", range(len(kernels.KINDS)))
def test_derivative_of_own_density(kind):
    rng = np.random.default_rng(0)
    x, m = rng.normal(size=(30, 3)), np.full(30, 1 / 30)
    reach = np.full(30, 10.0)
    lists = neighbors.neighbor_lists(x, reach, reach.copy(), 0, neighbors.build_index(x, 1.0, 0))
    kernel = (kind, kernels.normalisation(kind, 3))
    rho, grad, r = np.empty(30), np.empty((30, 3)), np.empty(lists[1].size)
    h = 1.3 / kernels.RADIUS[kind]
    summation.density_and_gradient(x, m, np.full(30, h), lists, kernel, rho, grad, r)
    values = [summation.own_density(4, m, hk, lists, r, kernel, 3)[0] for hk in (h - 1e-6, h + 1e-6)]
    _, slope = summation.own_density(4, m, h, lists, r, kernel, 3)
    assert slope == pytest.approx((values[1] - values[0]) / 2e-6, rel=1e-5)
