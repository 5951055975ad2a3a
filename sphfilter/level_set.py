"""Lattices that follow a density's level set: whitened, trimmed where log p has fallen far enough, any shape.

Where 002 (39) keeps an ellipsoid, the nodes kept here are those with log p > log p_max - Z²/2: the same
ellipsoid for a Gaussian, and the right region for anything else, in several pieces if need be. The lattice
grows from seeds over the neighbours of kept nodes until its edge is closed, so nothing is asked of the
density far away.
"""

import math
from typing import NamedTuple

import numpy as np

from .core.field import cells
from .core.field.cells import UNKNOWN, frontier
from .core.field.field import Field, evaluate
from .core.field.field import gradient as field_gradient
from .core.field.fitting import build_field
from .core.field.nodes import MOST_ASKED, relaid
from .core.field.shape import LOCAL, local_shape
from .core.field.stencils import stencils
from .errors import ModelError, PropagationError

__all__ = ["Laid", "at", "fewest_particles", "gaussian_volume", "gradient", "lay", "local", "outside",
           "posterior", "reach"]  # fmt: skip

_TRIES = 24
_STEP = 0.02  # of slopes, in standard deviations: far wider than jumps between polynomials can harm
_SKEWED = 6.0  # largest over smallest variance in coordinates that should be whitened
_ROUNDS = 60  # of sharpening a likelihood
_ENOUGH = 0.35  # nodes that have to count, over those of a Gaussian on a lattice of its own
_POWERS = 1.02  # ratio of two powers that are not told apart
_SMALL_BOX = 4  # cells, over the number of particles wanted
_LAYERS = 0.15  # least variance of the points that count, in units of their lattice: three layers
_ROUNDED = 20.0  # roundings a standard deviation must be wide
_LOW_DENSITY = 1e-300  # of masses


class Laid(NamedTuple):
    """A density on a lattice of its own."""

    x: np.ndarray  # (N, n)
    mass: np.ndarray  # (N,)
    field: Field
    log_mass: float  # log of the integral before it was normalised
    volume: float  # of the kept region in whitened coordinates
    mean: np.ndarray  # (n,)
    cov: np.ndarray  # (n, n)


def at(field, X):
    """log p of a field at the states X (M, n)."""
    out = np.empty(len(X))
    evaluate(field, stencils(field.mu.size), np.ascontiguousarray(X, dtype=float), out)
    return out


def gradient(field, X):
    """Gradient of `at` at the states X (M, n), shape (M, n)."""
    out = np.empty(X.shape)
    field_gradient(field, stencils(field.mu.size), np.ascontiguousarray(X, dtype=float), out)
    return out @ field.inverse


def outside(field, x, mass):
    """Probability of weighted states x (N, n) in cells where a field has no node: its values are a guess."""
    cell = np.floor((x - field.mu) @ field.inverse.T + 0.5) - field.low
    boxed = ((cell >= 0) & (cell < field.dims)).all(axis=1)
    flat = np.ravel_multi_index(tuple(cell[boxed].astype(np.int64).T), tuple(field.dims))
    return max(0.0, 1.0 - float(mass[boxed][field.owner[flat] >= 0].sum()))


def reach(scheme, n):
    """Z of a scheme in n dimensions: as far out as particles are cheap."""
    given = getattr(scheme, "reach", None)
    return given or {1: 5.5, 2: 4.2}.get(n, 4.0)


def gaussian_volume(n, depth):
    """Volume of the whitened ball in which a Gaussian's log p is at most `depth` below its largest."""
    return math.pi ** (n / 2) / math.gamma(n / 2 + 1) * (2.0 * depth) ** (n / 2)


def fewest_particles(n):
    """Particles below which no lattice resolves a Gaussian: a complete node two cells from the centre."""
    return (3**n if n <= 2 else 2 * n * n + 1) * (2 if n > 1 else 3)


def lay(log_p, mean, factor, seeds, n_particles, depth, volume=None):
    """Put a density on a lattice of at most `n_particles` nodes, and at least about half of that.

    Parameters
    ----------
    log_p : callable
        States (M, n) to logarithms of an unnormalised density (M,).
    mean, factor : ndarray, shape (n,), (n, n)
        Origin, and the lower factor of a covariance: the coordinates that are whitened.
    seeds : ndarray, shape (S, n)
        States at least one of which lies in every piece of the region.
    n_particles : int
    depth : float
        Z²/2.
    volume : float, optional
        First guess of the kept whitened volume.

    Returns
    -------
    Laid

    Raises
    ------
    PropagationError
        No spacing gives a lattice with complete nodes.
    """
    n, sten = len(mean), stencils(len(mean))
    if np.any(np.sqrt((factor**2).sum(axis=1)) < _ROUNDED * np.spacing(np.abs(mean))):
        raise PropagationError(
            f"the density near {mean} is narrower than floating-point numbers resolve that far from zero; "
            f"count states from a nearer origin"
        )
    volume = gaussian_volume(n, depth) if volume is None else volume
    best, count, too_fine, too_coarse = None, 0, 0.0, math.inf
    for _ in range(_TRIES):
        spacing = (volume / (0.92 * n_particles)) ** (1.0 / n)
        A = np.ascontiguousarray(factor * spacing)
        value, low, dims, highest, asked = _flood(log_p, mean, A, seeds, depth, sten, n_particles)
        new = relaid(value, low, dims, highest, asked, mean, A, sten, depth)
        closed = asked.size < MOST_ASKED * n_particles
        count = len(new[0]) if closed else asked.size
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
            f"(the last one had {count}); use more particles"
        )
    A, volume, node, x, log_density, mass, log_mass, new_mean, cov = best
    return Laid(x, mass, build_field(mean, A, node, log_density, sten), log_mass, volume, new_mean, cov)


