"""A log-density on a lattice: polynomials through the nodes around every node, and values anywhere.

The lattice is ``x = mu + A i`` with integer vectors i, regular in whitened coordinates. Around every node
whose neighbours are complete, log p is a polynomial fitted by weighted least squares ("moving least squares
particle hydrodynamics"). On a lattice those fits are the same linear combination of neighbours everywhere:
the rows are computed once per dimension (`stencils`), and a fit costs one small matrix product. Nodes at the
rim have no polynomial of their own; the nearest complete node's is used there, so nothing one-sided is ever
fitted.
"""

import itertools
import math
from functools import cache
from typing import NamedTuple

import numpy as np

from ._jit import jit

__all__ = ["Field", "Stencils", "build_field", "evaluate", "frontier", "opened", "slopes", "stencils"]

UNKNOWN = -math.inf  # of a cell whose value has not been asked for; an impossible state is merely very low
LOWEST = -1e300
_TREND = {3: 4, 4: 4}  # degree of the polynomial through all nodes by dimension, 3 beyond
_NODES_A_TERM = 2.5
_PAD = 3  # cells around the nodes in the box of a field, the reach of the widest neighbourhood
_NEARLY = 0.2  # relative distance of second derivatives from a Gaussian's that is taken for noise of the fit
_WEIGHT_DECAY = 4.0  # weights exp(-4 r^2 / r_max^2) of the least-squares fit


class Stencils(NamedTuple):
    """Neighbourhoods of increasing size and the least-squares rows that belong to them."""

    offsets: np.ndarray  # (largest size, n) int; a neighbourhood is the first so many of them
    size: np.ndarray  # (levels,)
    rows: np.ndarray  # (levels, largest size, M): coefficients from differences of neighbours
    parent: np.ndarray  # (M,) monomial that times x_axis gives this one, -1 for x_axis itself
    axis: np.ndarray  # (M,)
    trend: np.ndarray  # (degrees,) monomials of a polynomial through all nodes, by its degree; none if empty
    shift: np.ndarray  # (S, 3) int: terms `to`, `from` and of the displacement that move a polynomial's centre
    binomial: np.ndarray  # (S,)


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


def _neighborhoods(n):
    """(offsets, degree, with mixed cubic terms) by level; each holds the one before."""
    reach = {1: 3, 2: 2}.get(n, 2)
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


def _exponents(n, degree):
    """Exponents of the monomials up to a degree, by degree, without the constant."""
    every = itertools.product(range(degree + 1), repeat=n)
    return sorted((e for e in every if 1 <= sum(e) <= degree), key=lambda e: (sum(e), [-k for k in e]))


@cache
def stencils(n):
    """The `Stencils` of n dimensions."""
    levels = _neighborhoods(n)
    exponents = _exponents(n, max(_TREND.get(n, 3) if n > 2 else 0, *(degree for _, degree, _ in levels)))
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
    return Stencils(offsets, size, rows, np.array(parent), np.array(axis), trend[: 0 if n < 3 else None],
                    *_shifts(exponents))


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


@jit
def invert_lower(A):
    """Inverse of a lower triangular matrix."""
    n = A.shape[0]
    out = np.zeros((n, n))
    for c in range(n):
        for a in range(c, n):
            total = 1.0 if a == c else 0.0
            for b in range(c, a):
                total -= A[a, b] * out[b, c]
            out[a, c] = total / A[a, a]
    return out


@jit
def product(values):
    """Product of numbers, as a float: it may be beyond any integer."""
    total = 1.0
    for k in range(values.size):
        total *= values[k]
    return total


@jit
def marked(mark):
    """Numbers of the cells that are marked."""
    count = 0
    for flat in range(mark.size):
        count += mark[flat]
    found = np.empty(count, np.int64)
    count = 0
    for flat in range(mark.size):
        if mark[flat]:
            found[count] = flat
            count += 1
    return found


@jit
def eigen(h, w, V):
    """Eigenvalues and vectors (columns) of a small symmetric matrix, by Jacobi's rotations; h is used up."""
    n = h.shape[0]
    for a in range(n):
        for b in range(n):
            V[a, b] = 1.0 if a == b else 0.0
    for _ in range(30):
        off, size = 0.0, 0.0
        for a in range(n):
            size += h[a, a] ** 2
            for b in range(a):
                off += h[a, b] ** 2
        if not off > 1e-30 * size:
            break
        for a in range(n):
            for b in range(a):
                if h[a, b] != 0.0:
                    _rotate(h, V, a, b)
    for a in range(n):
        w[a] = h[a, a]


