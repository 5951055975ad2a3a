"""Weighted points that share ancestors: copies of one carry no more than it does."""

import math
from typing import NamedTuple

import numpy as np

from .._types import Floats, Ints
from ..core.cloud.weights import carried, effective, finite_rows, normalise

__all__ = ["Carried", "carriers"]


class Carried(NamedTuple):
    """States x (N, n), weights w (N,) of sum one, the evidence, and how many independent points they are."""

    x: Floats
    w: Floats
    family: Ints  # (N,)
    log_evidence: float
    effective: float  # for means
    families: float  # for the evidence

    @classmethod
    def of(cls, x: Floats, log_w: Floats, family: Ints) -> "Carried":
        """States with log-weights (N,) whose sum is the evidence, and the ancestor (N,) of each."""
        w, (fine, every) = np.zeros(len(x)), finite_rows(x)
        if not every:
            log_w = np.where(fine, log_w, -np.inf)
        log_evidence = normalise(log_w, w)
        if not math.isfinite(log_evidence):
            return cls(x, w, family, -np.inf, 0.0, 0.0)
        if not w.min() > 0.0:
            heavy = w > 0.0
            x, w, family = x[heavy], w[heavy], family[heavy]
        return cls(x, w, family, log_evidence, *carriers(x, w, family))


def carriers(x: Floats, w: Floats, family: Ints) -> tuple[float, float]:
    """Effective numbers of independent points: of which the mean, and of which the evidence is an average.

    Families are independent of each other, so that the variance of the mean is the sum of the squares of
    what each adds to it (Chan & Lai 2013); over that of one point that is the mean's. The evidence knows
    of no more than the families' weights.

    Parameters
    ----------
    x, w : ndarray, shapes (N, n), (N,)
        States, and weights of sum one.
    family : ndarray of int, shape (N,)
        The ancestor of each.

    Returns
    -------
    mean, evidence : float
    """
    squares, part = carried(x, w, family, int(family.max()) + 1)
    families = 1.0 / squares
    if not part > 0.0:
        return families, families
    # few families may agree by chance, and one agrees with itself: a variance seen F - 1 times
    return max(families, min(effective(w), (1.0 - squares) / part, families**2)), families
