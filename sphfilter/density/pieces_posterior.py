"""Bayes' rule on a few Gaussians: each is split, before the update, to where the reading no longer bends.

In the coordinates xi of a piece, with the reading r(xi) = R^(-1/2) (z - h) in units of its noise, the tensor
B_m = E[r_m (xi xi^T - 1)] is the mean curvature. Along the direction v that it bends most along a piece is
split into narrower ones until |v^T B v| is small, and each is updated by itself.
"""

import math
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from .._types import Bools, Floats, Ints
from ..errors import PropagationError
from .pieces import Pieces, nodes, root_of

__all__ = ["PiecesPosterior", "Settings", "pieces_posterior"]

_LOG_2_PI = math.log(2.0 * math.pi)
_BENT = 1.5  # times the bend that is allowed, from which a piece is split
_NARROWEST, _WIDEST = 0.15, 0.7  # of a piece along the split, over its own width
_AGAIN = 0.55  # the same, of one whose update is seen to be off
_APART, _REACH = 1.7, 4.0  # spacing of pieces over their width before, and how far out they go
_LEVELS, _REPAIRS = 5, 3
_NEGLIGIBLE, _LIGHT = math.log(1e6), 1e-5  # of the largest evidence, before; of all mass together, after
_ROUNDS, _SETTLED = 3, 0.1
_LEAST, _MOST = 0.05, 4.0  # variances that one round goes to
_OF_MISFIT, _LIGHT_SHARE = 0.3, 0.1
_TURN = 0.6  # radians, between the rule and that of the second opinion

#: States (M, n) to z less the reading, in units of its noise, (M, k).
White = Callable[[Floats], Floats]


class Settings(NamedTuple):
    """How fine pieces are."""

    bend: float  # of the reading over a piece, in units of its noise
    off: float  # by how much a piece's update may be off
    most: int  # nodes that may be asked


class PiecesPosterior(NamedTuple):
    """A posterior, and how good it is."""

    pieces: Pieces
    log_evidence: float  # but for the constant of the noise
    error: float  # of the mean, standard deviations
    evidence_error: float  # nats
    asked: int  # nodes


class _Front(NamedTuple):
    """Pieces in the states that the reading sees, and the prior's piece that each is a part of."""

    log_w: Floats  # (K,)
    mean: Floats  # (K, q)
    root: Floats  # (K, q, q)
    parent: Ints  # (K,)

    def some(self, which: Bools | Ints) -> "_Front":
        return _Front(self.log_w[which], self.mean[which], self.root[which], self.parent[which])


class _Updated(NamedTuple):
    """Pieces after the reading."""

    log_w: Floats  # (K,) with their evidence
    mean: Floats  # (K, q)
    root: Floats  # (K, q, q)
    off: Floats  # (K,) how far two opinions are apart, and the misfit
    evidence_off: Floats  # (K,) nats

    def some(self, which: Bools) -> "_Updated":
        return _Updated(*(part[which] for part in self))


def pieces_posterior(prior: Pieces, white: White, sees: Ints, settings: Settings) -> PiecesPosterior:
    """Pieces times the likelihood exp(-|white(x)|^2 / 2).

    Parameters
    ----------
    prior : Pieces
    white : callable
    sees : ndarray of int, shape (q,)
        States that the reading depends on; the others follow by regression, exactly for Gaussians.
    settings : Settings

    Raises
    ------
    PropagationError
        More nodes would have to be asked than the settings allow, or the reading is not finite there.
    """
    ask = _Asked(white, prior.mean.shape[1], sees, settings.most)
    root = root_of(prior.cov[:, sees][:, :, sees])
    front = _Front(prior.log_w, prior.mean[:, sees], root, np.arange(len(prior.log_w)))
    front, new = _checked(_straightened(front, ask, settings.bend), ask, settings.off)
    log_evidence = float(logsumexp(new.log_w))
    share = np.exp(new.log_w - log_evidence)
    error, evidence_error = float(share @ new.off), float(share @ new.evidence_off)
    heavy = _heavy(share)
    found = _lifted(prior, front.some(heavy), new.some(heavy), sees)
    return PiecesPosterior(found.normalised(), log_evidence, error, evidence_error, ask.count)


