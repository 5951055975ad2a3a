"""What one family leaves out of a density: a polynomial with its sign, and errors that have none."""

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from .._types import Floats, OfStates
from ..core._views import as_compiled
from ..core.cloud import inherited
from ..core.cloud.inherited import OF_UNSIGNED, along, steepness, whitener
from ..core.family.basis import Basis, basis, beyond, bound, fit, polynomials, values_at
from ..core.limits import TINY
from ..errors import PropagationError
from .family import Family, moments_apart, node_moments, turned
from .moments import columns

#: Mean (n,) and covariance (n, n) of prior and posterior.
Moments = tuple[tuple[Floats, Floats], tuple[Floats, Floats]]


@cache
def at_both_rules(n: int, degree: int) -> Basis:
    """The polynomials of a defect of n states at the nodes of a degree's rule, and at turned ones."""
    rule, other, more = basis(n, degree), turned(n, degree), beyond(n, degree)
    xi, u = np.concatenate([rule.xi, other.xi]), np.concatenate([rule.u, other.u])
    V = polynomials(n, int(more.power[-1].sum()), xi)[-1]
    return more._replace(xi=xi, u=u, log_w=np.concatenate([rule.log_w, other.log_w]), V=V, F=fit(V, u).T)


class Defect(NamedTuple):
    """What a family leaves out of the logarithm of a density."""

    e: Floats  # (M,) in polynomials of a higher degree, in the family's frame
    U: Floats  # (n, n) covariance of errors of the mean without a sign
    rest: float  # size of what those polynomials do not follow either

    @classmethod
    def none(cls, family: Family, error: float = 0.0) -> "Defect":
        """No defect but an error of the mean, standard deviations, of which nothing more is known."""
        M = len(beyond(len(family.mu), family.degree).power)
        return cls(np.zeros(M), family.A @ family.A.T * (error / OF_UNSIGNED) ** 2, error)

    @classmethod
    def of(cls, packed: Floats, family: Family) -> "Defect":
        """The defect of a family in one array, as compiled code has it; old files have fewer polynomials."""
        n = len(family.mu)
        known, e = len(packed) - n * n - 1, np.zeros(len(beyond(n, family.degree).power))
        e[:known] = packed[:known]
        return cls(e, packed[known:-1].reshape(n, n).copy(), float(packed[-1]))

    @property
    def packed(self) -> Floats:
        """All of it in one array."""
        return np.concatenate([self.e, self.U.ravel(), [self.rest]])

    def rough(self, family: Family) -> float:
        """Size of what the shape of its family's log p may be off by, without a sign."""
        return math.hypot(float(np.linalg.norm(self.e[len(family.c) :])), self.rest)

    def at(self, family: Family, X: Floats) -> Floats:
        """Values (K,) at states X (K, n); what they are at the edge of the frame goes on beyond it."""
        n, out = len(family.mu), np.empty(len(X))
        xi = np.linalg.solve(family.A, (X - family.mu).T).T
        far = np.sqrt((xi * xi).sum(axis=1))
        xi = np.ascontiguousarray(xi * (np.minimum(far, bound(n)) / np.maximum(far, TINY))[:, None])
        values_at(beyond(n, family.degree).power, self.e, xi, math.inf, out)
        return out

    def missed_at(self, family: Family, x: Floats, w: Floats) -> tuple[float, float, Floats]:
        """What `Inherited` ends with, of a cloud that begins at states x (N, n) of weights w (N,)."""
        off = self.at(family, x)
        return self.rough(family), float(w @ off), off


class Told(NamedTuple):
    """What a defect tells of a density."""

    error: float  # of the mean, in standard deviations, or half of that of the covariance if that is more
    unsigned: float  # the part of it without a sign
    log_mass: float  # mean of the defect's polynomial: what it adds to the log of the integral
    variance: float  # error of the variances as a part of each, where it is most


