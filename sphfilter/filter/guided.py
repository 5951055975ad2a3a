"""Bayes' rule on points: weighted, and once more from ancestors that the reading chooses.

Both passes are weighted together: each point by its likelihood over the mixture of what it may have been
drawn from, so that the guide, whatever it is worth, never makes a posterior worse than none.
"""

from typing import Any

import numpy as np

from .._types import Floats, Ints
from ..core.cloud.blocks import steered
from ..core.cloud.bridge import bridge
from ..core.cloud.control import is_better, is_led, is_tempered, least_led
from ..core.cloud.curve import places
from ..core.cloud.guide import look_ahead, over_both
from ..core.cloud.reader import GUIDE, PARTS, Part
from ..core.cloud.reading import OWN, weigh
from ..core.cloud.steps import NO_LEG
from ..core.cloud.weights import effective, normalise, prior_times
from ..core.limits import ALIKE
from ..density.moments import columns, moments
from ..density.passage import gone, leading_nets, nets_of, normals, sub_key
from ..density.points import Carried, Points, Prior
from ..density.quasi_random import NetPart, net
from ..model.compile import surfacing
from .bridged import bridged
from .stacked import Stacked, Walked, seen
from .tempered import tempered

_NARROWEST = 1e-12  # part of a prior's variance that is rounding, of sums of 5,000 points: 5,000 eps = 1e-12


def weighed(points: Points, sensor: Stacked, key: int) -> tuple[Carried, Points]:
    """Prior times the likelihood of all readings of one time, and points that go on: the prior's if it is 0.

    The prior may be the posterior of readings of the same time before, whose prior is taken then. The
    evidence is that of the readings of `sensor`, given those before.
    """
    before = 0.0
    if points.prior is not None:
        points, earlier, before = points.prior
        sensor = Stacked.of((*earlier, *sensor.asked), sensor.domain)
    found = _best(points, sensor, key)
    x, w, lineage = found.x, found.w, found.lineage
    if not found.lineages > 0.0:
        x, w, lineage = points.x, points.w, np.arange(len(points.w))[None]
    after = Points(x, w, None, Prior(points, sensor.asked, found.log_evidence), lineage)
    return found._replace(log_evidence=found.log_evidence - before), after


def _best(points: Points, sensor: Stacked, key: int) -> Carried:
    """The posterior by the first way that has enough carriers, or far more than those before it."""
    count, number = len(points.w), effective(points.w)
    best = _at_once(points, sensor, key)
    if best is None:
        best, sensor = _in_turn(points, sensor, key)
    if points.path is None:
        return best
    if len(sensor.z) and is_led(best.lineages, number, count):
        best = _better(best, piece_by_piece(points, sensor, key, least_led(best.lineages)))
    if is_tempered(best.lineages, number, count, sensor.hidden):
        best = _better(best, tempered(points, sensor.log_likelihood, key))
    return best


def _better(best: Carried, other: Carried | None) -> Carried:
    """The better one of two, if there are two."""
    return best if other is None or not is_better(other, best) else other


def _at_once(points: Points, sensor: Stacked, key: int) -> Carried | None:
    """The posterior of both passes in one call of compiled code; None where that does not know the case."""
    way = _way(points, sensor)
    if way is None:
        return None
    with surfacing():
        x, log_w, ancestor, wrong = weigh(way, nets_of(*points.x.shape), key)
    return None if wrong else Carried.of(x.T, log_w, ancestor, points.w, points.older)


def piece_by_piece(points: Points, sensor: Stacked, key: int, least: float) -> Carried | None:
    """The posterior of points led piece by piece of the way, at least so many by the first guide; or none."""
    way = _way(points, sensor)
    if way is None:
        return bridged(points, sensor, key, least)
    with surfacing():
        about = leading_nets(*points.x.shape), key, least, places(points.x.shape[1])
        x, log_w, ancestor, wrong = bridge(way, *about)
    if wrong:
        return bridged(points, sensor, key, least)
    return Carried.of(x.T, log_w, ancestor, points.w, points.older) if len(log_w) else None


def _way(points: Points, sensor: Stacked) -> tuple[Any, ...] | None:
    """A reading and the way of points to it as compiled code takes them; None where it does not know them."""
    path, reader = points.path, sensor.reader
    if path is None or reader is None or len(path.passages) != 2:
        return None
    kernel, moved = (Part(p.start, p.end, p.flow, p.lower, p.rows) for p in path.passages)
    leg = NO_LEG if path.passages[1].leg is None else path.passages[1].leg
    about = leg, leg is NO_LEG, path.passages[1].key, columns(path.x), columns(points.x), points.w, path.block
    return reader, *about, kernel, moved, *map(columns, path.u)


