"""A log-density on a lattice: polynomials through the nodes around every node, and values anywhere.

The lattice is ``x = mu + A i`` with integer vectors i, regular in whitened coordinates. Around every node
whose neighbours are complete, log p is a polynomial fitted by weighted least squares ("moving least squares
particle hydrodynamics"). On a lattice those fits are the same linear combination of neighbours everywhere:
the rows are computed once per dimension (`stencils`), and a fit costs one small matrix product. Nodes at the
rim have no polynomial of their own; the nearest complete node's is used there, so nothing one-sided is ever
fitted. From three dimensions on, where few nodes are complete, one polynomial through all nodes (`trend`) is
taken off before and added again.
"""

import math
from typing import NamedTuple

import numpy as np

from ._jit import jit
from .cells import LOWEST, product, strides_of, unravel
from .small_matrices import eigen, invert_lower
from .trend import recentred, trend, value_at

__all__ = ["Field", "build_field", "evaluate", "slopes"]

_RIM = 4.5  # squared distance: the rim lies at sqrt 2 from a complete node, half a cell inside of this
_PAD = 3  # cells around the nodes in the box of a field, the reach of the widest neighbourhood
_NEARLY = 0.2  # relative distance of second derivatives from a Gaussian's that is taken for noise of the fit


class Field(NamedTuple):
    """log p as polynomials on a lattice; see the module's text."""

    mu: np.ndarray  # (n,) origin
    A: np.ndarray  # (n, n) lattice vectors in columns
    inverse: np.ndarray  # (n, n) of A
    low: np.ndarray  # (n,) int, lowest cell of the box
    dims: np.ndarray  # (n,) int, cells of the box along every axis
    owner: np.ndarray  # (cells,) int, whose polynomial is used there; its complement (~) where no node lies
    node: np.ndarray  # (N, n) int
    log_p: np.ndarray  # (N,)
    coefficient: np.ndarray  # (N, M), in units of the lattice
    cap: float  # log p is below it wherever no node lies
    tail: np.ndarray  # (N, n, n) second derivatives for beyond the lattice: bent down in all directions


@jit
def build_field(mu, A, node, log_p, sten):
    """Fit the polynomials of an opened set of nodes (N, n). Every node must have a complete one nearby."""
    N, n = node.shape
    low, dims = np.empty(n, np.int64), np.empty(n, np.int64)
    for a in range(n):
        low[a], dims[a] = node[0, a], node[0, a]
        for i in range(N):
            low[a], dims[a] = min(low[a], node[i, a]), max(dims[a], node[i, a])
        low[a] -= _PAD
        dims[a] += _PAD + 1 - low[a]
    strides = strides_of(dims)
    ahead = np.zeros(sten.offsets.shape[0], np.int64)
    for k in range(ahead.size):
        for a in range(n):
            ahead[k] += sten.offsets[k, a] * strides[a]
    index = np.full(int(product(dims)), -1, np.int64)
    flats = np.zeros(N, np.int64)
    for i in range(N):
        for a in range(n):
            flats[i] += (node[i, a] - low[a]) * strides[a]
        index[flats[i]] = i
    M = sten.parent.size
    coefficient, tail = np.zeros((N, M)), np.zeros((N, n, n))
    owner = np.full(index.size, -1, np.int64)
    work, V, w = np.empty((n, n)), np.empty((n, n)), np.empty(n)
    least = 0.5 * _widest(node, log_p, w, V, work)
    base = trend(node, log_p, sten)
    rest = log_p.copy()
    monomials = np.empty(M)
    for i in range(N):
        if base.size > 0:
            rest[i] -= value_at(node[i], sten, base, monomials)
    for i in range(N):
        level = _level(index, flats[i], ahead, sten.size)
        if level < 0:
            continue
        owner[flats[i]] = i
        if base.size > 0:
            recentred(base, node[i], sten, monomials, coefficient[i])
        for k in range(sten.size[level]):
            difference = rest[index[flats[i] + ahead[k]]] - rest[i]
            for c in range(M):
                coefficient[i, c] += sten.rows[level, k, c] * difference
        _second_derivatives(coefficient[i], sten, tail[i])
    gaussian = _mean_curvature(tail, log_p, owner, flats)
    _concave(gaussian, least, w, V, work)
    for i in range(N):
        if _distance(tail[i], gaussian) < _NEARLY:
            tail[i] = gaussian
        else:
            _concave(tail[i], least, w, V, work)
    _spread_owners(owner, node, low, dims, strides)
    for flat in range(owner.size):
        if index[flat] < 0:
            owner[flat] = ~owner[flat]
    cap = _cap(log_p, gaussian)
    return Field(mu, A, invert_lower(A), low, dims, owner, node, log_p, coefficient, cap, tail)


