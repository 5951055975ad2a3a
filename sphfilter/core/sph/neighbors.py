"""Neighbour lists: cell list, k-d tree or brute force, closed under symmetry.

A pair (i, j) interacts when r < K max(h_i, h_j): the averaged kernel of 002 (15) needs the particles that
see i as well as those that i sees (002 keeps only the k nearest of i, and misses some). Lists also hold
`buffer` further particles each, so that they stay valid for several steps (002 section 4.3).

Rows are sorted by particle number: sums, and so results, are the same bits whatever the search.
"""

from typing import NamedTuple

import numpy as np

from .._jit import jit
from ..limits import TINY

METHODS = ("brute", "cells", "tree")
BRUTE, CELLS, TREE = range(3)
_LEAF = 16  # particles in a leaf of the k-d tree


class Index(NamedTuple):
    """A search structure; the arrays that a method does not need are empty.

    `order` lists particles cell by cell (`start` bounds the cells) or leaf by leaf; `low`, `high` are the
    corner of the cell grid and the cell sizes in row 0, or the bounding boxes of the tree's nodes.
    """

    method: int
    order: np.ndarray
    start: np.ndarray
    dims: np.ndarray
    low: np.ndarray
    high: np.ndarray


def choose_method(n_particles, dim):
    """Return the code of the fastest search for so many particles in so many dimensions (measured).

    Brute force wins on small clouds, cells in one dimension and on large clouds in two, the tree elsewhere.
    """
    if n_particles <= 250:
        return BRUTE
    return CELLS if dim == 1 or (dim == 2 and n_particles > 500) else TREE


@jit
def build_index(x, size, method):
    """Build the search structure of `method` over x (N, n); `size` is the cell width."""
    if method == CELLS:
        return _build_cells(x, size)
    if method == TREE:
        return _build_tree(x)
    none, nowhere = np.empty(0, np.int64), np.empty((0, 0))
    return Index(BRUTE, none, none, none, nowhere, nowhere)


@jit
def _build_cells(x, size):
    """Counting sort of the particles; no more than about two cells a particle."""
    N, n = x.shape
    low, high = np.empty((1, n)), np.empty((1, n))
    dims = np.empty(n, np.int64)
    n_cells = 1
    for d in range(n):
        low[0, d], top = x[0, d], x[0, d]
        for i in range(N):
            low[0, d], top = min(low[0, d], x[i, d]), max(top, x[i, d])
        span = top - low[0, d]
        dims[d] = int(min(max(span / size, 1.0), (2.0 * N) ** (1.0 / n) + 1.0))
        high[0, d] = max(span / dims[d], TINY)
        n_cells *= dims[d]
    cell = np.empty(N, np.int64)
    start = np.zeros(n_cells + 1, np.int64)
    for i in range(N):
        c = 0
        for d in range(n):
            c = c * dims[d] + min(int((x[i, d] - low[0, d]) / high[0, d]), dims[d] - 1)
        cell[i] = c
        start[c + 1] += 1
    for c in range(n_cells):
        start[c + 1] += start[c]
    order, fill = np.empty(N, np.int64), start.copy()
    for i in range(N):
        order[fill[cell[i]]] = i
        fill[cell[i]] += 1
    return Index(CELLS, order, start, dims, low, high)


