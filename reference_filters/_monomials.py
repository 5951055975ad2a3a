"""Monomials x^a = x₁^a₁ … xₙ^aₙ: sums of them over many states, and moments about another centre."""

from itertools import product
from math import comb, prod

import numpy as np

from sphfilter.core._jit import jit
from sphfilter.errors import ModelError

#: States taken at a time: as many as keep all monomials of a block near the processor.
_BLOCK = 64


def checked_powers(name, powers, dim):
    """Return lists of n whole numbers, none negative, as tuples.

    Raises
    ------
    ModelError
        Wrong length, or a power that is negative or no whole number.
    """
    values = [tuple(a) for a in powers]
    for a in values:
        if len(a) != dim or any(k != int(k) or k < 0 for k in a):
            raise ModelError(f"{name} holds {a}; give {dim} whole numbers >= 0, the power of each state.")
    return [tuple(int(k) for k in a) for a in values]


def down_set(powers, dim):
    """All b <= a of some a among `powers`, lowest order first, the zero power among them.

    They are what moments about another centre need, see `recentred`.
    """
    found = {(0,) * dim}
    for a in powers:
        found.update(product(*(range(k + 1) for k in a)))
    return sorted(found, key=lambda a: (sum(a), tuple(-k for k in a)))


def moment_name(a, states, central=False):
    """Text such as "E[q^2 v]", or "C[q^2 v]" of a central moment."""
    parts = [s if k == 1 else f"{s}^{k}" for s, k in zip(states, a, strict=True) if k]
    return f"{'C' if central else 'E'}[{' '.join(parts) or '1'}]"


def recentred(moments, powers, shift, wanted):
    """Moments E (x − c + s)^a from moments E (x − c)^b: Σ_b C(a, b) s^(a−b) E (x − c)^b.

    Parameters
    ----------
    moments : ndarray, shape (..., M)
    powers : list of M tuples
        With every b <= a of every wanted a.
    shift : ndarray, shape (..., n)
        s: the old centre minus the new one.
    wanted : list of S tuples

    Returns
    -------
    ndarray, shape (..., S)
    """
    index = {a: j for j, a in enumerate(powers)}
    out = np.zeros((*np.broadcast_shapes(moments.shape[:-1], shift.shape[:-1]), len(wanted)))
    for j, a in enumerate(wanted):
        for b in product(*(range(k + 1) for k in a)):
            term = prod(map(comb, a, b)) * moments[..., index[b]]
            for d, (k, m) in enumerate(zip(a, b, strict=True)):
                term = term * shift[..., d] ** (k - m)
            out[..., j] += term
    return out


def sum_monomials(x, centre, powers):
    """Sums Σ_i (x_i − c)^b over states x (N, n) about c (n,), shape (M,).

    Parameters
    ----------
    powers : list of M tuples
        As of `down_set` or `up_to`: with each, the one that is lower by one along its last axis.
    """
    index = {a: j for j, a in enumerate(powers)}
    parent, axis = np.zeros(len(powers), dtype=np.int64), np.zeros(len(powers), dtype=np.int64)
    for j, a in enumerate(powers[1:], start=1):
        axis[j] = np.flatnonzero(a)[-1]
        parent[j] = index[tuple(k - (d == axis[j]) for d, k in enumerate(a))]
    sums = np.zeros(len(powers))
    add_monomials(np.ascontiguousarray(x, dtype=float), np.array(centre, dtype=float), parent, axis, sums)
    return sums


@jit
def add_monomials(x, centre, parent, axis, sums):
    """Add Σ_i (x_i − c)^b to sums (M,); each monomial is its parent times one coordinate."""
    N, n = x.shape
    M = parent.size
    y, rows, totals = np.empty((n, _BLOCK)), np.ones((M, _BLOCK)), np.zeros((M, _BLOCK))
    for first in range(0, N, _BLOCK):
        B = min(_BLOCK, N - first)
        for d in range(n):
            for i in range(B):
                y[d, i] = x[first + i, d] - centre[d]
        for j in range(M):
            if j > 0:
                p, d = parent[j], axis[j]
                for i in range(B):
                    rows[j, i] = rows[p, i] * y[d, i]
            for i in range(B):
                totals[j, i] += rows[j, i]
    for j in range(M):
        for i in range(_BLOCK):
            sums[j] += totals[j, i]
