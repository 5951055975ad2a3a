"""Families times something, each in its own frame: Bayes' rule, and windows that split one into several."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from .._types import Floats, Ints, OfStates
from ..core.family.basis import Basis, basis, bound, values_at
from ..core.family.together import nodes_of, own_logs
from ..core.limits import TINY
from ..errors import PropagationError
from .families import Families, QuadratureMoments, at_nodes, log_total, looked_at, shares
from .family import ASTRAY, OF_MISFIT, Family, moments_apart, turned
from .pieces import Pieces

_SETTLED, _ROUNDS = 0.1, 8  # of moments in a frame; rounds; measured: half, twice move means by 5e-5 at most
AWAY = 3.0  # standard deviations at which what is lost may lie: 2 Φ(-3) = .003 of a Gaussian lies beyond

#: Width of parts over that of the whole. Measured: with .4 and .75 the error of the vehicle is .14 and 1
#: times as large.
NARROWER = 0.55
_APART = 1.7  # widths of their window from part to part: their sum ripples by 2 exp(-2 π² / 1.7²) = .002
_REACH = 4.0  # widths to which parts go: 2 Φ(-4) = 6e-5 of a Gaussian lies beyond
#: Of the largest evidence over that of a part which is dropped, or need not settle. Measured: half leaves
#: errors 1.05 times as large.
NEGLIGIBLE = math.log(1e6)
_POWERS = 8  # steps to the direction of strongest bending; measured: half, twice move means by 4e-16

#: States (J, N, n) to logarithms (J, N).
OfNodes = Callable[[Floats], Floats]


class FamiliesPosterior(NamedTuple):
    """A posterior, the log of its integral, and how far both may be off."""

    families: Families
    log_evidence: float
    error: float  # of the mean, in standard deviations
    evidence_error: float  # nats


class _Product(NamedTuple):
    """Families times something."""

    families: Families  # with their integrals as weights: none where a frame does not fit
    seen: QuadratureMoments
    misfit: Floats  # (J,) rms over the mass of log p less its polynomial


def families_posterior(prior: Families, log_weight: OfStates, least: float) -> FamiliesPosterior:
    """Families times exp(log_weight(X)); those of a share below `least` are dropped.

    Raises
    ------
    PropagationError
        No frames fit, or the likelihood is zero where they have nodes.
    """

    def weight(x: Floats) -> Floats:
        return log_weight(x.reshape(-1, x.shape[2])).reshape(x.shape[:2])

    own = np.arange(len(prior.mu))
    found = _product(prior, own, weight, (prior.mu.copy(), prior.A.copy()), prior.basis)
    other, misfit = _second_opinion(prior, found, weight)
    whole, mean, cov = found.seen.together(prior.log_w)
    again = other.together(prior.log_w)
    root = np.linalg.inv(np.linalg.cholesky(cov))
    apart = moments_apart(root @ (again[1] - mean), root @ (again[2] - cov) @ root.T)
    posterior = found.families
    misfit = np.where(posterior.w > 0.0, np.maximum(found.misfit, misfit), 0.0)
    odd = OF_MISFIT * math.sqrt(float(posterior.w @ misfit**2))
    heavy = posterior.w > least
    lost = -math.expm1(float(log_total(posterior.log_w[heavy])) - whole)
    error = math.hypot(max(apart, odd), AWAY * lost)
    return FamiliesPosterior(posterior.some(heavy).normalised(), whole, error, abs(again[0] - whole))


def split(whole: Families, k: int, bends: OfStates, degree: int, least: float) -> tuple[Families, float]:
    """Family number k times windows along the direction in which a function of the state bends most.

    Parameters
    ----------
    whole : Families
    k : int
    bends : callable
        States (M, n) to what bends, (M, n), in units of the states.
    degree : int
        Of what comes of it.
    least : float
        Share of the family, below which a part is dropped.

    Returns
    -------
    Families, float
        And the error that this adds, standard deviations.
    """
    one = whole.one(k)
    v = strongest_bend(one, bends)[0]
    front = narrower(Pieces(np.zeros(1), one.mu[None], one.A[None]), v, NARROWER)
    axis = v @ np.linalg.inv(one.A)
    square = 1.0 / NARROWER**2 - 1.0  # one over the square of a window's width
    middle = (front.mean - one.mu) @ axis * (1.0 + 1.0 / square)
    height = front.log_w + 0.5 * middle**2 / (1.0 + 1.0 / square) - math.log(NARROWER)

    def window(x: Floats) -> Floats:
        return height[:, None] - 0.5 * square * ((x - one.mu) @ axis - middle[:, None]) ** 2

    own = np.full(len(middle), k)
    found = _product(whole, own, window, (front.mean.copy(), front.root.copy()), basis(len(v), degree))
    parts = found.families
    heavy = parts.w >= min(least, parts.w.max())
    lost = abs(1.0 - math.exp(float(log_total(parts.log_w[heavy])) - whole.log_w[k]))
    misfit = math.hypot(OF_MISFIT * math.sqrt(float(parts.w @ found.misfit**2)), AWAY * lost)
    parts = parts.some(heavy).normalised()
    return parts._replace(log_w=parts.log_w + whole.log_w[k]), misfit


def strongest_bend(one: Family, bends: OfStates) -> tuple[Floats, float]:
    """Direction (n,) in a family's frame along which a function of the state bends most, and by how much."""
    rule = one.basis
    return bent_along(bends(one.nodes) @ np.linalg.inv(one.A).T, rule.xi, rule.u)


