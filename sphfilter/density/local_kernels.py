"""Weighted points as a sum of Gaussian kernels, each as wide as the density about it is."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from .._types import Floats, Ints
from ..core.cloud.kernels import log_sum, log_sum_gradient, seen
from ..core.cloud.weights import effective
from ..core.limits import EDGE, GOLDEN, LOOK, OUTLYING, TINY
from ..core.monomials import up_to
from ..core.sph.kernels import Kernel
from .quasi_random import systematic

#: Groups of points that have a kernel each; with twice as many, 10,000 points are a tenth better.
_KERNELS = 1024
#: Width of what looks about, over N^(-1/(n + 8)), as `python tests/density/kernel_widths.py` measures it.
_WIDTH = 1.4
_RIDGE = 1e-10  # of the mean diagonal of the normal matrix: a hundred terms round off 10⁻⁴ _RIDGE = 1e-14
_BLOCK = 4096  # points at a time: of 35 terms, as four states have, 8 · 35 _BLOCK = 1.1 MB


@dataclass(frozen=True)
class LocalKernels:
    """p(x) = sum_j m_j N(z; z_j, R_j R_jᵀ) / det factor, where x = centre + factor z: see `Mixture`."""

    centre: Floats  # (n,)
    factor: Floats  # (n, n)
    z: Floats  # (K, n)
    mass: Floats  # (K,)
    root: Floats  # (K, n, n), lower
    kernel: Kernel

    def pdf(self, X: Floats) -> Floats:
        """Density at the states X (M, n)."""
        return np.exp(self.logpdf(X))

    def logpdf(self, X: Floats) -> Floats:
        """Logarithm of the density at the states X (M, n); finite everywhere."""
        out = np.empty(len(X))
        log_sum(*self._asked(X), out)
        return out

    def gradient(self, X: Floats) -> Floats:
        """Gradient of the density at the states X (M, n), shape (M, n)."""
        out = np.empty(X.shape)
        log_sum_gradient(*self._asked(X), out)
        return np.asarray(np.linalg.solve(self.factor.T, out.T).T, dtype=float)

    def points(self, offsets: Floats, which: Ints) -> Floats:
        """States at an offset (k, n) each from kernels of some numbers (k,), in their smoothing lengths."""
        off = np.einsum("kab,kb->ka", self.root[which], offsets / np.sqrt(self.kernel.variance))
        return self.centre + (self.z[which] + off) @ self.factor.T

    def ends(self) -> tuple[Floats, Floats, Floats]:
        """Lower and upper ends of kernels of one state, and how wide they are; arrays."""
        middle, width = self.centre + self.factor[0] * self.z[:, 0], self.factor[0] * self.root[:, 0, 0]
        return middle - EDGE * width, middle + EDGE * width, width

    def _asked(self, X: Floats) -> tuple[Floats, ...]:
        """Arguments of compiled sums."""
        return np.ascontiguousarray(np.linalg.solve(self.factor, (X - self.centre).T).T), *self._terms

    @cached_property
    def _terms(self) -> tuple[Floats, Floats, Floats]:
        """Terms of every kernel for compiled sums: made once, for questions of one state after the other."""
        P = np.linalg.inv(self.root)
        size = np.linalg.slogdet(P)[1] - np.linalg.slogdet(np.sqrt(2.0 * np.pi) * self.factor)[1]
        middle = np.ascontiguousarray(np.einsum("kab,kb->ak", P, self.z))
        return np.log(self.mass) + size, middle, np.ascontiguousarray(np.moveaxis(P, 0, -1))


def local_kernels(x: Floats, mass: Floats) -> LocalKernels | None:
    """The kernels of points x (N, n), mass (N,), or None where their covariance is singular.

    Under a Gaussian of variance h² about it, a point sees points of mean m, from it, and covariance
    S = h² A². Where the density is a Gaussian's, kernels of covariance S give it back, whatever h, if points
    are moved by (1 + A)^-1 m: as in Liu and West's kernels, but in each place. So what is off is of order h⁴,
    as with a kernel of fourth order; the best h goes as N^(-1/(n + 8)). To the points seen, half of n + 1 are
    added that lie as under a constant density: else an outlier would see itself alone.

    Neighbours share a kernel, which has the covariance A C A of the group besides. What is left of the error
    is taken out of mean and covariance: they are those of the points.

    That h is of one scale. Where pieces are narrower, points that were left out are likelier under narrower
    kernels: h is halved as long as they are.
    """
    found = _whitened(x, mass)
    if found is None:
        return None
    within = _within(found[0], mass)
    return _of_width(*found, mass, within, _narrower(x, mass, within))


def _narrower(x: Floats, mass: Floats, within: Floats) -> float:
    """Part of the usual width, halved as long as points left out are likelier by a standard error."""
    order = np.argsort(GOLDEN * np.arange(len(x)) % 1.0)  # of all parts alike, whatever has put them in order
    chosen, often = np.unique(systematic(mass[order], _KERNELS), return_counts=True)
    halves = ((x[order[chosen[k::2]]], often[k::2] / often[k::2].sum()) for k in (0, 1))
    (some, own), (others, w) = halves
    if min(effective(own), effective(w)) < 0.25 * LOOK or np.isin(others, some).all(axis=1).any():
        return 1.0  # too few to tell, or copies of each other, which no width is too narrow for
    part, found = 1.0, _whitened(some, own)
    usual = None if found is None else _of_width(*found, own, within, 1.0)
    if found is None or usual is None:
        return 1.0
    told = usual.logpdf(others)
    least = told - math.log(len(own))  # one that is far from all others says no more than that
    while (finer := _of_width(*found, own, within, 0.5 * part)) is not None:
        more = np.logaddexp(finer.logpdf(others), least)
        gain = more - told
        if not w @ gain > math.sqrt(w**2 @ (gain - w @ gain) ** 2):
            break
        part, told = 0.5 * part, more
    return part


def _of_width(
    z: Floats, centre: Floats, whole: Floats, mass: Floats, within: Floats, part: float
) -> LocalKernels | None:
    """Kernels of points centre + whole z (N, n), by what is seen within a part of the usual h."""
    n = z.shape[1]
    one, h = np.eye(n), part * _WIDTH * np.sum(mass**2) ** (1.0 / (n + 8))
    w, z, C = _grouped(z @ np.linalg.inv(within).T, mass)
    m, S, number = np.empty_like(z), np.empty_like(C), np.empty_like(w)
    seen(w, z, h, m, S, number)
    flat = one - S / h**2  # what groups hide of the points is put back, as far as one sees in them
    hidden = C @ np.linalg.inv(one + C / h**2)
    m, S = m - np.einsum("kab,kbc,kc->ka", flat, hidden, m) / h**2, S + flat @ hidden @ flat
    known = (number / (number + 0.5 * (n + 1)))[:, None, None]
    values, axes = np.linalg.eigh(known * S + (1.0 - known) * h**2 * one)
    A: Any = (axes * np.sqrt(values / h**2)[:, None]) @ axes.transpose(0, 2, 1)
    z = z + np.linalg.solve(one + A, known * m[..., None])[..., 0]
    z, S = z - w @ z, A @ (h**2 * one + C) @ A
    own, wanted = (z * w[:, None]).T @ z + np.einsum("k,kab->ab", w, S), np.linalg.inv(within)
    factor = whole @ within @ _least_change(own, wanted @ wanted.T)
    try:
        return LocalKernels(centre, factor, z, w, np.linalg.cholesky(S), Kernel.of("gaussian", n))
    except np.linalg.LinAlgError:  # one point has all the weight but for rounding
        return None


def _grouped(z: Floats, mass: Floats) -> tuple[Floats, Floats, Floats]:
    """Masses (K,), means (K, n) and covariances (K, n, n) of groups, each halved across its widest state."""
    N, starts = len(z), np.zeros(1, int)
    while 2 * len(starts) <= _KERNELS and len(starts) < N:
        ends = np.append(starts[1:], N)
        own = np.repeat(np.arange(len(starts)), ends - starts)
        widest = np.argmax(np.maximum.reduceat(z, starts) - np.minimum.reduceat(z, starts), axis=1)
        order = np.lexsort((z[np.arange(N), widest[own]], own))
        z, mass, starts = z[order], mass[order], np.union1d(starts, (starts + ends) // 2)
    own = np.repeat(np.arange(len(starts)), np.diff(starts, append=N))
    w = np.add.reduceat(mass, starts)
    part = mass / w[own]
    mean = np.add.reduceat(part[:, None] * z, starts)
    d = z - mean[own]
    return w, mean, np.add.reduceat(np.einsum("k,ka,kb->kab", part, d, d), starts)


def _whitened(x: Floats, mass: Floats) -> tuple[Floats, Floats, Floats] | None:
    """Coordinates z (N, n), centre and root of points x = centre + root z; None where they are flat."""
    centre = mass @ x
    try:
        root = np.linalg.cholesky(((x - centre) * mass[:, None]).T @ (x - centre))
    except np.linalg.LinAlgError:
        return None
    return np.ascontiguousarray(np.linalg.solve(root, (x - centre).T).T), centre, np.asarray(root, float)


def _within(z: Floats, mass: Floats) -> Floats:
    """Lower root (n, n) of the covariance of whitened points within pieces that lie apart."""
    slope = _slope(z, mass)
    # Inverse of the slopes' second moments: covariance within the pieces, in no direction above the whole's.
    values, axes = np.linalg.eigh((slope * mass[:, None]).T @ slope)
    return np.asarray(np.linalg.cholesky((axes / np.maximum(values, 1.0)) @ axes.T), float)


def _least_change(have: Floats, wanted: Floats) -> Floats:
    """The symmetric matrix that makes one covariance (n, n) another: the least change of the states."""
    root = _root(have)
    inverse = np.linalg.inv(root)
    return inverse @ _root(root @ wanted @ root) @ inverse


def _root(matrix: Floats) -> Floats:
    """Symmetric root of a positive matrix (n, n)."""
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
    degree = max((p for p in (1, 2, 3) if 2 * math.comb(n + p, p) <= points), default=1)  # two for each term
    powers = np.array(up_to(degree, n))
    normal, pull = np.zeros((len(powers), len(powers))), np.zeros((len(powers), n))
    for k in range(0, N, _BLOCK):
        phi, gradients = _hermite(z[k : k + _BLOCK], powers, mass[k : k + _BLOCK])
        normal += (phi * mass[k : k + _BLOCK]) @ phi.T
        pull += gradients
    normal += _RIDGE * np.trace(normal) / len(powers) * np.eye(len(powers))
    c = np.linalg.solve(normal, pull)
    u = np.concatenate([_hermite(z[k : k + _BLOCK], powers)[0].T @ c for k in range(0, N, _BLOCK)])
    r2 = (z**2).sum(axis=1)
    near, far = 2.0, 3.0  # standard deviations to which it is trusted, and from which it no longer is
    doubt = np.clip((np.sqrt(r2) - near) / (far - near), 0.0, 1.0)
    short = np.maximum(r2 - (u * z).sum(axis=1), 0.0) / np.maximum(r2, near**2)
    return -u - (doubt * short)[:, None] * z


def _hermite(z: Floats, powers: Floats, mass: Floats | None = None) -> tuple[Floats, Floats]:
    """Products (q, N) of normalised Hermite polynomials at z (N, n), and the sums (q, n) of their gradients.

    Gradients are summed with masses (N,), where there are any. Beyond `OUTLYING` products are what they are
    on that sphere, which looks the same from all whitened coordinates.
    """
    r = np.maximum(np.linalg.norm(z, axis=1, keepdims=True), TINY)
    scale = np.minimum(1.0, OUTLYING / r)
    y = scale * z
    He = [np.ones_like(y), y]
    for k in range(2, powers.max() + 1):
        He.append((y * He[-1] - math.sqrt(k - 1) * He[-2]) / math.sqrt(k))
    values = np.array(He)  # (degree + 1, N, n)
    axes = range(z.shape[1])
    own = [values[powers[:, d], :, d] for d in axes]
    phi, sums = np.prod(own, axis=0), np.zeros(powers.shape)
    if mass is None:
        return phi, sums
    slopes = [np.sqrt(powers[:, d, None]) * values[np.maximum(powers[:, d] - 1, 0), :, d] for d in axes]
    g = np.stack([np.prod([*own[:d], slopes[d], *own[d + 1 :]], axis=0) for d in axes], axis=-1)
    way = np.where(scale < 1.0, z / r, 0.0)  # outwards, along which nothing changes beyond the sphere
    g = scale * (g - np.einsum("kia,ia->ki", g, way)[..., None] * way)
    return phi, np.einsum("kia,i->ka", g, mass)
