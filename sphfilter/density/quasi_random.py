"""Points that lie more evenly than random ones, by a key or as a net: always the same."""

import warnings
from enum import IntEnum
from functools import cache, lru_cache

import numpy as np

from .._types import Floats, Ints, OfStates
from ..core.cloud import weights
from ..core.cloud.curve import spread
from ..core.cloud.noise import even_normals

#: Standard deviations of the Gaussian that points come from, over the density's own. Measured: with 1.0 the
#: error of lorenz is 1.15 times as large, with 1.3 that of the pendulum 1.5 times.
_WIDER = 1.15
#: States that stand for a density, and as few as will do where it is only looked at: random ones would have
#: its mean within 1 / √2^15 = .006 and 1 / √2^12 = .016.
STATES, FEW_STATES = 2**15, 2**12


class NetPart(IntEnum):
    """Nets that are of no passage of a path, whose numbers are less: see `passage.MOST`."""

    LED = 30  # what leads points to a reading
    START = 31  # points of a Gaussian; clouds beside each other have the next ones
    DENSITY = 10_000  # points of any density


def spread_evenly(count: int, n: int, shift: Floats | float = 0.0, order: Ints | None = None) -> Floats:
    """Points (count, n) of the additive sequence of the root of x^(n+1) = x + 1, even over the unit cube.

    All are shifted, by a number or (n,), modulo one; `order` (count,) numbers them, else from the first on.
    """
    uniform = np.empty((n, count))
    order = np.arange(count) if order is None else order
    spread(_root(n) ** -np.arange(1.0, n + 1.0), np.broadcast_to(shift, n).astype(float), order, uniform)
    return uniform.T


@cache
def _root(n: int) -> float:
    from scipy import optimize  # on use: import time

    return float(optimize.brentq(lambda x: x ** (n + 1) - x - 1.0, 1.0, 2.0))


def quasi_random(count: int, n: int, key: int, order: Ints | None = None) -> Floats:
    """Points (count, n) evenly spread over the unit cube, shifted by a key; by number in some order.

    From three dimensions on they are Sobol's: of an additive sequence slanting tails and covariances are off
    by several times as much as those of random points, by up to ten times in three dimensions.
    """
    shift = np.random.Generator(np.random.Philox(key)).random(n)
    if n < 3:
        return spread_evenly(count, n, shift, order)
    numbers = np.arange(count) if order is None else order
    return np.asarray((_sobol(int(numbers.max(initial=0)) + 1, n, 0)[numbers] + shift) % 1.0)


def systematic(mass: Floats, count: int) -> Ints:
    """Numbers (count,) of points of weights (N,), each as often as its weight says but for rounding."""
    return weights.systematic(np.array(mass), count, 0.5)  # a copy: compiled code takes what may be written


def weighted_points(
    log_p: OfStates, moments: tuple[Floats, Floats], count: int, key: int
) -> tuple[Floats, Floats]:
    """Points (count, n) with weights (count,) of a density of given mean and covariance.

    They come from a Gaussian somewhat wider than that, weighted by the ratio of the two.
    """
    mean, cov = moments
    z = _WIDER * even(count, len(mean), key, NetPart.DENSITY)
    x = mean + np.einsum("ij,kj->ik", z, np.linalg.cholesky(cov))
    log_w = log_p(x) + 0.5 * np.sum(z**2, axis=1) / _WIDER**2
    w = np.exp(log_w - log_w.max())
    return x, w / w.sum()


@lru_cache(maxsize=16)
def _sobol(count: int, dim: int, part: int) -> Floats:
    """The first points (count, dim), read-only, of a scrambled Sobol sequence over the unit cube."""
    from scipy.stats import qmc  # on use: import time

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # numbers of points that are no power of two
        rng = np.random.default_rng([20220, part])  # one scrambling, that all nets have
        uniform = np.asarray(qmc.Sobol(dim, rng=rng).random(count))
    uniform.flags.writeable = False
    return uniform


@lru_cache(maxsize=64)
def net(count: int, dim: int, part: int = 0) -> Floats:
    """Standard normals (count, dim), read-only: a scrambled Sobol net in order of one more dimension.

    That dimension is dropped: it is the place along a curve through the states, with which the normals are
    even together. Mean and covariance are exact. Parts of a path have scramblings of their own: points of one
    net that follow each other lie on few lines, and noise of two predictions would hang together.
    """
    from scipy.special import ndtri  # on use: import time

    uniform = _sobol(count, dim + 1, part)
    z = ndtri(np.clip(uniform[np.argsort(uniform[:, 0]), 1:], 1e-12, 1.0 - 1e-12))
    z -= z.mean(axis=0)
    if count > 2 * dim:
        z = np.linalg.solve(np.linalg.cholesky(z.T @ z / count), z.T).T
    z = np.ascontiguousarray(z.T)  # as compiled code takes it
    z.flags.writeable = False
    return z.T


def even(count: int, dim: int, key: int, part: int) -> Floats:
    """Standard normals (count, dim) of the net of a part of a path, turned and shifted by a key."""
    return np.asarray(even_normals(net(count, dim, part).T, np.uint64(key)).T)
