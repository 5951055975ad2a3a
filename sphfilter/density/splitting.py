"""Gaussian pieces split into narrower ones, until a reading bends little over each.

In the coordinates xi of a piece, with the reading r(xi) = R^(-1/2) (z - h) in units of its noise, the tensor
B_m = E[r_m (xi xi^T - 1)] is the mean curvature. Pieces are split along the direction v in which |v^T B v| is
largest.
"""

import math
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from .._types import Bools, Floats, Ints
from ..core.limits import TINY
from ..errors import PropagationError
from .pieces import nodes

__all__ = [
    "Front",
    "ReadingAtNodes",
    "White",
    "bent_along",
    "children",
    "quadratics",
    "quadrature_moments",
    "states_at",
    "straightened",
]

#: Width of pieces over that of one which is split because its update is off. Measured: with .4 and .75 the
#: error of the vehicle is .14 and 1 times as large, and bananas split none.
NARROWER = 0.55
_BENT = 1.5  # times the bend allowed, that splits a piece; measured: 1, 3: 1.05, 1.35 times the error
#: Of a piece along the split, over its own width. Measured: errors are .96 to 1.04 times as large with half
#: and twice of the first, and with .5 and .9 for the second.
_NARROWEST, _WIDEST = 0.15, 0.7
_APART = 1.7  # widths of their window from piece to piece: their sum ripples by 2 exp(-2 π² / 1.7²) = .002
_REACH = 4.0  # widths to which pieces go: 2 Φ(-4) = 6e-5 of a Gaussian lies beyond
_LEVELS = 5  # measured: three move means by 1e-6, ten by none
#: Of the largest evidence over that of a piece which is dropped, or need not settle. Measured: half leaves
#: errors 1.05 times as large, and with twice bananas take too many nodes.
NEGLIGIBLE = math.log(1e6)
_POWERS = 8  # steps to the direction of strongest bending; measured: half, twice move means by 4e-16

#: States (M, n) to z less the reading, in units of its noise, (M, k).
White = Callable[[Floats], Floats]


class Front(NamedTuple):
    """Pieces in the states that the reading sees, and the prior's piece that each is a part of."""

    log_w: Floats  # (K,)
    mean: Floats  # (K, q)
    root: Floats  # (K, q, q)
    parent: Ints  # (K,)

    def some(self, which: Bools | Ints) -> "Front":
        return Front(self.log_w[which], self.mean[which], self.root[which], self.parent[which])


class ReadingAtNodes:
    """The reading at nodes of pieces, and how many were asked."""

    def __init__(self, white: White, n: int, sees: Ints, most: int) -> None:
        self._white, self._n, self._sees, self._most, self.count = white, n, sees, most, 0

    def __call__(self, Y: Floats) -> Floats:
        """At states (K, N, q) along the axes that are seen; shape (K, N, k)."""
        K, N, q = Y.shape
        self.count += K * N
        if self.count > self._most:
            raise PropagationError(f"pieces would need more than {self._most} nodes for this reading")
        X = np.zeros((K * N, self._n))
        X[:, self._sees] = Y.reshape(-1, q)
        r = self._white(X)
        if not np.isfinite(r).all():
            raise PropagationError("the reading of a piece is not finite")
        return r.reshape(K, N, -1)


def states_at(front: Front, xi: Floats) -> Floats:
    """States (K, N, q) at coordinates (N, q), or (K, N, q), of pieces."""
    return front.mean[:, None] + np.einsum(
        "kab,...ib->kia" if xi.ndim == 2 else "kab,kib->kia", front.root, xi
    )


def straightened(front: Front, ask: ReadingAtNodes, bend: float) -> Front:
    """Split pieces until the reading bends little over each; those that explain it too badly are dropped."""
    done, top = [], -np.inf
    for left in range(_LEVELS, -1, -1):
        seen = quadrature_moments(front, ask)
        top = max(top, float(seen.bound.max()))
        keep = seen.bound > top - NEGLIGIBLE
        bent = keep & (seen.bend > _BENT * bend) & (left > 0)
        done.append((front.some(keep & ~bent), seen.bound[keep & ~bent]))
        if not bent.any():
            break
        ratio = np.clip(np.sqrt(bend / seen.bend[bent]), _NARROWEST, _WIDEST)
        front = children(front.some(bent), seen.v[bent], ratio)
    parts = zip(*(f.some(bound > top - NEGLIGIBLE) for f, bound in done), strict=True)
    return Front(*(np.concatenate(part) for part in parts))


