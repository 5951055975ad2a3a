"""A prediction and a reading of a cloud and of the smaller one beside it, in one call.

That is what `prediction.cloud` and `filter.by_cloud` do of any model and sensor, for a cycle of which nothing
needs more: all other cycles are theirs.
"""

from typing import NamedTuple

import numpy as np
from numba import types

from .._addresses import NOWHERE_AT, Entry
from .._jit import MATRIX, VECTOR, jit
from .reading import EVEN, READER, Part, weigh
from .steps import CUBE, LEG
from .way import begin, carry, carry_linear
from .weights import AWAY, carried, compared, effective, together, weighted_moments

__all__ = ["FEW", "PARTS", "Cycled", "Resting", "cycle"]

#: Part of points below which carriers are few: the way piece by piece, at six times the cost, divides errors
#: by five.
FEW = 0.25
_INTS, _KEY = types.int64[::1], types.int64
_NET = types.Array(types.float64, 2, "C", readonly=True)
_MOVED = types.NamedTuple([MATRIX, MATRIX, CUBE, CUBE, CUBE], Part)
_WAY = LEG, types.boolean, _KEY, MATRIX, MATRIX, VECTOR, _INTS, _MOVED, _MOVED, MATRIX, MATRIX
_BEGIN = Entry(begin, (MATRIX, VECTOR, _INTS, types.int64, _KEY, _NET, types.uint32[::1], types.int64))
_CARRY = Entry(carry, (LEG, MATRIX, _INTS, _NET, _KEY))
_LINEAR = Entry(carry_linear, (types.Tuple([MATRIX, VECTOR, MATRIX]), MATRIX, _INTS, _NET, _KEY))
_WEIGH = Entry(weigh, (READER, *_WAY, types.UniTuple(_NET, 3), _KEY))
_CARRIED = Entry(carried, (MATRIX, VECTOR, _INTS))
#: What a cycle is made of, each compiled by itself.
PARTS = _BEGIN, _CARRY, _LINEAR, _WEIGH, _CARRIED
_begin_at, _carry_at, _linear_at, _weigh_at, _carried_at = [entry.at for entry in PARTS]


class Resting(NamedTuple):
    """A cloud as a reading left it; keys, and normals of what comes: the guide, the begin, the motion."""

    x: np.ndarray  # (N, n)
    w: np.ndarray
    family: np.ndarray
    moving: int
    reading: int
    nets: tuple  # of (count, n)


class Cycled(NamedTuple):
    """A cloud after a cycle: its prior's points, weights, mean and covariance, and what `carried` says."""

    usual: bool  # whether nothing was found that needs more; else the rest is of no worth
    y: np.ndarray
    w: np.ndarray
    mean: np.ndarray
    cov: np.ndarray
    found: tuple


@jit
def cycle(parts, leg, change, reader, cloud, beside, table, bits):
    """One prediction and one reading.

    Parameters
    ----------
    parts : tuple of int
        Addresses of `PARTS`.
    leg : Leg
        None that is called, of a linear model.
    change : tuple of ndarray, shapes (n, n), (n,), (n, n)
        Φ, offset and L of a linear model; of another, any.
    reader : Reader
    cloud, beside : Resting
    table, bits : ndarray, int
        Of the curve.

    Returns
    -------
    cloud, beside : Cycled
    before, after : tuple of float
        Squared errors that the two show of mean and covariance, before and after the reading.
    """
    one = _cycled(parts, leg, change, reader, cloud, table, bits)
    two = _cycled(parts, leg, change, reader, beside, table, bits)
    before = compared(one.mean, one.cov, two.mean, two.cov)
    return one, two, before, compared(one.found[4], one.found[5], two.found[4], two.found[5])


@jit
def _cycled(parts, leg, change, reader, cloud, table, bits):
    _, first, second = cloud.nets
    (count, n), key = first.shape, cloud.moving
    begun = _begin_at(parts[0])(cloud.x, cloud.w, cloud.family, count, key, first, table, bits)
    start, x, u, w, block, middle, lower, flow = begun
    kernel = Part(middle, middle, flow, lower, np.empty((1, 0, 0)))
    linear = leg.drift == NOWHERE_AT
    if linear:
        y, v, middle, end, flow, lower, rows = _linear_at(parts[2])(change, x, block, second, key)
    else:
        y, v, middle, end, flow, lower, rows = _carry_at(parts[1])(leg, x, block, second, key)
    moved = Part(middle, end, flow, lower, rows)
    way = reader, leg, linear, key, start, y, w, block, kernel, moved, u, v, cloud.nets, cloud.reading
    z, log_w, family, wrong = _weigh_at(parts[3])(*way)
    found = _carried_at(parts[4])(z, log_w, family)
    mean, cov = np.empty(n), np.empty((n, n))
    weighted_moments(y, w, mean, cov)
    enough = found[7] >= min(FEW * count, EVEN * effective(w))
    usual = enough and wrong == 0 and together(y, AWAY)[1] and found[3] > -np.inf
    return Cycled(usual, y, w, mean, cov, found)
