"""Bayes' rule on a few Gaussians: each is split before the update to where the reading no longer bends."""

import math
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from .._types import Bools, Floats, Ints
from ..core.limits import TINY
from ..core.step_control import TRIES
from .family import turn
from .pieces import HEAVY, Pieces, nodes, root_of
from .splitting import (
    NARROWER,
    Front,
    ReadingAtNodes,
    White,
    children,
    quadratics,
    quadrature_moments,
    states_at,
    straightened,
)

__all__ = ["PiecesPosterior", "Settings", "pieces_posterior"]

_LIGHT = 1e-5  # what the lightest, dropped, carry together; measured: half, twice move means by 7e-4 at most
_ROUNDS = 3  # measured: one moves means by .001, six by none
_SETTLED = 0.1  # standard deviations that a round moves
_LEAST = 0.05  # variance that one round goes to at least ...
_MOST = 4.0  # ... and at most (measured: half and twice change no run)
_OF_MISFIT = 0.3  # measured: with half and twice errors are .94 and .99 times as large


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
    ask = ReadingAtNodes(white, prior.mean.shape[1], sees, settings.most)
    root = root_of(prior.cov[:, sees][:, :, sees])
    front = Front(prior.log_w, prior.mean[:, sees], root, np.arange(len(prior.log_w)))
    front, new = _checked(straightened(front, ask, settings.bend), ask, settings.off)
    log_evidence = float(logsumexp(new.log_w))
    share = np.exp(new.log_w - log_evidence)
    error, evidence_error = float(share @ new.off), float(share @ new.evidence_off)
    heavy = Pieces(new.log_w, new.mean, new.root).heavy(_LIGHT)
    found = _lifted(prior, front.some(heavy), new.some(heavy), sees)
    return PiecesPosterior(found.normalised(), log_evidence, error, evidence_error, ask.count)


def _checked(todo: Front, ask: ReadingAtNodes, most: float) -> tuple[Front, "_Updated"]:
    """Update pieces, and split once more those for which two opinions differ by more than `most`."""
    fronts: list[Front] = []
    updates: list[_Updated] = []
    for left in range(TRIES, -1, -1):
        new = _updated(todo, ask)
        share = np.exp(new.log_w - logsumexp(np.concatenate([new.log_w, *(u.log_w for u in updates)])))
        bad = new.off > most * np.maximum(1.0, HEAVY / np.maximum(share, TINY))
        bad &= (share > _LIGHT) & (left > 0)
        fronts.append(todo.some(~bad))
        updates.append(new.some(~bad))
        if not bad.any():
            break
        todo = todo.some(bad)
        todo = children(todo, quadrature_moments(todo, ask).v, np.full(len(todo.log_w), NARROWER))
    joined = (tuple(np.concatenate(p) for p in zip(*parts, strict=True)) for parts in (fronts, updates))
    return Front(*next(joined)), _Updated(*next(joined))


def _updated(front: Front, ask: ReadingAtNodes) -> _Updated:
    """Each piece times the likelihood, as one Gaussian."""
    xi, u = nodes(front.mean.shape[1])
    b, root = _linearised(ask(states_at(front, xi)), xi, u)
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
    other, q = _product(front, ask, b, root, (xi @ turn(xi.shape[1]).T, u)), xi.shape[1]
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
        """The product with some pieces seen anew."""
        parts = [part.copy() for part in self]
        for part, values in zip(parts, new, strict=True):
            part[where] = values
        return _Product(*parts)


def _product(
    front: Front, ask: ReadingAtNodes, b: Floats, root: Floats, rule: tuple[Floats, Floats]
) -> _Product:
    """Pieces times the likelihood, at the nodes of frames b (K, q), root (K, q, q) in their coordinates."""
    xi, u = rule
    y = b[:, None] + np.einsum("kab,ib->kia", root, xi)
    r = ask(states_at(front, y))
    T = -0.5 * (np.einsum("kia,kia->ki", y, y) + np.einsum("kim,kim->ki", r, r))
    log_v = T + np.log(u) + 0.5 * np.sum(xi**2, axis=1)
    total = logsumexp(log_v, axis=1)
    w = np.exp(log_v - total[:, None])
    mean = w @ xi
    off = xi - mean[:, None]
    cov = np.einsum("ki,kia,kib->kab", w, off, off)
    one = np.eye(xi.shape[1])
    moved = np.maximum(np.abs(mean).max(axis=1), np.abs(cov - one).max(axis=(1, 2)))
    fit = quadratics(xi.shape[1])
    misfit = np.sqrt(np.einsum("ki,ki->k", w, (T - T @ fit) ** 2))
    return _Product(total + np.linalg.slogdet(root)[1], mean, cov, moved, misfit)


def _root_of(C: Floats, least: float = _LEAST) -> Floats:
    """Symmetric roots of covariances (K, q, q), of variances that are neither too small nor too large."""
    values, axes = np.linalg.eigh(C)
    return np.einsum("kab,kb,kcb->kac", axes, np.sqrt(np.clip(values, least, _MOST)), axes)


def _lifted(prior: Pieces, front: Front, new: _Updated, sees: Ints) -> Pieces:
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
    return Pieces(new.log_w, mean, root_of(0.5 * (cov + cov.transpose(0, 2, 1))))
