"""Weighted points as a sum of Gaussian kernels, each as wide as the density about it is."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from .._types import Floats, Ints
from ..core.cloud.kernels import log_sum, log_sum_gradient, seen
from ..core.limits import EDGE
from ..core.sph.kernels import Kernel
from .whitening import framed, least_change

#: Groups of points that have a kernel each; with twice as many, 10,000 points are a tenth better.
_KERNELS = 1024
#: Width of what looks about, over N^(-1/(n + 8)), as `python tests/density/kernel_widths.py` measures it.
_WIDTH = 1.4


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
    """
    found, n = framed(x, mass), x.shape[1]
    if found is None:
        return None
    centre, whole, z, within = found
    one, h = np.eye(n), _WIDTH * np.sum(mass**2) ** (1.0 / (n + 8))
    w, z, C = _grouped(z @ np.linalg.inv(within).T, mass)
    m, S, number = np.empty_like(z), np.empty_like(C), np.empty_like(w)
    seen(w, z, h, m, S, number)
    flat = one - S / h**2  # what groups hide of the points is put back, as far as one sees in them
    hidden = C @ np.linalg.inv(one + C / h**2)
    m, S = m - np.einsum("kab,kbc,kc->ka", flat, hidden, m) / h**2, S + flat @ hidden @ flat
    part = (number / (number + 0.5 * (n + 1)))[:, None, None]
    values, axes = np.linalg.eigh(part * S + (1.0 - part) * h**2 * one)
    A: Any = (axes * np.sqrt(values / h**2)[:, None]) @ axes.transpose(0, 2, 1)
    z = z + np.linalg.solve(one + A, part * m[..., None])[..., 0]
    z, S = z - w @ z, A @ (h**2 * one + C) @ A
    own, wanted = (z * w[:, None]).T @ z + np.einsum("k,kab->ab", w, S), np.linalg.inv(within)
    factor = whole @ within @ least_change(own, wanted @ wanted.T)
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
