"""Blocks of rows for threads: enough to keep them busy, and as many whatever the number of threads."""

import numpy as np

from .._jit import jit

__all__ = ["BLOCKS", "PARALLEL_FROM", "add_parts", "even", "even_pairs"]

BLOCKS = 8
#: Particles from which blocks pay; by their number alone, so that the thread count never changes results.
PARALLEL_FROM = 2000


@jit
def even(N):
    """First rows of blocks of about as many rows, and N at the end, shape (BLOCKS + 1,)."""
    return np.arange(BLOCKS + 1) * N // BLOCKS


@jit
def even_pairs(start):
    """As `even`, blocks of about as many pairs; those of row s begin at start[s]."""
    return np.searchsorted(start, np.arange(BLOCKS + 1) * start[-1] // BLOCKS)


@jit
def add_parts(parts, total):
    """Add the sums of the blocks, shape (BLOCKS, ...), to the total, block by block.

    Written out: numba compiles an array expression ten times as long.
    """
    size = total.size
    part, sums = parts.reshape((BLOCKS, size)), total.reshape(size)
    for b in range(BLOCKS):
        for k in range(size):
            sums[k] += part[b, k]