def read_out(family: Family, defect: Defect, rest: float = 0.0) -> Told:
    """What a defect tells of its family, by the nodes of both rules; `rest` is the size of what it leaves.

    What moments by these nodes are off from those by the family's own is an error, too: far out both rules
    take a polynomial that rises for one that falls, and the own does not.
    """
    (nodes, states, w), own = _at_nodes(family), node_moments(family.basis.xi, family.weighted()[0])
    own_b, own_C = own
    b, C = node_moments(nodes.xi, w)
    if not whitener(C).any():
        raise PropagationError("one family does not hold the density: few of its nodes have any weight")
    told = told_at(states, w, defect.at(family, states), defect.U, rest)
    apart = moments_apart(b - own_b, C - own_C)
    change = np.abs((C - own_C).diagonal()) / np.maximum(C.diagonal(), TINY)  # of each variance, as a part
    variance = math.hypot(told.variance, float(change.max()))
    error, unsigned = math.hypot(told.error, apart), math.hypot(told.unsigned, apart)
    return told._replace(error=error, unsigned=unsigned, variance=variance)


def read_out_after(prior: Family, defect: Defect, points: tuple[Floats, Floats], moments: Moments) -> Told:
    """What a prior's defect tells of a posterior, by states (N, n) and weights (N,) of that.

    The moments are those of prior and posterior.
    """
    U, rest = _without_sign(prior, defect, moments)
    return told_at(*points, defect.at(prior, points[0]), U, rest)


def told_at(x: Floats, w: Floats, off: Floats, U: Floats, rest: float) -> Told:
    """What a defect of values `off` (N,) at states x (N, n) of weights w (N,) tells."""
    return Told(*inherited.told_at(columns(x), as_compiled(w), as_compiled(off), as_compiled(U), rest))


def _at_nodes(family: Family) -> tuple[Basis, Floats, Floats]:
    """Nodes of both rules, states (N, n) where a family has these, and their probabilities (N,)."""
    nodes = at_both_rules(len(family.mu), family.degree)
    states = family.mu + nodes.xi @ family.A.T
    log_w = family.log_p(states) + nodes.log_w
    w = np.exp(log_w - log_w.max())
    return nodes, states, np.asarray(w / w.sum(), np.float64)


def defect_of(family: Family, log_p: OfStates, like: Defect) -> Defect:
    """The defect of a family that stands for a density of logarithm log_p; `like` that has all else."""
    nodes, X, w = _at_nodes(family)
    missed = log_p(X) - family.c @ nodes.V[: len(family.c)]
    e = missed @ nodes.F
    rest = math.sqrt(float(w @ (missed - e @ nodes.V) ** 2))
    return Defect(e, like.U, math.hypot(like.rest, rest))


class AfterReading(NamedTuple):
    """A defect that a reading leaves."""

    defect: Defect
    rest: float  # size of what its polynomials miss of the product with the likelihood
    log_mass: float  # mean over the posterior of the prior's defect


def after_reading(
    prior: Family, defect: Defect, posterior: Family, products: Floats, moments: Moments
) -> AfterReading:
    """The defect of a posterior, whose logarithm is off as the prior's is, and by what its polynomial misses.

    Of a normalised posterior `products` (N,) are the logarithms of prior times likelihood over the evidence,
    at its nodes of both rules; moments are those before and after the reading.
    """
    nodes, states, w = _at_nodes(posterior)
    off = defect.at(prior, states)
    missed = products + off - posterior.c @ nodes.V[: len(posterior.c)]
    e = missed @ nodes.F
    left = Defect(e, *_without_sign(prior, defect, moments))
    return AfterReading(left, math.sqrt(float(w @ (missed - e @ nodes.V) ** 2)), float(w @ off))


def _without_sign(prior: Family, defect: Defect, moments: Moments) -> tuple[Floats, float]:
    """What a reading leaves of errors of a prior's mean without a sign, and of its shape."""
    (_, cov), (_, own_cov) = moments
    n, degree = len(cov), prior.degree
    gain = np.linalg.solve(cov, own_cov).T  # what a reading leaves of a shift
    left = math.sqrt(min(float(np.trace(gain)) / n, 1.0))
    size = defect.rough(prior) * steepness(*where(moments), degree)
    U = gain @ defect.U @ gain.T + own_cov * size**2 / n
    # errors without a sign have the density's own variance at most: more would say nothing more
    U *= min(1.0, n / max(float(np.linalg.solve(own_cov, U).trace()), TINY))
    return U, defect.rest * left ** (degree + 2)


def where(moments: Moments) -> tuple[Floats, Floats]:
    """Where a posterior is, (n,), and how wide, (n, n), in the frame of its prior."""
    shift, spread = along(*(as_compiled(part) for each in moments for part in each))
    return shift, spread