def _checked(todo: _Front, ask: "_Asked", most: float) -> tuple[_Front, "_Updated"]:
    """Update pieces, and split once more those for which two opinions differ by more than `most`."""
    fronts: list[_Front] = []
    updates: list[_Updated] = []
    for left in range(_REPAIRS, -1, -1):
        new = _updated(todo, ask)
        share = np.exp(new.log_w - logsumexp(np.concatenate([new.log_w, *(u.log_w for u in updates)])))
        bad = new.off > most * np.maximum(1.0, _LIGHT_SHARE / np.maximum(share, 1e-300))
        bad &= (share > _LIGHT) & (left > 0)
        fronts.append(todo.some(~bad))
        updates.append(new.some(~bad))
        if not bad.any():
            break
        todo = todo.some(bad)
        todo = _children(todo, _look(todo, ask).v, np.full(len(todo.log_w), _AGAIN))
    joined = (tuple(np.concatenate(p) for p in zip(*parts, strict=True)) for parts in (fronts, updates))
    return _Front(*next(joined)), _Updated(*next(joined))


class _Asked:
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


def _at(front: _Front, xi: Floats) -> Floats:
    """States (K, N, q) at coordinates (N, q), or (K, N, q), of pieces."""
    return front.mean[:, None] + np.einsum(
        "kab,...ib->kia" if xi.ndim == 2 else "kab,kib->kia", front.root, xi
    )


def _straightened(front: _Front, ask: _Asked, bend: float) -> _Front:
    """Split pieces until the reading bends little over each; those that explain it too badly are dropped."""
    done, top = [], -np.inf
    for left in range(_LEVELS, -1, -1):
        seen = _look(front, ask)
        top = max(top, float(seen.bound.max()))
        keep = seen.bound > top - _NEGLIGIBLE
        bent = keep & (seen.bend > _BENT * bend) & (left > 0)
        done.append((front.some(keep & ~bent), seen.bound[keep & ~bent]))
        if not bent.any():
            break
        ratio = np.clip(np.sqrt(bend / seen.bend[bent]), _NARROWEST, _WIDEST)
        front = _children(front.some(bent), seen.v[bent], ratio)
    parts = zip(*(f.some(bound > top - _NEGLIGIBLE) for f, bound in done), strict=True)
    return _Front(*(np.concatenate(part) for part in parts))


class _Look(NamedTuple):
    """Pieces before the reading."""

    bend: Floats  # (K,)
    v: Floats  # (K, q) along which
    bound: Floats  # (K,) most evidence that a piece may have


def _look(front: _Front, ask: _Asked) -> _Look:
    xi, u = nodes(front.mean.shape[1])
    r = ask(_at(front, xi))
    v, bend = _bent_along(r)
    mean = np.einsum("i,kim->km", u, r)
    off = r - mean[:, None]
    S = np.einsum("i,kim,kil->kml", u, off, off) + np.eye(r.shape[2])
    linear = -0.5 * np.einsum("km,km->k", mean, np.linalg.solve(S, mean[..., None])[..., 0])
    linear -= 0.5 * np.linalg.slogdet(S)[1]
    summed = logsumexp(-0.5 * np.einsum("kim,kim->ki", r, r) + np.log(u), axis=1)
    return _Look(bend, v, front.log_w + np.maximum(linear, summed))