@jit
def _cap(log_p, gaussian):
    """Largest log p that a Gaussian has outside of its nodes' cells, half a cell's diagonal beyond them."""
    n, trace, lowest = gaussian.shape[0], 0.0, log_p.min()
    for a in range(n):
        trace -= gaussian[a, a]
    return lowest + math.sqrt(2.0 * (log_p.max() - lowest)) * 0.5 * math.sqrt(max(trace, 0.0))


@jit
def _widest(node, log_p, w, V, work):
    """Curvature of the Gaussian with the nodes' covariance along its widest axis, in units of the lattice."""
    N, n = node.shape
    mean, total, highest = np.zeros(n), 0.0, log_p.max()
    for i in range(N):
        m = math.exp(log_p[i] - highest)
        total += m
        for a in range(n):
            mean[a] += m * node[i, a]
    for a in range(n):
        mean[a] /= total
        for b in range(n):
            work[a, b] = 0.0
    for i in range(N):
        m = math.exp(log_p[i] - highest) / total
        for a in range(n):
            for b in range(n):
                work[a, b] += m * (node[i, a] - mean[a]) * (node[i, b] - mean[b])
    eigen(work, w, V)
    return -1.0 / w.max()


@jit
def _mean_curvature(second, log_p, owner, flats):
    """Second derivatives averaged over the mass of complete nodes: a Gaussian's own, wherever it is cut."""
    n = second.shape[1]
    mean, total, highest = np.zeros((n, n)), 0.0, log_p.max()
    for i in range(log_p.size):
        if owner[flats[i]] == i:
            m = math.exp(log_p[i] - highest)
            total += m
            for a in range(n):
                for b in range(n):
                    mean[a, b] += m * second[i, a, b]
    return mean / max(total, 1e-300)


@jit
def _distance(h, other):
    """Frobenius norm of a difference, relative to the other."""
    off, size = 0.0, 0.0
    for a in range(h.shape[0]):
        for b in range(h.shape[0]):
            off += (h[a, b] - other[a, b]) ** 2
            size += other[a, b] ** 2
    return math.sqrt(off / size)


@jit
def _concave(h, least, w, V, work):
    """Bound the eigenvalues of a symmetric matrix from above by `least` < 0: no tail without an end."""
    n = h.shape[0]
    for a in range(n):
        for b in range(n):
            work[a, b] = h[a, b]
    eigen(work, w, V)
    for a in range(n):
        for b in range(n):
            h[a, b] = 0.0
            for k in range(n):
                h[a, b] += V[a, k] * min(w[k], least) * V[b, k]


@jit
def _level(index, flat, ahead, size):
    """Largest neighbourhood that is complete; -1 if none is. The box's margin holds all of them."""
    level = -1
    for k in range(ahead.size):
        if index[flat + ahead[k]] < 0:
            break
        if k + 1 == size[level + 1]:
            level += 1
    return level


@jit
def _second_derivatives(c, sten, h):
    n = h.shape[0]
    for k in range(n, c.size):
        p = sten.parent[k]
        if p >= n:
            break  # of higher degree from here on
        a, b = sten.axis[k], sten.axis[p]
        h[a, b] = h[b, a] = 2.0 * c[k] if a == b else c[k]


@jit
def _spread_owners(owner, node, low, dims, strides):
    """Give every cell of the box the complete node nearest to it, wave by wave from the nodes outwards."""
    n = dims.size
    cell, other = np.empty(n, np.int64), np.empty(n, np.int64)
    queue = np.empty(owner.size, np.int64)
    head, tail = 0, 0
    for flat in range(owner.size):
        if owner[flat] >= 0:
            queue[tail] = flat
            tail += 1
    while head < tail:
        flat = queue[head]
        head += 1
        unravel(flat, strides, cell)
        for a in range(n):
            for step in (-1, 1):
                if cell[a] + step < 0 or cell[a] + step >= dims[a]:
                    continue
                at = flat + step * strides[a]
                if owner[at] < 0:
                    unravel(at, strides, other)
                    owner[at] = _nearest_of(other, owner, node, low, dims, strides, at, owner[flat])
                    queue[tail] = at
                    tail += 1


