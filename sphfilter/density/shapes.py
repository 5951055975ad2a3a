"""Shapes of a density: kernels, and polynomials of log p on a lattice.

A shape answers the same questions, whatever it is made of: pdf, logpdf and gradient at states; mean and
covariance; weighted states that stand for it; samples; marginals; where it ends. Those of states (M, n) take
and return arrays without checking them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol, TypeAlias

import numpy as np

from .._types import Floats, Ints, OfStates
from ..core.field.field import Field
from ..core.field.walls import NO_WALLS, Walls
from ..core.limits import TINY
from ..core.sph.kernels import Kernel, kernel_variance
from ..errors import PropagationError
from ..lattice import field as lattice_field
from ..lattice.level_set import LatticeDensity
from ..lattice.walls import inside
from ..model.domain import Domain
from . import marginal, mixture
from .moments import matched
from .quasi_random import quasi_random, spread_evenly, systematic

LATTICE_SUPPORT = 1.2  # smoothing length on a lattice over its spacing: the coupling eta = h / dx of 000
_CANDIDATES = 8  # states in cells over points drawn; measured: half, twice change errors by .9, .7 times
_OF_MODES = 1.0 / 8.0  # of points, drawn from all modes as often; errors of the others: √(8/7) = 1.07 times
CELL_POINTS = 2**17  # in all cells, up to 128 in each and at least 16: 8 n bytes each = n MB
#: Mean (n,) and covariance (n, n).
Moments: TypeAlias = tuple[Floats, Floats]


class Shape(Protocol):
    """The questions that every shape answers, and what most answer alike."""

    @property
    def bare(self) -> "Shape":
        """The shape without its domain."""
        return self

    @property
    def smooth(self) -> bool:
        """Whether log p is a smooth function everywhere: kernels end somewhere."""
        return True

    @property
    def cell(self) -> Floats | None:
        """Edges (n, n) of a lattice's cells, in columns; None where the density lies on none."""
        return None

    @property
    def cells(self) -> Floats | None:
        """Middles (M, n) of a lattice's cells in which the density is more than nothing; or None."""
        return None

    @property
    def widening(self) -> float:
        """Variance along each axis by which the covariance exceeds that of the points."""
        return 0.0

    @property
    def degree(self) -> int:
        """Degree of the polynomial that log p is; zero where it is no single one."""
        return 0

    @property
    def closed(self) -> bool:
        """Whether linear models and sensors make another of its kind: Gaussians added, each by itself."""
        return False

    @property
    def own_points(self) -> tuple[Floats, Floats] | None:
        """Points (N, n) and weights (N,) that steps carry, as they lie; None where they carry log p."""
        return None

    @property
    def atoms(self) -> tuple[Floats, Floats] | None:
        """States (N, n) and masses (N,), where the density is read as these alone; else None."""
        return None

    @property
    def known_entropy(self) -> float | None:
        """-E[log p], nats, where log p is known at all atoms; else None."""
        return None

    @property
    def heaviest(self) -> Moments | None:
        """Moments of its heaviest part with all that lies about it; None where there are no parts."""
        return None

    def nodes(self, n_particles: int) -> int:
        """Nodes that a lattice of the density has where none asks for more, if it has so many particles."""
        return n_particles

    def on_lattice(self, n_particles: int) -> LatticeDensity | None:
        """The density on a lattice of at most so many nodes; None where nodes or points are the density."""
        return None

    def pdf(self, X: Floats) -> Floats:
        """Density, shape (M,)."""
        return np.exp(self.logpdf(X))

    def logpdf(self, X: Floats) -> Floats:
        """Logarithm of the density, shape (M,); minus infinity where there is none."""

    def gradient(self, X: Floats) -> Floats:
        """Gradient of the density, shape (M, n)."""

    def mean(self) -> Floats:
        """Mean, shape (n,)."""

    def cov(self, centre: Floats) -> Floats:
        """Covariance about a centre (n,), shape (n, n)."""

    def states(self, count: int, smooth: bool) -> tuple[Floats, Floats]:
        """States (M, n) and weights (M,) whose sums are expectations, of `smooth` functions or of any."""

    def expected(self, function: OfStates, X: Floats, w: Floats) -> float:
        """Expectation of a function, by its `states`."""
        return float(w @ function(X))

    def distribution(self, y: Floats, F: Floats) -> Floats:
        """Distribution function (K,) of one state at places (K,), where F (K,) is the integral of the pdf."""
        return F

    def scattered(self, count: int, key: int) -> tuple[Floats, Floats]:
        """Quasi-random points (count, n) by a key, and their weights (count,)."""

    def drawn(self, count: int, key: int) -> tuple[Floats, Floats]:
        """Points as of `scattered`, shifted and stretched: with mean and covariance of the density."""
        (x, w), mean = self.scattered(count, key), self.mean()
        try:
            return matched(x, w, mean, self.cov(mean)), w
        except np.linalg.LinAlgError:  # flat along some combination of the states
            return x, w

    def sample(self, size: int, rng: np.random.Generator) -> Floats:
        """Draw states, shape (size, n)."""

    def raw_moment(self, powers: Ints, centre: Floats) -> float | None:
        """Moment about a centre (n,) in closed form; None where there is none."""
        return None

    def marginal(self, axes: Sequence[int]) -> dict[str, Any]:
        """Particles of the density of some axes, by name."""

    def ends(self) -> tuple[Floats, Floats, Floats]:
        """Lower and upper ends of a density of one state, and how wide its parts are; arrays."""