def bent_along(r: Floats, xi: Floats, u: Floats) -> tuple[Floats, float]:
    """Direction (n,) along which a function (N, k) at nodes xi (N, n) of weights u (N,) bends most; how much.

    The tensor B_m = E[r_m (xi xi^T - 1)] is its mean curvature, and the direction v that of the largest
    |v^T B v|.
    """
    second = u[:, None, None] * (np.einsum("ia,ib->iab", xi, xi) - np.eye(xi.shape[1]))
    B = np.einsum("iab,im->mab", second, r)
    v = np.linalg.eigh(np.einsum("mac,mbc->ab", B, B))[1][:, -1]
    for _ in range(_POWERS):
        Bv = B @ v
        step = np.einsum("m,ma->a", Bv @ v, Bv)
        size = np.linalg.norm(step)
        v = step / max(size, TINY) if size > 0.0 else v
    return v, float(np.linalg.norm(B @ v @ v))


def narrower(one: Pieces, v: Floats, ratio: float) -> Pieces:
    """Gaussians that together are one, each `ratio` as wide along v (n,) in its coordinates."""
    s = ratio / math.sqrt(1.0 - ratio * ratio)
    count = math.ceil(_REACH * (1.0 + s * s) / (_APART * s))
    centre = _APART * s * np.arange(-count, count + 1)
    log_w = -0.5 * centre**2 / (1.0 + s * s)
    log_w -= logsumexp(log_w)
    mean = one.mean[0] + np.outer(centre / (1.0 + s * s), one.root[0] @ v)
    root = one.root[0] @ (np.eye(len(v)) - (1.0 - ratio) * np.outer(v, v))
    kept = log_w > -NEGLIGIBLE
    return Pieces(one.log_w[0] + log_w[kept], mean[kept], np.repeat(root[None], kept.sum(), axis=0))


def _product(
    prior: Families, own: Ints, weight: OfNodes, frames: tuple[Floats, Floats], rule: Basis
) -> _Product:
    """Families of numbers `own` (J,) times exp(weight), from frames (J, n), (J, n, n), which are moved."""
    (mu, A), far, log_w = frames, bound(prior.mu.shape[1]), prior.log_w[own]
    x = np.empty((len(mu), *rule.xi.shape))
    for left in range(_ROUNDS, 0, -1):
        nodes_of(rule.xi, mu, A, x)
        log_p = _logs(prior, own, weight, x, far)
        seen = looked_at(rule, log_p, mu, A, _SETTLED if left > 1 else math.inf)
        if (seen.off[seen.total + log_w > np.max(seen.total + log_w) - NEGLIGIBLE] < _SETTLED).all():
            break
    c = np.einsum("ki,ij->kj", log_p, rule.F)  # not a matrix product: its last bits depend on the threads
    w = shares(log_p + rule.log_w)
    misfit, held = np.sqrt(np.sum(w * (log_p - at_nodes(rule, c)) ** 2, axis=1)), seen.off < ASTRAY
    if not held.any():
        raise PropagationError("families do not hold what they become: no frame settles")
    c[:, 0] -= seen.total
    log_w = np.where(held, log_w + seen.total, -math.inf)
    return _Product(Families(log_w, mu, A, c), seen, np.where(held, misfit, 0.0))


def _logs(prior: Families, own: Ints, weight: OfNodes, x: Floats, far: float) -> Floats:
    log_p = np.empty(x.shape[:2])
    own_logs(prior.basis.power, prior.mu, prior.A, prior.c, own, x, far, log_p)
    log_p += weight(x)
    if not np.isfinite(log_p).all():
        raise PropagationError("families do not hold the posterior: the likelihood is zero at their nodes")
    return log_p


def _second_opinion(prior: Families, found: _Product, weight: OfNodes) -> tuple[QuadratureMoments, Floats]:
    """Moments of a product at nodes that nothing was fitted to, and the misfits there."""
    families = found.families
    rule, far = turned(families.mu.shape[1], families.degree), bound(families.mu.shape[1])
    x = np.empty((len(families.mu), *rule.xi.shape))
    nodes_of(rule.xi, families.mu, families.A, x)
    log_p = _logs(prior, np.arange(len(x)), weight, x, far)
    fitted = np.empty_like(log_p)
    for k, c in enumerate(families.c):
        values_at(rule.power, c, rule.xi, far, fitted[k])
    seen = looked_at(rule, log_p, families.mu, families.A)
    w = shares(log_p + rule.log_w)
    return seen, np.sqrt(np.sum(w * (log_p - found.seen.total[:, None] - fitted) ** 2, axis=1))
