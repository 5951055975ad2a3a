"""States and weights that stand for a density, of whatever kind, and where a state lies among them."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .._types import Floats, in_a_line
from ..errors import ModelError


class WeightedStates(NamedTuple):
    """States X (M, n) with weights w (M,) that sum to one; None for a cloud of samples, which has no density.

    `logpdf` takes states (K, n); `log_p` (M,) is what it gives at X, where that is known already.
    """

    X: Floats
    w: Floats
    logpdf: Callable[[Floats], Floats] | None = None
    log_p: Floats | None = None

    def __repr__(self) -> str:
        return in_a_line(self)


def state_rank(spread: WeightedStates, x: Floats) -> Floats:
    """Probability that each state lies below its value in x (n,), shape (n,): uniform if x is drawn."""
    # plain sums: those of matrix products depend on the number of threads, in their last bits
    halves = [np.sum(spread.w[:, None] * side, axis=0) for side in (x > spread.X, x >= spread.X)]
    return np.clip(0.5 * (halves[0] + halves[1]), 0.0, 1.0)


def hpd_rank(spread: WeightedStates, X: ArrayLike) -> Floats:
    """Probability of the region where the density is higher than at each of the states X (K, n), shape (K,).

    Of a state drawn from the density it is uniform, whatever the shape: its rank among highest-density
    regions. NaN for samples, which have no density.
    """
    X = np.atleast_2d(X)
    if spread.logpdf is None:
        return np.full(len(X), np.nan)
    log_p = spread.logpdf(spread.X) if spread.log_p is None else spread.log_p
    order = np.argsort(-log_p, kind="stable")
    total = np.concatenate([[0.0], np.cumsum(spread.w[order])])
    return np.minimum(total[np.searchsorted(-log_p[order], -spread.logpdf(X))], 1.0)


def checked_part(probability: ArrayLike) -> Floats:
    """Return probabilities as an array, or raise `ModelError` if one does not lie between 0 and 1."""
    probability = np.asarray(probability, dtype=float)
    if not np.all((probability > 0.0) & (probability < 1.0)):
        raise ModelError(f"probability must lie between 0 and 1, got {probability}")
    return probability


def quantile_of(y: Floats, w: Floats, probability: ArrayLike) -> Any:
    """Value below which numbers y (M,) of weights (M,) lie with a probability; (K,) for such."""
    probability = checked_part(probability)
    order = np.argsort(y)
    F = np.cumsum(w[order]) - 0.5 * w[order]
    found = np.interp(probability, F, y[order])
    return found if probability.ndim else float(found)
