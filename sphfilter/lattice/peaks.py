"""Peaks of prior times likelihood between the nodes of a lattice: looked for, climbed and measured."""

from typing import NamedTuple

import numpy as np

from .._types import Bools, Floats, OfStates
from ..core.limits import EDGE, LOG_2_PI, NOTHING, ROUNDS

_ON_LINES = 2048  # states asked along lines in all; measured: half and twice change no run
_MOST = 100  # peaks; measured: half and twice change no run
_SCALES = 2.0 ** np.arange(3, -31, -1.0)  # steps of a climb: 8 to 2^-30 = 1e-9 standard deviations
_DROP = 0.5  # nats that log p falls within a width: z² / 2 at a standard deviation of a Gaussian


class Peak(NamedTuple):
    """A local maximum of a density, and what a Gaussian with its curvature has there."""

    x: Floats  # (n,)
    factor: Floats  # (n, n), lower factor of the covariance
    log_mass: float


def along_axes(product: OfStates, log_weight: OfStates, start: Floats, std: Floats) -> Floats:
    """Local maxima (M, n) of a likelihood along a line through a state in every direction of the axes.

    Each line goes through the best state of those before, so that what is thin in several states one by one
    is found. Along the lines only the likelihood is asked.
    """
    n = len(start)
    u = np.linspace(-EDGE, EDGE, _ON_LINES // n + 1)
    found, highest = [], -np.inf
    for axis in range(n):
        line = np.repeat(start[None], len(u), axis=0)
        line[:, axis] += u * std[axis]
        w = log_weight(line)
        top = 1 + np.flatnonzero((w[1:-1] > w[:-2]) & (w[1:-1] >= w[2:]))
        if not top.size:
            continue
        values = product(line[top])
        found.append(line[top])
        if values.max() > highest:
            start, highest = line[top[values.argmax()]], values.max()
    return np.concatenate(found) if found else np.empty((0, n))


def peaks(product: OfStates, X: Floats, values: Floats, factor: Floats) -> list[Peak]:
    """The highest peaks that states lie on, none twice.

    `product` gives logarithms (M,) of an unnormalised density at states (M, n). The climb begins at X (M, n),
    where they are `values` (M,); peaks are no wider than the covariance whose lower factor is `factor` (n,
    n).
    """
    found: list[Peak] = []
    for _ in range(_MOST):
        if not len(X):
            break
        best = values.argmax()
        top = _climbed(product, X[best], values[best], factor)
        if not any(_within(top[None], peak)[0] for peak in found):
            found.append(_measured(product, top, factor))
        near = _within(X, found[-1])
        near[best] = True
        X, values = X[~near], values[~near]
    return found


def _within(X: Floats, peak: Peak) -> Bools:
    """Which states lie within four standard deviations of a peak."""
    y = np.linalg.solve(peak.factor, (X - peak.x).T)
    return np.asarray(np.einsum("an,an->n", y, y) < 16.0)


def _climbed(product: OfStates, x: Floats, value: float, factor: Floats) -> Floats:
    """The top of what a state lies on: the best of steps of all sizes, until none goes up."""
    steps = (_SCALES[:, None, None] * np.concatenate([factor.T, -factor.T])).reshape(-1, len(x))
    for _ in range(ROUNDS):
        tried = x + steps
        values = product(tried)
        best = values.argmax()
        if not values[best] > value + 1e-3:
            break
        x, value = tried[best], values[best]
    return x


def _measured(product: OfStates, x: Floats, factor: Floats) -> Peak:
    """A peak with the covariance of its curvature, in the middle of what it falls off on both sides."""
    n = len(x)
    sides = np.concatenate([factor.T, -factor.T])
    fall = product(x[None])[0] - product((x + _SCALES[::-1, None, None] * sides).reshape(-1, n)).reshape(
        -1, 2 * n
    )
    past = fall > _DROP
    past[-1] = True
    first = past.argmax(axis=0)
    at = np.take_along_axis(fall, first[None], axis=0)[0]
    scale = _SCALES[::-1][first]
    ends = scale * np.clip(np.sqrt(_DROP / np.maximum(at, _DROP)), 0.5, 1.0)
    ahead, behind = ends[:n], ends[n:]
    x = x + factor @ (0.5 * (ahead - behind))
    widths = np.minimum(0.5 * (ahead + behind), 1.0)
    basis = factor * widths
    curvature = _curvature(product, x, basis)
    values, axes = np.linalg.eigh(curvature)
    least = widths.min() ** 2  # nothing is wider than the factor
    root = (axes / np.sqrt(np.maximum(values, max(least, 1e-12)))) @ axes.T
    own = basis @ root
    own = np.linalg.cholesky(own @ own.T)
    log_mass = product(x[None])[0] + 0.5 * n * LOG_2_PI + np.log(np.diag(own)).sum()
    return Peak(x, own, float(log_mass))


def _curvature(product: OfStates, x: Floats, basis: Floats) -> Floats:
    """Minus the second differences (n, n) of a log-density along the columns of a basis."""
    n = len(x)
    unit = np.eye(n)
    pairs = [(a, b) for a in range(n) for b in range(a)]
    moves = [np.zeros(n), *unit, *-unit]
    moves += [s * unit[a] + r * unit[b] for a, b in pairs for s in (1, -1) for r in (1, -1)]
    fall = product(x + np.array(moves) @ basis.T)
    fall = np.clip(fall[0] - fall, -NOTHING, NOTHING)
    out = np.diag(np.maximum(fall[1 : n + 1] + fall[n + 1 : 2 * n + 1], 0.1))
    for k, (a, b) in enumerate(pairs):
        pp, pm, mp, mm = fall[2 * n + 1 + 4 * k : 2 * n + 5 + 4 * k]
        out[a, b] = out[b, a] = 0.25 * (pp - pm - mp + mm)
    return out
