"""Lattices that follow a density's level set: whitened, trimmed where log p has fallen far enough, any shape.

Where 002 (39) keeps an ellipsoid, the nodes kept here are those with log p > log p_max - Z²/2: the same
ellipsoid for a Gaussian, and the right region for anything else, in several pieces if need be. The lattice
grows from seeds over the neighbours of kept nodes until its edge is closed, so nothing is asked of the
density far away.
"""

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from .._types import Floats, Ints, OfStates
from ..core.field import cells
from ..core.field.field import Field
from ..core.field.fitting import build_field
from ..core.field.nodes import MOST_ASKED, relaid
from ..core.field.stencils import stencils
from ..core.field.walls import NO_WALLS, Walls
from ..core.limits import ROUNDS
from ..errors import PropagationError
from .field import log_p_at
from .walls import near_walls

_SMALL_BOX = 4  # cells of each particle, asked at once; measured: half takes 1.01 times the evaluations
#: Spacing, in standard deviations, of a lattice whose sums have the variance of a Gaussian within 1.5 %: by
#: Poisson's formula they lack 2 k² exp(-k²/2) of it, k = 2 pi / spacing.
_WIDE = 1.6
#: Roundings that a standard deviation must be wide: nodes are off by half of one at most, and log p, with the
#: slope of a standard deviation out, by 1 / 40 = 2.5 %.
_ROUNDED = 20.0


class LatticeDensity(NamedTuple):
    """A density on a lattice of its own."""

    x: Floats  # (N, n)
    mass: Floats  # (N,)
    field: Field
    log_mass: float  # log of the integral before it was normalised
    volume: float  # of the kept region in whitened coordinates
    mean: Floats  # (n,)
    cov: Floats  # (n, n)
    walls: Walls = NO_WALLS  # where it ends

    def log_p(self, X: Floats) -> Floats:
        """Logarithm of the density at states (M, n), by its polynomials, shape (M,)."""
        return log_p_at(self.field, X)


def lattice_reach(scheme: object, n: int) -> float:
    """Z of a scheme in n dimensions: as far out as particles are cheap."""
    given = getattr(scheme, "reach", None)
    return given or {1: 5.5, 2: 4.2}.get(n, 4.0)


def lattice_depth(scheme: object, n: int) -> float:
    """Nats below the highest value of a Gaussian's log p at its Z: where lattices are cut."""
    return 0.5 * lattice_reach(scheme, n) ** 2


def root_of(cov: Floats, why: str = "a piece is flat along some combination of the states") -> Floats:
    """Lower factors of covariances (..., n, n); raises `PropagationError` that says why where one is flat."""
    try:
        return np.asarray(np.linalg.cholesky(cov), np.float64)
    except np.linalg.LinAlgError:
        raise PropagationError(why) from None


def gaussian_volume(n: int, depth: float) -> float:
    """Volume of the whitened ball in which a Gaussian's log p is at most `depth` below its largest."""
    return math.pi ** (n / 2) / math.gamma(n / 2 + 1) * (2.0 * depth) ** (n / 2)


def fewest_particles(n: int) -> int:
    """Particles below which no lattice resolves a Gaussian: a complete node two cells from the centre."""
    return (3**n if n <= 2 else 2 * n * n + 1) * (2 if n > 1 else 3)


@cache
def min_nodes(dim: int) -> int:
    """Number of nodes that a lattice begins with, and never has less of."""
    return max(60, 3 * fewest_particles(dim))


def usual_nodes(dim: int) -> int:
    """Number of nodes of a lattice of a density that lay on none before."""
    return 4 * min_nodes(dim)


def enough_particles(n: int) -> int:
    """Particles, to two digits, of a lattice that holds a Gaussian of n states and its variance."""
    nodes = gaussian_volume(n, lattice_depth(None, n)) / _WIDE**n
    return max(fewest_particles(n), int(float(f"{nodes:.2g}")))


