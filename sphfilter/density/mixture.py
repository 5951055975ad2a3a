"""Densities as mixtures of kernels."""

import itertools
import math
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy import special

from .._types import Floats, Ints
from ..core.limits import TINY
from ..core.sph import kernels
from ..core.sph.neighbors import build_index, choose_method
from ..core.sph.summation import sample_density, sample_density_parallel, sample_gradient

#: Distances of points and particles. Measured by the clock of `Mixture.pdf`, of 2,000 to 4,000 kernels of one
#: to four states: so many are 2 to 20 ms of one thread.
_PARALLEL_FROM = 10_000_000


class Mixture(NamedTuple):
    """p(x) = sum_j m_j W(z - z_j, h_j) / det factor, with kernels that are spheres in z.

    x = centre + factor z.
    """

    centre: Floats  # (n,)
    factor: Floats  # (n, n)
    z: Floats  # (N, n)
    mass: Floats  # (N,)
    h: Floats  # (N,)
    kernel: kernels.Kernel
    index: Any  # of the search

    def pdf(self, X: Floats) -> Floats:
        """Density at the states X (M, n)."""
        z = np.linalg.solve(self.factor, (X - self.centre).T).T
        return _at(self, np.ascontiguousarray(z)) / abs(np.linalg.det(self.factor))

    def logpdf(self, X: Floats) -> Floats:
        """Logarithm of the density; minus infinity outside of the kernels' supports."""
        with np.errstate(divide="ignore"):
            return np.log(self.pdf(X))

    def gradient(self, X: Floats) -> Floats:
        """Gradient of `pdf` at the states X (M, n), shape (M, n)."""
        z = np.ascontiguousarray(np.linalg.solve(self.factor, (X - self.centre).T).T)
        out = np.empty_like(z)
        sample_gradient(z, self.z, self.mass, self.h, self.index, self.kernel.pair, out)
        return np.linalg.solve(self.factor.T, out.T).T / abs(np.linalg.det(self.factor))

    def points(self, offsets: Floats, which: slice | Ints = slice(None)) -> Floats:
        """States at `offsets` (k, n) from kernels, in their smoothing lengths, shape (N k, n).

        which : a slice of the kernels, or their numbers (k,) for one offset of each.
        """
        z, h = self.z[which], self.h[which]
        if isinstance(which, slice):
            z, h = z[:, None], h[:, None]
        z = (z + h[..., None] * offsets).reshape(-1, z.shape[-1])
        return self.centre + z @ self.factor.T

    def ends(self) -> tuple[Floats, Floats, Floats]:
        """Lower and upper ends of kernels of one state, and how wide they are; arrays."""
        width = self.factor[0, 0] * self.h
        middle, reach = self.centre + self.factor[0, 0] * self.z[:, 0], self.kernel.radius * width
        return middle - reach, middle + reach, width


def mixture(
    x: Floats,
    mass: Floats,
    h: Floats,
    kernel: kernels.Kernel,
    centre: Floats | None = None,
    factor: Floats | None = None,
) -> Mixture:
    """The mixture of kernels of given code and C_n at x (N, n), which are z where there is a factor."""
    n = x.shape[1]
    centre = np.zeros(n) if centre is None else centre
    factor = np.eye(n) if factor is None else factor
    x = np.ascontiguousarray(x)
    index = build_index(x, kernel.radius * np.median(h), choose_method(len(x), n))
    return Mixture(centre, factor, x, mass, h, kernel, index)


@cache
def standing_for(code: int, n: int, count: int) -> Floats:
    """Points (count, n) that stand for the kernel with h = 1: evenly spread, with its mean and covariance."""
    from scipy.stats import qmc  # on use: import time

    uniform = qmc.Sobol(n + 1, scramble=False).random(count)
    X = drawn(code, np.clip(uniform, 0.5 / count, 1 - 0.5 / count))
    X -= X.mean(axis=0)
    root = np.linalg.cholesky(X.T @ X / count)
    return math.sqrt(kernels.kernel_variance(code, n)) * np.linalg.solve(root, X.T).T


def drawn(code: int, uniform: Floats) -> Floats:
    """Map uniform numbers (k, n + 1) to points (k, n) distributed as the kernel with h = 1."""
    n = uniform.shape[1] - 1
    direction = special.ndtri(np.clip(uniform[:, :-1], 1e-15, 1 - 1e-15))
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    q = np.linspace(0.0, kernels.RADIUS[code], 512)
    radial = q ** (n - 1) * np.array([kernels.shape(code, qk) for qk in q])
    cdf = np.concatenate([[0.0], np.cumsum(0.5 * (radial[1:] + radial[:-1]))])
    radius = np.interp(uniform[:, -1], cdf / cdf[-1], q)
    return radius[:, None] * direction / np.maximum(length, TINY)


def raw_moment(mix: Mixture, powers: Sequence[int] | Ints, centre: Floats) -> float:
    """Expectation of prod_d (x_d - centre_d)^powers[d], the factor being one.

    The kernels' own moments are those of a direction times a radius: E[xi^k] = C_n / C_(n+|k|) times the
    moments of the normal distribution with variance 1 / (2 pi), for the integrals of W r^|k| over n
    dimensions are those of W over n + |k|.
    """
    code, constant = mix.kernel.pair
    n, d, total = len(powers), mix.z - centre, 0.0
    for even in itertools.product(*(range(0, int(power) + 1, 2) for power in powers)):
        order = sum(even)
        own = constant / kernels.normalisation(code, n + order) * math.pi ** (-0.5 * order)
        for power, k in zip(powers, even, strict=True):
            own *= math.comb(int(power), k) * math.gamma(0.5 * (k + 1)) / math.sqrt(math.pi)
        total += own * (mix.mass @ (mix.h**order * np.prod(d ** (powers - np.array(even)), axis=1)))
    return float(total)


def silverman(mass: Floats, n: int) -> float:
    """Standard deviation of kernels, in those of the points (N, n): best for the pdf of a Gaussian."""
    effective = 1.0 / float(np.square(mass).sum())  # a product would start threads, which spin for longer
    return float((4.0 / ((n + 2.0) * effective)) ** (1.0 / (n + 4.0)))


def _at(mix: Mixture, z: Floats) -> Floats:
    """Sum of the kernels at z (M, n)."""
    out = np.empty(len(z))
    # Threads only for long sums: a process that has used them cannot be forked.
    sums = sample_density_parallel if len(z) * len(mix.z) > _PARALLEL_FROM else sample_density
    sums(z, mix.z, mix.mass, mix.h, mix.index, mix.kernel.pair, out)
    return out
