"""SPH kernels W(r, h) = C_n h^-n W1(r/h) in any dimension n, zero beyond the support radius K h.

The one-dimensional shapes W1 are those of 002 (23)-(24) and 000 (73)-(78), and the Wendland functions.
Their constants are found by quadrature for every n (000 (86)-(89)), so that the Gaussian, which is cut
at K = 3, integrates to one; 002 (27) leaves the constant of the uncut Gaussian (1.2e-4 short in 2-D).
"""

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from .._jit import jit

#: Kernel names; the position of a name is its integer code in compiled functions.
KINDS = ("gaussian", "lucy", "cubic", "wendland_c2", "wendland_c4")
GAUSSIAN, LUCY, CUBIC, WENDLAND_C2, WENDLAND_C4 = range(5)

#: Support radius K of each kernel, in units of h: 002 (23)-(24), 000 (73)-(78); beyond it they are zero.
RADIUS = np.array([3.0, 1.0, 2.0, 1.0, 1.0])


@jit
def shape(kind, q):
    """W1(q), zero beyond the support."""
    if kind == GAUSSIAN:
        return math.exp(-q * q) if q < 3.0 else 0.0
    if kind == CUBIC:
        if q < 1.0:
            return 1.0 - 1.5 * q * q + 0.75 * q * q * q
        return 0.25 * (2.0 - q) ** 3 if q < 2.0 else 0.0
    s = max(1.0 - q, 0.0)  # not a branch: which pairs lie within the support is hard to predict
    if kind == LUCY:
        return (1.0 + 3.0 * q) * s * s * s
    if kind == WENDLAND_C2:
        return s**4 * (1.0 + 4.0 * q)
    return s**6 * (1.0 + 6.0 * q + 35.0 / 3.0 * q * q)


@jit
def slope(kind, q):
    """W1'(q)/q, finite at q = 0: the gradient of W is C_n h^-(n+2) slope(q) (x - x_j)."""
    if kind == GAUSSIAN:
        return -2.0 * math.exp(-q * q) if q < 3.0 else 0.0
    if kind == CUBIC:
        if q < 1.0:
            return -3.0 + 2.25 * q
        return -0.75 * (2.0 - q) ** 2 / q if q < 2.0 else 0.0
    s = max(1.0 - q, 0.0)
    if kind == LUCY:
        return -12.0 * s * s
    if kind == WENDLAND_C2:
        return -20.0 * s * s * s
    return -56.0 / 3.0 * (1.0 + 5.0 * q) * s**5


def _radial_moment(kind, power):
    """Integral of W1(q) q^power over the support, by Gauss-Legendre panels that end at each knot."""
    nodes, weights = np.polynomial.legendre.leggauss(32)
    total = 0.0
    for a in np.arange(RADIUS[kind]):
        q = a + 0.5 * (nodes + 1.0)
        total += 0.5 * sum(w * shape(kind, qk) * qk**power for qk, w in zip(q, weights, strict=True))
    return total


@cache
def normalisation(kind, n):
    """C_n of 000 (86)-(89): with it W integrates to one in n dimensions."""
    return float(math.gamma(n / 2) / (2.0 * math.pi ** (n / 2) * _radial_moment(kind, n - 1)))


@cache
def kernel_variance(kind, n):
    """c_K: the variance of the kernel along each axis is c_K h^2."""
    return float(_radial_moment(kind, n + 1) / (n * _radial_moment(kind, n - 1)))


class Kernel(NamedTuple):
    """A kernel in n dimensions, in numbers; compiled sums take its `pair`."""

    kind: int  # its place in `KINDS`
    constant: float  # C_n
    radius: float  # K, in units of h
    variance: float  # c_K, in units of h^2 along each axis

    @classmethod
    def of(cls, name: str, n: int) -> "Kernel":
        """The kernel of a name."""
        kind = KINDS.index(name)
        return cls(kind, normalisation(kind, n), float(RADIUS[kind]), kernel_variance(kind, n))

    @property
    def pair(self) -> tuple[int, float]:
        """Code and constant."""
        return self.kind, self.constant