@jit
def _nearest_of(cell, owner, node, low, dims, strides, flat, best):
    """The nearest of the owners beside a cell."""
    n = dims.size
    nearest = np.inf
    for a in range(n):
        for step in (-1, 1):
            if 0 <= cell[a] + step < dims[a] and owner[flat + step * strides[a]] >= 0:
                j = owner[flat + step * strides[a]]
                r2 = 0.0
                for b in range(n):
                    r2 += float(cell[b] + low[b] - node[j, b]) ** 2
                if r2 < nearest:
                    nearest, best = r2, j
    return best


@jit
def _quartic(c, x, y):
    """The polynomial of two dimensions, nested: half the time of the general sum."""
    in_x = c[0] + x * (c[2] + x * (c[5] + x * c[9]))
    in_y2 = c[4] + x * (c[7] + x * c[11]) + y * (c[8] + x * c[12] + y * c[13])
    return x * in_x + y * (c[1] + x * (c[3] + x * (c[6] + x * c[10])) + y * in_y2)


@jit
def _located(field, strides, y, d):
    """Owner of the cell of a state y (n,), and the squared distance from it; d (n,) becomes the distance.

    All in units of the lattice. The owner is a complement as in the field; the distance is infinite for a
    state beyond all numbers.
    """
    flat, n = 0, d.size
    for a in range(n):
        t = 0.0
        for c in range(n):
            t += field.inverse[a, c] * (y[c] - field.mu[c])
        if not abs(t) < 1e150:
            return field.owner[0], np.inf
        d[a] = t
        k = int(min(max(math.floor(t + 0.5) - field.low[a], 0.0), field.dims[a] - 1.0))
        flat += k * strides[a]
    j, r2 = field.owner[flat], 0.0
    for a in range(n):
        d[a] -= field.node[j if j >= 0 else ~j, a]
        r2 += d[a] * d[a]
    return j, r2


@jit
def evaluate(field, sten, Y, out):
    """log p at the states Y (M, n).

    Further from a complete node than the rim of the lattice reaches, the quadratic part goes on alone, made
    concave and never rising: an outlier's likelihood meets a Gaussian tail, not a cubic one. Where the second
    derivatives are a Gaussian's but for noise, they are the Gaussian's: far out that noise is what counts.
    """
    n, M = field.mu.size, sten.parent.size
    strides = strides_of(field.dims)
    b, d = np.empty(M), np.empty(n)
    for q in range(Y.shape[0]):
        j, r2 = _located(field, strides, Y[q], d)
        if r2 == np.inf:
            out[q] = LOWEST
            continue
        most = np.inf if j >= 0 else field.cap
        j = j if j >= 0 else ~j
        if r2 > _RIM:
            v = 0.0
            for a in range(n):
                v += field.coefficient[j, a] * d[a]
                for c in range(n):
                    v += 0.5 * d[a] * field.tail[j, a, c] * d[c]
            v = min(v, 0.0)
        elif n == 2:
            v = _quartic(field.coefficient[j], d[0], d[1])
        else:
            v = value_at(d, sten, field.coefficient[j], b)
        out[q] = max(min(field.log_p[j] + v, most), LOWEST)


@jit
def slopes(field, sten, Y, owner, out):
    """Gradient of log p (M, n), in units of the lattice, at states Y (M, n), and whose polynomial's it is."""
    n, M = field.mu.size, sten.parent.size
    strides = strides_of(field.dims)
    b, d, db = np.empty(M), np.empty(n), np.empty((M, n))
    for q in range(Y.shape[0]):
        j, r2 = _located(field, strides, Y[q], d)
        j = j if j >= 0 else ~j
        owner[q] = j
        for a in range(n):
            out[q, a] = 0.0
        if r2 <= _RIM:
            for p in range(M):
                axis, parent = sten.axis[p], sten.parent[p]
                b[p] = d[axis] * (1.0 if parent < 0 else b[parent])
                for a in range(n):
                    db[p, a] = 0.0 if parent < 0 else db[parent, a] * d[axis]
                    if a == axis:
                        db[p, a] += 1.0 if parent < 0 else b[parent]
                    out[q, a] += field.coefficient[j, p] * db[p, a]
        elif r2 < np.inf:
            for a in range(n):
                out[q, a] = field.coefficient[j, a]
                for c in range(n):
                    out[q, a] += field.tail[j, a, c] * d[c]