def _bent_along(r: Floats) -> tuple[Floats, Floats]:
    """Direction (K, q) along which readings (K, N, k) at the nodes bend most, and by how much."""
    xi, u = nodes(_states_of(r.shape[1]))
    second = u[:, None, None] * (np.einsum("ia,ib->iab", xi, xi) - np.eye(xi.shape[1]))
    B = np.einsum("iab,kim->kmab", second, r)
    v = np.linalg.eigh(np.einsum("kmac,kmbc->kab", B, B))[1][:, :, -1]
    for _ in range(8):
        Bv = np.einsum("kmab,kb->kma", B, v)
        along = np.einsum("kma,ka->km", Bv, v)
        step = np.einsum("km,kma->ka", along, Bv)
        size = np.linalg.norm(step, axis=1, keepdims=True)
        v = np.where(size > 0.0, step / np.maximum(size, 1e-300), v)
    along = np.einsum("kmab,ka,kb->km", B, v, v)
    return v, np.sqrt(np.sum(along**2, axis=1))


@cache
def _states_of(count: int) -> int:
    """Number of states whose rule has so many nodes."""
    return next(n for n in range(1, 7) if len(nodes(n)[1]) == count)


def _children(front: _Front, v: Floats, ratio: Floats) -> _Front:
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
        kept = log_w > -_NEGLIGIBLE
        count = int(kept.sum())
        own = np.full(count, front.parent[k])
        parts.append((front.log_w[k] + log_w[kept], mean[kept], np.repeat(root[None], count, axis=0), own))
    return _Front(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def _updated(front: _Front, ask: _Asked) -> _Updated:
    """Each piece times the likelihood, as one Gaussian."""
    xi, u = nodes(front.mean.shape[1])
    b, root = _linearised(ask(_at(front, xi)), xi, u)
    active, seen = np.arange(len(b)), None
    for _ in range(_ROUNDS):
        found = _product(front.some(active), ask, b[active], root[active], (xi, u))
        seen = found if seen is None else seen.put(active, found)
        b[active] += np.einsum("kab,kb->ka", root[active], found.mean)
        root[active] = np.einsum("kab,kbc->kac", root[active], _root_of(found.cov))
        active = active[found.moved > _SETTLED]
        if not len(active):
            break
    assert seen is not None
    other, q = _product(front, ask, b, root, (xi @ _turn(xi.shape[1]).T, u)), xi.shape[1]
    off = np.linalg.norm(other.mean, axis=1) / math.sqrt(q)
    wider = 0.5 * np.linalg.norm(other.cov - np.eye(q), axis=(1, 2)) / math.sqrt(q)
    apart = np.abs(other.log_evidence - seen.log_evidence)
    off = np.max([off, wider, apart, _OF_MISFIT * other.misfit], axis=0)
    mean = front.mean + np.einsum("kab,kb->ka", front.root, b)
    whole = np.einsum("kab,kbc->kac", front.root, root)
    return _Updated(front.log_w + seen.log_evidence, mean, whole, off, apart)


def _linearised(r: Floats, xi: Floats, u: Floats) -> tuple[Floats, Floats]:
    """Mean (K, q) and a root (K, q, q) of posteriors by statistical linearisation, in pieces' coordinates."""
    mean = np.einsum("i,kim->km", u, r)
    off = r - mean[:, None]
    S = np.einsum("i,kim,kil->kml", u, off, off) + np.eye(r.shape[2])
    cross = np.einsum("i,ia,kim->kam", u, xi, off)
    gain = np.linalg.solve(S, cross.transpose(0, 2, 1)).transpose(0, 2, 1)
    cov = np.eye(xi.shape[1]) - np.einsum("kam,kbm->kab", gain, cross)
    return -np.einsum("kam,km->ka", gain, mean), _root_of(cov, 1e-12)


class _Product(NamedTuple):
    """A piece times the likelihood, as the nodes of a frame see it."""

    log_evidence: Floats  # (K,)
    mean: Floats  # (K, q) in the frame
    cov: Floats  # (K, q, q)
    moved: Floats  # (K,) from the frame
    misfit: Floats  # (K,) rms of the logarithm less a quadratic

    def put(self, where: Ints, new: "_Product") -> "_Product":
        """The same with some pieces seen anew."""
        parts = [part.copy() for part in self]
        for part, values in zip(parts, new, strict=True):
            part[where] = values
        return _Product(*parts)


def _product(front: _Front, ask: _Asked, b: Floats, root: Floats, rule: tuple[Floats, Floats]) -> _Product:
    """Pieces times the likelihood, at the nodes of frames b (K, q), root (K, q, q) in their coordinates."""
    xi, u = rule
    y = b[:, None] + np.einsum("kab,ib->kia", root, xi)
    r = ask(_at(front, y))
    T = -0.5 * (np.einsum("kia,kia->ki", y, y) + np.einsum("kim,kim->ki", r, r))
    log_v = T + np.log(u) + 0.5 * np.sum(xi**2, axis=1)
    total = logsumexp(log_v, axis=1)
    w = np.exp(log_v - total[:, None])
    mean = w @ xi
    off = xi - mean[:, None]
    cov = np.einsum("ki,kia,kib->kab", w, off, off)
    one = np.eye(xi.shape[1])
    moved = np.maximum(np.abs(mean).max(axis=1), np.abs(cov - one).max(axis=(1, 2)))
    fit = _quadratics(len(xi), xi.shape[1])
    misfit = np.sqrt(np.einsum("ki,ki->k", w, (T - T @ fit) ** 2))
    return _Product(total + np.linalg.slogdet(root)[1], mean, cov, moved, misfit)


@cache
def _quadratics(count: int, n: int) -> Floats:
    """Projection (N, N) of values at the nodes on quadratic polynomials; the same for a turned rule."""
    xi, u = nodes(n)
    pairs = [(a, b) for a in range(n) for b in range(a + 1)]
    V = np.column_stack([np.ones(count), xi, *(xi[:, a] * xi[:, b] for a, b in pairs)])
    root = np.sqrt(u)[:, None]
    return (np.linalg.pinv(V * root) * root.T).T @ V.T


def _root_of(C: Floats, least: float = _LEAST) -> Floats:
    """Symmetric roots of covariances (K, q, q), of variances that are neither too small nor too large."""
    values, axes = np.linalg.eigh(C)
    return np.einsum("kab,kb,kcb->kac", axes, np.sqrt(np.clip(values, least, _MOST)), axes)


@cache
def _turn(n: int) -> Floats:
    """A turn in every plane of two axes that follow one another: of the nodes of a second opinion."""
    turn = np.eye(n)
    for a in range(n - 1):
        plane = np.eye(n)
        plane[a, a] = plane[a + 1, a + 1] = math.cos(_TURN)
        plane[a, a + 1], plane[a + 1, a] = -math.sin(_TURN), math.sin(_TURN)
        turn = turn @ plane
    return turn


def _heavy(share: Floats) -> Bools:
    """Which pieces are not among the lightest that together have nothing."""
    order = np.argsort(share)
    light = np.cumsum(share[order]) < _LIGHT
    out = np.ones(len(share), dtype=bool)
    out[order[light]] = False
    return out


def _lifted(prior: Pieces, front: _Front, new: _Updated, sees: Ints) -> Pieces:
    """Pieces of all states: those that the reading does not see follow by regression."""
    P, n = prior.cov[front.parent], prior.mean.shape[1]
    if len(sees) == n:
        return Pieces(new.log_w, new.mean, new.root)
    gain = np.linalg.solve(P[:, sees][:, :, sees], P[:, sees]).transpose(0, 2, 1)
    mean = prior.mean[front.parent] + np.einsum(
        "kaq,kq->ka", gain, new.mean - prior.mean[front.parent][:, sees]
    )
    less = P[:, sees][:, :, sees] - np.einsum("kac,kbc->kab", new.root, new.root)
    cov = P - np.einsum("kaq,kqr,kbr->kab", gain, less, gain)
    return Pieces(new.log_w, mean, np.linalg.cholesky(0.5 * (cov + cov.transpose(0, 2, 1))))