def _flood(log_p, mean, A, seeds, depth, sten, n_particles):
    """Values of log p on all lattice cells within `depth` of the largest, from the seeds outwards."""
    n = len(mean)
    ball = sten.offsets[: sten.size[0]]
    low, dims = np.empty(n, np.int64), np.empty(n, np.int64)
    seeds, reach = np.ascontiguousarray(seeds), cells.furthest(n)
    at_seeds = cells.seeds_in_box(seeds, mean, np.linalg.inv(A), reach, low, dims)
    if np.prod(dims.astype(float)) > cells.MOST_CELLS:
        raise PropagationError(_spread(mean))
    value, asked, highest = np.full(np.prod(dims), UNKNOWN), np.empty(0, np.int64), -np.inf
    if value.size <= _SMALL_BOX * n_particles:
        asked, highest, beyond = _asked_at_once(log_p, mean, A, value, low, dims, depth, ball)
        if not beyond:
            return value, low, dims, highest, asked
        value, low, dims, asked = cells.widen(value, low, dims, asked)
        found, _ = frontier(value, asked, highest - depth, dims, ball)
    else:
        found = cells.seeded(at_seeds, low, dims)
    while found.size and asked.size < MOST_ASKED * n_particles:
        _, states = cells.states_of(found, mean, A, low, dims)
        value[found] = log_p(states)
        highest = max(highest, value[found].max())
        asked = np.concatenate([asked, found])
        found, beyond = frontier(value, asked, highest - depth, dims, ball)
        if beyond:
            value, low, dims, asked = cells.widen(value, low, dims, asked)
            if value.size == 0:
                raise PropagationError(_spread(mean))
            found, beyond = frontier(value, asked, highest - depth, dims, ball)
    return value, low, dims, highest, asked


def _asked_at_once(log_p, mean, A, value, low, dims, depth, ball):
    """All cells of a small box: waves from the seeds would cost more than the cells they save.

    Values of cells above the depth and of those beside go into `value`, as if the rest had not been asked.
    """
    _, states = cells.states_of(np.arange(value.size), mean, A, low, dims)
    everywhere = log_p(states)
    highest = everywhere.max()
    kept = np.flatnonzero(everywhere > highest - depth)
    value[kept] = everywhere[kept]
    rim, beyond = frontier(value, kept, highest - depth, dims, ball)
    value[rim] = everywhere[rim]
    return np.concatenate([kept, rim]), highest, beyond


def _spread(mean):
    return (
        f"the density near {mean} is spread over more lattice cells than fit into memory: its pieces are "
        f"much smaller than the distance between them, or it has no edge"
    )