@dataclass(frozen=True, eq=False)
class Kernels(Shape):
    """Particles and the kernels around them: p(x) = sum_j m_j W(x - x_j, h_j) (002 (16)).

    `kind` says what moments and expectations are of: "points" (sums over the particles) or "mixture"
    (integrals of p).
    """

    x: Floats  # (N, n)
    mass: Floats  # (N,)
    h: Floats  # (N,)
    kernel: Kernel
    kind: str
    images: mixture.Mixture | None = field(default=None, repr=False)  # with those that stand beyond ends
    log_p: Floats | None = field(default=None, repr=False)  # (N,) of the particles, where it is known

    @cached_property
    def mixture(self) -> mixture.Mixture:
        """The kernels that the pdf sums; made at the first question."""
        if self.images is not None:
            return self.images
        return mixture.mixture(self.x, self.mass, self.h, self.kernel)

    @property
    def smooth(self) -> bool:
        return False

    @property
    def widening(self) -> float:
        if self.kind != "mixture":
            return 0.0
        return float(self.kernel.variance * (self.mass @ self.h**2))

    @property
    def atoms(self) -> tuple[Floats, Floats] | None:
        return (self.x, self.mass) if self.kind == "points" else None

    @property
    def known_entropy(self) -> float | None:
        return None if self.atoms is None or self.log_p is None else -float(self.mass @ self.log_p)

    def pdf(self, X: Floats) -> Floats:
        return self.mixture.pdf(X)

    def logpdf(self, X: Floats) -> Floats:
        return self.mixture.logpdf(X)

    def gradient(self, X: Floats) -> Floats:
        return self.mixture.gradient(X)

    def mean(self) -> Floats:
        """Mean, shape (n,); points and mixture agree, kernels being symmetric."""
        return self.mass @ self.x

    def cov(self, centre: Floats) -> Floats:
        d = self.x - centre
        return (d * self.mass[:, None]).T @ d + self.widening * np.eye(self.x.shape[1])

    def states(self, count: int, smooth: bool) -> tuple[Floats, Floats]:
        """Particles for "points"; else `count` states a kernel, spread evenly, always the same ones."""
        if self.atoms is not None:
            return self.atoms
        offsets = mixture.standing_for(self.kernel.kind, self.x.shape[1], count)
        X = self.mixture.points(offsets, slice(len(self.x)))  # images are seen, but carry nothing
        return X, np.repeat(self.mass / count, count)

    def sample(self, size: int, rng: np.random.Generator) -> Floats:
        mix = self.mixture
        mass = mix.mass[: len(self.x)]  # without images
        offsets = mixture.drawn(mix.kernel.kind, rng.random((size, self.x.shape[1] + 1)))
        return mix.points(offsets, rng.choice(len(mass), size=size, p=mass))

    def scattered(self, count: int, key: int) -> tuple[Floats, Floats]:
        mix = self.mixture
        offsets = mixture.drawn(mix.kernel.kind, quasi_random(count, self.x.shape[1] + 1, key))
        points = mix.points(offsets, systematic(mix.mass[: len(self.x)], count))
        return points, np.full(count, 1.0 / count)

    def raw_moment(self, powers: Ints, centre: Floats) -> float | None:
        return mixture.raw_moment(self.mixture, powers, centre) if self.kind == "mixture" else None

    def marginal(self, axes: Sequence[int]) -> dict[str, Any]:
        """Particles of the density of some axes, by name: the same kernel, with its variance there."""
        ratio = math.sqrt(self.kernel.variance / kernel_variance(self.kernel.kind, len(axes)))
        return {"x": self.x[:, axes], "mass": self.mass, "h": ratio * self.h, "read_out": self.kind}

    def ends(self) -> tuple[Floats, Floats, Floats]:
        return self.mixture.ends()

    def around(self, domain: Domain) -> "Kernels":
        """The kernels with their images beyond the ends of a domain."""
        reach = self.kernel.radius * self.h.max()
        seen = domain.seen(domain.fold(self.x), self.mass, self.h, reach)
        return replace(self, images=mixture.mixture(*seen, self.kernel))

    def turns(self, domain: Domain, X: Floats) -> list[Floats]:
        """States at which to ask for the density of states X in a domain: images stand beyond its ends."""
        return [domain.fold(X)]


