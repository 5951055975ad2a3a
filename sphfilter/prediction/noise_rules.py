"""Rules of weighted noise paths, along which log p goes from lattice to lattice."""

import math
from functools import cache

import numpy as np

from .._types import Floats
from ..core.characteristics.noise_paths import Paths


@cache
def paths(m: int, order: int) -> Paths:
    """Weighted noise paths for m noises, as `Paths`.

    Each is straight to a point of dW, and bent so that the covariance of dW with the area under it is right.
    One noise has Gauss-Hermite points, two have a hexagon (degree five), bent both ways; three have an
    icosahedron (degree five), four and more the symmetric rule of degree three, all of them straight.
    """
    if m == 1:
        return _twisted(_hermite(order))
    if m == 2:
        return _twisted(_hexagon())
    if m == 0:
        dW, weights = np.zeros((1, 0)), np.ones(1)
    elif m == 3:
        dW, weights = _icosahedron()
    else:
        dW, weights = np.concatenate([np.eye(m), -np.eye(m)]) * math.sqrt(m), np.full(2 * m, 0.5 / m)
    return Paths(np.log(weights), np.hstack([dW, np.zeros_like(dW)]), np.zeros(len(dW)))


def _twisted(table: Floats) -> Paths:
    """Paths whose noise and bend stand in a table, and last its weight. Twists do not covary with either, as
    those of paths that go nowhere are to the side of their bends, and others to the opposite side.
    """
    w, weights = np.ascontiguousarray(table[:, :-1]), table[:, -1]
    m = w.shape[1] // 2
    bent, still = w[:, m] != 0.0, ~w[:, :m].any(axis=1)
    here, there = weights[bent & still].sum(), weights[bent & ~still].sum()
    twist = np.where(still, there, -here) * bent
    twist /= math.sqrt(weights @ twist**2) or 1.0
    return Paths(np.log(weights), w, twist)


def _hermite(order: int) -> Floats:
    """Gauss-Hermite points, bent both ways; the outermost two, whose weight is small, are straight."""
    x, weights = np.polynomial.hermite_e.hermegauss(order)
    weights = weights / weights.sum()
    heavy = np.arange(order) if order <= 3 else np.arange(1, order - 1)
    bend = 1.0 / math.sqrt(weights[heavy].sum())
    rows = [(x[k], side * bend, 0.5 * weights[k]) for k in heavy for side in (1.0, -1.0)]
    rows += [(x[k], 0.0, weights[k]) for k in range(order) if k not in heavy]
    return np.array(rows)


def _hexagon() -> Floats:
    """Radon's seven points; bends alternate around the hexagon so that those of two noises do not covary."""
    angle = np.arange(6) * math.pi / 3
    rows = [(0.0, 0.0, a, b, 0.125) for a in (1.0, -1.0) for b in (1.0, -1.0)]
    for k, (x, y) in enumerate(zip(2.0 * np.cos(angle), 2.0 * np.sin(angle), strict=True)):
        rows += [(x, y, a, a * (-1.0) ** k, 1.0 / 24.0) for a in (1.0, -1.0)]
    return np.array(rows)


def _icosahedron() -> tuple[Floats, Floats]:
    """Thirteen points (13, 3) and weights of degree five for three normal numbers."""
    golden = 0.5 * (1.0 + math.sqrt(5.0))
    corners = np.array([(0.0, a, b * golden) for a in (1.0, -1.0) for b in (1.0, -1.0)])
    corners = np.concatenate([np.roll(corners, k, axis=1) for k in range(3)])
    points = np.concatenate([np.zeros((1, 3)), corners * math.sqrt(5.0 / (1.0 + golden**2))])
    return points, np.array([0.4] + [0.05] * 12)
