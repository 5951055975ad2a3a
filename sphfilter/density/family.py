"""One exponential family: log p is a polynomial in a frame, and a lattice only where one is asked for."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np

from .._types import Floats, OfStates
from ..core.family.basis import Basis, basis, bound, polynomials, size, values_at
from ..core.family.frame import inverse, moved, weigh
from ..core.limits import LOG_2_PI, STEP
from ..core.small_matrices import moments
from ..lattice.level_set import LatticeDensity, fewest_particles, lattice_depth, lay, usual_nodes
from ..model.domain import Domain
from .moments import matched
from .quasi_random import STATES, weighted_points
from .shapes import Moments, Polynomials, Shape

ASTRAY = 0.3  # of a frame's moments: no family holds the density then; measured: half, twice change no run
#: Part of a polynomial's misfit that errors are estimated by. Measured: with half and twice, a model that
#: switches takes .8 and 1.2 times the evaluations for 2.4 and .5 times the error, others 1.02 at most.
OF_MISFIT = 0.5
_NODES = {1: 200, 2: 1000, 3: 4000, 4: 12_000}  # of a lattice for questions, of four states and more the last
_FEW = 3  # states, of which a rule of 12³ = 1,728 nodes costs less than a step
ON_LATTICE = 2  # states up to which a lattice answers, and may come after one family


class Family(NamedTuple):
    """log p(mu + A xi) = sum_j c_j h_j(xi), with Hermite polynomials h_j of total degree up to d."""

    mu: Floats  # (n,)
    A: Floats  # (n, n)
    c: Floats  # (M,)

    @property
    def degree(self) -> int:
        """d."""
        return degree_of(len(self.mu), len(self.c))

    @property
    def basis(self) -> Basis:
        """Polynomials, nodes and weights."""
        return basis(len(self.mu), self.degree)

    @property
    def nodes(self) -> Floats:
        """States (N, n) at the nodes of the frame."""
        return self.mu + self.basis.xi @ self.A.T

    def log_p(self, X: Floats) -> Floats:
        """Logarithm of the density at states (M, n), shape (M,); far out it falls as a wide Gaussian does."""
        n = len(self.mu)
        back, out = np.empty((n, n)), np.empty(len(X))
        inverse(self.A, back)
        xi = np.ascontiguousarray((X - self.mu) @ back.T)
        values_at(self.basis.power, self.c, xi, bound(n), out)
        return out

    def weighted(self) -> tuple[Floats, float]:
        """Probabilities (N,) of the nodes, and the logarithm of the integral of the density."""
        return node_weights(self.basis, self.A, self.c @ self.basis.V)

    @property
    def astray(self) -> float:
        """How far the moments are from those of the frame at most, as where the polynomial rises far out."""
        return moved(*node_moments(self.basis.xi, self.weighted()[0]))

    def shape(self, moments: Any) -> Shape:
        """The shape of a density of these moments."""
        return Exponential(self, moments)

    def normalised(self) -> "Family":
        """The family with an integral of one."""
        c = self.c.copy()
        c[0] -= self.weighted()[1]
        return Family(self.mu, self.A, c)


@cache
def _fine_rule(n: int) -> tuple[Floats, Floats]:
    """Nodes (N, n) of Gauss's rule, twelve along each state, and logarithms of weights over the density."""
    points, weights = np.polynomial.hermite_e.hermegauss(12)  # to degree 23: three of a quartic's exponent
    each = np.indices(n * (12,)).reshape(n, -1).T
    xi = points[each]
    return xi, np.log(weights)[each].sum(axis=1) + 0.5 * (xi * xi).sum(axis=1)


def miscounted(family: Family) -> float:
    """How far moments by a family's own nodes are from those by many more, standard deviations.

    Zero of four states and more, where many are too many, and of odd degrees, whose far ends are none.
    """
    n = len(family.mu)
    if n > _FEW or family.degree % 2:
        return 0.0
    xi, log_w = _fine_rule(n)
    w = np.empty(len(xi))
    weigh(log_w, n, family.log_p(family.mu + xi @ family.A.T), w)
    b, C = node_moments(xi, w)
    own_b, own_C = node_moments(family.basis.xi, family.weighted()[0])
    return moments_apart(b - own_b, C - own_C)


