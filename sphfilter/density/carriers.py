"""Weighted points that share ancestors: copies of one carry no more than it does."""

from typing import NamedTuple

import numpy as np

from .._types import Floats, Ints
from ..core.cloud.weights import effective, normalise
from .points import moments

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
        w = np.zeros(len(x))
        fine = np.isfinite(log_w) & np.isfinite(x).all(axis=1)
        log_evidence = normalise(np.where(fine, log_w, -np.inf), w)
        if not np.isfinite(log_evidence):
            return cls(x, w, family, -np.inf, 0.0, 0.0)
        if not fine.all():
            x, w, family = x[fine], w[fine], family[fine]
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
    families = 1.0 / float(np.sum(np.bincount(family, w) ** 2))
    mean, cov = moments(x, w)
    scale = np.sqrt(np.diag(cov))
    if not (np.isfinite(scale).all() and (scale > 0.0).all()):
        return families, families
    z = (x - mean) / scale
    added = np.stack([np.bincount(family, w * z[:, a]) for a in range(x.shape[1])])
    unlike = np.linalg.pinv(cov / np.outer(scale, scale), hermitian=True)
    part = float(np.einsum("ij,ik,jk->", unlike, added, added)) / x.shape[1]
    # few families may agree by chance, and one agrees with itself: a variance seen F - 1 times
    of_mean = min((1.0 - 1.0 / families) / max(part, 1e-300), families**2)
    return max(families, min(effective(w), of_mean)), families
