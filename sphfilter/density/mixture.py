"""Densities as mixtures of kernels: the kernels as they stand, or what they widen a density by taken back."""

import itertools
import math
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy import special

from .._types import Floats, Ints
from ..core.corrected.moment_correction import Diffusion, Polynomials, correct, exponents
from ..core.sph import kernels
from ..core.sph.neighbors import build_index, choose_method
from ..core.sph.summation import sample_density, sample_density_parallel, sample_gradient

__all__ = ["Mixture", "drawn", "framed", "least_change", "mixture", "narrowed", "raw_moment", "shrunk",
           "silverman", "standing_for"]  # fmt: skip

_PARALLEL_FROM = 10_000_000  # distances of points and particles, about a second's work of one thread
_POINTS_A_TERM = 2  # of the polynomial of slopes
_TRUSTED = 2.0, 3.0  # standard deviations from the mean to which it is, and from which it no longer is


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


def narrowed(mix: Mixture, axes: Sequence[int]) -> float:
    """Smoothing lengths of kernels seen along some axes only, over those along all, for equal widths."""
    rows = mix.factor[axes]
    seen = np.linalg.det(rows @ rows.T) ** (0.5 / len(axes))
    return seen * abs(np.linalg.det(mix.factor)) ** (-1.0 / len(mix.centre))


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
    return radius[:, None] * direction / np.maximum(length, 1e-300)


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
    effective = 1.0 / (mass @ mass)
    return float((4.0 / ((n + 2.0) * effective)) ** (1.0 / (n + 4.0)))


def framed(x: Floats, mass: Floats) -> tuple[Floats, ...] | None:
    """Whitened coordinates z (N, n) of points x = centre + root z; None where their covariance is singular.

    Centre, root, z, the slope of the log-density at z, and the lower root (n, n) of the covariance within
    pieces that lie apart.
    """
    centre = mass @ x
    try:
        root = np.linalg.cholesky(((x - centre) * mass[:, None]).T @ (x - centre))
    except np.linalg.LinAlgError:
        return None
    z = np.ascontiguousarray(np.linalg.solve(root, (x - centre).T).T)
    slope = _slope(z, mass)
    # Inverse of the slopes' second moments: covariance within the pieces, in no direction above the whole's.
    values, axes = np.linalg.eigh((slope * mass[:, None]).T @ slope)
    within = np.linalg.cholesky((axes / np.maximum(values, 1.0)) @ axes.T)
    return centre, *(np.asarray(part, dtype=float) for part in (root, z, slope, within))


def shrunk(x: Floats, mass: Floats, h: Floats, kernel: kernels.Kernel) -> Mixture | None:
    """The mixture with the kernels' own variance taken back, for points that have the density's covariance.

    Kernels of variance s² move what a density carries by -s²/2 times the slope of its logarithm, as heat
    would. Points are moved back along that slope and kernels made smaller by as much: for a Gaussian, points
    x become mu + a (x - mu) and h becomes a h, with a = (1 + s²)^-1/2 in whitened coordinates. Pieces far
    apart shrink each towards its own middle, and kernels are spheres where the covariance within the pieces
    is whitened. What is left of the error is taken out of the covariance: it is that of the points, exactly.

    Parameters
    ----------
    x : ndarray, shape (N, n)
    mass, h : ndarray, shape (N,)
    kernel : Kernel

    Returns
    -------
    Mixture, or None where the points' covariance is singular.

    Notes
    -----
    P. Hall, M. Minnotte, "High order data sharpening for density estimation", J. R. Stat. Soc. B 64 (2002)
    141, with the slope of a polynomial instead of that of the kernels, which know no more of it than of p.
    """
    found, n = framed(x, mass), x.shape[1]
    if found is None:
        return None
    centre, whole, z, slope, within = found
    h = h * (np.prod(np.diag(whole)) * np.prod(np.diag(within))) ** (-1.0 / n)
    variance = kernel.variance * (mass @ h**2)
    a = 1.0 / math.sqrt(1.0 + variance)
    z = np.linalg.solve(within, z.T).T + (1.0 - a) * slope @ within
    z -= mass @ z
    own = (z * mass[:, None]).T @ z + a**2 * variance * np.eye(n)
    wanted = np.linalg.inv(within)
    return mixture(z, mass, a * h, kernel, centre, whole @ within @ least_change(own, wanted @ wanted.T))


def least_change(have: Floats, wanted: Floats) -> Floats:
    """The symmetric matrix that makes one covariance (n, n) another: the least change of the states."""
    root = _root(have)
    inverse = np.linalg.inv(root)
    return inverse @ _root(root @ wanted @ root) @ inverse


def _root(matrix: Floats) -> Floats:
    values, axes = np.linalg.eigh(matrix)
    return (axes * np.sqrt(values)) @ axes.T


def _slope(z: Floats, mass: Floats) -> Floats:
    """Gradient of the log-density (N, n) at whitened points, a polynomial of degree three.

    It is the one for which E[q . grad log p] = -E[div q] holds for polynomials q of that degree: that of a
    Gaussian, or of exp of any polynomial of degree four, exactly. Far from the middle, where a few light
    points would decide, it points inwards at least as steeply as a Gaussian's.
    """
    N, n = z.shape
    points = min(N, 1.0 / np.sum(mass**2))
    degree = max((p for p in (1, 2, 3) if _POINTS_A_TERM * math.comb(n + p, p) <= points), default=1)
    powers, u = exponents(n, degree), np.zeros((N, n))
    polynomials = Polynomials(powers, np.empty((N, len(powers))), np.empty((len(powers), len(powers))))
    diffusion = Diffusion(np.eye(n).reshape(1, -1), np.arange(n), np.eye(n))
    # Arrays like those of a march, for which it is compiled: a density's own masses are read-only.
    correct(np.ascontiguousarray(z), mass.copy(), diffusion, polynomials, u)
    r2 = (z**2).sum(axis=1)
    near, far = _TRUSTED
    doubt = np.clip((np.sqrt(r2) - near) / (far - near), 0.0, 1.0)
    short = np.maximum(r2 - (u * z).sum(axis=1), 0.0) / np.maximum(r2, near**2)
    return -u - (doubt * short)[:, None] * z


def _at(mix: Mixture, z: Floats) -> Floats:
    """Sum of the kernels at z (M, n)."""
    out = np.empty(len(z))
    # Threads only for long sums: a process that has used them cannot be forked.
    sums = sample_density_parallel if len(z) * len(mix.z) > _PARALLEL_FROM else sample_density
    sums(z, mix.z, mix.mass, mix.h, mix.index, mix.kernel.pair, out)
    return out
