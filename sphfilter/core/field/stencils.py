"""Neighbourhoods of lattice nodes, and the least-squares rows that turn their values into polynomials."""

import itertools
import math
from functools import cache
from typing import NamedTuple

import numpy as np
from numba import typeof

from ..monomials import up_to

_TREND = {3: 4, 4: 4}  # degree of the polynomial through all nodes by dimension, 3 beyond
_WEIGHT_DECAY = 4.0  # weights exp(-4 r^2 / r_max^2) of the least-squares fit


class Stencils(NamedTuple):
    """Neighbourhoods of increasing size and the least-squares rows that belong to them."""

    offsets: np.ndarray  # (largest size, n) int; a neighbourhood is the first so many of them
    size: np.ndarray  # (levels,)
    widest: int  # largest number in them
    rows: np.ndarray  # (levels, largest size, M): coefficients from differences of neighbours
    parent: np.ndarray  # (M,) monomial that times x_axis gives this one, -1 for x_axis itself
    axis: np.ndarray  # (M,)
    trend: np.ndarray  # (degrees,) monomials of a polynomial through all nodes, by its degree; none if empty
    shift: np.ndarray  # (S, 3) int: terms `to`, `from` and of the displacement, for another centre
    binomial: np.ndarray  # (S,)


def _neighborhoods(n):
    """(offsets, degree, with mixed cubic terms) by level; each holds the one before."""
    reach = 3 if n == 1 else 2
    g = np.array([o for o in itertools.product(range(-reach, reach + 1), repeat=n) if any(o)])
    r2, axes, widest = (g**2).sum(1), (g != 0).sum(1), np.abs(g).max(1)
    if n == 1:
        return [(g[widest <= k], 2 * k, True) for k in (1, 2, 3)]
    ball = r2 <= 2
    star = ball | ((r2 == 4) & (axes == 1))
    levels = [(g[ball], 2, True), (g[star], 3, False)]
    if n == 2:
        levels += [(g[r2 <= 5], 3, True), (g[widest <= 2], 4, True)]
    elif n == 3:
        levels += [(g[r2 <= 4], 3, True)]
    return levels


@cache
def stencils(n):
    """The `Stencils` of n dimensions."""
    levels = _neighborhoods(n)
    degree = max(_TREND.get(n, 3) if n > 2 else 0, *(degree for _, degree, _ in levels))
    exponents = up_to(degree, n)[1:]  # the constant is the node's own value
    E = np.array(exponents)
    size = np.array([len(g) for g, _, _ in levels])
    rank = {tuple(o): level for level in reversed(range(len(levels))) for o in levels[level][0]}
    offsets = np.array(sorted(rank, key=lambda o: (rank[o], sum(k * k for k in o), o)))
    rows = np.zeros((len(levels), size[-1], len(E)))
    for level, (_, degree, mixed) in enumerate(levels):
        used = E.sum(1) <= degree
        if not mixed:
            used &= ~((E.sum(1) == 3) & ((E > 0).sum(1) == 3))
        g = offsets[: size[level]]
        basis = np.prod(g[:, None, :].astype(float) ** E[None, used], axis=2)
        r2 = (g**2).sum(1)
        weighted = basis * np.exp(-_WEIGHT_DECAY * r2 / r2.max())[:, None]
        rows[level, : size[level], used] = np.linalg.solve(weighted.T @ basis, weighted.T)
    axis = [next(a for a in range(n) if e[a]) for e in exponents]
    lowered = [tuple(k - (a == b) for b, k in enumerate(e)) for e, a in zip(exponents, axis, strict=True)]
    parent = [exponents.index(e) if any(e) else -1 for e in lowered]
    trend = np.array([(E.sum(1) <= degree).sum() for degree in range(1, E.sum(1).max() + 1)])
    about = offsets, size, int(offsets.max()), rows, np.array(parent), np.array(axis)
    return Stencils(*about, trend[: 0 if n < 3 else None], *_shifts(exponents))


def _shifts(exponents):
    """How coefficients around one point follow from those around another: see `Stencils`."""
    at = {e: k for k, e in enumerate(exponents)}
    shift, binomial = [], []
    for source, e in enumerate(exponents):
        for lower in itertools.product(*(range(k + 1) for k in e)):
            if any(lower) and lower != e:
                left = tuple(k - j for k, j in zip(e, lower, strict=True))
                shift.append((at[lower], source, at[left]))
                binomial.append(math.prod(math.comb(k, j) for k, j in zip(e, lower, strict=True)))
    return np.array(shift).reshape(-1, 3), np.array(binomial, dtype=float)


#: Numba's type of `Stencils`.
STENCILS = typeof(stencils(1))
