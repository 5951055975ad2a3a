"""The search for parameters of largest log-evidence: a simplex, then Newton's method, within bounds."""

import numpy as np

from .._types import Bools, Floats
from ..core.limits import LEAP, ROUNDS, TINY
from .evidence import Evidence
from .quadratic import (
    FIRST,
    STEPS,
    Function,
    Quadratic,
    first_steps,
    quadratic,
    scales,
    slope_step_for,
    slopes,
)

_LOOSE = 0.3  # nats in a simplex that are left to Newton; measured: half 1.0 times the runs, twice 1.2
_POLISHED = 1e-5  # nats below the top that are enough in the end: √(2e-5) = .0045 standard errors
_CLOSE = 2e-3  # nats below the top of the quadratic that are enough before slopes are polished: √(4e-3) = .06
ROUND = 0.05  # least curvature, over one in round coordinates; measured: half and twice change no fit
#: Standard errors that are next to nothing: from a bound that an estimate is on, a maximum that is found, and
#: from the top of a profile (NEAR² / 2 nats: the parabola tells the rest).
NEAR = 0.25


def searched(evidence: Evidence, theta: Floats, max_evaluations: int) -> tuple[Floats, float]:
    """Simplex search from a guess; returns the best point and its log-evidence."""
    from scipy.optimize import minimize  # on use: import time

    low, high = evidence.bounds
    step = first_steps(theta, low, high)
    step = np.where(theta + step > high, -step, step)
    simplex = np.vstack([theta, theta + np.diag(step)])
    options = {"initial_simplex": simplex, "maxfev": max_evaluations, "fatol": _LOOSE, "xatol": np.inf}
    limits = list(zip(low, high, strict=True))
    found = minimize(lambda v: -evidence(v), theta, method="Nelder-Mead", bounds=limits, options=options)
    return found.x, -float(found.fun)


def off_bounds(evidence: Evidence, theta: Floats, value: float) -> tuple[Floats, float]:
    """Take parameters off bounds from which the log-evidence rises."""
    low, high = evidence.bounds
    for k in np.flatnonzero((theta <= low) | (theta >= high)):
        inwards = theta.copy()
        inwards[k] += FIRST * first_steps(theta, low, high)[k] * (1.0 if theta[k] <= low[k] else -1.0)
        moved = evidence(inwards)
        if moved > value:
            theta, value = inwards, moved
    return theta, value


def climbed(
    evidence: Evidence, theta: Floats, value: float, max_evaluations: int
) -> tuple[Floats, float, Bools, Quadratic | None]:
    """Newton's method: the point, its log-evidence, which parameters are free, and the last quadratic.

    Parameters that come to a bound stay there. The quadratic is None if no parameter is free, or if the
    search was stopped before there was one.
    """
    low, high = evidence.bounds
    free: Bools = (theta > low) & (theta < high)
    root, local = np.empty(0), None
    first = first_steps(theta, low, high)
    for _ in range(ROUNDS):
        if not free.any() or evidence.n_evaluations > max_evaluations:
            break
        inside, centre = evidence.within(theta, free), theta[free]
        if not root.size:
            names = evidence.names_of(free)
            root = np.diag(scales(inside, centre, value, first[free], low[free], high[free], names))
        near = _near_bounds(theta, root, free, low, high)
        if near.any():
            k = np.flatnonzero(free)[near][0]
            theta, value = _at_bound(evidence, theta, value, k)
            free, root, local = free & (np.arange(len(free)) != k), np.empty(0), None
            continue
        h = min(STEPS[1], room(centre, root, low[free], high[free]))
        local = quadratic(inside, centre, value, root, h)
        done = local.flattest[0] < -ROUND and local.rise < _CLOSE
        step, root = _newton_step(local)
        there, moved = _line(evidence, theta, value, free, step)
        done |= moved == value  # as near as such differences come
        theta, value = there, moved
        if done and not _near_bounds(theta, root, free, low, high).any():
            break
    if local is not None and _near_bounds(theta, root, free, low, high).any():
        local = None
    if local is not None:  # in the last coordinates, in which it is round
        local = local._replace(root=root, hessian=-np.eye(free.sum()))
    return theta, value, free, local


