"""A shape of a density in a domain: kernels, or polynomials of log p, whose states go round or end."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import special

from .._types import Floats, OfStates
from ..model.domain import Domain
from .shapes import Kernels, Polynomials, Shape


def _of_shape(name: str) -> Any:
    """A property that answers as the shape does, wherever its states live."""
    return property(lambda self: getattr(self.shape, name))


@dataclass(frozen=True, eq=False)
class Folded(Shape):
    """A shape whose states live in a domain: round circles, between walls."""

    shape: Any  # that has particles: `Kernels`, `Polynomials` or an `Exponential`
    domain: Domain

    smooth = _of_shape("smooth")
    cell = _of_shape("cell")
    degree = _of_shape("degree")
    closed = _of_shape("closed")
    own_points = _of_shape("own_points")
    known_entropy = _of_shape("known_entropy")
    heaviest = _of_shape("heaviest")

    @property
    def bare(self) -> Any:
        return self.shape

    @property
    def atoms(self) -> tuple[Floats, Floats] | None:
        """States inside of the domain, and masses, where the density is read as these alone."""
        alone = self.shape.atoms and self._seen.atoms
        return alone and (self.domain.fold(alone[0]), alone[1])

    @property
    def cells(self) -> Floats | None:
        return None if self.cell is None else self._seen.cells

    def nodes(self, n_particles: int) -> int:
        return self.shape.nodes(n_particles)

    @property
    def _ends(self) -> bool:
        """Do polynomials end at walls, and go round no circle? Their moments are integrals then."""
        return self.shape.smooth and not self.domain.periodic.any()

    @cached_property
    def _seen(self) -> Kernels | Polynomials:
        return self.shape.around(self.domain)

    @property
    def _cut(self) -> Any:
        """The shape as it ends at walls, where there are some."""
        return self._seen if self.domain.walled.any() else self.shape

    def pdf(self, X: Floats) -> Floats:
        """Density, shape (M,); zero beyond the ends."""
        turns = self._seen.turns(self.domain, X)
        out = self._seen.pdf(turns[0]) if len(turns) == 1 else np.exp(self._summed(turns))
        out[~self.domain.contains(X)] = 0.0
        return out

    def logpdf(self, X: Floats) -> Floats:
        turns = self._seen.turns(self.domain, X)
        out = self._seen.logpdf(turns[0]) if len(turns) == 1 else self._summed(turns)
        out[~self.domain.contains(X)] = -np.inf
        return out

    def _summed(self, turns: list[Floats]) -> Floats:
        return special.logsumexp([self._seen.logpdf(Y) for Y in turns], axis=0)

    def gradient(self, X: Floats) -> Floats:
        turns = self._seen.turns(self.domain, X)
        out = sum((self._seen.gradient(Y) for Y in turns), np.zeros(X.shape))
        out[~self.domain.contains(X)] = 0.0
        return out

    def mean(self) -> Floats:
        """Mean direction of periodic axes, mean of others, shape (n,)."""
        if self._ends:
            return self.shape.mean()
        return self.domain.mean(self.shape.x, self.shape.mass)

    def cov(self, centre: Floats) -> Floats:
        """Covariance of differences from the mean direction, whatever the centre, shape (n, n)."""
        if self._ends:
            return self.shape.cov(centre)
        d, mass = self.domain.nearest(self.shape.x - self.mean()), self.shape.mass
        return (d * mass[:, None]).T @ d + self.shape.widening * np.eye(d.shape[1])

    def states(self, count: int, smooth: bool) -> tuple[Floats, Floats]:
        """Weighted states of the shape, inside of the domain."""
        X, w = self._seen.states(count, smooth)
        return self.domain.fold(X), w

    def expected(self, function: OfStates, X: Floats, w: Floats) -> float:
        return self.shape.expected(function, X, w)

    def sample(self, size: int, rng: np.random.Generator) -> Floats:
        return self.domain.fold(self._cut.sample(size, rng))

    def scattered(self, count: int, key: int) -> tuple[Floats, Floats]:
        """Points inside of the domain, and their weights: of a formula those that it draws on the line."""
        x, w = self.shape.drawn(count, key) if self.degree > 0 else self._seen.scattered(count, key)
        return self.domain.fold(x), w

    drawn = scattered  # nothing is stretched round a circle

    def marginal(self, axes: Sequence[int]) -> dict[str, Any]:
        return self._cut.marginal(axes)

    def ends(self) -> tuple[Floats, Floats, Floats]:
        low, high, width = self._seen.ends()
        if self.domain.periodic[0]:
            return self.domain.low, self.domain.high, width
        return *self.domain.within(low.min(), high.max(), 0.0), width
