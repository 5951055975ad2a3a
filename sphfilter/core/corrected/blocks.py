"""Blocks of rows for threads: enough to keep them busy, and as many whatever the number of threads."""

import numpy as np

from .._jit import jit

__all__ = ["BLOCKS", "PARALLEL_FROM", "even", "even_pairs"]

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
