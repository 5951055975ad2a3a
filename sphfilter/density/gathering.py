"""Families taken together where one says what several do."""

import math

import numpy as np

from .._types import Bools, Floats
from .families import Families, log_total
from .family import OF_MISFIT, Family, fitted, moments_apart, node_moments


def merged_families(families: Families, most: float, heavy: float) -> tuple[Families, float]:
    """Put one family in the place of all if that is off by at most `most`, else in that of halves of them.

    Those of a share below `heavy` may be off by more.

    Returns
    -------
    Families, float
        The heaviest first, and the error that this adds, standard deviations.
    """
    seen, off, found = families.looked_at(), 0.0, []
    groups = [np.arange(len(families.log_w))]
    while groups:
        which = groups.pop()
        own, (_, mean, cov) = families.some(which), seen.some(which).together(families.log_w[which])
        log_w = float(log_total(own.log_w))
        one, change = _fitted(own._replace(log_w=own.log_w - log_w), mean, cov)
        if len(which) == 1 or change <= most * max(1.0, heavy / math.exp(log_w)):
            found.append((log_w, *(families.one(which[0]) if len(which) == 1 else one)))
            off += 0.0 if len(which) == 1 else math.exp(log_w) * change
        else:
            side = _side(seen.mean[which] - mean, own.w, cov)
            groups += [half for half in (which[side], which[~side]) if len(half)]
    return Families(*(np.array(part) for part in zip(*found, strict=True))).normalised(), off


def _side(away: Floats, w: Floats, cov: Floats) -> Bools:
    """On which side (K,) of the mean of all middles lie, along what parts them most."""
    z = np.linalg.solve(np.linalg.cholesky(cov), away.T)
    along = np.linalg.eigh((z * w) @ z.T)[1][:, -1] @ z
    return np.asarray(along > 0.5 * (along.min() + along.max()))


def _fitted(families: Families, mean: Floats, cov: Floats) -> tuple[Family, float]:
    """One family in the place of several, and what it is off by: in log p, the mean, or the covariance."""
    one, misfit = fitted(families.log_p, mean, cov, families.degree)
    b, C = node_moments(one.basis.xi, one.weighted()[0])
    return one, max(OF_MISFIT * misfit, moments_apart(b, C - np.eye(len(mean))))