def lay(
    log_p: OfStates,
    mean: Floats,
    factor: Floats,
    seeds: Floats,
    n_particles: int,
    depth: float,
    volume: float | None = None,
    walls: Walls = NO_WALLS,
) -> LatticeDensity:
    """Put a density on a lattice of at most `n_particles` nodes, and at least about half of that.

    Of states (M, n) `log_p` gives the logarithms (M,) of an unnormalised density; the origin `mean` (n,) and
    the lower `factor` (n, n) of a covariance are the coordinates that are whitened. At least one of the
    states `seeds` (S, n) lies in every piece of the region, whose `depth` is Z²/2, and whose kept whitened
    volume may be guessed. A few cells beyond walls log_p is asked for its smooth continuation. Raises
    `PropagationError` if no spacing gives a lattice with complete nodes.
    """
    n, sten = len(mean), stencils(len(mean))
    if np.any(np.sqrt((factor**2).sum(axis=1)) < _ROUNDED * np.spacing(np.abs(mean))):
        raise PropagationError(
            f"the density near {mean} is narrower than floating-point numbers resolve that far from zero; "
            f"count states from a nearer origin"
        )
    volume = gaussian_volume(n, depth) if volume is None else volume
    best, count, too_fine, too_coarse = None, 0, 0.0, math.inf
    ball = sten.offsets[: sten.size[0]]
    seeds, low, dims = np.ascontiguousarray(seeds), np.empty(n, np.int64), np.empty(n, np.int64)
    for _ in range(ROUNDS):
        spacing = (volume / (0.92 * n_particles)) ** (1.0 / n)
        A = np.ascontiguousarray(factor * spacing)
        start = cells.seeds_in_box(seeds, mean, np.linalg.inv(A), cells.furthest(n), low, dims), low, dims
        most, at_once = MOST_ASKED * n_particles, _SMALL_BOX * n_particles
        ask = near_walls(log_p, walls, A, sten.widest)
        value, *box, asked, highest, fits = flood(
            ask, (mean, A), start, ball, depth, most=most, at_once=at_once
        )
        if not fits:
            raise PropagationError(
                f"the density near {mean} is spread over more lattice cells than fit into memory: its pieces "
                f"are much smaller than the distance between them, it has no edge, or {n} states are too many"
            )
        new = relaid((value, *box, highest, asked), mean, A, sten, depth, walls)
        count = len(new[1]) if asked.size < most else asked.size
        if 0 < count <= n_particles:
            best = A, count * spacing**n, *new
            if count >= 0.5 * n_particles:
                break
        if count > n_particles:
            too_fine = max(too_fine, volume)
        else:
            too_coarse = min(too_coarse, volume)
        guess = volume * np.clip(count, 0.1 * n_particles, 10.0 * n_particles) / (0.92 * n_particles)
        volume = guess if too_fine < guess < too_coarse else math.sqrt(too_fine * too_coarse)
    if best is None:
        raise PropagationError(
            f"no lattice of at most {n_particles} particles resolves the density of {n} states near {mean} "
            f"(the last one had {count}); use more particles: a Gaussian of {n} states takes about "
            f"{enough_particles(n)}"
        )
    A, volume, node, x, log_density, mass, log_mass, new_mean, cov = best
    return LatticeDensity(
        x, mass, build_field(mean, A, node, len(x), log_density, sten), log_mass, volume, new_mean, cov, walls
    )


class Flooded(NamedTuple):
    """Cells that have been asked, in a box around them."""

    value: Floats  # of all cells of the box; `cells.UNKNOWN` where none was asked for
    low: Ints  # (n,), corner of the box
    dims: Ints  # (n,)
    asked: Ints  # flat numbers of the cells that were asked
    highest: float  # value
    fits: bool  # the box did not outgrow the memory


def flood(
    ask: OfStates, frame: tuple[Floats, Floats], start: tuple[Ints, Ints, Ints], ball: Ints, depth: float, *,
    most: float = math.inf, at_once: float = 0, highest: float = -math.inf,
) -> Flooded:  # fmt: skip
    """Values on all cells of a lattice that lie within a depth of the largest value, and on those beside.

    `ask` takes states (M, n) to values (M,). The lattice's frame is the middle (n,) of cell zero, and vectors
    (n, n) in columns. It `start`s with cells (S, n), one at least in every piece of the region, and corner
    and size (n,) of a box around them; a `ball` (B, n) are the steps from a cell to those beside it. After
    `most` cells no more are asked; of a box as small as `at_once` all are asked at once. The `highest` value
    is that which is known.
    """
    found, low, dims = start
    if np.prod(dims.astype(float)) > cells.MOST_CELLS:
        return Flooded(np.empty(0), low, dims, np.empty(0, np.int64), highest, False)
    value, asked = np.full(np.prod(dims), cells.UNKNOWN), np.empty(0, np.int64)
    if value.size <= at_once:
        asked, highest, whole = _at_once(ask, frame, (value, low, dims), depth, ball)
        if whole:
            return Flooded(value, low, dims, asked, highest, True)
        grown = cells.grown(value, low, dims, asked, highest - depth, ball)
    else:
        grown = value, low, dims, asked, cells.seeded(found, low, dims)
    while grown is not None and grown[-1].size and grown[-2].size < most:
        value, low, dims, asked, found = grown
        value[found] = ask(cells.states_of(found, *frame, low, dims)[1])
        highest, asked = max(highest, value[found].max()), np.concatenate([asked, found])
        grown = cells.grown(value, low, dims, asked, highest - depth, ball)
    if grown is not None:
        value, low, dims, asked, _ = grown
    return Flooded(value, low, dims, asked, highest, grown is not None)


def _at_once(
    ask: OfStates, frame: tuple[Floats, Floats], box: tuple[Floats, Ints, Ints], depth: float, ball: Ints
) -> tuple[Ints, float, bool]:
    """All cells of a small box: waves would cost more than the cells they save.

    Values of cells above the depth and of those beside go into the box, as if the rest had not been asked.
    Returns the numbers of these cells, the largest value, and whether the box holds them all.
    """
    value, low, dims = box
    everywhere = ask(cells.states_of(np.arange(value.size), *frame, low, dims)[1])
    highest = everywhere.max()
    kept = np.flatnonzero(everywhere > highest - depth)
    value[kept] = everywhere[kept]
    rim, beyond = cells.frontier(value, kept, highest - depth, dims, ball)
    value[rim] = everywhere[rim]
    return np.concatenate([kept, rim]), highest, not beyond
