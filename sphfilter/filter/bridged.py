"""Points led to a reading piece by piece of the way: what no single guide over the whole of it can do.

Over a long way the flow folds, and what a linear guide says of its end is wrong by more than a sharp sensor
forgives. Over half of it, it is wrong by a quarter or less: points are led over the first half of what
remains, are chosen by what a new guide says from there, and so on to a single step. Guides only choose and
lead; the weights are those of the model, so that the evidence has no bias whatever the guides are worth
(Del Moral & Murray 2015; Park & Ionides 2020).
"""

import math
from typing import Any

import numpy as np

from .._types import Floats, Ints
from ..core.cloud.blocks import blocks_of, centres
from ..core.cloud.bridge import MISSED, MORE, some_free
from ..core.cloud.guide import look_ahead, of_first, over_both
from ..core.cloud.reader import PARTS
from ..core.cloud.weights import effective, normalise
from ..core.limits import TINY
from ..density.moments import columns
from ..density.passage import along, gone, normals, relinearised, stored_key, sub_key
from ..density.points import Carried, Passage, Points
from ..density.quasi_random import NetPart, net
from .stacked import Stacked, Walked, seen


def bridged(points: Points, sensor: Stacked, key: int, least: float) -> Carried | None:
    """A posterior by guides over ever shorter rests of the way since the last reading.

    The prior's points have the path that they came. None where the first guide chooses fewer than `least` of
    the points, or a later one none: what moves points later parts only those that were chosen.
    """
    path: Any = points.path
    x, y, block, passages, u = path.x, points.x, path.block, path.passages, path.u
    log_w, lineage, count = np.log(np.maximum(points.w, TINY)), np.arange(len(path.x)), MORE * len(path.x)
    stage = 0
    while True:  # each stage takes one step of the way, or more
        own = sub_key(key, stage)
        if stage > 0:
            order = along(x, np.full(len(x), 1.0 / len(x)))
            x, log_w, lineage, block = x[order], log_w[order], lineage[order], blocks_of(len(x))
            passages, u, y = _anew(passages, x, block, own)
        w = np.empty(len(x))
        total = normalise(log_w, w)
        walked = Walked(x, y, u, np.full(len(x), 1.0 / len(x)), block)
        ancestor, new, log_ratio = _led(walked, passages, w, sensor, count, own)
        if not len(ancestor) or (stage == 0 and effective(1.0 * np.bincount(ancestor)) < least):
            return None
        if len(passages) > 1:
            about = sensor.log_likelihood(y), w, columns(u[0]), np.uint64(own)
            ancestor, new, log_ratio = some_free((ancestor, new, log_ratio), *about)
        z = gone(passages[0], x[ancestor], new.T, block[ancestor], True)
        if len(passages) == 1:
            ends = np.concatenate([y, z])
            log_w = total + over_both(sensor.log_likelihood(ends), log_ratio, w)
            return Carried.of(ends, log_w, np.append(lineage, lineage[ancestor]), points.w, points.older)
        log_w, lineage = total - log_ratio - math.log(count), lineage[ancestor]
        kept = np.asarray(np.isfinite(z).all(axis=1))
        if not kept.any():
            return None
        x, log_w = np.where(kept[:, None], z, z[np.argmax(kept)]), np.where(kept, log_w, -np.inf)
        passages, stage = passages[1:], stage + 1


def _anew(passages: Any, x: Floats, block: Any, key: Any) -> tuple[Any, Any, Floats]:
    """The rest of the way from points x (N, n), noise for each part of it, and where that takes them."""
    count, n = x.shape
    passages = _halved(passages, x, key)
    u = normals(count, n, key, len(passages))
    for passage, v in zip(passages, u, strict=True):
        x = gone(passage, x, v, block, False)
    return passages, u, x


def _led(
    walked: Walked, passages: Any, w: Floats, sensor: Stacked, count: int, key: Any
) -> tuple[Ints, Floats, Floats]:
    """Ancestors (count,), what leads them over the first of the passages (n, count), and what that is worth.

    The last are logarithms of the guide's density over the prior's, of the points that have `Walked`, of
    shares w (N,), and of the new ones.
    """
    n = walked.x.shape[1]
    rows, _, ahead = seen(sensor, passages, walked, sensor.predict(walked.y), MISSED)
    about = of_first(ahead, rows), columns(walked.u[0]), w, walked.block
    return look_ahead(*about, net(count, n, NetPart.LED).T, np.uint64(key))


def _halved(passages: Any, x: Floats, key: Any) -> tuple[Passage, ...]:
    """Passages, linearised about blocks of points x (N, n), the first no longer than half of all steps."""
    first, *later = passages
    if first.leg is not None:
        steps = -(-sum(1 if p.leg is None else p.leg.steps for p in passages) // 2)
        if steps < first.leg.steps:
            t = first.leg.t + steps * first.leg.h
            rest = first.leg._replace(t=t, steps=first.leg.steps - steps)
            later = [first._replace(leg=rest), *later]
            first = first._replace(leg=first.leg._replace(steps=steps))
    c, out = centres(columns(x)), []
    for k, passage in enumerate([first, *later]):
        out.append(relinearised(passage, c, stored_key(key, PARTS + k)))
        c = out[-1].end
    return tuple(out)
