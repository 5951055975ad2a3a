"""A few Gaussians together: what sharp, bent or two-sided readings leave of one."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.special import logsumexp

from .._types import Bools, Floats, Ints
from ..core.family.rules import rule as family_rule
from ..core.limits import AROUND, ENTRIES, LOG_2_PI, ROUNDS
from ..core.merging import merge
from ..lattice.level_set import LatticeDensity, root_of, usual_nodes
from .family import laid_by
from .moments import moments_of_sum
from .quasi_random import STATES, quasi_random, systematic
from .shapes import Moments, Shape

#: Part of the change of log p by mergers, that is an error of the mean. Measured: with half and twice errors
#: are .9 to 1.1 times as large.
OF_CHANGE = 0.2


class Pieces(NamedTuple):
    """p(x) = sum_k exp(log_w_k) N(x; mean_k, root_k root_k^T)."""

    log_w: Floats  # (K,)
    mean: Floats  # (K, n)
    root: Floats  # (K, n, n)

    def some(self, which: Any) -> "Pieces":
        """The pieces of a mask or of numbers."""
        return Pieces(*(part[which] for part in self))

    @property
    def w(self) -> Floats:
        """Shares (K,) of the whole."""
        w: Floats = np.exp(self.log_w - np.logaddexp.reduce(self.log_w))
        return w

    @property
    def cov(self) -> Floats:
        """Covariances (K, n, n)."""
        return np.einsum("kac,kbc->kab", self.root, self.root)

    def shape(self, _: Any) -> Shape:
        """The shape of a density of these pieces."""
        return GaussianPieces(self)

    def normalised(self) -> "Pieces":
        """The pieces with shares of sum one, the heaviest first."""
        order = np.argsort(-self.log_w, kind="stable")
        log_w = self.log_w[order] - np.logaddexp.reduce(self.log_w)
        return Pieces(log_w, self.mean[order], self.root[order])

    def moments(self) -> tuple[Floats, Floats]:
        """Mean (n,) and covariance (n, n) of the whole."""
        return moments_of_sum(self.w, self.mean, self.cov)

    def heavy(self, least: float, away: float = 1.0) -> Bools:
        """All (K,) but those that `light` names."""
        return ~light(self.w, self.mean, self.cov, least, away)

    def log_each(self, X: Floats) -> Floats:
        """Logarithm of each piece, with its weight, at states (M, n); shape (M, K)."""
        n, back = X.shape[1], np.linalg.inv(self.root)
        z = (X - self.mean[:, None]) @ back.transpose(0, 2, 1)
        peak = self.log_w - np.linalg.slogdet(self.root)[1] - 0.5 * n * LOG_2_PI
        return peak - 0.5 * np.einsum("kma,kma->mk", z, z)

    def log_p(self, X: Floats) -> Floats:
        """Logarithm of the density at states (M, n), shape (M,)."""
        step = max(1, ENTRIES // self.mean.size)
        parts = [logsumexp(self.log_each(X[i : i + step]), axis=1) for i in range(0, len(X), step)]
        return np.concatenate(parts) if parts else np.empty(0)


def light(w: Floats, means: Floats, covs: Floats, least: float, away: float = 1.0) -> Bools:
    """The lightest parts of a sum, (K,), of shares w (K,) of sum one, which carry less than `least` of it.

    What a part carries is its share of the probability, times the standard deviations `away` at which what is
    left out may lie, or of the variance, if that is more: without a light part that is far off a density may
    be much narrower. Means are (K, n), covariances (K, n, n).
    """
    off = means - w @ means
    square = covs + off[:, :, None] * off[:, None]
    back = np.linalg.pinv(np.einsum("k,kab->ab", w, square), hermitian=True)
    carried = w * np.maximum(away, np.einsum("kab,ab->k", square, back) / means.shape[1])
    order = np.argsort(carried)
    out = np.zeros(len(w), dtype=bool)
    out[order[np.cumsum(carried[order]) < least]] = True
    return out


@cache
def nodes(n: int) -> tuple[Floats, Floats]:
    """Nodes (N, n) and positive weights (N,) exact to degree five under the standard normal law."""
    if n == 1:
        points, weights = np.polynomial.hermite_e.hermegauss(5)  # exact to degree 2 · 5 - 1 = 9
        return points[:, None], weights / weights.sum()
    if n > 4:  # where the short rule has weights below zero
        return family_rule(n, 2)
    axes = math.sqrt(3.0) * np.vstack([np.eye(n), -np.eye(n)])
    pairs = [a + b for i, a in enumerate(axes) for b in axes[i + 1 :] if np.any(a + b)]
    xi = np.vstack([np.zeros(n), axes, pairs])
    u = np.repeat([1.0 + (n * n - 7.0 * n) / 18.0, (4.0 - n) / 18.0, 1.0 / 36.0], [1, 2 * n, len(pairs)])
    return np.ascontiguousarray(xi[u > 0.0]), u[u > 0.0]


def pieces_of(mean: Floats, cov: Floats) -> Pieces:
    """One Gaussian as pieces."""
    return Pieces(np.zeros(1), np.array([mean]), root_of(cov)[None])


def merged(pieces: Pieces, most: float, reach: float = 1.0) -> tuple[Pieces, float]:
    """Merge pairs of pieces, the most alike first, until log p would change by more than `most`.

    With a `reach` that is asked so many times as far out. Middles of pairs lie within `AROUND` widths.
    Returns the pieces, and the change of log p, averaged over the mass.
    """
    xi, u = nodes(pieces.mean.shape[1])
    far_out = np.array(reach * xi.T, order="C")
    *parts, debt = merge(*map(np.ascontiguousarray, pieces), most, AROUND, far_out, u)
    found = Pieces(*parts)
    return found.normalised(), float(found.w @ debt)


def particles_of_pieces(pieces: Pieces) -> dict[str, Any]:
    """Fields of a density of pieces, by name: their nodes are its particles."""
    xi, u = nodes(pieces.mean.shape[1])
    x = pieces.mean[:, None] + np.einsum("kab,ib->kia", pieces.root, xi)
    width = np.exp(np.linalg.slogdet(pieces.root)[1] / x.shape[2])
    return {
        "x": x.reshape(-1, x.shape[2]),
        "mass": np.outer(pieces.w, u).ravel(),
        "h": np.repeat(width, len(u)),
        "read_out": "pieces",
        "pieces": pieces,
        "moments": pieces.moments(),
    }


@dataclass(frozen=True, eq=False)
class GaussianPieces(Shape):
    """A sum of Gaussians: all questions in closed form, or by states spread evenly in each."""

    pieces: Pieces
    closed = True

    @property
    def heaviest(self) -> Moments:
        """Mean and covariance of the heaviest Gaussian with all that lie within `AROUND` of its widths."""
        w, middle, own = self.pieces.w, self.pieces.mean, self.pieces.cov
        mean, cov, found = middle[0], own[0], np.zeros(len(w), bool)
        for _ in range(ROUNDS):
            z = np.linalg.solve(np.linalg.cholesky(cov), (middle - mean).T)
            near = np.sum(z**2, axis=0) < AROUND**2
            if np.array_equal(near, found):
                break
            found = near
            mean, cov = moments_of_sum(w[near] / w[near].sum(), middle[near], own[near])
        return mean, cov

    def nodes(self, n_particles: int) -> int:
        """Nodes that a lattice of the density has: those of a rule in each piece are none."""
        return usual_nodes(self.pieces.mean.shape[1])

    def on_lattice(self, n_particles: int) -> LatticeDensity:
        return laid_by(self.pieces.log_p, self._moments, n_particles, self.pieces.mean)

    def logpdf(self, X: Floats) -> Floats:
        return self.pieces.log_p(X)

    def gradient(self, X: Floats) -> Floats:
        p = np.exp(self.pieces.log_each(X))
        pull = np.linalg.solve(self.pieces.cov, (self.pieces.mean - X[:, None])[..., None])[..., 0]
        return np.einsum("mk,mka->ma", p, pull)

    @cached_property
    def _moments(self) -> tuple[Floats, Floats]:
        return self.pieces.moments()

    def mean(self) -> Floats:
        return self._moments[0].copy()

    def cov(self, centre: Floats) -> Floats:
        off = self._moments[0] - centre
        return self._moments[1] + np.outer(off, off)

    def states(self, count: int, smooth: bool) -> tuple[Floats, Floats]:
        """States spread evenly in each piece, as many in all, and in each by its share."""
        n_each = np.maximum((STATES * self.pieces.w).astype(int), 64)
        own = np.repeat(np.arange(len(n_each)), n_each)
        number = np.arange(len(own)) - np.searchsorted(own, own)  # even among those of every piece
        even = quasi_random(len(own), self.pieces.mean.shape[1], 0, number)
        return self.at(own, even), (self.pieces.w / n_each)[own]

    def at(self, own: Ints, uniform: Floats) -> Floats:
        """States (M, n) of pieces of given numbers (M,), at points (M, n) of the unit cube."""
        from scipy.special import ndtri  # on use: import time

        z = ndtri(np.clip(uniform, 1e-15, 1.0 - 1e-15))
        return self.pieces.mean[own] + np.einsum("mab,mb->ma", self.pieces.root[own], z)

    def sample(self, size: int, rng: np.random.Generator) -> Floats:
        own = rng.choice(len(self.pieces.w), size=size, p=self.pieces.w)
        return self.at(own, rng.random((size, self.pieces.mean.shape[1])))

    def scattered(self, count: int, key: int) -> tuple[Floats, Floats]:
        own = systematic(self.pieces.w, count), quasi_random(count, self.pieces.mean.shape[1], key)
        return self.at(*own), np.full(count, 1.0 / count)

    def marginal(self, axes: Sequence[int]) -> dict[str, Any]:
        """Particles of the density of some axes, by name: the same pieces there."""
        cov = self.pieces.cov[:, axes][:, :, axes]
        own = Pieces(self.pieces.log_w, self.pieces.mean[:, axes], root_of(cov))
        return particles_of_pieces(own)

    def ends(self) -> tuple[Floats, Floats, Floats]:
        mean, width = self.pieces.mean[:, 0], np.abs(self.pieces.root[:, 0, 0])
        return mean - 9.0 * width, mean + 9.0 * width, width
