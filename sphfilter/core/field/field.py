"""A log-density on a lattice: polynomials around its nodes, and their values and slopes anywhere.

The lattice is ``x = mu + A i`` with integer vectors i, regular in whitened coordinates. Around every node
whose neighbours are complete, log p is a polynomial fitted by weighted least squares ("moving least squares
particle hydrodynamics", `fitting`); the nearest one is used elsewhere. States are taken in lanes: what is the
same for all of them is looked up once, and the arithmetic runs over several at a time.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import typeof

from .._jit import jit
from ..limits import TINY
from .cells import LOWEST, strides_of

_RIM = 4.5  # squared distance: the rim lies at sqrt 2 from a complete node, half a cell inside of this
_LANES = 16  # states at a time: 70 monomials of four states, 16 * 70 * 8 bytes = 9 KB, beside the polynomials
_BEYOND = 1.0 / math.sqrt(TINY)  # lattice cells: states out there are none, with squares of 1 / TINY = 1e300


class Field(NamedTuple):
    """log p as polynomials on a lattice; see the module's text."""

    mu: np.ndarray  # (n,) origin
    A: np.ndarray  # (n, n) lattice vectors in columns
    inverse: np.ndarray  # (n, n) of A
    low: np.ndarray  # (n,) int, lowest cell of the box
    dims: np.ndarray  # (n,) int, cells of the box along every axis
    owner: np.ndarray  # (cells,) int, whose polynomial is used there; its complement (~) where no node lies
    node: np.ndarray  # (N, n) int
    kept: int  # of the nodes are above the density's depth, the first ones; the others lie beside them
    log_p: np.ndarray  # (N,)
    coefficient: np.ndarray  # (N, M), in units of the lattice
    cap: float  # log p is below it wherever no node lies
    tail: np.ndarray  # (N, n, n) second derivatives for beyond the lattice: bent down in all directions


_INTEGERS, _NUMBERS, _MATRIX = np.empty(1, np.int64), np.empty(1), np.empty((1, 1))
#: Numba's type of a `Field`.
FIELD = typeof(
    Field(
        _NUMBERS, _MATRIX, _MATRIX, _INTEGERS, _INTEGERS, _INTEGERS, np.empty((1, 1), np.int64), 1, _NUMBERS,
        _MATRIX, 0.0, np.empty((1, 1, 1)),
    )
)  # fmt: skip


class _Lanes(NamedTuple):
    """Room for `_LANES` states at a time; what is left over of the last ones is never read."""

    d: np.ndarray  # (n, lanes) distance from the owner, in units of the lattice
    r2: np.ndarray  # (lanes,) its square; infinite for a state beyond all numbers
    owner: np.ndarray  # (lanes,) int, whose polynomial is used
    most: np.ndarray  # (lanes,) what log p cannot exceed there
    b: np.ndarray  # (M + 1, lanes) monomials of d, one first


@jit
def _lanes(n, M):
    b = np.empty((M + 1, _LANES))
    for lane in range(_LANES):
        b[0, lane] = 1.0
    return _Lanes(np.zeros((n, _LANES)), np.zeros(_LANES), np.zeros(_LANES, np.int64), np.zeros(_LANES), b)


@jit
def _located(field, strides, Y, first, lanes):
    """Find the cells of the states from Y[first] on; returns how many."""
    d, r2, owner = lanes.d, lanes.r2, lanes.owner
    n, count = d.shape[0], min(_LANES, Y.shape[0] - first)
    for lane in range(_LANES):
        owner[lane], r2[lane] = 0, 0.0
    for a in range(n):
        for lane in range(_LANES):
            d[a, lane] = 0.0
        for c in range(n):
            scale, centre = field.inverse[a, c], field.mu[c]
            for lane in range(count):
                d[a, lane] += scale * (Y[first + lane, c] - centre)
    for a in range(n):
        low, last, stride = field.low[a], field.dims[a] - 1.0, strides[a]
        for lane in range(_LANES):
            known = abs(d[a, lane]) < _BEYOND
            r2[lane] = r2[lane] if known else np.inf
            d[a, lane] = d[a, lane] if known else 0.0
            owner[lane] += int(min(max(math.floor(d[a, lane] + 0.5) - low, 0.0), last)) * stride
    for lane in range(_LANES):
        j = field.owner[owner[lane]]
        lanes.most[lane] = np.inf if j >= 0 else field.cap
        owner[lane] = j if j >= 0 else ~j
        for a in range(n):
            d[a, lane] -= field.node[owner[lane], a]
    for a in range(n):
        for lane in range(_LANES):
            r2[lane] += d[a, lane] * d[a, lane]
    return count