def posterior(x, mass, log_prior, log_weight, n_particles, depth, cell=None):
    """Lay prior times likelihood, however sharp the likelihood or far out its peak.

    The likelihood is raised to a power under which it is wide enough for the points at hand, the product is
    laid, and its nodes are the points of the next, higher power: the lattice closes in on the posterior, all
    its pieces at once.

    Parameters
    ----------
    x, mass : ndarray, shape (N, n), (N,)
        Points of the prior.
    log_prior, log_weight : callable
        States (M, n) to (M,); the weight may be minus infinity.
    n_particles : int
    depth : float
    cell : ndarray, shape (n, n), optional
        Lattice vectors of the points, in columns, if they lie on a lattice.

    Returns
    -------
    Laid
        Its log_mass is the log-evidence.
    """
    n = x.shape[1]
    counting = (4.0 * math.pi) ** (n / 2) / gaussian_volume(n, depth)  # effective part of a Gaussian's nodes
    enough = min(2.0 * 3.0**n, _ENOUGH * counting * n_particles)
    log_mass = np.log(np.maximum(mass, _LOW_DENSITY))
    power, closed_in, laid = 0.0, False, None
    for _ in range(_ROUNDS):
        weight = log_weight(x)
        if not np.any(weight > -np.inf):
            raise PropagationError(
                "prior times likelihood is zero wherever the prior has particles: check the measurement, its "
                "unit and its noise"
            )
        on_lattice = None if cell is None else np.linalg.solve(cell, x.T).T
        power = _power(log_mass, weight, power, enough, on_lattice)
        heavy = log_mass + power * np.where(weight > -np.inf, weight, -1e300)
        w = np.exp(heavy - heavy.max())
        effective = w.sum() ** 2 / (w @ w)
        w /= w.sum()
        mean = w @ x
        factor = _factor(x, w, mean, mass)
        if np.isnan(factor).any():
            raise ModelError("the posterior's covariance is not finite; check the likelihood")
        heavy = w > w.max() * math.exp(-depth)
        seeds = x[heavy]

        def product(Y, power=power):
            return log_prior(Y) + power * np.maximum(log_weight(Y), -1e250)

        factor = _within(product, seeds, w[heavy], factor)
        if closed_in:  # the nodes know the pieces of the posterior now
            factor, seeds = local(laid), x
        volume = None
        if cell is not None and len(seeds) >= enough:  # the region's own cells, measured by the new ones
            volume = len(seeds) * abs(np.linalg.det(cell)) / np.prod(np.diag(factor))
        laid = lay(product, mean, factor, seeds, n_particles, depth, volume)
        if power == 1.0 and (effective >= enough or closed_in) and _whitened(factor, local(laid)):
            return laid
        closed_in, cell = power == 1.0, laid.field.A
        x, mass, log_mass = laid.x, laid.mass, np.log(np.maximum(laid.mass, _LOW_DENSITY))
        # What the nodes carry already is the likelihood to the power reached.
        log_mass = log_mass - power * np.maximum(log_weight(x), -1e250)
        log_mass -= log_mass.max()
    if power == 1.0:
        return laid
    raise PropagationError("the likelihood is too sharp to close in on; check the measurement's noise")


def _power(log_mass, weight, reached, enough, y):
    """Largest power of the likelihood under which enough points count; more than reached before.

    Points y (N, n) in units of their lattice must count in more than one of its layers in every direction.
    """

    def effective(power):
        heavy = log_mass + power * np.where(weight > -np.inf, weight, -1e300)
        w = np.exp(heavy - heavy.max())
        count = w.sum() ** 2 / (w @ w)
        if y is None or count < enough:
            return count
        d = y - w @ y / w.sum()
        thinnest = np.linalg.eigvalsh((d * (w / w.sum())[:, None]).T @ d)[0]
        return count if thinnest > _LAYERS else 0.0

    if effective(1.0) >= enough:
        return 1.0
    low, high = max(reached, 1e-12), 1.0
    while high > _POWERS * low:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if effective(middle) >= enough else (low, middle)
    return min(1.0, max(low, 1.05 * reached))


def local(laid):
    """Lower factor of the covariance within the pieces of a density: see `local_shape`."""
    L = np.linalg.cholesky(laid.cov)
    shape = np.empty_like(L)
    local_shape(laid.field, laid.mass, L, shape)
    return L @ shape


def _within(log_p, x, w, factor):
    """A factor of the covariance within the pieces of a density, from its slopes at weighted points.

    As `local_shape`, before there is a lattice: a posterior in two thin pieces needs a spacing that
    resolves each of them.
    """
    step = _STEP * factor.T[:, None]
    around = np.concatenate([x + step, x - step]).reshape(-1, x.shape[1])
    ahead, behind = log_p(around).reshape(2, -1, len(x))
    slopes = np.clip((ahead - behind) / (2.0 * _STEP), -1e100, 1e100).T
    information = (slopes * (w / w.sum())[:, None]).T @ slopes
    values, axes = np.linalg.eigh(information)
    if not np.isfinite(values).all() or values[-1] * LOCAL < 1.0:
        return factor
    inverse = (axes / np.maximum(values, 1.0)) @ axes.T  # no piece is wider than the whole
    return factor @ np.linalg.cholesky(inverse)


def _whitened(factor, other):
    """Does a factor whiten what another does, nearly enough for a lattice?"""
    ratio = np.linalg.solve(factor, other)
    spread = np.linalg.eigvalsh(ratio @ ratio.T)
    return spread[-1] < _SKEWED * spread[0]


def _factor(x, w, mean, mass):
    """Lower factor of the weighted covariance; flat directions get a thousandth of the points' own spread."""
    d = x - mean
    cov = (d * w[:, None]).T @ d
    own = x - mass @ x
    spread = (own * mass[:, None]).T @ own
    try:
        return np.linalg.cholesky(cov + 1e-9 * spread)
    except np.linalg.LinAlgError:
        scale = np.sqrt(np.maximum(np.diag(spread), 1e-300))
        w_, V = np.linalg.eigh((cov + 1e-9 * spread) / np.outer(scale, scale))
        root = V * np.sqrt(np.maximum(w_, 1e-12 * max(w_.max(), 1e-300)))
        return np.linalg.cholesky(scale[:, None] * (root @ root.T) * scale)
