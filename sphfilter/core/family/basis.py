"""Orthonormal Hermite polynomials at the nodes of a rule, and what follows from these alone."""

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from numba import njit, types

from .._jit import MATRIX, VECTOR, jit
from ..monomials import up_to
from .rules import rule

#: Points at a time: tables of seven powers of four states, 7 * 4 * 64 * 8 bytes = 14 KB.
_AT_ONCE = 64
_BEYOND = 1.6  # standard deviations beyond √n: P(χ_n > √n + 1.6) = .009 to .012 of a Gaussian lies there
#: Least singular value of polynomials that nodes tell apart; measured: all are above .001 or below 1e-13.
_TOLD_APART = 1e-6
_FALL = 0.15  # least fall of log p out there, a square of a deviation: of a variance of 1 / (2 · .15) = 3.3


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
    power, below, root, V = polynomials(n, degree, xi)
    log_w = np.log(u) + 0.5 * (xi**2).sum(axis=1)
    return Basis(power, below, root, xi, u, log_w, V, (V * u).T.copy(), _lower(n, degree))


@cache
def beyond(n, degree):
    """Polynomials of one or two degrees more at the nodes of the `basis` of n states and a degree.

    F fits the lower ones as there, and the higher ones by themselves, as far as the nodes tell them apart. A
    symmetric model leaves a polynomial of even degree nothing of the next one, which is odd. Of four states
    and quartics a fifth of those of degree six are not told apart, and a linear model's defect grew by them.
    """
    own = basis(n, degree)
    more = degree + (2 if degree == 2 or n == 1 or (degree % 2 == 0 and n <= 3) else 1)
    power, below, root, V = polynomials(n, more, own.xi)
    F = np.ascontiguousarray(np.concatenate([own.F.T, fit(V[len(own.power) :], own.u)]).T)
    return own._replace(power=power, below=below, root=root, V=V, F=F, lower=_lower(n, more))


def _lower(n, degree):
    return np.array([size(n, degree - 1), size(n, degree - 2)])


def fit(V, u):
    """Matrix (M, N) of a least-squares fit to values at nodes of weights u, of what these tell apart."""
    root = np.sqrt(u)
    return np.linalg.pinv((V * root).T, rcond=_TOLD_APART) * root


def polynomials(n, degree, xi):
    """Powers (M, n), the numbers and factors of derivatives (n, M), and values (M, N) at points xi (N, n)."""
    powers = up_to(degree, n)
    number = {a: j for j, a in enumerate(powers)}
    below, root = np.full((n, len(powers)), -1), np.zeros((n, len(powers)))
    for j, a in enumerate(powers):
        for axis in range(n):
            if a[axis]:
                below[axis, j] = number[*a[:axis], a[axis] - 1, *a[axis + 1 :]]
                root[axis, j] = math.sqrt(a[axis])
    power, V = np.array(powers), np.empty((len(powers), len(xi)))
    for j, unit in enumerate(np.eye(len(powers))):
        values_at(power, unit, xi, math.inf, V[j])
    return power, below, root, V


@jit
def values_at(power, c, xi, bound, out):
    """sum_j c_j h_j at points xi (K, n), into out (K,).

    Beyond the radius `bound` the values fall at least as a wide Gaussian does: polynomials may rise there.
    """
    _values(power, c, xi, out)
    if bound == np.inf:
        return
    edge, further, count = np.empty(xi.shape), np.empty(xi.shape[0]), 0
    for i in range(xi.shape[0]):
        further[i] = _square(xi[i]) - bound * bound
        if further[i] > 0.0:
            for a in range(xi.shape[1]):
                edge[count, a] = xi[i, a] * bound / math.sqrt(further[i] + bound * bound)
            count += 1
    there, k = np.empty(count), 0
    _values(power, c, edge[:count], there)
    for i in range(xi.shape[0]):
        if further[i] > 0.0:
            out[i] = min(out[i], there[k] - _FALL * further[i])
            k += 1


@jit
def _square(xi):
    total = 0.0
    for a in range(xi.size):
        total += xi[a] ** 2
    return total


@jit
def _values(power, c, xi, out):
    table, product = np.empty((xi.shape[1], power.max() + 1, _AT_ONCE)), np.empty(_AT_ONCE)
    for start in range(0, out.size, _AT_ONCE):
        some, values = xi[start : start + _AT_ONCE], out[start : start + _AT_ONCE]
        _tabulate(some, table)
        for i in range(values.size):
            values[i] = 0.0
        for j in range(c.size):
            _multiply(power[j], table, product[: values.size])
            for i in range(values.size):
                values[i] += c[j] * product[i]


@jit
def averages(power, xi, mass, first, second):
    """Averages of polynomials of powers (M, n) over points (N, n) of weights (N,), and of their squares."""
    (N, n), M = xi.shape, power.shape[0]
    table, product = np.empty((n, power.max() + 1, _AT_ONCE)), np.empty(_AT_ONCE)
    for j in range(M):
        first[j] = second[j] = 0.0
    for start in range(0, N, _AT_ONCE):
        some, own = xi[start : start + _AT_ONCE], mass[start : start + _AT_ONCE]
        _tabulate(some, table)
        for j in range(M):
            _multiply(power[j], table, product[: own.size])
            once, twice = _sums(own, product)
            first[j] += once
            second[j] += twice


@njit(error_model="numpy", fastmath={"reassoc", "nsz", "contract"})
def _sums(own, product):
    """Weighted sums of products and of their squares, in any order, as vector instructions want it."""
    once = twice = 0.0
    for i in range(own.size):
        part = own[i] * product[i]
        once += part
        twice += part * product[i]
    return once, twice


@jit
def _tabulate(x, table):
    """Orthonormal polynomials of each coordinate of points x (K, n), into table (n, top + 1, K)."""
    for a in range(x.shape[1]):
        for i in range(x.shape[0]):
            table[a, 0, i] = 1.0
        for k in range(table.shape[1] - 1):
            down, up = math.sqrt(k), 1.0 / math.sqrt(k + 1.0)
            for i in range(x.shape[0]):
                below = down * table[a, k - 1, i] if k > 0 else 0.0
                table[a, k + 1, i] = (x[i, a] * table[a, k, i] - below) * up


@jit
def _multiply(power, table, product):
    """The product of one variable's polynomials of powers (n,), at all points of a table (n, top + 1, K)."""
    for i in range(product.size):
        product[i] = 1.0
    for a in range(power.size):
        if power[a] > 0:
            for i in range(product.size):
                product[i] *= table[a, power[a], i]


def bound(n):
    """Radius beyond which a polynomial is not trusted."""
    return math.sqrt(n) + _BEYOND


#: Numba's type of a `Basis`.
_INTS = types.int64[:, ::1]
BASIS = types.NamedTuple(
    [_INTS, _INTS, MATRIX, MATRIX, VECTOR, VECTOR, MATRIX, MATRIX, types.int64[::1]], Basis
)
