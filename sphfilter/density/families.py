"""A few exponential families together: what a flow that bends makes of one; and one in their place."""

import math
from typing import Any, NamedTuple

import numpy as np

from .._types import Bools, Floats
from ..core.family.basis import Basis, basis, bound
from ..core.family.together import log_sum, nodes_of, settled_round
from .family import OF_MISFIT, Exponential, Family, degree_of, fitted, moments_apart, node_moments
from .points import moments_of_sum
from .shapes import Moments, Shape

#: Share of a family, below which it may be off by more: HEAVY over it. Measured: half, twice change no run.
HEAVY = 0.1


class Families(NamedTuple):
    """p(x) = sum_k exp(log_w_k) p_k(x), with families p_k of one degree whose integrals are one."""

    log_w: Floats  # (K,)
    mu: Floats  # (K, n)
    A: Floats  # (K, n, n)
    c: Floats  # (K, M)

    def some(self, which: Any) -> "Families":
        """The families of a mask or of numbers."""
        return Families(*(np.ascontiguousarray(part[which]) for part in self))

    @property
    def degree(self) -> int:
        """Degree of the polynomials."""
        return degree_of(self.mu.shape[1], self.c.shape[1])

    @property
    def basis(self) -> Basis:
        """Polynomials, nodes and weights."""
        return basis(self.mu.shape[1], self.degree)

    @property
    def w(self) -> Floats:
        """Shares (K,) of the whole."""
        return shares(self.log_w)

    def one(self, k: int) -> Family:
        """Family number k."""
        return Family(self.mu[k], self.A[k], self.c[k])

    def log_p(self, X: Floats) -> Floats:
        """Logarithm of the density at states (M, n), shape (M,)."""
        out = np.empty(len(X))
        log_sum(self.basis.power, *self, np.ascontiguousarray(X), bound(X.shape[1]), out)
        return out

    @property
    def middles(self) -> Floats:
        """Where parts of the sum lie, (K, n)."""
        return self.mu

    def shape(self, x: Floats, mass: Floats, moments: Moments, domain: None) -> Shape:
        """The shape of a density with nodes x (N, n) and their masses."""
        return Exponential(self.log_p, x, mass, moments, self.mu)

    def normalised(self) -> "Families":
        """The families with shares of sum one, the heaviest first."""
        found = self.some(np.argsort(-self.log_w, kind="stable"))
        return found._replace(log_w=found.log_w - log_total(found.log_w))

    def looked_at(self) -> "QuadratureMoments":
        """Their integrals and moments, by their own nodes."""
        return looked_at(self.basis, at_nodes(self.basis, self.c), self.mu, self.A)


class QuadratureMoments(NamedTuple):
    """Densities as the nodes of their frames see them."""

    total: Floats  # (K,) logarithms of the integrals
    mean: Floats  # (K, n)
    cov: Floats  # (K, n, n)
    off: Floats  # (K,) of the moments in their frames

    def some(self, which: Any) -> "QuadratureMoments":
        """The moments of a mask or of numbers."""
        return QuadratureMoments(*(part[which] for part in self))

    def together(self, log_w: Floats) -> tuple[float, Floats, Floats]:
        """Logarithm of the integral of the sum with weights (K,), its mean (n,) and its covariance (n, n)."""
        log_w = np.where(self.off < math.inf, log_w + self.total, -math.inf)
        whole = float(log_total(log_w))
        w = np.exp(log_w - whole)
        return whole, *moments_of_sum(w, self.mean, self.cov)


def looked_at(
    rule: Basis, log_p: Floats, mu: Floats, A: Floats, settled: float = math.inf
) -> QuadratureMoments:
    """Densities of logarithms (K, N) at the nodes of frames, which follow those that are not `settled`."""
    total, mean, cov, off = np.empty(len(mu)), np.empty_like(mu), np.empty_like(A), np.empty(len(mu))
    before = mu.copy(), A.copy()
    settled_round(rule, np.ascontiguousarray(log_p), settled, mu, A, total, mean, cov, off)
    mean = before[0] + np.einsum("kab,kb->ka", before[1], mean)
    return QuadratureMoments(total, mean, np.einsum("kab,kbc,kdc->kad", before[1], cov, before[1]), off)