@jit
def _rotate(h, V, a, b):
    """Make h[a, b] zero."""
    theta = 0.5 * (h[b, b] - h[a, a]) / h[a, b]
    t = (1.0 if theta >= 0.0 else -1.0) / (abs(theta) + math.sqrt(theta * theta + 1.0))
    c = 1.0 / math.sqrt(t * t + 1.0)
    s = t * c
    for k in range(h.shape[0]):
        x, y = h[k, a], h[k, b]
        h[k, a], h[k, b] = c * x - s * y, s * x + c * y
    for k in range(h.shape[0]):
        x, y = h[a, k], h[b, k]
        h[a, k], h[b, k] = c * x - s * y, s * x + c * y
        x, y = V[k, a], V[k, b]
        V[k, a], V[k, b] = c * x - s * y, s * x + c * y


@jit
def strides_of(dims):
    """Steps in a flat array for one step along every axis."""
    n = dims.size
    strides = np.ones(n, np.int64)
    for a in range(n - 2, -1, -1):
        strides[a] = strides[a + 1] * dims[a + 1]
    return strides


@jit
def _inside(cell, offset, dims, strides, flat):
    """Flat index of a cell plus an offset, or -1 outside of the box. `cell` is counted from the
    box's corner.
    """
    for a in range(dims.size):
        k = cell[a] + offset[a]
        if k < 0 or k >= dims[a]:
            return -1
        flat += offset[a] * strides[a]
    return flat


@jit
def _unravel(flat, strides, cell):
    for a in range(strides.size):
        cell[a] = flat // strides[a]
        flat -= cell[a] * strides[a]


@jit
def frontier(value, asked, kept_above, dims, offsets):
    """Cells not yet asked for beside an asked cell above a level; the bool tells if any lies outside.

    Cells found are given a very low value in `value`, so that none is found twice.
    """
    strides, n = strides_of(dims), dims.size
    cell = np.empty(n, np.int64)
    found, count, beyond = np.empty(asked.size * offsets.shape[0], np.int64), 0, False
    for k in range(asked.size):
        if value[asked[k]] > kept_above:
            _unravel(asked[k], strides, cell)
            for j in range(offsets.shape[0]):
                at = _inside(cell, offsets[j], dims, strides, asked[k])
                if at < 0:
                    beyond = True
                elif value[at] == UNKNOWN:
                    value[at] = LOWEST
                    found[count] = at
                    count += 1
    if beyond:  # the box will be another one: forget
        for k in range(count):
            value[found[k]] = UNKNOWN
    return found[:count].copy(), beyond


@jit
def opened(value, asked, kept_above, dims, ball):
    """Cells above a level that belong to a complete ball of such cells: no tips, no single nodes."""
    strides, n = strides_of(dims), dims.size
    cell = np.empty(n, np.int64)
    keep = np.zeros(value.size, np.bool_)
    for k in range(asked.size):
        if value[asked[k]] <= kept_above:
            continue
        _unravel(asked[k], strides, cell)
        complete = True
        for j in range(ball.shape[0]):
            at = _inside(cell, ball[j], dims, strides, asked[k])
            if at < 0 or value[at] <= kept_above:
                complete = False
                break
        if complete:
            keep[asked[k]] = True
            for j in range(ball.shape[0]):
                keep[_inside(cell, ball[j], dims, strides, asked[k])] = True
    return marked(keep)


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
    base = _trend(node, log_p, sten)
    rest = log_p.copy()
    monomials = np.empty(M)
    for i in range(N):
        if base.size > 0:
            rest[i] -= _monomials(node[i], sten, base, monomials)
    for i in range(N):
        level = _level(index, flats[i], ahead, sten.size)
        if level < 0:
            continue
        owner[flats[i]] = i
        if base.size > 0:
            _recentred(base, node[i], sten, monomials, coefficient[i])
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
    """Largest log p that a Gaussian has outside of its nodes' cells, half a diagonal of a cell beyond them."""
    n, trace, lowest = gaussian.shape[0], 0.0, log_p.min()
    for a in range(n):
        trace -= gaussian[a, a]
    return lowest + math.sqrt(2.0 * (log_p.max() - lowest)) * 0.5 * math.sqrt(max(trace, 0.0))


@jit
def _monomials(x, sten, c, b):
    """Value of a polynomial of coefficients c at x, and all monomials b."""
    total = 0.0
    for p in range(b.size):
        b[p] = x[sten.axis[p]] * (1.0 if sten.parent[p] < 0 else b[sten.parent[p]])
        total += c[p] * b[p]
    return total


@jit
def _recentred(c, x, sten, b, out):
    """Coefficients around x of a polynomial with coefficients c around the origin; its constant left out."""
    _monomials(x, sten, c, b)
    for p in range(c.size):
        out[p] = c[p]
    for k in range(sten.binomial.size):
        out[sten.shift[k, 0]] += sten.binomial[k] * c[sten.shift[k, 1]] * b[sten.shift[k, 2]]


