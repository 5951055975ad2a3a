"""Gaussian pieces taken together where one Gaussian says what two do."""

from typing import NamedTuple

import numpy as np

from .._types import Bools, Floats, Ints
from ..lattice.level_set import root_of
from .pieces import NEAR, Pieces, nodes

#: Part of the change of log p by mergers, that is an error of the mean. Measured: with half and twice errors
#: are .9 to 1.1 times as large.
OF_CHANGE = 0.2
#: Of a piece, that it may be merged with; and that are looked at for these. Measured: with half and twice
#: errors are .95 and 1.1 times as large, and of the second as they are.
_NEIGHBOURS, _LOOKED_AT = 6, 32
_LIGHT = 0.02  # share from which on less is allowed; measured: half and twice move means by .001 at most


def merged(pieces: Pieces, most: float, reach: float = 1.0) -> tuple[Pieces, float]:
    """Merge pairs of pieces, the most alike first, until log p would change by more than `most`.

    How much it changes is the rms over the pair, with the changes of earlier mergers added; of light pieces
    it may be more. With a `reach` it is asked so many times as far out. Returns the pieces, and the change of
    log p, averaged over the mass.
    """
    total = np.logaddexp.reduce(pieces.log_w)
    debt, alive = np.zeros(len(pieces.log_w)), np.ones(len(pieces.log_w), dtype=bool)
    pairs = _pairs(pieces, alive, np.arange(len(debt)))
    joined = _together(pieces, pairs, debt, total, reach)
    while len(pairs):
        chosen = _disjoint(pairs, joined.cost, most)
        if not chosen.any():
            break
        alive[pairs[chosen]] = False
        new = np.arange(len(debt), len(debt) + chosen.sum())
        debt = np.concatenate([debt, joined.debt[chosen]])
        alive = np.concatenate([alive, np.ones(len(new), dtype=bool)])
        parts = zip(pieces, joined.piece.some(chosen), strict=True)
        pieces = Pieces(*(np.concatenate(part) for part in parts))
        left = np.asarray(alive[pairs].all(axis=1))
        more = _pairs(pieces, alive, new)
        fresh = _together(pieces, more, debt, total, reach)
        pairs, joined = np.concatenate([pairs[left], more]), joined.some(left).and_(fresh)
    found = pieces.some(alive)
    return found.normalised(), float(found.w @ debt[alive])


class _Joined(NamedTuple):
    """Pairs of pieces as one Gaussian each."""

    piece: Pieces
    debt: Floats  # (P,) change of log p, with those before
    cost: Floats  # (P,) the same, as it counts for a piece of that weight

    def some(self, which: Bools) -> "_Joined":
        return _Joined(self.piece.some(which), self.debt[which], self.cost[which])

    def and_(self, other: "_Joined") -> "_Joined":
        both = Pieces(*(np.concatenate(part) for part in zip(self.piece, other.piece, strict=True)))
        return _Joined(
            both, *(np.concatenate(part) for part in ((self.debt, other.debt), (self.cost, other.cost)))
        )


def _pairs(pieces: Pieces, alive: Bools, new: Ints) -> Ints:
    """Numbers (P, 2) of `new` pieces and of the nearest that are alive."""
    from scipy.spatial import cKDTree  # on use: import time

    others, back = np.flatnonzero(alive), np.linalg.inv(pieces.root[new])
    places, count = _places(pieces, others), min(_LOOKED_AT, len(others))
    found = cKDTree(places).query(places[np.searchsorted(others, new)], count)[1]
    near = others[found.reshape(len(new), count)]
    z = (back[:, None] @ (pieces.mean[near] - pieces.mean[new, None])[..., None])[..., 0]
    away = np.where(near == new[:, None], np.inf, np.sum(z**2, axis=2))
    wider = back[:, None] @ pieces.root[near] - np.eye(z.shape[2])
    first = np.argsort(away + np.sum(wider**2, axis=(2, 3)), axis=1, kind="stable")[:, :_NEIGHBOURS]
    taken = np.take_along_axis(away, first, axis=1) < NEAR**2
    pairs = np.column_stack(
        [np.repeat(new, taken.sum(axis=1)), np.take_along_axis(near, first, axis=1)[taken]]
    )
    return np.unique(np.sort(pairs, axis=1), axis=0)


def _places(pieces: Pieces, own: Ints) -> Floats:
    """Where (K, m) pieces lie among each other: those with near middles and like spreads are close."""
    some = pieces.some(own)
    back = np.linalg.inv(root_of(np.einsum("k,kab->ab", some.w, some.cov)))
    root = back @ some.root
    scale = np.einsum("kaa->ka", root)
    lower = (root / scale[:, None])[:, *np.tril_indices(scale.shape[1], -1)]
    return np.hstack([some.mean @ back.T, np.log(scale), lower])


def _together(pieces: Pieces, pairs: Ints, debt: Floats, total: float, reach: float) -> _Joined:
    """Pairs as one Gaussian each, and what that changes."""
    log_w = np.logaddexp(*pieces.log_w[pairs].T)
    share = np.exp(pieces.log_w[pairs] - log_w[:, None])
    mean = np.einsum("ps,psa->pa", share, pieces.mean[pairs])
    off = pieces.mean[pairs] - mean[:, None]
    own = pieces.root[pairs]
    cov = np.einsum("ps,psac,psbc->pab", share, own, own) + np.einsum("ps,psa,psb->pab", share, off, off)
    root = root_of(cov)
    xi, u = nodes(mean.shape[1])
    xi = reach * xi
    back = np.linalg.inv(own)
    z = xi @ np.swapaxes(back @ root[:, None], -1, -2) - np.swapaxes(back @ off[..., None], -1, -2)
    each = np.log(share) + np.linalg.slogdet(back)[1]
    of_each = each[:, :, None] - 0.5 * np.einsum("psia,psia->psi", z, z)
    two = np.logaddexp(of_each[:, 0], of_each[:, 1])
    one = -0.5 * np.sum(xi**2, axis=1) - np.linalg.slogdet(root)[1][:, None]
    owed = np.einsum("ps,ps->p", share, debt[pairs]) + np.sqrt((two - one) ** 2 @ u)
    light = np.sqrt(_LIGHT / np.exp(log_w - total))
    return _Joined(Pieces(log_w, mean, root), owed, owed / np.maximum(1.0, light))


def _disjoint(pairs: Ints, cost: Floats, most: float) -> Bools:
    """Which pairs are merged at once: the cheapest first, no piece twice."""
    taken, chosen = np.zeros(int(pairs.max()) + 1, dtype=bool), np.zeros(len(pairs), dtype=bool)
    for p in np.argsort(cost, kind="stable"):
        if cost[p] > most:
            break
        if not taken[pairs[p]].any():
            chosen[p] = True
            taken[pairs[p]] = True
    return chosen