@dataclass(frozen=True, eq=False)
class Polynomials(Shape):
    """Polynomials of log p between the nodes of a lattice, tails included."""

    field: Field
    x: Floats  # (N, n), the nodes
    mass: Floats  # (N,)
    moments: Moments | None  # beyond the cut too
    walls: Walls = NO_WALLS  # where it ends

    @property
    def cell(self) -> Floats:
        return self.field.A

    @cached_property
    def cells(self) -> Floats:
        return marginal.around(self.field, self.walls)

    def logpdf(self, X: Floats) -> Floats:
        return lattice_field.log_p_at(self.field, X)

    def gradient(self, X: Floats) -> Floats:
        return self.pdf(X)[:, None] * lattice_field.gradient(self.field, X)

    def mean(self) -> Floats:
        return self.mass @ self.x if self.moments is None else self.moments[0].copy()

    def cov(self, centre: Floats) -> Floats:
        if self.moments is not None:
            return self.moments[1].copy()
        d = self.x - centre
        return (d * self.mass[:, None]).T @ d

    def states(self, count: int, smooth: bool) -> tuple[Floats, Floats]:
        """States in every cell.

        Those of all cells lie in rows: sums of `smooth` functions are spectrally accurate then, while an edge
        along the rows would be known to the distance between two of them only; so else each cell has its own.
        """
        n, found = len(self.field.mu), len(self.cells)
        return self._weighed(_cell_points(n, found, smooth))

    def survey(self) -> tuple[Floats, Floats]:
        """States (M, n) in every cell, one at least, and their probabilities."""
        return self._weighed(_cell_points(len(self.field.mu), len(self.cells), False, 2**13, 0))

    def sample(self, size: int, rng: np.random.Generator) -> Floats:
        X, w = self._weighed(rng.random((32, len(self.field.mu))))
        return X[rng.choice(len(X), size=size, p=w)]

    def scattered(self, count: int, key: int) -> tuple[Floats, Floats]:
        """Points in the cells: of many states in each, as many as the density says; some of all modes alike.

        Of a mode that holds next to nothing, and that a reading may make much of, points know then, too.
        """
        cells, n = len(self.cells), len(self.field.mu)
        if not cells:
            raise PropagationError(
                f"no points can be drawn from so coarse a lattice of {n} states; use more particles"
            )
        each = 2 ** math.ceil(math.log2(max(_CANDIDATES * count / cells, 2.0)))
        X = self.in_cells(spread_evenly(each, n))
        p = self.pdf(X) * inside(self.walls, X)
        p /= p.sum()
        mode = np.repeat(lattice_field.modes(self.field, self.cells, p.reshape(cells, each).sum(1)), each)
        held, often = np.bincount(mode, p), p
        if (many := np.count_nonzero(held)) > 1:
            often = p * (1.0 - _OF_MODES + _OF_MODES / many / np.maximum(held, TINY)[mode])
        taken = systematic(often, count)
        w = p[taken] / often[taken]
        points = X[taken] + (quasi_random(count, n, key) - 0.5) * each ** (-1.0 / n) @ self.field.A.T
        return points, w / w.sum()

    def marginal(self, axes: Sequence[int]) -> dict[str, Any]:
        """Particles of the density of some axes, by name: summed over the others, on a lattice of its own."""
        laid = marginal.marginal_on_lattice(self.field, self.x, self.mass, axes, self.walls)
        if self.moments is not None:
            mean, cov = self.moments  # beyond the cut too
            laid = laid._replace(mean=mean[axes], cov=cov[np.ix_(axes, axes)])
        return lattice_particles(laid)

    def ends(self) -> tuple[Floats, Floats, Floats]:
        width = np.array([self.field.A[0, 0]])
        return self.cells.min() - width, self.cells.max() + width, width

    def around(self, domain: Domain) -> "Polynomials":
        """The polynomials between the walls of a domain; along angles they may lie several times round."""
        return replace(self, walls=domain.walls)

    def turns(self, domain: Domain, X: Floats) -> list[Floats]:
        """States X turned round periodic axes, as often as the nodes go round."""
        turns = [domain.fold(X)]
        for d in np.flatnonzero(domain.periodic):
            low, period = domain.low[d], domain.period[d]
            first, last = (np.floor((x - low) / period) for x in (self.x[:, d].min(), self.x[:, d].max()))
            shift = np.eye(len(domain.low))[d] * period
            turns = [Y + k * shift for Y in turns for k in np.arange(first - 1, last + 2)]
        return turns

    def _weighed(self, uniform: Floats) -> tuple[Floats, Floats]:
        """States in all cells, as of `in_cells`, that lie between the walls; and their probabilities."""
        X = self.in_cells(uniform)
        X = X[inside(self.walls, X)] if self.walls[0].size else X
        p = self.pdf(X)
        return X, p / p.sum()

    def in_cells(self, uniform: Floats) -> Floats:
        """States (M k, n) in all cells, at `uniform` (k, n) or (M, k, n) parts of them."""
        offsets = (uniform % 1.0 - 0.5) @ self.field.A.T
        return (self.cells[:, None] + offsets).reshape(-1, offsets.shape[-1])


def _cell_points(n: int, cells: int, smooth: bool, most: int = CELL_POINTS, least: int = 4) -> Floats:
    """Points (k, n) of a unit cell; or (cells, k, n), each cell's own, where sums in rows are no use."""
    from scipy.stats import qmc  # on use: import time

    count = 2 ** int(np.clip(np.log2(most / cells), least, 7))
    uniform = qmc.Sobol(n, scramble=False).random(count) + 0.5 / count
    return uniform if smooth else uniform + spread_evenly(cells, n)[:, None]


def lattice_particles(laid: LatticeDensity) -> dict[str, Any]:
    """Fields of a density on a lattice, by name: arguments of `ParticleDensity`."""
    spacing = abs(np.linalg.det(laid.field.A)) ** (1.0 / laid.x.shape[1])
    return {
        "x": laid.x,
        "mass": laid.mass,
        "h": np.full(len(laid.x), LATTICE_SUPPORT * spacing),
        "read_out": "log_density",
        "log_density": laid.field.log_p[: laid.field.kept],
        "field": laid.field,
        "volume": laid.volume,
        "moments": (laid.mean, laid.cov),
    }
