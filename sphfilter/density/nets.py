"""Nets: standard normals that lie evenly along a curve, the same for every cloud of so many points."""

import warnings
from functools import lru_cache

import numpy as np

from .._types import Floats

_SEED = 20220  # of the one scrambling that all nets have


@lru_cache(maxsize=64)
def net(count: int, dim: int, part: int = 0) -> Floats:
    """Standard normals (count, dim), read-only: a scrambled Sobol net in order of one more dimension.

    That dimension is dropped: it is the place along a curve through the states, with which the normals are
    even together. Mean and covariance are exact. Parts of a path have scramblings of their own: points of one
    net that follow each other lie on few lines, and noise of two predictions would hang together.
    """
    from scipy.special import ndtri  # on use: import time
    from scipy.stats import qmc

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # numbers of points that are no power of two
        uniform = qmc.Sobol(dim + 1, rng=np.random.default_rng([_SEED, part])).random(count)
    z = ndtri(np.clip(uniform[np.argsort(uniform[:, 0]), 1:], 1e-12, 1.0 - 1e-12))
    z -= z.mean(axis=0)
    if count > 2 * dim:
        z = np.linalg.solve(np.linalg.cholesky(z.T @ z / count), z.T).T
    z = np.ascontiguousarray(z)
    z.flags.writeable = False
    return z
