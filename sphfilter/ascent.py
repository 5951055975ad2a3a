"""The search for parameters of largest log-evidence: a simplex, then Newton's method, within bounds."""

import numpy as np
from scipy.optimize import minimize

from .curvature import quadratic, scales

__all__ = ["CLOSE", "ROUND", "climbed", "off_bounds", "ridge", "room", "searched"]

_FIRST = 0.1  # of a guess, or of the width of its bounds: first step of the search
_LOOSE = 0.3  # nats between the corners of a simplex at which the search leaves the rest to Newton
_STEP = 0.6  # of differences on the way, in standard errors
_NEWTON = 8
CLOSE = 2e-3  # nats below the top of the quadratic at which a maximum is found: .06 standard errors
_LONGEST = 2.0  # standard errors that Newton's method goes at once
ROUND = 0.05  # least curvature, over one in round coordinates, that is a curvature
_AT_BOUND = 0.2  # standard errors from a bound, within which an estimate is on it


def searched(evidence, theta, low, high, max_evaluations):
    """Simplex search from a guess; returns the best point and its log-evidence."""
    width = np.where(np.isfinite(high - low), high - low, np.inf)
    step = np.minimum(_FIRST * np.where(theta == 0.0, 1.0, np.abs(theta)), 0.5 * width)
    step = np.where(theta + step > high, -step, step)
    simplex = np.vstack([theta, theta + np.diag(step)])
    options = {"initial_simplex": simplex, "maxfev": max_evaluations, "fatol": _LOOSE, "xatol": np.inf}
    limits = list(zip(low, high, strict=True))
    found = minimize(lambda v: -evidence(v), theta, method="Nelder-Mead", bounds=limits, options=options)
    return found.x, -float(found.fun)


def off_bounds(evidence, theta, value, low, high):
    """Take parameters off bounds from which the log-evidence rises."""
    for k in np.flatnonzero((theta <= low) | (theta >= high)):
        width = high[k] - low[k] if np.isfinite(high[k] - low[k]) else abs(theta[k]) or 1.0
        inwards = theta.copy()
        inwards[k] += _FIRST**2 * width * (1.0 if theta[k] <= low[k] else -1.0)
        moved = evidence(inwards)
        if moved > value:
            theta, value = inwards, moved
    return theta, value


def climbed(evidence, theta, value, low, high, max_evaluations):
    """Newton's method: the point, its log-evidence, which parameters are free, and the last quadratic.

    Parameters that come to a bound stay there.
    """
    free, root, local = (theta > low) & (theta < high), None, None
    for _ in range(_NEWTON):
        if not free.any() or evidence.n_evaluations > max_evaluations:
            break
        inside, centre = evidence.within(theta, free), theta[free]
        if root is None:
            names = np.array(evidence.names)[free]
            root = np.diag(scales(inside, centre, value, centre, low[free], high[free], names))
        near = np.minimum(theta - low, high - theta)[free] < _AT_BOUND * np.linalg.norm(root, axis=1)
        if near.any():
            k = np.flatnonzero(free)[near][0]
            theta, free = theta.copy(), free.copy()
            theta[k], free[k] = (low[k] if theta[k] - low[k] < high[k] - theta[k] else high[k]), False
            value, root, local = evidence(theta), None, None
            continue
        h = min(_STEP, room(centre, root, low[free], high[free]))
        local = quadratic(inside, centre, value, root, h)
        done = local.flattest[0] < -ROUND and local.rise < CLOSE
        step, root = _newton_step(local)
        theta, value = _line(evidence, theta, value, free, step, low, high)
        if done:
            break
    if local is not None:
        local = local._replace(root=root)
    return theta, value, free, local


def _newton_step(local):
    """Step to the top of a quadratic, at most two standard errors, and coordinates in which it is round."""
    values, axes = np.linalg.eigh(local.hessian)
    bent = np.maximum(np.abs(values), ROUND)
    step = axes @ (axes.T @ local.gradient / bent)
    length = np.linalg.norm(np.sqrt(bent) * (axes.T @ step))
    return local.root @ step * min(1.0, _LONGEST / max(length, 1e-300)), local.root @ (axes / np.sqrt(bent))


def _line(evidence, theta, value, free, step, low, high):
    """The best of a step and its halves, where one is better than none."""
    for part in (1.0, 0.5, 0.25):
        there = theta.copy()
        there[free] = np.clip(theta[free] + part * step, low[free], high[free])
        moved = evidence(there)
        if moved > value:
            return there, moved
    return theta, value


def room(centre, root, low, high):
    """Longest step of `quadratic` within bounds."""
    two = np.sort(np.abs(root), axis=1)[:, -2:].sum(axis=1)
    return float(np.min(np.minimum(centre - low, high - centre) / two))


def ridge(evidence, theta, free, covariance, k):
    """Climb in the free parameters by Newton steps with the Hessian of the maximum."""
    value = evidence(theta)
    if not free.any() or not np.isfinite(value):
        return value
    held = covariance[np.ix_(free, free)]
    if np.isfinite(covariance[k, k]):
        held = held - np.outer(covariance[free, k], covariance[free, k]) / covariance[k, k]
    root = np.linalg.cholesky(held)
    for _ in range(_NEWTON):
        inside = evidence.within(theta, free)
        steps = _STEP * root.T
        ahead, behind = (np.array([inside(theta[free] + s * d) for d in steps]) for s in (1.0, -1.0))
        gradient = (ahead - behind) / (2.0 * _STEP)
        if not np.isfinite(gradient).all() or 0.5 * gradient @ gradient < CLOSE:
            break
        there = theta.copy()
        there[free] += root @ (gradient * min(1.0, 1.5 / np.linalg.norm(gradient)))
        moved = evidence(there)
        if moved <= value:
            break
        theta, value = there, moved
    return value