def at_nodes(rule: Basis, c: Floats) -> Floats:
    """Polynomials (K, M) at the nodes, shape (K, N); the same bits whatever the threads."""
    return np.einsum("kj,ji->ki", c, rule.V)


def log_total(values: Floats) -> Floats:
    """Logarithm of the sum of exponentials along the last axis."""
    top = values.max(axis=-1, keepdims=True)
    total: Floats = np.log(np.exp(values - top).sum(axis=-1)) + top[..., 0]
    return total


def shares(values: Floats) -> Floats:
    """Exponentials over their sums along the last axis."""
    w: Floats = np.exp(values - values.max(axis=-1, keepdims=True))
    return w / w.sum(axis=-1, keepdims=True)


def families_of(family: Family) -> Families:
    """One."""
    return Families(np.zeros(1), family.mu[None], family.A[None], family.c[None])


def particles_of_families(families: Families) -> dict[str, Any]:
    """Fields of a density of families, by name: their nodes are its particles."""
    rule, (K, n) = families.basis, families.mu.shape
    x = np.empty((K, len(rule.xi), n))
    nodes_of(rule.xi, families.mu, families.A, x)
    log_p = at_nodes(rule, families.c) + rule.log_w
    width = np.exp(np.linalg.slogdet(families.A)[1] / n)
    return {
        "x": x.reshape(-1, n),
        "mass": (families.w[:, None] * shares(log_p)).ravel(),
        "h": np.repeat(width, len(rule.xi)),
        "read_out": "pieces",
        "families": families,
        "moments": families.looked_at().together(families.log_w)[1:],
    }


def merged_families(families: Families, most: float, heavy: float) -> tuple[Families, float]:
    """Put one family in the place of all if that is off by at most `most`, else in that of halves of them.

    Those of a share below `heavy` may be off by more.

    Returns
    -------
    Families, float
        The heaviest first, and the error that this adds, standard deviations.
    """
    seen, off, found = families.looked_at(), 0.0, []
    groups = [np.arange(len(families.log_w))]
    while groups:
        which = groups.pop()
        own, (_, mean, cov) = families.some(which), seen.some(which).together(families.log_w[which])
        log_w = float(log_total(own.log_w))
        one, change = _fitted(own._replace(log_w=own.log_w - log_w), mean, cov)
        if len(which) == 1 or change <= most * max(1.0, heavy / math.exp(log_w)):
            found.append((log_w, *(families.one(which[0]) if len(which) == 1 else one)))
            off += 0.0 if len(which) == 1 else math.exp(log_w) * change
        else:
            side = _side(seen.mean[which] - mean, own.w, cov)
            groups += [half for half in (which[side], which[~side]) if len(half)]
    return Families(*(np.array(part) for part in zip(*found, strict=True))).normalised(), off


def _side(away: Floats, w: Floats, cov: Floats) -> Bools:
    """On which side (K,) of the mean of all middles lie, along what parts them most."""
    z = np.linalg.solve(np.linalg.cholesky(cov), away.T)
    along = np.linalg.eigh((z * w) @ z.T)[1][:, -1] @ z
    return np.asarray(along > 0.5 * (along.min() + along.max()))


def _fitted(families: Families, mean: Floats, cov: Floats) -> tuple[Family, float]:
    """One family in the place of several, and what it is off by: in log p, the mean, or the covariance."""
    one, misfit = fitted(families.log_p, mean, cov, families.degree)
    b, C = node_moments(one.basis.xi, one.weighted()[0])
    return one, max(OF_MISFIT * misfit, moments_apart(b, C - np.eye(len(mean))))
