"""The way of a cloud from one reading to the next: how it begins, and an interval of it, in one call each."""

import numpy as np

from .._jit import jit
from .blocks import block_roots, blocks_of, centres, combined, multiplied
from .curve import ordered
from .linearise import linearised, widths
from .move import affine, moved_over, shifted
from .noise import even_normals, mixed, stored, uniform
from .weights import effective, for_moments, taken, weighted_moments

# what numbers of a key are for
_CUT, FIRST, AGAIN, PILOT, KERNEL = range(5)
#: Effective part of points, below which they are drawn anew: half of them have √2 = 1.4 times the error.
_FEW = 0.5


@jit
def begin(x, w, lineage, count, key, net, table, bits):
    """Begin the way of a cloud: points in order, each for a Gaussian no wider than their distance.

    They are drawn anew where too few of them weigh anything, those far out more often than they weigh.
    Copies of a point part by its Gaussian, whatever the noise of the model. Blocks keep their mean and
    covariance.

    Points x (n, N) of weights w (N,), of whose `lineage` (readings, N) those of a number come from one
    point of before (without any, each is its own, not yet smoothed), become `count`, by a net (n, count) of
    standard normals; table and bits are the curve's. Returns start, y, u (n, count): middles of the
    Gaussians, points in them, and what moved each; w and block (count,); middle (blocks, n) and lower
    (blocks, n, n): centres, and roots of the Gaussians' covariances; and the lineages of the points, older
    (readings, count).
    """
    n, N = x.shape
    mean, cov = np.empty(n), np.empty((n, n))
    weighted_moments(x, w, mean, cov)
    order = ordered(x, mean, cov, table, bits)
    if count != N or effective(w) < _FEW * count:
        order, w = for_moments(x, w, mean, cov, order, count, uniform(np.uint64(key), np.uint64(_CUT)))
    else:
        w = w[order]
    x = taken(x, order)
    # what a reading has left is smoothed each time; a density that becomes points is smoothed once
    known, power = (lineage[0][order], max(2.0 / n, 1.0)) if lineage.size > 0 else (order, 2.0 / n)
    part = widths(x, known, power)
    block, middle, lower = blocks_of(count), centres(x), block_roots(x)
    u, flow = even_normals(net, np.uint64(stored(key, KERNEL))), np.empty(lower.shape)
    kept = np.sqrt(1.0 - part**2)
    start = combined(kept, x, 1.0 - kept, middle, block)
    flow[:] = np.eye(n)
    lower *= part.reshape(-1, 1, 1)
    older = taken(lineage, order)
    y = shifted(start, u, block, lower)
    return start, y, u, w, block, middle, lower, flow, older


@jit
def carry(leg, x, block, net, key):
    """Carry points x (n, N) over a leg, with their ends moved by the normals of a net (n, N).

    Returns y and u (n, N), ends and what moved them; start and end (blocks, n), centres of the blocks and
    where they come without noise; and Φ, L (blocks, n, n) and V (blocks, n, d), what linearises the blocks.
    """
    start, u = centres(x), even_normals(net, np.uint64(key))
    end, flow, lower, rows = linearised(leg, start)
    y = moved_over(leg, x, u, rows, block, mixed(np.uint64(key), np.uint64(FIRST)))
    return y, u, start, end, flow, lower, rows


@jit
def carry_linear(change, x, block, net, key):
    """Carry points x (n, N) over a linear change Φ x + offset + L u, as `carry` does over a leg."""
    start = centres(x)
    end, flow, lower = everywhere(change, start)
    u = even_normals(net, np.uint64(key))
    return affine(x, u, block, start, end, flow, lower), u, start, end, flow, lower, np.empty((1, 0, 0))


@jit
def everywhere(change, start):
    """Ends of centres (blocks, n) after a linear change, and its Φ and L in all blocks."""
    (blocks, n), (Phi, offset, L) = start.shape, change
    flow, lower = np.empty((blocks, n, n)), np.empty((blocks, n, n))
    flow[:], lower[:] = Phi, L
    return offset + multiplied(flow, start.copy().reshape(blocks, n, 1))[:, :, 0], flow, lower
