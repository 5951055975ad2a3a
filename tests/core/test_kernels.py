"""Kernels against quadrature, in every dimension they are used in."""

import numpy as np
import pytest
from scipy import integrate, special

from sphfilter.core.sph import kernels

KINDS = range(len(kernels.KINDS))


def sphere(n):
    return 2 * np.pi ** (n / 2) / special.gamma(n / 2)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("n", range(1, 7))
def test_kernel_integrates_to_one_and_has_its_variance(kind, n):
    K, C = kernels.RADIUS[kind], kernels.normalisation(kind, n)
    knots = np.arange(1.0, K)
    points = knots if len(knots) else None
    mass, _ = integrate.quad(lambda q: kernels.shape(kind, q) * q ** (n - 1), 0, K, points=points)
    spread, _ = integrate.quad(lambda q: kernels.shape(kind, q) * q ** (n + 1), 0, K, points=points)
    assert C * sphere(n) * mass == pytest.approx(1.0, rel=1e-9)
    assert C * sphere(n) * spread / n == pytest.approx(kernels.kernel_variance(kind, n), rel=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_slope_is_the_derivative_over_q(kind):
    q = np.linspace(0.05, 0.95, 19) * kernels.RADIUS[kind] + 1e-3
    step = 1e-6
    for qk in q:
        difference = (kernels.shape(kind, qk + step) - kernels.shape(kind, qk - step)) / (2 * step)
        assert kernels.slope(kind, qk) * qk == pytest.approx(difference, abs=1e-7)
    assert np.isfinite(kernels.slope(kind, 0.0))


@pytest.mark.parametrize("kind", KINDS)
def test_kernel_falls_and_is_zero_beyond_its_support(kind):
    q = np.linspace(0, kernels.RADIUS[kind], 50)
    values = np.array([kernels.shape(kind, qk) for qk in q])
    assert np.all(np.diff(values) < 0)
    assert kernels.shape(kind, kernels.RADIUS[kind]) == 0.0
    assert kernels.slope(kind, kernels.RADIUS[kind]) == 0.0


def test_published_constants():
    """000 (86)-(89) and 002 (28); the Gaussian's is that of the cut kernel, not 002 (27)."""
    lucy = kernels.KINDS.index("lucy")
    expected = [5 / 4, 5 / np.pi, 105 / (16 * np.pi), 28 / np.pi**2]
    assert [kernels.normalisation(lucy, n) for n in (1, 2, 3, 4)] == pytest.approx(expected)
    uncut = [np.pi ** (-n / 2) for n in (2, 4, 6)]
    ratios = [kernels.normalisation(0, n) / c - 1 for n, c in zip((2, 4, 6), uncut, strict=True)]
    assert ratios == pytest.approx([1.2e-4, 1.2e-3, 6e-3], rel=0.1)
