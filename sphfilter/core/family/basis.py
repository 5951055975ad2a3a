"""Orthonormal Hermite polynomials at the nodes of a rule, and what follows from these alone."""

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from numba import typeof

from .._jit import jit
from ..monomials import up_to
from .rules import rule

__all__ = ["BASIS", "Basis", "averages", "basis", "size", "values_at"]

_BEYOND, _FALL = 1.6, 0.15  # standard deviations beyond the root of n, and least fall of log p out there


class Basis(NamedTuple):
    """Polynomials h_j of total degree up to d, orthonormal under the rule, lowest degree first."""

    power: np.ndarray  # (M, n) int
    below: np.ndarray  # (n, M) number of the polynomial of one degree less along an axis; -1 if none
    root: np.ndarray  # (n, M) of the power along that axis: d h_j / d x_a = root h_below
    xi: np.ndarray  # (N, n) nodes
    u: np.ndarray  # (N,) weights
    log_w: np.ndarray  # (N,) log u + |xi|^2 / 2: weights of densities rather than of Gaussians
    V: np.ndarray  # (M, N) h_j at the nodes
    F: np.ndarray  # (N, M) u_i h_j: the least-squares fit to values at the nodes
    lower: np.ndarray  # (2,) polynomials of degrees up to d - 1 and d - 2


def size(n, degree):
    """Number M of polynomials."""
    return math.comb(n + degree, degree)


@cache
def basis(n, degree):
    """The `Basis` of n states and a degree."""
    xi, u = (np.array(part) for part in rule(n, degree))
    powers = up_to(degree, n)
    number = {a: j for j, a in enumerate(powers)}
    below, root = np.full((n, len(powers)), -1), np.zeros((n, len(powers)))
    for j, a in enumerate(powers):
        for axis in range(n):
            if a[axis]:
                below[axis, j] = number[*a[:axis], a[axis] - 1, *a[axis + 1 :]]
                root[axis, j] = math.sqrt(a[axis])
    power, square = np.array(powers), (xi**2).sum(axis=1)
    V = np.empty((len(powers), len(xi)))
    for j, unit in enumerate(np.eye(len(powers))):
        values_at(power, unit, xi, math.inf, V[j])
    lower = np.array([size(n, degree - 1), size(n, degree - 2)])
    log_w = np.log(u) + 0.5 * square
    return Basis(power, below, root, xi, u, log_w, V, (V * u).T.copy(), lower)


@jit
def values_at(power, c, xi, bound, out):
    """sum_j c_j h_j at points xi (K, n), into out (K,).

    Beyond the radius `bound` the values fall at least as a wide Gaussian does: polynomials may rise there.
    """
    n, table = xi.shape[1], np.empty((xi.shape[1], power.max() + 1))
    for i in range(xi.shape[0]):
        square = 0.0
        for a in range(n):
            square += xi[i, a] ** 2
        out[i] = _value(power, c, xi[i], 1.0, table)
        if square > bound * bound:
            edge = _value(power, c, xi[i], bound / math.sqrt(square), table)
            out[i] = min(out[i], edge - _FALL * (square - bound * bound))


@jit
def averages(power, xi, mass, first, second):
    """Averages of polynomials of powers (M, n) over points (N, n) of weights (N,), and of their squares."""
    (M, n), table = power.shape, np.empty((xi.shape[1], power.max() + 1))
    first[:] = 0.0
    second[:] = 0.0
    for i in range(xi.shape[0]):
        _tabulate(xi[i], 1.0, table)
        for j in range(M):
            product = 1.0
            for a in range(n):
                product *= table[a, power[j, a]]
            first[j] += mass[i] * product
            second[j] += mass[i] * product**2


@jit
def _tabulate(x, scale, table):
    """Orthonormal polynomials of one variable at the coordinates `scale` x (n,), into table (n, top + 1)."""
    for a in range(x.size):
        table[a, 0] = 1.0
        for k in range(table.shape[1] - 1):
            below = math.sqrt(k) * table[a, k - 1] if k > 0 else 0.0
            table[a, k + 1] = (scale * x[a] * table[a, k] - below) / math.sqrt(k + 1.0)


@jit
def _value(power, c, x, scale, table):
    """sum_j c_j h_j at the point `scale` x (n,)."""
    M, n = power.shape
    _tabulate(x, scale, table)
    total = 0.0
    for j in range(M):
        product = c[j]
        for a in range(n):
            product *= table[a, power[j, a]]
        total += product
    return total


def bound(n):
    """Radius beyond which a polynomial is not trusted."""
    return math.sqrt(n) + _BEYOND


#: Numba's type of a `Basis`.
BASIS = typeof(basis(1, 2))