@jit
def _monomials(sten, d, b):
    """All monomials b (M + 1, lanes) of d (n, lanes), the one first."""
    for p in range(sten.parent.size):
        x, lower, out = d[sten.axis[p]], b[sten.parent[p] + 1], b[p + 1]
        for lane in range(_LANES):
            out[lane] = x[lane] * lower[lane]


@jit
def evaluate(field, sten, Y, out):
    """log p at the states Y (M, n).

    Further from a complete node than the rim of the lattice reaches, the quadratic part goes on alone, made
    concave and never rising: an outlier's likelihood meets a Gaussian tail, not a cubic one. Where the second
    derivatives are a Gaussian's but for noise, they are the Gaussian's: far out that noise is what counts.
    """
    lanes, strides = _lanes(field.mu.size, sten.parent.size), strides_of(field.dims)
    value = np.empty(_LANES)
    for first in range(0, Y.shape[0], _LANES):
        count = _located(field, strides, Y, first, lanes)
        _monomials(sten, lanes.d, lanes.b)
        _sums(field.coefficient, lanes.owner, lanes.b, value)
        for lane in range(count):
            j, v = lanes.owner[lane], value[lane]
            if not lanes.r2[lane] <= _RIM:
                v = min(_tail(field, j, lanes.d, lane), 0.0) if lanes.r2[lane] < np.inf else -np.inf
            out[first + lane] = max(min(field.log_p[j] + v, lanes.most[lane]), LOWEST)


@jit
def _sums(coefficient, owner, b, out):
    """Polynomials of the owners, from the monomials b (M + 1, lanes).

    Four sums at a time: one alone would wait for its own last addition.
    """
    for lane in range(0, _LANES, 4):
        c0, c1 = coefficient[owner[lane]], coefficient[owner[lane + 1]]
        c2, c3 = coefficient[owner[lane + 2]], coefficient[owner[lane + 3]]
        v0, v1, v2, v3 = 0.0, 0.0, 0.0, 0.0
        for p in range(c0.size):
            at = b[p + 1]
            v0 += c0[p] * at[lane]
            v1 += c1[p] * at[lane + 1]
            v2 += c2[p] * at[lane + 2]
            v3 += c3[p] * at[lane + 3]
        out[lane], out[lane + 1], out[lane + 2], out[lane + 3] = v0, v1, v2, v3


@jit
def _tail(field, j, d, lane):
    """What is used beyond the rim of the lattice, from node j's own log p."""
    v = 0.0
    for a in range(d.shape[0]):
        v += field.coefficient[j, a] * d[a, lane]
        for c in range(d.shape[0]):
            v += 0.5 * d[a, lane] * field.tail[j, a, c] * d[c, lane]
    return v


@jit
def gradient(field, sten, Y, out):
    """Gradient of log p (M, n), in units of the lattice, at states Y (M, n): of the polynomials themselves.

    Beyond the rim of the lattice it is that of the quadratic part that goes on alone.
    """
    n, M = field.mu.size, sten.parent.size
    lanes, strides, db = _lanes(n, M), strides_of(field.dims), np.zeros(M + 1)
    for first in range(0, Y.shape[0], _LANES):
        count = _located(field, strides, Y, first, lanes)
        _monomials(sten, lanes.d, lanes.b)
        for lane in range(count):
            j, near = lanes.owner[lane], lanes.r2[lane] <= _RIM
            for a in range(n):
                slope = 0.0 if near else field.coefficient[j, a]
                for c in range(0 if near else n):
                    slope += field.tail[j, a, c] * lanes.d[c, lane]
                for p in range(M if near else 0):
                    axis, parent = sten.axis[p], sten.parent[p] + 1
                    db[p + 1] = lanes.d[axis, lane] * db[parent] + (
                        lanes.b[parent, lane] if axis == a else 0.0
                    )
                    slope += field.coefficient[j, p] * db[p + 1]
                out[first + lane, a] = slope


@jit
def slopes(field, sten, Y, owner, out):
    """Gradient of log p (M, n), in units of the lattice, at states Y (M, n), and whose polynomial's it is.

    By the quadratic part that goes on beyond the lattice: enough to aim paths by.
    """
    n = field.mu.size
    lanes, strides = _lanes(n, sten.parent.size), strides_of(field.dims)
    for first in range(0, Y.shape[0], _LANES):
        count = _located(field, strides, Y, first, lanes)
        for lane in range(count):
            j, finite = lanes.owner[lane], lanes.r2[lane] < np.inf
            owner[first + lane] = j
            for a in range(n):
                slope = field.coefficient[j, a] if finite else 0.0
                for c in range(n if finite else 0):
                    slope += field.tail[j, a, c] * lanes.d[c, lane]
                out[first + lane, a] = slope