@cache
def degree_of(n: int, M: int) -> int:
    """Degree of M polynomials of n states."""
    return next(d for d in range(2, M) if size(n, d) == M)


def node_weights(rule: Any, A: Floats, log_p: Floats) -> tuple[Floats, float]:
    """Probabilities (N,) of nodes with log-densities (N,), and the log of the integral over the states."""
    w, n = np.empty(len(rule.xi)), len(A)
    total = weigh(rule.log_w, n, np.ascontiguousarray(log_p), w)
    return w, total + inverse(A, np.empty((n, n)))


def node_moments(xi: Floats, w: Floats) -> tuple[Floats, Floats]:
    """Mean (n,) and covariance (n, n) of nodes with probabilities."""
    n = xi.shape[1]
    b, C = np.empty(n), np.empty((n, n))
    moments(xi, w, b, C)
    return b, C


def fitted(log_p: OfStates, mean: Floats, cov: Floats, degree: int) -> tuple[Family, float]:
    """The family of a degree next to a log-density, in its moments' frame, and the misfit over its mass."""
    rule, A = basis(len(mean), degree), np.asarray(np.linalg.cholesky(cov), np.float64)
    values = log_p(mean + rule.xi @ A.T)
    c = values @ rule.F
    w = node_weights(rule, A, values)[0]
    return Family(mean, A, c).normalised(), math.sqrt(float(w @ (values - c @ rule.V) ** 2))


def moments_apart(shift: Floats, change: Floats) -> float:
    """How far moments are apart in a frame: rms over the states of a shift (n,), half of a change (n, n)."""
    n, change = len(shift), change.ravel(order="K")
    return max(math.sqrt(shift.dot(shift)) / math.sqrt(n), 0.5 * math.sqrt(change.dot(change) / n))


@cache
def turned(n: int, degree: int) -> Basis:
    """The rule turned in every plane of two axes that follow one another; of one state, with a point more."""
    rule, whole, turn = basis(n, degree), np.eye(n), 0.6  # radians
    if n == 1:
        more = basis(1, degree + 1)
        return _at(rule._replace(u=more.u, log_w=more.log_w), more.xi)
    for a in range(n - 1):
        plane = np.eye(n)
        plane[a, a] = plane[a + 1, a + 1] = math.cos(turn)
        plane[a, a + 1], plane[a + 1, a] = -math.sin(turn), math.sin(turn)
        whole = whole @ plane
    return _at(rule, np.ascontiguousarray(rule.xi @ whole.T))


def _at(rule: Basis, xi: Floats) -> Basis:
    """The polynomials of a rule at other nodes xi (N, n)."""
    V = polynomials(xi.shape[1], int(rule.power[-1].sum()), xi)[-1]
    return rule._replace(xi=xi, V=V, F=np.ascontiguousarray((V * rule.u).T))


def gaussian_family(mean: Floats, cov: Floats, degree: int) -> Family:
    """A Gaussian."""
    n = len(mean)
    A: Floats = np.asarray(np.linalg.cholesky(cov), np.float64)
    c = _standard(n, degree).copy()
    c[0] = -0.5 * n * LOG_2_PI - np.log(A.diagonal()).sum() - 0.5 * n
    return Family(np.array(mean), A, c)


@cache
def _standard(n: int, degree: int) -> Floats:
    """Coefficients (M,) of a Gaussian in its own frame, but for the constant."""
    power = basis(n, degree).power
    return np.where((power.max(axis=1) == 2) & (power.sum(axis=1) == 2), -math.sqrt(0.5), 0.0)


def particles_of(family: Family) -> dict[str, Any]:
    """Fields of a density that is one family, by name: its nodes are its particles."""
    return nodes_of(family) | {"read_out": "family", "family": family, "moments": moments_of(family)}


def nodes_of(family: Family) -> dict[str, Any]:
    """Particles of a family by name: its nodes x (N, n), their mass (N,), and how wide, h (N,), each is."""
    w, width = family.weighted()[0], abs(np.linalg.det(family.A)) ** (1.0 / len(family.mu))
    return {"x": family.nodes, "mass": w, "h": np.full(len(w), width)}