@jit
def _trend(node, log_p, sten):
    """Coefficients (M,) of the polynomial through all nodes that fits best, weighted by the root of p.

    Its degree is the highest for which there are nodes enough. Empty where lattices do without.
    """
    N, M, terms = log_p.size, sten.parent.size, 0
    for degree in range(sten.trend.size):
        if N >= _NODES_A_TERM * sten.trend[degree]:
            terms = sten.trend[degree]
    if terms == 0:
        return np.empty(0)
    out, scale, highest = np.zeros(M), np.ones(M + 1), log_p.max()
    b, K = np.empty(M), terms + 1
    A, right = np.zeros((K, K)), np.zeros(K)
    for i in range(N):
        _monomials(node[i], sten, out, b)
        w = math.exp(0.5 * (log_p[i] - highest))
        for p in range(K):
            bp = w * (1.0 if p == 0 else b[p - 1])
            right[p] += bp * log_p[i]
            A[p, 0] += bp
            for q in range(1, p + 1):
                A[p, q] += bp * b[q - 1]
    for p in range(K):
        scale[p] = 1.0 / math.sqrt(A[p, p])
    for p in range(K):
        for q in range(p + 1):
            A[p, q] *= scale[p] * scale[q]
        A[p, p] += 1e-11
        for q in range(p + 1):
            for k in range(q):
                A[p, q] -= A[p, k] * A[q, k]
            A[p, q] = math.sqrt(max(A[p, p], 1e-15)) if p == q else A[p, q] / A[q, q]
    for p in range(K):
        right[p] *= scale[p]
        for q in range(p):
            right[p] -= A[p, q] * right[q]
        right[p] /= A[p, p]
    for p in range(K - 1, -1, -1):
        for q in range(p + 1, K):
            right[p] -= A[q, p] * right[q]
        right[p] /= A[p, p]
        if p > 0:
            out[p - 1] = right[p] * scale[p]
    return out


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
        _unravel(flat, strides, cell)
        for a in range(n):
            for step in (-1, 1):
                if cell[a] + step < 0 or cell[a] + step >= dims[a]:
                    continue
                at = flat + step * strides[a]
                if owner[at] < 0:
                    _unravel(at, strides, other)
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
        flat, finite = 0, True
        for a in range(n):
            t = 0.0
            for c in range(n):
                t += field.inverse[a, c] * (Y[q, c] - field.mu[c])
            finite &= abs(t) < 1e150
            d[a] = t if finite else 0.0
            k = int(min(max(math.floor(d[a] + 0.5) - field.low[a], 0.0), field.dims[a] - 1.0))
            flat += k * strides[a]
        if not finite:
            out[q] = LOWEST
            continue
        j, most = field.owner[flat], np.inf
        if j < 0:
            j, most = ~j, field.cap
        r2, v = 0.0, 0.0
        for a in range(n):
            d[a] -= field.node[j, a]
            r2 += d[a] * d[a]
        if r2 <= 4.5:  # the rim lies at sqrt 2 from a complete node, half a cell inside of 4.5
            if n == 2:
                v = _quartic(field.coefficient[j], d[0], d[1])
            else:
                for p in range(M):
                    b[p] = d[sten.axis[p]] * (1.0 if sten.parent[p] < 0 else b[sten.parent[p]])
                    v += field.coefficient[j, p] * b[p]
        else:
            for a in range(n):
                v += field.coefficient[j, a] * d[a]
                for c in range(n):
                    v += 0.5 * d[a] * field.tail[j, a, c] * d[c]
            v = min(v, 0.0)
        out[q] = max(min(field.log_p[j] + v, most), LOWEST)


@jit
def slopes(field, sten, Y, owner, out):
    """Gradient of log p (M, n), in units of the lattice, at states Y (M, n), and whose polynomial it is of."""
    n, M = field.mu.size, sten.parent.size
    strides = strides_of(field.dims)
    b, d, db = np.empty(M), np.empty(n), np.empty((M, n))
    for q in range(Y.shape[0]):
        flat, finite = 0, True
        for a in range(n):
            t = 0.0
            for c in range(n):
                t += field.inverse[a, c] * (Y[q, c] - field.mu[c])
            finite &= abs(t) < 1e150
            d[a] = t if finite else 0.0
            k = int(min(max(math.floor(d[a] + 0.5) - field.low[a], 0.0), field.dims[a] - 1.0))
            flat += k * strides[a]
            out[q, a] = 0.0
        j = field.owner[flat]
        j = j if j >= 0 else ~j
        owner[q] = j
        if not finite:
            continue
        r2 = 0.0
        for a in range(n):
            d[a] -= field.node[j, a]
            r2 += d[a] * d[a]
        if r2 <= 4.5:
            for p in range(M):
                axis, parent = sten.axis[p], sten.parent[p]
                b[p] = d[axis] * (1.0 if parent < 0 else b[parent])
                for a in range(n):
                    db[p, a] = 0.0 if parent < 0 else db[parent, a] * d[axis]
                    if a == axis:
                        db[p, a] += 1.0 if parent < 0 else b[parent]
                    out[q, a] += field.coefficient[j, p] * db[p, a]
        else:
            for a in range(n):
                out[q, a] = field.coefficient[j, a]
                for c in range(n):
                    out[q, a] += field.tail[j, a, c] * d[c]
