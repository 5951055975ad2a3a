"""Bayes' rule on one exponential family: a frame that fits the posterior, and a second opinion of it."""

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from .._types import Floats, OfStates
from ..core.family.basis import Basis, basis, bound, values_at
from ..core.family.frame import moved, root_between
from ..core.limits import TINY
from ..errors import PropagationError
from .family import ASTRAY, OF_MISFIT, Family, moments_apart, node_moments, node_weights, turn

__all__ = ["FamilyPosterior", "family_posterior", "turned"]

_SETTLED, _ROUNDS = 1e-3, 8  # of the moments in the frame; rounds
_LEAST, _MOST, _STEP = 0.05, 4.0, 3.0  # variances, and shift, that one round goes to


class FamilyPosterior(NamedTuple):
    """A posterior, the log of its integral before it was normalised, and how far both may be off."""

    family: Family
    log_evidence: float
    misfit: float  # rms over the mass of log p less its polynomial
    error: float  # of the mean, in standard deviations
    evidence_error: float  # nats


def family_posterior(
    prior: Family, log_weight: OfStates, first: tuple[Floats, Floats] | None = None
) -> FamilyPosterior:
    """A family times exp(log_weight(X)), in a frame of its own.

    Parameters
    ----------
    prior : Family
    log_weight : callable
        States (M, n) to logarithms (M,).
    first : tuple of ndarray, shapes (n,), (n, n), optional
        Mean of the frame to begin with, and a factor of its covariance; those of the prior's if not given.

    Returns
    -------
    FamilyPosterior

    Raises
    ------
    PropagationError
        No frame fits the posterior, or the likelihood is zero where it has nodes.
    """
    rule = prior.basis
    mu, A = (prior.mu, prior.A) if first is None else first
    for left in range(_ROUNDS, 0, -1):
        log_p = _product(prior, log_weight, mu + rule.xi @ A.T)
        w, log_evidence = node_weights(rule, A, log_p)
        b, C = node_moments(rule.xi, w)
        off = moved(b, C)
        if off < _SETTLED or left == 1:
            break
        root = np.empty(C.shape)
        root_between(C, _LEAST, _MOST, root)
        mu, A = mu + A @ (b * min(1.0, _STEP / max(float(np.linalg.norm(b)), TINY))), A @ root
    if not off < ASTRAY:
        raise PropagationError(
            f"one family of degree {prior.degree} does not hold the posterior: its frame does not settle"
        )
    found = Family(mu, np.ascontiguousarray(A), log_p @ rule.F)
    misfit = _rms(w, log_p - found.c @ rule.V)
    seen = _Seen(b, C, log_evidence, misfit)
    other = _second_opinion(prior, log_weight, found)
    apart = _apart(seen, other)
    error = max(apart[0], OF_MISFIT * max(misfit, other.misfit))
    return FamilyPosterior(found.normalised(), log_evidence, max(misfit, other.misfit), error, apart[1])


class _Seen(NamedTuple):
    """A posterior as the nodes of one rule see it."""

    b: Floats
    C: Floats
    log_evidence: float
    misfit: float


def _product(prior: Family, log_weight: OfStates, X: Floats) -> Floats:
    """Log of prior times likelihood at states."""
    log_p = prior.log_p(X) + log_weight(X)
    if np.count_nonzero(np.isfinite(log_p)) < len(log_p):
        raise PropagationError("one family does not hold the posterior: the likelihood is zero at its nodes")
    return log_p


def _second_opinion(prior: Family, log_weight: OfStates, found: Family) -> _Seen:
    """Density and moments of a posterior at nodes that it was not fitted to."""
    rule = turned(len(found.mu), found.degree)
    log_p = _product(prior, log_weight, found.mu + rule.xi @ found.A.T)
    w, log_evidence = node_weights(rule, found.A, log_p)
    fitted = np.empty(len(log_p))
    values_at(rule.power, found.c, rule.xi, bound(len(found.mu)), fitted)
    return _Seen(*node_moments(rule.xi, w), log_evidence, _rms(w, log_p - fitted))


def _apart(one: _Seen, other: _Seen) -> tuple[float, float]:
    """How far two opinions are apart: in the mean, standard deviations, and in the evidence, nats."""
    apart = moments_apart(one.b - other.b, one.C - other.C)
    return apart, abs(one.log_evidence - other.log_evidence)


def _rms(w: Floats, off: Floats) -> float:
    return math.sqrt(float(w @ off**2))


@cache
def turned(n: int, degree: int) -> Basis:
    """The rule turned in every plane of two axes that follow one another; of one state, with a point more."""
    rule = basis(n, degree)
    if n == 1:
        more = basis(1, degree + 1)
        return rule._replace(xi=more.xi, u=more.u, log_w=more.log_w)
    return rule._replace(xi=np.ascontiguousarray(rule.xi @ turn(n).T))
