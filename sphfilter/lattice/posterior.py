"""Closing in on a posterior, however sharp the likelihood."""

import math
from typing import Any

import numpy as np

from .._types import Floats, OfStates
from ..core.field.shape import local_shape
from ..core.field.walls import Walls
from ..core.limits import ALIKE, ROUNDS, TINY
from ..errors import ModelError, PropagationError
from .level_set import LatticeDensity, gaussian_volume, lay
from .regular import mean_and_cov

_STEP = 0.02  # of slopes, in standard deviations; measured: half and twice move means by .0007 at most
#: Largest over least variance that is whitened enough. Measured by tests/recorded_runs.py: half and twice
#: change no run, but without it one of modes ends on another lattice, whose covariance is 1.8 % apart.
_SKEWED = 6.0
_ENOUGH = 0.35  # nodes that have to count, over a Gaussian's; measured: half fails in test_update_seeing.py
_POWERS = 1.02  # ratio of powers not told apart; measured: 1.01, 1.05 take .76, .87 times the work
#: Least variance in units of the lattice: that of three layers. Measured by tests/lattice/test_posterior.py:
#: without it a reading of one of four states is held by no lattice.
_LAYERS = 0.15


def posterior(
    x: Floats,
    mass: Floats,
    log_prior: OfStates,
    log_weight: OfStates,
    n_particles: int,
    depth: float,
    cell: Floats | None,
    walls: Walls,
) -> LatticeDensity:
    """Lay prior times likelihood, however sharp the likelihood or far out its peak.

    The likelihood is raised to a power under which it is wide enough for the points at hand, the product is
    laid, and its nodes are the points of the next, higher power: the lattice closes in on the posterior, all
    its pieces at once. Its `log_mass` is the log-evidence.

    Points of the prior are x (N, n), of mass (N,); if they lie on a lattice, the columns of `cell` (n, n) are
    its vectors. `log_prior` and `log_weight`, which may be minus infinity, take states (M, n) to (M,); the
    rest is as of `lay`.
    """
    n = x.shape[1]
    counting = (4.0 * math.pi) ** (n / 2) / gaussian_volume(n, depth)  # effective part of a Gaussian's nodes
    enough = min(2.0 * 3.0**n, _ENOUGH * counting * n_particles)
    log_mass = np.log(np.maximum(mass, TINY))
    power: float = 0.0
    laid: LatticeDensity | None = None
    closed_in = False
    for _ in range(ROUNDS):
        weight = log_weight(x)
        if not np.any(weight > -np.inf):
            raise PropagationError(
                "prior times likelihood is zero wherever the prior has particles: check the measurement, its "
                "unit and its noise"
            )
        on_lattice: Any = None if cell is None else np.linalg.solve(cell, x.T).T
        power = _power(log_mass, weight, power, enough, on_lattice)
        w = _weights(log_mass, weight, power)
        effective = w.sum() ** 2 / (w @ w)
        w /= w.sum()
        mean, cov = mean_and_cov(x, w)
        factor = _factor(cov, mean_and_cov(x, mass)[1])
        if np.isnan(factor).any():
            raise ModelError("the posterior's covariance is not finite; check the likelihood")
        heavy = w > w.max() * math.exp(-depth)
        seeds = x[heavy]

        def product(Y: Floats, power: float = power) -> Floats:
            return log_prior(Y) + power * np.maximum(log_weight(Y), -1e250)

        factor = _within(product, seeds, w[heavy], factor)
        if closed_in and laid is not None:  # the nodes know the pieces of the posterior now
            factor, seeds = within_pieces(laid), x
        volume = None
        if cell is not None and len(seeds) >= enough:  # the region's own cells, measured by the new ones
            volume = len(seeds) * abs(np.linalg.det(cell)) / np.prod(np.diag(factor))
        laid = lay(product, mean, factor, seeds, n_particles, depth, volume, walls)
        if power == 1.0 and (effective >= enough or closed_in) and _whitened(factor, within_pieces(laid)):
            return laid
        closed_in, cell = power == 1.0, laid.field.A
        x, mass, log_mass = laid.x, laid.mass, np.log(np.maximum(laid.mass, TINY))
        # What the nodes carry already is the likelihood to the power reached.
        log_mass = log_mass - power * np.maximum(log_weight(x), -1e250)
        log_mass -= log_mass.max()
    if power == 1.0 and laid is not None:
        return laid
    raise PropagationError("the likelihood is too sharp to close in on; check the measurement's noise")


def _weights(log_mass: Floats, weight: Floats, power: float) -> Floats:
    """Weights (N,), the largest one, of points of the prior under a power of the likelihood."""
    heavy = log_mass + power * np.where(weight > -np.inf, weight, -1e300)
    return np.exp(heavy - heavy.max())


def _power(log_mass: Floats, weight: Floats, reached: float, enough: float, y: Floats | None) -> float:
    """Largest power of the likelihood under which enough points count; more than reached before.

    Points y (N, n) in units of their lattice must count in more than one of its layers in every direction.
    """

    def effective(power: float) -> float:
        w = _weights(log_mass, weight, power)
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


def within_pieces(laid: LatticeDensity) -> Floats:
    """Lower factor of the covariance within the pieces of a density: see `local_shape`."""
    L: Any = np.linalg.cholesky(laid.cov)
    shape = np.empty_like(L)
    local_shape(laid.field, laid.mass, L, shape)
    return L @ shape


def _within(log_p: OfStates, x: Floats, w: Floats, factor: Floats) -> Floats:
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
    if not np.isfinite(values).all() or values[-1] * ALIKE < 1.0:
        return factor
    narrower = _lower(axes / np.sqrt(np.maximum(values, 1.0)))  # no piece is wider than the whole
    return np.asarray(factor @ narrower, dtype=float)


def _whitened(factor: Floats, other: Floats) -> bool:
    """Does a factor whiten what another does, nearly enough for a lattice?"""
    ratio = np.linalg.solve(factor, other)
    spread = np.linalg.eigvalsh(ratio @ ratio.T)
    return spread[-1] < _SKEWED * spread[0]


def _factor(cov: Floats, spread: Floats) -> Floats:
    """Lower factor of a covariance; flat directions get a thousandth of the points' own spread."""
    try:
        return np.asarray(np.linalg.cholesky(cov + 1e-9 * spread))
    except np.linalg.LinAlgError:
        scale = np.sqrt(np.maximum(np.diag(spread), TINY))
        w_, V = np.linalg.eigh((cov + 1e-9 * spread) / np.outer(scale, scale))
        root = V * np.sqrt(np.maximum(w_, 1e-12 * max(w_.max(), TINY)))
        return _lower(scale[:, None] * root)


def _lower(root: Floats) -> Floats:
    """Lower factor of root @ root.T, however thin that is: no squares are taken on the way."""
    R: Floats = np.linalg.qr(root.T)[1]
    return R.T * np.sign(np.diag(R))
