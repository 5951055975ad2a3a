"""A cloud of points over an interval: order, noise that is even along it, motion; and once more, guided."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from .._types import Floats
from ..core._addresses import address_of
from ..core.cloud.curve import along_curve, places
from ..core.cloud.linearise import block_roots, block_size, centres, linearise, lower_and_rows, shrunk
from ..core.cloud.move import affine, move, moved_twice
from ..core.cloud.noise import LANES, even_normals, mixed, uniform
from ..core.cloud.steps import BESIDE, BETWEEN, FLOW, STIFF_FLOW, Leg
from ..core.cloud.weights import effective, systematic
from ..density.nets import net
from ..density.points import Passage, Path, Points, moments
from ..model.compile import surfacing
from ..model.discretization import linear_transition
from ..model.sde import SDE
from ..model.simulate import noise_root

__all__ = ["begun", "even", "gone", "key_at", "leg_of", "ordered", "Steps", "passed", "steps_bias", "systematically"]

#: Effective part of points, below which they are drawn anew.
_FEW = 0.5
#: Passages after which a path is forgotten: a reading goes through all of them once more.
_MOST = 8
#: Points by which the bias of steps is told, of one chunk of lanes, and groups of them.
_PILOTS, _GROUPS = 64, 4
_GONE = 0.1  # of them, that a model may carry to infinity


class Steps(NamedTuple):
    """Steps of an interval, and whether the drift is too stiff to be followed in one step each."""

    number: int
    stiff: bool = False


# what numbers of a key are for
_CUT, _FIRST, _AGAIN, _PILOT, _KERNEL = (np.uint64(k) for k in range(5))


def begun(mean: Floats, cov: Floats, count: int, key: int) -> Points:
    """A Gaussian of mean (n,) and covariance (n, n) as points, each with noise as wide as their distance."""
    n = len(mean)
    spread = count ** (-1.0 / n)
    root = noise_root(cov) if np.linalg.det(cov) <= 0.0 else np.linalg.cholesky(cov)
    x = mean + np.sqrt(1.0 - spread**2) * np.einsum("ij,kj->ik", net(count, n), root)
    w = np.full(count, 1.0 / count)
    x = np.ascontiguousarray(x[_along(x, w)])
    u = even(count, n, key)
    middle = centres(x)
    noise = _same_everywhere(None, key, middle, middle, np.eye(n), spread * root)
    y = x + np.einsum("ij,kj->ik", u, spread * root)
    return Points(y, w, Path(x, _blocks(count), (noise,), (u,)))


def passed(
    points: Points, model: SDE, t0: float, t1: float, steps: Steps, count: int, key: int
) -> Points:
    """Points carried over an interval in steps; those of a new path are `count`."""
    path = points.path
    if path is None or len(path.passages) >= _MOST or len(points.w) != count:
        points = _apart(ordered(points, count, key), key)
        path = points.path
        assert path is not None
    passage = _passage(model, points.x, (t0, t1), steps, key)
    u = even(count, model.dim, key)
    x = gone(passage, points.x, u, path.block, False)
    return Points(x, points.w, Path(path.x, path.block, (*path.passages, passage), (*path.u, u)))


def key_at(t: float, number: int) -> int:
    """The key of what happens at a time: the same whatever the density, so that evidence is smooth in a model."""
    word = np.array([t + 0.0]).view(np.uint64)[0]
    return int(mixed(word, np.uint64(number)) >> np.uint64(1))


def ordered(points: Points, count: int, key: int) -> Points:
    """The points in order along a curve, drawn anew where too few of them weigh anything."""
    order = _along(points.x, points.w)
    w = points.w[order]
    if len(w) != count or effective(w) < _FEW * count:
        order, w = order[systematically(w, count, key)], np.full(count, 1.0 / count)
    return Points(points.x[order], w)


def _apart(points: Points, key: int) -> Points:
    """Ordered points, of which each stands for a Gaussian as wide as their distance: a reading can lead it there.

    Copies of a point part by it, whatever the noise of the model. Mean and covariance of every block are kept.
    """
    x, n = points.x, points.x.shape[1]
    block, part = _blocks(len(x)), block_size(len(x)) ** (-1.0 / n)
    middle, root = centres(x), block_roots(x)
    flow = np.tile(np.eye(n), (len(middle), 1, 1))
    kernel = Passage(None, key, middle, middle, flow, part * root, np.empty((1, 0, 0)))
    u = even(len(x), n, int(mixed(np.uint64(key), _KERNEL) >> np.uint64(1)))
    start = shrunk(x, middle, math.sqrt(1.0 - part**2))
    return Points(gone(kernel, start, u, block, False), points.w, Path(start, block, (kernel,), (u,)))


def systematically(w: Floats, count: int, key: int) -> Floats:
    """Numbers (count,) of points of weights w (N,), each as often as its weight says but for rounding."""
    return systematic(w, count, uniform(np.uint64(key), _CUT))


def even(count: int, dim: int, key: int) -> Floats:
    """Standard normals (count, dim) of the net, turned and shifted by a key."""
    return even_normals(net(count, dim), np.uint64(key))


def gone(passage: Passage, x: Floats, u: Floats, block: Floats, again: bool) -> Floats:
    """Points (N, n) at the end of a passage, from x, with ends moved by u; `again` with other noise beside."""
    if passage.leg is None:
        return affine(x, u, block, passage.start, passage.end, passage.flow, passage.lower)
    x, key = x.copy(), mixed(np.uint64(passage.key), _AGAIN if again else _FIRST)
    with surfacing():
        move(passage.leg, x, u, passage.rows, block, np.uint64(key), 0, -(-len(x) // LANES))
    return x


def leg_of(model: SDE, t0: float, t1: float, steps: int, stiff: bool = False) -> Leg:
    """A model over an interval, as compiled code takes it."""
    additive, functions = not model.state_dependent_noise, (model.flow_drift_batch, model.flow_jacobian_batch)
    own = STIFF_FLOW if stiff else FLOW, BESIDE if additive else BETWEEN
    return Leg(
        *[address_of(function) for function in (*functions, model.noise_batch, *own)],
        model.p,
        _root(model),
        model.domain.codes,
        t0,
        (t1 - t0) / steps,
        steps,
        additive,
        model.constant_diffusion,
        "reflecting" in model.domain.kinds,
    )


@lru_cache(maxsize=64)
def _root(model: SDE) -> Floats:
    return noise_root(model.spectral_density)


def steps_bias(points: Points, model: SDE, span: tuple[float, float], steps: Steps, key: int) -> float:
    """How far means of points are apart after steps and after half as long ones, in standard deviations.

    Of a few points, along the same noise: so much steps of that length are off, or a little more. Means are of
    groups of neighbours: what steps do to one branch of a density is judged by the width of that branch.
    """
    x = np.ascontiguousarray(points.x[np.sort(systematic(points.w, _PILOTS, 0.5))])
    x = np.ascontiguousarray(x[_along(x, np.full(len(x), 1.0 / len(x)))])
    number, stiff = steps
    leg, half = leg_of(model, *span, number, stiff), leg_of(model, *span, 2 * number, stiff)
    with surfacing():
        coarse, fine = moved_twice(leg, half, x, np.uint64(mixed(np.uint64(key), _PILOT)))
    alive = np.isfinite(fine).all(axis=1)
    if alive.mean() < 1.0 - _GONE or not np.isfinite(coarse[alive]).all():
        return math.inf
    squares = []
    for own in np.array_split(np.flatnonzero(alive), _GROUPS):
        unit = np.maximum(np.std(fine[own], axis=0), 1e-300)
        squares.append(np.mean(((coarse[own] - fine[own]).mean(axis=0) / unit) ** 2))
    return math.sqrt(np.mean(squares))


def _passage(model: SDE, x: Floats, span: tuple[float, float], steps: Steps, key: int) -> Passage:
    """A model over an interval, linearised about blocks of points x (N, n)."""
    start = centres(x)
    if model.linear:
        flow, offset, Q = linear_transition(model, span[1] - span[0])
        end = np.einsum("ij,kj->ik", start, flow) + offset
        return _same_everywhere(model, key, start, end, flow, noise_root(Q))
    leg = leg_of(model, *span, *steps)
    end = start.copy()
    with surfacing():
        flow, B = linearise(leg, end)
    return Passage(leg, key, start, end, flow, *lower_and_rows(B), model)


def _same_everywhere(
    model: SDE | None, key: int, start: Floats, end: Floats, flow: Floats, lower: Floats
) -> Passage:
    """A linear change with noise of the same covariance in all blocks."""
    size = (len(start), 1, 1)
    return Passage(None, key, start, end, np.tile(flow, size), np.tile(lower, size), np.empty((1, 0, 0)), model)


def _blocks(count: int) -> Floats:
    return np.arange(count) // block_size(count)


def _along(x: Floats, w: Floats) -> Floats:
    """Numbers of points (N, n) in an order in which neighbours follow each other."""
    mean, cov = moments(x, w)
    try:
        white = np.linalg.inv(np.linalg.cholesky(cov))
    except np.linalg.LinAlgError:  # flat along some combination of the states
        white = np.diag(1.0 / np.sqrt(np.maximum(np.diag(cov), 1e-300)))
    return along_curve(x, mean, white, *places(x.shape[1]))
