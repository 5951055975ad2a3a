"""Weighted points that share ancestors: copies of one carry no more than it does."""

from typing import NamedTuple

import numpy as np

from .._types import Floats, Ints
from ..core.cloud.weights import carriers

NO_LINES = np.empty((0, 0), np.int64)  # of points each its own


class Carried(NamedTuple):
    """States x (N, n), weights w (N,) of sum one, the evidence, and how many independent points they are."""

    x: Floats
    w: Floats
    lineage: Ints  # (readings, N): ancestors among the prior's points, and those of readings before
    log_evidence: float
    mean: Floats  # (n,)
    cov: Floats  # (n, n)
    effective: float  # for means
    lineages: float  # for the evidence

    @classmethod
    def of(cls, x: Floats, log_w: Floats, ancestor: Ints, older: Ints = NO_LINES) -> "Carried":
        """States with log-weights (N,) whose sum is the evidence, and each one's ancestor (N,) in the prior.

        The prior's points may have lineages (readings, M).
        """
        return cls(*carriers(x, log_w, ancestor, older))
