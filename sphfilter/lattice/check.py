"""How well a lattice knows what was laid on it: its polynomials against the density between nodes."""

import itertools
from typing import NamedTuple

import numpy as np
from scipy.special import gammaincc

from .._types import Floats, OfStates
from ..core.field.field import Field
from ..core.field.walls import NO_WALLS, Walls
from ..core.limits import NOTHING, TINY
from . import field as lattice_field
from .level_set import LatticeDensity
from .regular import mean_and_cov
from .walls import inside, node_weights

#: Probability ε at L standard deviations widens a variance by ε L²: it counts as ε L² / 20, so that what may
#: be left out by default, .001, leaves variances within .02.
_FAR = 20.0
_DEEPEST = 2.0  # times a Gaussian's depth; measured: half takes 1.1 times the evaluations, twice no more


class Misfit(NamedTuple):
    """Errors of a lattice's polynomials between its nodes."""

    residual: float  # mean over the mass of |p / p' - 1|
    mean: float  # error of the mean, in standard deviations
    log_mass: float  # error of the logarithm of the integral
    edge: float = 0.0  # part of the mass that they put where there is none


def misfit(laid: LatticeDensity, log_p: OfStates) -> Misfit:
    """Compare a lattice's polynomials with what was laid, `log_p`, in the middles of its cells."""
    n = laid.x.shape[1]
    steps = range(-1, 3) if laid.walls[0].size else range(2)  # integrals to a wall see cells beyond it
    corners = np.array(list(itertools.product(steps, repeat=n)))
    cells = (laid.field.node[: laid.field.kept, None] + corners).reshape(-1, n)  # by their upper nodes
    low = cells.min(axis=0)
    dims = cells.max(axis=0) - low + 1
    flat = np.ravel_multi_index(tuple((cells - low).T), tuple(dims))
    cells = low + np.transpose(np.unravel_index(np.unique(flat), tuple(dims)))
    X = laid.field.mu + (cells - 0.5) @ laid.field.A.T
    part, within = node_weights(laid.walls, laid.field.A, X), inside(laid.walls, X)
    X, part, within = X[part != 0.0], part[part != 0.0], within[part != 0.0]
    asked, fitted = log_p(X) - laid.log_mass, laid.log_p(X)
    highest = max(asked.max(), fitted.max())
    p, q = np.exp(asked - highest), np.exp(np.maximum(fitted - highest, -NOTHING))
    off = np.abs(q - p)[within].sum() / max(p[within].sum(), TINY)
    edge = q[within & (p == 0.0)].sum() / max(p[within].sum(), TINY)
    p, q = p * part, q * part
    if not p.sum() > 0.0:
        return Misfit(1.0, 1.0, 1.0)
    residual = min(1.0, float(off))
    # sums over nodes and over the middles between them are two integrals of the same
    middle = p @ X / p.sum()
    apart = np.stack([middle - q @ X / q.sum(), middle - laid.mean], axis=1)
    whitened = np.linalg.solve(np.linalg.cholesky(laid.cov), apart)
    integral = highest + np.log(p.sum() * abs(np.linalg.det(laid.field.A)))
    log_mass = max(abs(float(np.log(p.sum() / q.sum()))), abs(float(integral)))
    return Misfit(residual, float(np.linalg.norm(whitened, axis=0).max()), log_mass, float(edge))


class Beside(NamedTuple):
    """Probability in the cells beyond the cut of a density."""

    mass: float = 0.0  # probability
    mean: float = 0.0  # what they would add to its mean, in standard deviations


def beside(field: Field | None, mean: Floats, cov: Floats, walls: Walls = NO_WALLS) -> Beside:
    """Probability in the cells that were asked beyond the cut; none where there is no lattice."""
    if field is None:
        return Beside()
    X, mass = cells_beside(field, walls)
    added = np.linalg.solve(np.linalg.cholesky(cov), mass @ (X - mean))
    return Beside(left_out(field, walls), float(np.linalg.norm(added)))


def cells_beside(field: Field, walls: Walls) -> tuple[Floats, Floats]:
    """States (K, n) and probabilities (K,) of the cells that were asked beyond the cut of a density."""
    X = field.mu + field.node[field.kept :] @ field.A.T
    return X, np.exp(field.log_p[field.kept :]) * abs(np.linalg.det(field.A)) * inside(walls, X)


def nodes_and_beside(x: Floats, mass: Floats, field: Field | None, walls: Walls) -> tuple[Floats, Floats]:
    """Nodes x (N, n) of a field with their probabilities, and `cells_beside`; without a field the points."""
    if field is None:
        return x, mass
    around = cells_beside(field, walls)
    return np.concatenate([x, around[0]]), np.concatenate([mass, around[1]])


class Remote(NamedTuple):
    """Moments that states beyond a lattice would add to its density."""

    mean: float = 0.0  # standard deviations
    variance: float = 0.0  # as a part of it, in the direction of most


def remote(mean: Floats, cov: Floats, x: Floats, mass: Floats) -> Remote:
    """What is too little to count as probability may be far enough away to count in a mean and variance.

    Of a density on a lattice, mean (n,) and cov (n, n), and of states x (N, n) beyond it with their
    probabilities, mass (N,).
    """
    d = np.linalg.solve(np.linalg.cholesky(cov), (x - mean).T)
    return Remote(float(np.linalg.norm(d @ mass)), float(np.linalg.eigvalsh((d * mass) @ d.T)[-1]))


def felt(mean: Floats, cov: Floats, x: Floats) -> Floats:
    """Times (M,) that probability at states (M, n) counts, by how far they lie from a density's mean (n,)."""
    d = np.linalg.solve(np.linalg.cholesky(cov), (x - mean).T)
    return np.maximum(np.einsum("am,am->m", d, d) / _FAR, 1.0)


def left_out(field: Field, walls: Walls = NO_WALLS) -> float:
    """Probability in the cells that were asked beyond those that were kept."""
    p = np.exp(field.log_p[: field.kept])
    if walls[0].size:
        x = lattice_field.nodes(field)
        p = np.exp(field.log_p) * node_weights(walls, field.A, x)
        p[field.kept :][inside(walls, x[field.kept :])] = 0.0
    return max(0.0, 1.0 - float(p.sum() * abs(np.linalg.det(field.A))))


def deep_enough(
    log_p: Floats, x: Floats, mass: Floats, depth: float, beyond: tuple[Floats, Floats] | None = None
) -> float:
    """Depth at which to cut a density so that no more is left out than `depth` leaves out of a Gaussian.

    Pieces of it may be far lower than its highest, though not negligible, and its tails heavier. Its cells x
    (N, n) have `log_p` and `mass` (N,); both depths are nats below the highest value, and `beyond` are states
    (K, n) and probabilities (K,) of cells beyond these, in tails that end at about that depth.
    """
    allowed, own = gammaincc(0.5 * x.shape[1], depth), mass / mass.sum()
    mean, cov = mean_and_cov(x, own)
    counted = own * felt(mean, cov, x)
    missed = 0.0 if beyond is None else float(felt(mean, cov, beyond[0]) @ beyond[1])
    lowest_first = np.argsort(log_p)
    kept = np.cumsum(counted[lowest_first]) > allowed
    lowest = float(log_p.max() - log_p[lowest_first[np.argmax(kept)]])
    tails = depth + np.log(max(1.0, missed / allowed))
    return min(max(depth, lowest, tails), _DEEPEST * depth)
