"""The polynomials of a field: fits around the nodes of a lattice, and what goes on beyond them.

On a lattice the least-squares fits are the same linear combination of neighbours everywhere: the rows are
computed once per dimension (`stencils`), and a fit costs one small matrix product. Nodes at the rim have no
polynomial of their own; the nearest complete node's is used there, so nothing one-sided is ever fitted. From
three dimensions on, where few nodes are complete, one polynomial through all nodes (`trend`) is taken off
before and added again.
"""

import math

import numpy as np
from numba import types

from .._addresses import Entry
from .._jit import MATRIX, VECTOR, jit
from ..limits import TINY
from ..small_matrices import eigen, extremes, invert_lower
from .cells import box_of, cells_in, strides_of, unravel
from .field import Field
from .stencils import STENCILS
from .trend import recentred, trend, value_at

_NEARLY = 0.2  # relative distance of second derivatives from a Gaussian's that is taken for noise of the fit


@jit
def build_field(mu, A, node, kept, log_p, sten):
    """Fit the polynomials of an opened set of nodes (N, n), whose first ones are `kept`.

    Every node must have a complete one nearby.
    """
    N, n = node.shape
    low, dims = np.empty(n, np.int64), np.empty(n, np.int64)
    box_of(node, sten.widest, low, dims)
    strides = strides_of(dims)
    ahead = np.zeros(sten.offsets.shape[0], np.int64)
    for k in range(ahead.size):
        for a in range(n):
            ahead[k] += sten.offsets[k, a] * strides[a]
    index = np.full(int(cells_in(dims)), -1, np.int64)
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
        fitted = coefficient[i]
        for k in range(sten.size[level]):
            difference, row = rest[index[flats[i] + ahead[k]]] - rest[i], sten.rows[level, k]
            for c in range(M):
                fitted[c] += row[c] * difference
        _second_derivatives(coefficient[i], sten, tail[i])
    gaussian = _mean_curvature(tail, log_p, owner, flats)
    _concave(gaussian, least, w, V, work)
    for i in range(N):
        if owner[flats[i]] != i:
            continue  # only complete nodes own anything
        if _distance(tail[i], gaussian) < _NEARLY:
            for a in range(n):
                for b in range(n):
                    tail[i, a, b] = gaussian[a, b]
        else:
            _concave(tail[i], least, w, V, work)
    _spread_owners(owner, node, low, dims, strides)
    for flat in range(owner.size):
        if index[flat] < 0:
            owner[flat] = ~owner[flat]
    cap = _cap(log_p[:kept], gaussian)
    return Field(mu, A, invert_lower(A), low, dims, owner, node, kept, log_p, coefficient, cap, tail)


@jit
def _cap(log_p, gaussian):
    """Largest log p that a Gaussian has outside of its nodes' cells, half a cell's diagonal beyond them."""
    n, trace = gaussian.shape[0], 0.0
    lowest, highest = extremes(log_p)
    for a in range(n):
        trace -= gaussian[a, a]
    return lowest + math.sqrt(2.0 * (highest - lowest)) * 0.5 * math.sqrt(max(trace, 0.0))


@jit
def _widest(node, log_p, w, V, work):
    """Curvature of the Gaussian with the nodes' covariance along its widest axis, in units of the lattice."""
    N, n = node.shape
    mean, total, highest = np.zeros(n), 0.0, extremes(log_p)[1]
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
    return -1.0 / extremes(w)[1]


@jit
def _mean_curvature(second, log_p, owner, flats):
    """Second derivatives averaged over the mass of complete nodes: a Gaussian's own, wherever it is cut."""
    n = second.shape[1]
    mean, total, highest = np.zeros((n, n)), 0.0, extremes(log_p)[1]
    for i in range(log_p.size):
        if owner[flats[i]] == i:
            m = math.exp(log_p[i] - highest)
            total += m
            for a in range(n):
                for b in range(n):
                    mean[a, b] += m * second[i, a, b]
    return mean / max(total, TINY)


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
    cells = np.empty((owner.size, n), np.int64)  # remembered: divisions would cost more
    queue = np.empty(owner.size, np.int64)
    head, tail = 0, 0
    for flat in range(owner.size):
        if owner[flat] >= 0:
            queue[tail] = flat
            unravel(flat, strides, cells[tail])
            tail += 1
    while head < tail:
        flat, cell = queue[head], cells[head]
        head += 1
        for a in range(n):
            for step in (-1, 1):
                if cell[a] + step < 0 or cell[a] + step >= dims[a]:
                    continue
                at = flat + step * strides[a]
                if owner[at] < 0:
                    other = cells[tail]
                    for b in range(n):
                        other[b] = cell[b] + (step if a == b else 0)
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


#: `build_field` by its address.
BUILD = Entry(build_field, (VECTOR, MATRIX, types.int64[:, ::1], types.int64, VECTOR, STENCILS))