def _at_bound(evidence: Evidence, theta: Floats, value: float, k: int) -> tuple[Floats, float]:
    """A parameter on the bound that it is near, or left where it is if there is less evidence there.

    Where the filter refuses the bound, as a variance of zero, it comes as near as that has more evidence.
    """
    low, high = evidence.bounds
    bound = low[k] if theta[k] - low[k] < high[k] - theta[k] else high[k]
    held, off = theta.copy(), theta[k] - bound
    held[k] = bound
    moved = evidence(held)
    if moved > -np.inf:
        return (held, moved) if moved >= value else (theta, value)
    for held[k] in bound + off * 0.1 ** np.arange(1, ROUNDS):
        moved = evidence(held)
        if moved < value + _CLOSE:
            break
        theta, value = held.copy(), moved
    return theta, value


def bounded_where_refused(evidence: Evidence, theta: Floats) -> list[str]:
    """Bound by zero the parameters above it that the filter refuses below it, as variances; their names."""
    low, refused = evidence.bounds[0], np.zeros(len(theta), dtype=bool)
    for k in np.flatnonzero(np.isneginf(low) & (theta > 0.0)):
        refused[k] = evidence(theta * np.where(np.arange(len(theta)) == k, -_CLOSE, 1.0)) == -np.inf
    low[refused] = 0.0
    return evidence.names_of(refused)


def _near_bounds(theta: Floats, root: Floats, free: Bools, low: Floats, high: Floats) -> Bools:
    """Which free parameters are on a bound, or too near it for differences."""
    return np.minimum(theta - low, high - theta)[free] < NEAR * np.linalg.norm(root, axis=1)


def polished(
    function: Function,
    centre: Floats,
    value: float,
    local: Quadratic,
    rough: float,
    low: Floats,
    high: Floats,
) -> tuple[Floats, float, float]:
    """The rest of the way, with a known Hessian and slopes over shorter steps, which need them less long.

    Returns the point, its value, and the rise to the top that is left by the last slopes.
    """
    h = min(slope_step_for(rough), room(centre, local.root, low, high))
    for _ in range(ROUNDS):
        local = local._replace(value=value, gradient=slopes(function, centre, local.root, h))
        if local.rise < _POLISHED + rough:
            break
        there = np.clip(centre + local.shift, low, high)
        moved = function(there)
        if moved < value:
            break
        centre, value = there, moved
    return centre, value, local.rise


def _newton_step(local: Quadratic) -> tuple[Floats, Floats]:
    """Step to the top of a quadratic, of at most `LEAP`, and coordinates in which it is round."""
    values, axes = np.linalg.eigh(local.hessian)
    bent = np.maximum(np.abs(values), ROUND)
    step = axes @ (axes.T @ local.gradient / bent)
    length = np.linalg.norm(np.sqrt(bent) * (axes.T @ step))
    step = local.root @ step * min(1.0, LEAP / max(float(length), TINY))
    return step, local.root @ (axes / np.sqrt(bent))


def _line(evidence: Evidence, theta: Floats, value: float, free: Bools, step: Floats) -> tuple[Floats, float]:
    """The best of a step and its halves, where one is better than none."""
    low, high = evidence.bounds
    for part in (1.0, 0.5, 0.25):
        there = theta.copy()
        there[free] = np.clip(theta[free] + part * step, low[free], high[free])
        moved = evidence(there)
        if moved > value:
            return there, moved
    return theta, value


def room(centre: Floats, root: Floats, low: Floats, high: Floats) -> float:
    """Longest step of `quadratic` that stays off bounds: the filter may refuse what is on one."""
    two = np.sort(np.abs(root), axis=1)[:, -2:].sum(axis=1)
    return 0.9 * float(np.min(np.minimum(centre - low, high - centre) / two))


def ridge(evidence: Evidence, theta: Floats, free: Bools, covariance: Floats, k: int) -> float:
    """Climb in the free parameters by Newton steps with the Hessian of the maximum."""
    value = evidence(theta)
    if not free.any() or not np.isfinite(value):
        return value
    held: Floats = covariance[np.ix_(free, free)]
    if np.isfinite(covariance[k, k]):
        held = held - np.outer(covariance[free, k], covariance[free, k]) / covariance[k, k]
    root = np.asarray(np.linalg.cholesky(held), dtype=float)
    for _ in range(ROUNDS):
        inside = evidence.within(theta, free)
        gradient = slopes(inside, theta[free], root, STEPS[1])
        rise = float(0.5 * gradient @ gradient)
        if not np.isfinite(rise):
            break
        if rise < 0.5 * NEAR**2:
            return value + rise
        there = theta.copy()
        there[free] += root @ (gradient * min(1.0, LEAP / float(np.linalg.norm(gradient))))
        moved = evidence(there)
        if moved <= value:
            break
        theta, value = there, moved
    return value