def _in_turn(points: Points, sensor: Stacked, key: int) -> tuple[Carried, Stacked]:
    """The posterior of the first pass, or of both where that is uneven; and the sensor with its guide."""
    h = None if sensor.hidden else sensor.predict(points.x)
    log_l = sensor.log_likelihood(points.x, h)
    best = Carried.of(
        points.x, prior_times(points.w, log_l), np.arange(len(points.w)), points.w, points.older
    )
    if points.path is None or best.lineages >= ALIKE * effective(points.w):
        return best, sensor
    if sensor.hidden:
        sensor = _piloted(sensor, points, log_l)
        h = sensor.predict(points.x) if len(sensor.z) else None
    return (best if h is None else _twice(points, log_l, h, sensor, key) or best), sensor


def _piloted(sensor: Stacked, points: Points, log_l: Floats) -> Stacked:
    """The sensors with linear readings beside them, in place of those that say nothing but a likelihood.

    The first pass over a prior's points tells mean and covariance before and after such sensors. A linear one
    with Gaussian noise that makes the same of a Gaussian leads points to where the likelihood is. `log_l`
    (N,) is the log-likelihood of all readings at the prior's points. The sensors are the same where too few
    points can have been read to tell how they lie, or none lie closer.
    """
    before, after = np.empty(len(points.w)), np.empty(len(points.w))
    known = sensor.log_weights(points.x, sensor.guides) if sensor.guides else np.zeros(len(points.w))
    could = np.isfinite(normalise(prior_times(points.w, known), before))
    if not could or not np.isfinite(normalise(prior_times(points.w, log_l), after)):
        return sensor
    n, carriers = points.x.shape[1], min(effective(before), effective(after))
    if carriers <= n + 1:
        return sensor
    (mean, cov), (moved, narrower) = moments(points.x, before), moments(points.x, after)
    try:
        white = np.linalg.inv(np.linalg.cholesky(cov))
    except np.linalg.LinAlgError:
        return sensor
    s, V = np.linalg.eigh(white @ narrower @ white.T)
    s = np.maximum(s, _NARROWEST)
    # mean and covariance of few points are off themselves: by 1 / carriers and (n + 1) / carriers of it
    s = s * (1.0 + (n + 2) / carriers)
    rows = (V.T @ white)[s < ALIKE]
    s = s[s < ALIKE]
    # of unit noise, √(1/s - 1) e leaves variance s along e, and moves the mean by 1 - s of what it reads
    gain = np.sqrt(1.0 / s - 1.0)
    z = gain * (rows @ mean + rows @ (moved - mean) / (1.0 - s))
    return sensor.with_pilot(np.ascontiguousarray(gain[:, None] * rows), z) if len(s) else sensor


def _twice(points: Points, log_l: Floats, h: Floats, sensor: Stacked, key: int) -> Carried | None:
    """The posterior of both passes, with readings h (N, k) of the first; None where no guide can be made."""
    path = points.path
    assert path is not None
    x, w, (x0, block, passages, U, _) = points.x, points.w, path
    (count, n), own = x.shape, sub_key(key, GUIDE)
    rows, u, ahead = seen(sensor, passages, Walked(x0, x, U, w, block), h, OWN)
    ancestor, new, log_ratio = look_ahead(ahead, u, w, block, net(count, n, NetPart.LED).T, own)
    if not len(ancestor):
        return None
    y, block, u = x0[ancestor], block[ancestor], new.T
    V = _led(rows, block, u, len(passages), own) if len(rows) else [u]
    for passage, v in zip(passages, V, strict=True):
        y = gone(passage, y, v, block, True)
    log_l = np.concatenate([log_l, sensor.log_likelihood(y)])
    log_w, own = over_both(log_l, log_ratio, w), np.concatenate([np.arange(count), ancestor])
    return Carried.of(np.concatenate([x, y]), log_w, own, w, points.older)


def _led(rows: Floats, block: Ints, u: Floats, parts: int, key: Any) -> list[Floats]:
    """What moves the points in each passage, (N, n) each, such that together it moves their ends by u."""
    count, n = u.shape
    U = np.concatenate([columns(v) for v in normals(count, n, key, parts, PARTS)])
    steered(rows, block, columns(u), U)
    return [U[k * n : (k + 1) * n].T for k in range(parts)]