@jit
def _halve(order, x, axis, a, b, middle):
    """Reorder order[a:b] so that nothing before `middle` lies beyond anything after it (quickselect)."""
    last = b - 1
    while a < last:
        pivot = x[order[(a + last) // 2], axis]
        i, j = a, last
        while i <= j:
            while x[order[i], axis] < pivot:
                i += 1
            while x[order[j], axis] > pivot:
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i, j = i + 1, j - 1
        if middle <= j:
            last = j
        elif middle >= i:
            a = i
        else:
            return


@jit
def _build_tree(x):
    """Balanced k-d tree: nodes are numbered as in a heap, each halves its particles on its widest axis."""
    N, n = x.shape
    n_nodes = 1
    while N / n_nodes > _LEAF:
        n_nodes *= 2
    n_nodes = 2 * n_nodes - 1
    order, start = np.arange(N), np.zeros(2 * n_nodes, np.int64)
    low, high = np.empty((n_nodes, n)), np.empty((n_nodes, n))
    start[1] = N
    for node in range(n_nodes):
        a, b = start[2 * node], start[2 * node + 1]
        widest = 0
        for d in range(n):
            low[node, d], high[node, d] = np.inf, -np.inf
            for s in range(a, b):
                low[node, d] = min(low[node, d], x[order[s], d])
                high[node, d] = max(high[node, d], x[order[s], d])
            if high[node, d] - low[node, d] > high[node, widest] - low[node, widest]:
                widest = d
        if 2 * node + 2 < n_nodes:
            middle = (a + b) // 2
            _halve(order, x, widest, a, b, middle)
            start[4 * node + 2], start[4 * node + 3] = a, middle
            start[4 * node + 4], start[4 * node + 5] = middle, b
    return Index(TREE, order, start, np.empty(0, np.int64), low, high)


@jit
def _gather(x, order, low, high, y, k, R2, found, r2, n_found):
    """Append those of order[low:high] that lie within the radius of point k, with squared distances.

    Every candidate is written and the count advanced only for a hit: no branch to mispredict. Two dimensions
    are written out, where a loop over axes costs several times as much. So are the arguments: as pairs, of
    rows and of what is found, they cost 3 % of a march.
    """
    n = x.shape[1]
    for s in range(low, high):
        j = order[s]
        if n == 2:
            a, b = y[k, 0] - x[j, 0], y[k, 1] - x[j, 1]
            gap2 = a * a + b * b
        else:
            gap2 = 0.0
            for d in range(n):
                a = y[k, d] - x[j, d]
                gap2 += a * a
        found[n_found], r2[n_found] = j, gap2
        n_found += gap2 <= R2
    return n_found


@jit
def _query_cells(index, x, y, k, R, found, r2):
    axes = index.dims.size
    first, last, at = np.empty(axes, np.int64), np.empty(axes, np.int64), np.empty(axes, np.int64)
    for d in range(axes):
        u = (y[k, d] - index.low[0, d]) / index.high[0, d]
        w = R / index.high[0, d]
        first[d] = int(min(max(u - w, 0.0), index.dims[d] - 1.0))
        last[d] = int(min(max(u + w, 0.0), index.dims[d] - 1.0))
        at[d] = first[d]
    n_found = 0
    while True:
        c = 0
        for d in range(axes):
            c = c * index.dims[d] + at[d]
        low, high = index.start[c], index.start[c + 1]
        n_found = _gather(x, index.order, low, high, y, k, R * R, found, r2, n_found)
        d = axes - 1
        while d >= 0 and at[d] == last[d]:
            at[d] = first[d]
            d -= 1
        if d < 0:
            return n_found
        at[d] += 1


@jit
def _query_tree(index, x, y, k, R, found, r2):
    n_nodes, n = index.low.shape
    stack = np.empty(64, np.int64)
    stack[0], depth, n_found = 0, 1, 0
    while depth > 0:
        depth -= 1
        node = stack[depth]
        gap2 = 0.0
        for d in range(n):
            gap2 += max(index.low[node, d] - y[k, d], 0.0, y[k, d] - index.high[node, d]) ** 2
        if gap2 > R * R:
            continue
        if 2 * node + 2 < n_nodes:
            stack[depth], stack[depth + 1] = 2 * node + 1, 2 * node + 2
            depth += 2
        else:
            low, high = index.start[2 * node], index.start[2 * node + 1]
            n_found = _gather(x, index.order, low, high, y, k, R * R, found, r2, n_found)
    return n_found


@jit
def _query_all(x, y, k, R, found, r2):
    """Brute force in two passes: all distances, which vectorises, then the hits moved to the front."""
    N, n = x.shape
    if n == 2:
        y0, y1 = y[k, 0], y[k, 1]
        for j in range(N):
            r2[j] = (y0 - x[j, 0]) ** 2 + (y1 - x[j, 1]) ** 2
    else:
        for j in range(N):
            gap2 = 0.0
            for d in range(n):
                gap2 += (y[k, d] - x[j, d]) ** 2
            r2[j] = gap2
    n_found = 0
    for j in range(N):
        gap2 = r2[j]
        found[n_found], r2[n_found] = j, gap2
        n_found += gap2 <= R * R
    return n_found


@jit
def query(index, x, y, k, R, found, r2):
    """Write the particles of x within R of y[k], and squared distances, to `found`, `r2` (N,); how many."""
    if index.method == CELLS:
        return _query_cells(index, x, y, k, R, found, r2)
    if index.method == TREE:
        return _query_tree(index, x, y, k, R, found, r2)
    return _query_all(x, y, k, R, found, r2)


@jit
def _reach(x, i, support, reach, buffer, index, found, r2):
    """Radius in which at least `buffer` particles lie beyond the support of i, starting from `reach`."""
    while True:
        n_found = query(index, x, x, i, reach, found, r2)
        inside = 0
        for s in range(n_found):
            inside += r2[s] <= support * support
        if n_found - inside >= buffer or n_found == x.shape[0] or not reach < np.inf:
            return reach, n_found
        reach *= 1.2


@jit
def neighbor_lists(x, support, reach, buffer, index):
    """Symmetric neighbour lists with at least `buffer` particles beyond each support, K h (N,).

    The `reach` (N,) is the radius to search first, and grown in place where the buffer is not met. Returns
    start (N + 1,) and neighbors: row i is ``neighbors[start[i]:start[i+1]]``, sorted, without i itself.
    """
    N = x.shape[0]
    found, r2 = np.empty(N, np.int64), np.empty(N)
    pairs, gaps2, n_pairs = np.empty(32 * N, np.int32), np.empty(32 * N), 0
    start = np.zeros(N + 1, np.int64)
    for i in range(N):
        reach[i], n_found = _reach(x, i, support[i], max(reach[i], support[i]), buffer, index, found, r2)
        if n_pairs + n_found > pairs.size:
            more, more2 = np.empty(2 * pairs.size + N, np.int32), np.empty(2 * pairs.size + N)
            for s in range(n_pairs):  # written out: numba compiles a copy of slices ten times as long
                more[s], more2[s] = pairs[s], gaps2[s]
            pairs, gaps2 = more, more2
        for s in range(n_found):
            if found[s] != i:
                pairs[n_pairs], gaps2[n_pairs] = found[s], r2[s]
                n_pairs += 1
        start[i + 1] = n_pairs
    return _close(reach, start, pairs, gaps2)


@jit
def _close(reach, start, pairs, gaps2):
    """Add i to the list of j wherever j lies in the reach of i but not i in that of j, and sort rows."""
    N = reach.size
    size = np.zeros(N + 1, np.int64)
    for i in range(N):
        size[i + 1] += start[i + 1] - start[i]
        for s in range(start[i], start[i + 1]):
            if gaps2[s] > reach[pairs[s]] ** 2:
                size[pairs[s] + 1] += 1
    bounds = size
    for i in range(N):
        bounds[i + 1] += bounds[i]
    fill, rows = bounds[:-1].copy(), np.empty(bounds[-1], np.int32)
    for i in range(N):
        for s in range(start[i], start[i + 1]):
            j = pairs[s]
            rows[fill[j]] = i
            fill[j] += 1
            if gaps2[s] > reach[j] ** 2:
                rows[fill[i]] = j
                fill[i] += 1
    for i in range(N):
        _insertion_sort(rows, bounds[i], bounds[i + 1])
    return bounds, rows


@jit
def _insertion_sort(a, low, high):
    """Sort a[low:high]; rows are filled almost in order, which this sort rewards."""
    for s in range(low + 1, high):
        value, k = a[s], s
        while k > low and a[k - 1] > value:
            a[k] = a[k - 1]
            k -= 1
        a[k] = value
