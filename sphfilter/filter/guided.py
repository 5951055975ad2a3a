"""Bayes' rule on points: weighted, and once more from ancestors that the reading chooses.

Both passes are weighted together: each point by its likelihood over the mixture of what it may have been
drawn from, so that the guide, whatever it is worth, never makes a posterior worse than none.
"""

from typing import Any, NamedTuple

import numpy as np

from .._types import Floats, Ints, OfStates
from ..core.cloud.guide import look_ahead, over_both, spread
from ..core.cloud.noise import even_normals, uniform
from ..core.cloud.weights import effective, finite_rows
from ..density.carriers import Carried
from ..density.nets import net
from ..density.passage import LED, gone, normals, sub_key
from ..density.points import Points, Prior
from ..model.domain import Domain
from .bridged import bridged
from .stacked import Stacked, seen
from .tempered import tempered

__all__ = ["Weighed", "weighed"]

#: Effective part of weights, from which they are good enough as they are.
_EVEN = 0.9
#: Times the reading's own noise that the guide sees: 1.2 has heavy weights on two wells, 2 is as good.
_WIDER = 1.5
#: Variance of a point's own rest about the mean of four neighbours', over that of one.
_OWN = 1.0 + 1.0 / 4.0
#: Part of points below which carriers are few: the way piece by piece, at six times the cost, divides errors
#: by five; what points lose of their carriers along it; the part below which tempering, at twenty, is tried.
_FEW, _LOST, _FEWER = 0.25, 2.0, 1.0 / 16.0
#: Independent points enough for an error of .14; times the carriers of one way, by which another is better.
_ENOUGH, _FAR_MORE = 50.0, 2.0
_NEXT_TO_NONE = 16.0  # the evidence's error is a quarter of a nat, and weights' own number is believed


class Weighed(NamedTuple):
    """A posterior as points, its log-evidence, and how many independent points each of them is an average of.

    Copies of a point count once. Where they are few, the error of a mean is about 1/√effective standard
    deviations, and that of the log-evidence 1/√families, whatever clouds agree on.
    """

    points: Points
    log_evidence: float
    effective: float  # 0 where no point can have been read: the points are the prior's
    families: float


def weighed(points: Points, readings: tuple[Any, ...], key: int, domain: Domain | None = None) -> Weighed:
    """Prior times the likelihood of all readings of one time.

    Parameters
    ----------
    points : Points
        The prior; or the posterior of readings of the same time before, whose prior is taken.
    readings : tuple of Asked
    key : int
    domain : Domain, optional

    Returns
    -------
    Weighed
        Its evidence is that of these readings, given those before.
    """
    before = 0.0
    if points.prior is not None:
        points, earlier, before = points.prior
        readings = (*earlier, *readings)

    def log_likelihood(x: Floats) -> Floats:
        fine, every = finite_rows(x)
        X = x if every else x[fine]
        X = X if domain is None else domain.wrap(X)
        values = readings[0].log_weight(X)
        for asked in readings[1:]:
            values = values + asked.log_weight(X)
        if every:
            return values
        log_l = np.full(len(x), -np.inf)
        log_l[fine] = values
        return log_l

    found = _best(points, Stacked.of(readings, domain), log_likelihood, key)
    x, w, family = found.x, found.w, found.family
    if not found.families > 0.0:
        x, w, family = points.x, points.w, np.arange(len(points.w))
    after = Points(x, w, None, Prior(points, readings, found.log_evidence), family)
    return Weighed(after, found.log_evidence - before, found.effective, found.families)


def _best(points: Points, sensor: Stacked | None, log_likelihood: OfStates, key: int) -> Carried:
    """The posterior by the first way that has enough carriers, or far more than those before it."""
    w, path, count = points.w, points.path, len(points.w)
    log_l = log_likelihood(points.x)
    best = Carried.of(points.x, _logarithms(w) + log_l, np.arange(count))
    if path is None or best.families >= _EVEN * effective(w):
        return best
    if sensor is not None:
        best = _twice(points, log_l, sensor, log_likelihood, key) or best
    if sensor is not None and best.families < _FEW * count:
        least = _LOST * _FAR_MORE * best.families if best.families > _NEXT_TO_NONE else 0.0
        best = _better(best, bridged(points, sensor, log_likelihood, key, least))
    enough = _ENOUGH if sensor is None else _NEXT_TO_NONE
    if best.families < min(_FEWER * count, enough):
        best = _better(best, tempered(points, log_likelihood, key))
    return best


def _better(best: Carried, other: Carried | None) -> Carried:
    """The one that has far more carriers; where both have next to none, else that of the higher evidence.

    Both know the evidence without bias: what has missed the posterior says too little, most of the time.
    """
    if other is None or other.families > _FAR_MORE * best.families:
        return other or best
    few = max(best.families, other.families) < _NEXT_TO_NONE
    return other if few and other.log_evidence > best.log_evidence else best


def _logarithms(w: Floats) -> Floats:
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(w))


def _twice(
    points: Points, log_l: Floats, sensor: Stacked, log_likelihood: OfStates, key: int
) -> Carried | None:
    """The posterior of both passes; None where no guide can be made."""
    path = points.path
    assert path is not None
    x, w, (x0, block, passages, U) = points.x, points.w, path
    (count, n), own = x.shape, sub_key(key, 11)
    rows, u, HL, r, noise, C = seen(sensor, passages, x0, x, U, w, block)
    R = np.ascontiguousarray(_WIDER * (noise + _OWN * C))
    z, cut = even_normals(net(count, n, LED), own), uniform(own, np.uint64(0))
    ancestor, u, log_ratio = look_ahead(r, u, w, block, HL, R, z, cut)
    if not len(ancestor):
        return None
    y, block = x0[ancestor], block[ancestor]
    V = [u] if rows is None else _led(rows, block, u, len(passages), own)
    for passage, v in zip(passages, V, strict=True):
        y = gone(passage, y, v, block, True)
    log_l = np.concatenate([log_l, log_likelihood(y)])
    family = np.append(np.arange(count), ancestor)
    return Carried.of(np.concatenate([x, y]), over_both(log_l, log_ratio, w), family)


def _led(rows: Floats, block: Ints, u: Floats, parts: int, key: Any) -> list[Floats]:
    """What moves the points in each passage, (N, n) each, such that together it moves their ends by u."""
    count, n = u.shape
    U = np.concatenate(normals(count, n, key, parts, 20), axis=1)
    spread(rows, block, u, U)
    return [np.ascontiguousarray(U[:, k * n : (k + 1) * n]) for k in range(parts)]