class _Look(NamedTuple):
    """Pieces before the reading."""

    bend: Floats  # (K,)
    v: Floats  # (K, q) along which
    bound: Floats  # (K,) most evidence that a piece may have


def quadrature_moments(front: Front, ask: ReadingAtNodes) -> _Look:
    xi, u = nodes(front.mean.shape[1])
    r = ask(states_at(front, xi))
    v, bend = bent_along(r, xi, u)
    w, ripple = _rippled_along(r, xi, u)
    v, bend = np.where((ripple > bend)[:, None], w, v), np.maximum(bend, ripple)
    mean = np.einsum("i,kim->km", u, r)
    off = r - mean[:, None]
    S = np.einsum("i,kim,kil->kml", u, off, off) + np.eye(r.shape[2])
    linear = -0.5 * np.einsum("km,km->k", mean, np.linalg.solve(S, mean[..., None])[..., 0])
    linear -= 0.5 * np.linalg.slogdet(S)[1]
    summed = logsumexp(-0.5 * np.einsum("kim,kim->ki", r, r) + np.log(u), axis=1)
    return _Look(bend, v, front.log_w + np.maximum(linear, summed))


def bent_along(r: Floats, xi: Floats, u: Floats) -> tuple[Floats, Floats]:
    """Direction (K, q) along which readings (K, N, k) at the nodes bend most, and by how much."""
    second = u[:, None, None] * (np.einsum("ia,ib->iab", xi, xi) - np.eye(xi.shape[1]))
    B = np.einsum("iab,kim->kmab", second, r)
    v = np.linalg.eigh(np.einsum("kmac,kmbc->kab", B, B))[1][:, :, -1]
    for _ in range(_POWERS):
        Bv = np.einsum("kmab,kb->kma", B, v)
        along = np.einsum("kma,ka->km", Bv, v)
        step = np.einsum("km,kma->ka", along, Bv)
        size = np.linalg.norm(step, axis=1, keepdims=True)
        v = np.where(size > 0.0, step / np.maximum(size, TINY), v)
    along = np.einsum("kmab,ka,kb->km", B, v, v)
    return v, np.sqrt(np.sum(along**2, axis=1))


def _rippled_along(r: Floats, xi: Floats, u: Floats) -> tuple[Floats, Floats]:
    """Direction (K, q) along which readings (K, N, k) are no quadratics, and by how much."""
    off = r - np.einsum("kim,ij->kjm", r, quadratics(xi.shape[1]))
    square = u * np.einsum("kim,kim->ki", off, off)
    along = np.linalg.eigh(np.einsum("ki,ia,ib->kab", square, xi, xi))[1][:, :, -1]
    return along, np.sqrt(2.0 * square.sum(axis=1))


@cache
def quadratics(n: int) -> Floats:
    """Projection (N, N) of values at the nodes on quadratic polynomials; the same for a turned rule."""
    xi, u = nodes(n)
    pairs = [(a, b) for a in range(n) for b in range(a + 1)]
    V = np.column_stack([np.ones(len(xi)), xi, *(xi[:, a] * xi[:, b] for a, b in pairs)])
    root = np.sqrt(u)[:, None]
    return (np.linalg.pinv(V * root) * root.T).T @ V.T


def children(front: Front, v: Floats, ratio: Floats) -> Front:
    """Pieces that together are others, each `ratio` (K,) as wide along v (K, q)."""
    parts = []
    for k, rho in enumerate(ratio):
        s = rho / math.sqrt(1.0 - rho * rho)
        count = math.ceil(_REACH * (1.0 + s * s) / (_APART * s))
        centre = _APART * s * np.arange(-count, count + 1)
        log_w = math.log(_APART * s / math.sqrt(2.0 * math.pi * (1.0 + s * s))) - 0.5 * centre**2 / (
            1.0 + s * s
        )
        log_w -= logsumexp(log_w)
        mean = front.mean[k] + np.outer(centre / (1.0 + s * s), front.root[k] @ v[k])
        root = front.root[k] @ (np.eye(len(v[k])) - (1.0 - rho) * np.outer(v[k], v[k]))
        kept = log_w > -NEGLIGIBLE
        count = int(kept.sum())
        own = np.full(count, front.parent[k])
        parts.append((front.log_w[k] + log_w[kept], mean[kept], np.repeat(root[None], count, axis=0), own))
    return Front(*(np.concatenate(part) for part in zip(*parts, strict=True)))