def moments_of(family: Family) -> tuple[Floats, Floats]:
    """Mean (n,) and covariance (n, n) of a family, by its nodes."""
    b, C = node_moments(family.basis.xi, family.weighted()[0])
    return family.mu + family.A @ b, family.A @ C @ family.A.T


def laid_by(log_p: OfStates, moments: Any, n_particles: int, middles: Floats) -> LatticeDensity:
    """A density of given moments on a lattice of at most so many nodes, from its `middles` (K, n)."""
    mean, cov = moments
    n_particles = max(n_particles, fewest_particles(len(mean)))
    depth = lattice_depth(None, len(mean))
    return lay(log_p, mean, np.linalg.cholesky(cov), middles, n_particles, depth)


@dataclass(frozen=True, eq=False)
class Exponential(Shape):
    """One exponential family: density and moments by polynomials, all else on a lattice laid.

    A Gaussian has samples and marginals in closed form. In a domain all else is asked of the lattice.
    """

    family: Family
    moments: Moments

    @cached_property
    def laid(self) -> Polynomials:
        """The family's density on a lattice."""
        laid = self.on_lattice(_NODES[min(len(self.family.mu), 4)])
        return Polynomials(laid.field, laid.x, laid.mass, self.moments)

    @property
    def degree(self) -> int:
        return self.family.degree

    @property
    def _bent(self) -> bool:
        """Whether there are terms above the second degree: a Gaussian has none."""
        return bool(self.family.c[size(len(self.moments[0]), 2) :].any())

    @property
    def x(self) -> Floats:
        return self.laid.x

    @property
    def mass(self) -> Floats:
        return self.laid.mass

    def nodes(self, n_particles: int) -> int:
        """Nodes that a lattice of the density has: those of a frame are no lattice, and fewer."""
        return usual_nodes(len(self.family.mu))

    def around(self, domain: Domain) -> Polynomials:
        """The polynomials of the lattice between the walls of a domain."""
        return self.laid.around(domain)

    def on_lattice(self, n_particles: int) -> LatticeDensity:
        return laid_by(self.family.log_p, self.moments, n_particles, self.moments[0][None])

    def logpdf(self, X: Floats) -> Floats:
        return self.family.log_p(X)

    def gradient(self, X: Floats) -> Floats:
        frame = np.linalg.cholesky(self.moments[1]).T
        slopes = [(self.logpdf(X + step) - self.logpdf(X - step)) / (2.0 * STEP) for step in STEP * frame]
        return np.linalg.solve(frame, slopes).T * self.pdf(X)[:, None]

    def mean(self) -> Floats:
        return self.moments[0].copy()

    def cov(self, centre: Floats) -> Floats:
        return self.moments[1].copy()

    def states(self, count: int, smooth: bool) -> tuple[Floats, Floats]:
        """States in every cell of the lattice; of many states points spread evenly, with weights."""
        if len(self.moments[0]) <= ON_LATTICE:
            return self.laid.states(count, smooth)
        return weighted_points(self.logpdf, self.moments, STATES, 0)

    def sample(self, size: int, rng: np.random.Generator) -> Floats:
        if self._bent:
            return self.laid.sample(size, rng)
        mean, cov = self.moments
        return mean + rng.standard_normal((size, len(mean))) @ np.linalg.cholesky(cov).T

    def scattered(self, count: int, key: int) -> tuple[Floats, Floats]:
        return weighted_points(self.logpdf, self.moments, count, key)

    def drawn(self, count: int, key: int) -> tuple[Floats, Floats]:
        x, w = self.scattered(count, key)
        return matched(x, w, *self.moments), w

    def marginal(self, axes: Sequence[int]) -> dict[str, Any]:
        """Particles of the density of some axes, by name: a Gaussian, or on a lattice of its own."""
        if self._bent:
            return self.laid.marginal(axes)
        mean, cov = self.moments
        return particles_of(gaussian_family(mean[axes], cov[np.ix_(axes, axes)], 2))

    def ends(self) -> tuple[Floats, Floats, Floats]:
        return self.laid.ends()
