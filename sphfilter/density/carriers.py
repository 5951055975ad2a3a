"""Weighted points that share ancestors: copies of one carry no more than it does."""

from typing import NamedTuple

from .._types import Floats, Ints
from ..core.cloud.weights import carriers

__all__ = ["Carried"]


class Carried(NamedTuple):
    """States x (N, n), weights w (N,) of sum one, the evidence, and how many independent points they are."""

    x: Floats
    w: Floats
    lineage: Ints  # (N,)
    log_evidence: float
    mean: Floats  # (n,)
    cov: Floats  # (n, n)
    effective: float  # for means
    lineages: float  # for the evidence

    @classmethod
    def of(cls, x: Floats, log_w: Floats, lineage: Ints) -> "Carried":
        """States with log-weights (N,) whose sum is the evidence, and the ancestor (N,) of each."""
        return cls(*carriers(x, log_w, lineage))
