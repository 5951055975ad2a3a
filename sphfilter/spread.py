"""States and weights that stand for a density, of whatever kind, and where a state lies among them."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

__all__ = ["Spread", "below", "higher"]


class Spread(NamedTuple):
    """States X (M, n) with weights w (M,) that sum to one; the log-density there, if there is a density.

    `logpdf` takes states (K, n); it and `log_p` (M,) are None for a cloud of samples.
    """

    X: np.ndarray
    w: np.ndarray
    log_p: np.ndarray | None = None
    logpdf: Callable | None = None


def below(spread, x):
    """Probability that each state lies below its value in x (n,), shape (n,): uniform if x is drawn."""
    return 0.5 * (spread.w @ (x > spread.X) + spread.w @ (x >= spread.X))


def higher(spread, X):
    """Probability of the region where the density is higher than at each of the states X (K, n), shape (K,).

    Of a state drawn from the density it is uniform, whatever the shape: its rank among highest-density
    regions. NaN for samples, which have no density.
    """
    X = np.atleast_2d(X)
    if spread.logpdf is None:
        return np.full(len(X), np.nan)
    order = np.argsort(-spread.log_p, kind="stable")
    total = np.concatenate([[0.0], np.cumsum(spread.w[order])])
    return np.minimum(total[np.searchsorted(-spread.log_p[order], -spread.logpdf(X))], 1.0)
