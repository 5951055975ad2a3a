"""Cells of a lattice in a box of integers: their numbers, and regions that grow over them."""

import math

import numpy as np

from .._jit import jit

UNKNOWN = -math.inf  # of a cell whose value has not been asked for; an impossible state is merely very low
LOWEST = -1e300  # sums of 1e8 such numbers are numbers still, 1e308 < 2^1024
MARGIN = 3  # cells around the seeds in the first box: as far as neighbourhoods reach, stencils(1).widest = 3
MOST_CELLS = 20_000_000  # of a box: 8 bytes each = 160 MB


@jit
def cells_in(dims):
    """Number of cells of a box, as a float: it may be beyond any integer."""
    total = 1.0
    for k in range(dims.size):
        total *= dims[k]
    return total


@jit
def strides_of(dims):
    """Steps in a flat array for one step along every axis."""
    n = dims.size
    strides = np.empty(n, np.int64)
    strides[n - 1] = 1
    for a in range(n - 2, -1, -1):
        strides[a] = strides[a + 1] * dims[a + 1]
    return strides


@jit
def inside(cell, offset, dims, strides, flat):
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
def unravel(flat, strides, cell):
    """Write where a cell of a flat number is, counted from the box's corner, to cell (n,)."""
    for a in range(strides.size):
        cell[a] = flat // strides[a]
        flat -= cell[a] * strides[a]


@jit
def furthest(n):
    """Cells around the origin that seeds may lie in: pieces of a density further out would be lost."""
    return max(500.0, min(1e6, 0.4 * MOST_CELLS ** (1.0 / n)))


@jit
def seeds_in_box(points, mu, inverse, reach, low, dims):
    """Lattice cells (N, n) that some points lie in, at most `reach` from the origin; and a box around them.

    The box's lowest cell and its size along every axis are written to low and dims (n,).
    """
    N, n = points.shape
    cells = np.empty((N, n), np.int64)
    for i in range(N):
        for a in range(n):
            t = 0.0
            for c in range(n):
                t += inverse[a, c] * (points[i, c] - mu[c])
            cells[i, a] = math.floor(min(max(t, -reach), reach) + 0.5)
    box_of(cells, MARGIN, low, dims)
    return cells


@jit
def box_of(cells, margin, low, dims):
    """Corner and size of the box that holds some cells (N, n), with a margin on every side."""
    for a in range(dims.size):
        low[a], dims[a] = cells[0, a], cells[0, a]
        for i in range(cells.shape[0]):
            low[a], dims[a] = min(low[a], cells[i, a]), max(dims[a], cells[i, a])
        low[a] -= margin
        dims[a] += margin + 1 - low[a]


@jit
def seeded(cells, low, dims):
    """Flat numbers of cells, each once."""
    mark = np.zeros(int(cells_in(dims)), np.bool_)
    for i in range(cells.shape[0]):
        flat = 0
        for a in range(dims.size):
            flat = flat * dims[a] + cells[i, a] - low[a]
        mark[flat] = True
    return np.flatnonzero(mark)


@jit
def states_of(found, mu, A, low, dims):
    """States (M, n) of cells of a box, given by flat numbers; and their integer coordinates."""
    n = dims.size
    node, Y = np.empty((found.size, n), np.int64), np.empty((found.size, n))
    for k in range(found.size):
        rest = found[k]
        for a in range(n - 1, -1, -1):
            node[k, a] = rest % dims[a] + low[a]
            rest //= dims[a]
        for a in range(n):
            Y[k, a] = mu[a]
            for c in range(n):
                Y[k, a] += A[a, c] * node[k, c]
    return node, Y


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
            unravel(asked[k], strides, cell)
            for j in range(offsets.shape[0]):
                at = inside(cell, offsets[j], dims, strides, asked[k])
                if at < 0:
                    beyond = True
                elif value[at] == UNKNOWN:
                    value[at] = LOWEST
                    found[count] = at
                    count += 1
    if beyond:  # the box will be another one: forget
        for k in range(count):
            value[found[k]] = UNKNOWN
    return found[:count], beyond


@jit
def opened(value, asked, kept_above, dims, ball):
    """Cells above a level that belong to a complete ball of such cells: no tips, no single nodes."""
    strides, n = strides_of(dims), dims.size
    cell = np.empty(n, np.int64)
    keep = np.zeros(value.size, np.bool_)
    for k in range(asked.size):
        if value[asked[k]] <= kept_above:
            continue
        unravel(asked[k], strides, cell)
        complete = True
        for j in range(ball.shape[0]):
            at = inside(cell, ball[j], dims, strides, asked[k])
            if at < 0 or value[at] <= kept_above:
                complete = False
                break
        if complete:
            keep[asked[k]] = True
            for j in range(ball.shape[0]):
                keep[inside(cell, ball[j], dims, strides, asked[k])] = True
    return np.flatnonzero(keep)


@jit
def widen(value, low, dims, asked):
    """A larger box on every side; values and the list of asked cells are carried over. Empty if too large."""
    n = dims.size
    grow, new_low, new_dims = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
    for a in range(n):
        grow[a] = max(dims[a] // 4, 2)
        new_low[a], new_dims[a] = low[a] - grow[a], dims[a] + 2 * grow[a]
    if cells_in(new_dims) > MOST_CELLS:
        return np.empty(0), new_low, new_dims, asked
    new, moved = np.full(int(cells_in(new_dims)), UNKNOWN), np.empty(asked.size, np.int64)
    for k in range(asked.size):
        rest, at, stride = asked[k], 0, 1
        for a in range(n - 1, -1, -1):
            at += (rest % dims[a] + grow[a]) * stride
            rest //= dims[a]
            stride *= new_dims[a]
        new[at], moved[k] = value[asked[k]], at
    return new, new_low, new_dims, moved


def grown(value, low, dims, asked, kept_above, ball):
    """The next wave over a box, which is widened where that leaves it; asked once a wave, and not compiled.

    Returns values, corner and size of the box, the cells asked, and those to ask: see `frontier` and `widen`.
    None where the box outgrows the memory.
    """
    found, beyond = frontier(value, asked, kept_above, dims, ball)
    if beyond:
        value, low, dims, asked = widen(value, low, dims, asked)
        if value.size == 0:
            return None
        found, _ = frontier(value, asked, kept_above, dims, ball)
    return value, low, dims, asked, found
