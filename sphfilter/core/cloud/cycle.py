"""Predictions and readings of a cloud and of the smaller one beside it, one after the other, in one call.

That is what `prediction.cloud` and `filter.by_cloud` do of any model and sensor, as long as nothing needs
more: what does is theirs.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import types

from .._addresses import ADDRESS, NOWHERE_AT, Entry
from .._jit import MATRIX, VECTOR, jit
from .._views import lent
from . import control
from .bridge import BRIDGE
from .inherited import (
    Inherited,
    after_prediction,
    error_with,
    kept,
    left_by_reading,
    spread_with,
    variance_error_with,
    with_missed,
)
from .lineages import Carried, carriers
from .move import over
from .noise import NORMAL, stored
from .pace import FIRST_TRIED, MOST_LOST, Bias, Steps, chosen
from .reader import NET, WAY, Part, Reader
from .reading import foreseen, weigh
from .steps import LEG
from .way import begin, carry, carry_linear
from .weights import any_beyond, compared, effective, near_others, systematic, taken, weighted_moments

#: How a record ends: all is put through; the next cloud has another number of points; what the last reading
#: left is to be judged, or has missed; the next one is unusual, and is not put through.
ALL, MORE, JUDGE, MISSED, UNUSUAL = range(5)
_INTS, _LINES, _KEY = types.int64[::1], types.int64[:, ::1], types.int64
_CURVE, _CLOUD = types.Tuple([types.uint32[::1], types.int64]), types.Tuple([MATRIX, VECTOR])
_BEGIN = Entry(begin, (MATRIX, VECTOR, _LINES, types.int64, _KEY, NET, *_CURVE))
_CARRY = Entry(carry, (LEG, MATRIX, _INTS, NET, _KEY))
_LINEAR = Entry(carry_linear, (types.Tuple([MATRIX, VECTOR, MATRIX]), MATRIX, _INTS, NET, _KEY))
_WEIGH = Entry(weigh, (WAY, types.UniTuple(NET, 3), _KEY))
_CARRIED = Entry(carriers, (MATRIX, VECTOR, _INTS, VECTOR, _LINES))
_MOTION, _SPAN = types.Tuple([LEG, ADDRESS]), types.UniTuple(types.float64, 2)
_STEPS = types.NamedTuple([types.int64, types.boolean], Steps), types.UniTuple(types.int64, 2), types.float64
_CHOSEN = Entry(chosen, (_MOTION, _SPAN, _CLOUD, _KEY, _CURVE, *_STEPS))
#: What a record is put through, each compiled by itself.
PARTS = _BEGIN, _CARRY, _LINEAR, _WEIGH, _CARRIED, _CHOSEN
_bridge_at = BRIDGE.at  # compiled when a record needs it
_begin_at, _carry_at, _linear_at, _weigh_at, _carried_at, _chosen_at = [entry.at for entry in PARTS]


class Cloud(NamedTuple):
    """A cloud, or a shadow, as a reading left it, and what moves it on."""

    x: np.ndarray  # (n, N)
    w: np.ndarray  # (N,)
    lineage: np.ndarray  # (readings, N)
    begun: tuple  # what `begin` returns, of points that have begun a way; else `nothing_begun`
    nets: tuple  # normals (n, count) of the guide, the begin and the motion; and those of `BRIDGE`, or none


class Standing(NamedTuple):
    """A cloud and its shadow, and what they have told."""

    many: Cloud
    shadow: Cloud
    size: int  # points that the errors told are of
    mean: float  # squares of what the two are apart by
    variance: float
    log_evidence: float
    step: float  # seconds
    stiff: bool
    points: int  # of the next cloud
    calm: int
    age: int  # predictions since the start
    inherited: Inherited


class Bounds(NamedTuple):
    """Errors of a mean, in standard deviations, that decide about a reading; and the most steps."""

    target: float
    missed: float  # from which a reading is looked at again
    flagged: float  # from which it is flagged, and a prediction is
    doubtful: float  # in which nothing is right
    most: int  # steps


class _Cycled(NamedTuple):
    """A cloud after a cycle: its prior's points, weights, mean and covariance, and what is left of it."""

    usual: bool  # whether nothing was found that needs more; else the rest is of no worth
    begin: np.ndarray  # (n, N), where those points began
    y: np.ndarray
    w: np.ndarray
    mean: np.ndarray
    cov: np.ndarray
    found: Carried


@jit
def put_through(parts, motion, sensor, spans, standing, bounds, curve):
    """Put readings through a cloud that a reading has left, as far as each of them is usual.

    `parts` are addresses of `PARTS`; `motion` is a model's leg, what moves points along its drift where
    that is stiff, and of a linear one, whose leg is not called, Φ (K, n, n), offset (K, n) and L (K, n, n)
    over each interval; `sensor` is a `Reader` and what it reads, (K, k); `spans` are times (K + 1,),
    seconds, first that of the cloud, and the least steps of each interval; `curve` is a table and its bits.
    Returns how the record ends, how many readings are done, the values of a `Standing` after the last of
    them and before it, and of each reading mean and covariance before and after it, the log-evidence and
    its error, the errors of the mean and the variances, the innovation with its covariance where h is a
    function, and whether it or its prediction is flagged.
    """
    parts, motion, sensor, spans, curve = lent((parts, motion, sensor, spans, curve))
    (leg, stiff_flow, changes), (reader, Z), (times, least) = motion, sensor, spans
    (K, k), (n, count) = Z.shape, standing.many.nets[0].shape
    m, P, x, C = np.empty((K, n)), np.empty((K, n, n)), np.empty((K, n)), np.empty((K, n, n))
    evidence, unsure, error, wider = np.empty(K), np.empty(K), np.empty(K), np.empty(K)
    off, S, flagged = np.empty((K, k)), np.empty((K, k, k)), np.empty(K, np.bool_)
    before, end, done = standing, ALL, 0
    while done < K and end == ALL:
        j, s, span = done, standing, (times[done], times[done + 1])
        own, step, bias = _paced(parts, leg, stiff_flow, span, s, least[j], bounds, curve)
        if not bias.mean < np.inf:
            end = UNUSUAL
            break
        about = parts, own, _change(changes, j, n), _reads(reader, Z[j], span[1])
        fewer = control.steps_of_shadow(own.steps, own.flow == stiff_flow, least[j])
        few = over(own, own.flow, *span, fewer)
        one, two = _both(about, few, s, curve)
        ahead, squares = _told(s, one, two, count)
        alone, spread = control.errors_told(*squares[:2], one.found, count, bias)
        if not (one.usual and two.usual and alone == alone):
            end = UNUSUAL
            break
        m[j], P[j], x[j], C[j] = one.mean, one.cov, one.found.mean, one.found.cov
        evidence[j] = one.found.log_evidence
        unsure[j] = control.evidence_error(squares[2], one.found, count, n)
        old, brought, nats = _brought(s.inherited, one, (alone, spread))
        shown = control.shown(squares[0], bias.mean), control.shown(squares[1], bias.variance)
        error[j] = error_with(alone, shown[0], brought)
        wider[j] = variance_error_with(spread, shown[1], brought)
        doubt = spread_with(spread, shown[1], brought)
        unsure[j] = control.both(unsure[j], nats)
        if reader.h != NOWHERE_AT:  # of a linear sensor the moments say it
            off[j], S[j] = foreseen(about[3], one.y, one.w, one.mean)
        ahead = control.error_ahead(ahead, old, bias)
        flagged[j] = not (ahead <= bounds.flagged and error[j] <= bounds.flagged)
        flagged[j] |= control.may_be_wrong(max(old.wider, doubt), bounds.flagged)
        told = control.decisive(control.error_by(squares[0]), control.error_by(squares[1]), bounds.target, n)
        wanted = control.points_for(count, told, bounds.target, n)
        points, calm = control.next_points(count, wanted, s.calm)
        stiff = own.flow == stiff_flow
        paced = step, stiff, points, calm, s.age + 1
        many = _left(s.many, one.found, one.found.lineage)
        shadow = _left(s.shadow, two.found, two.found.lineage[:1].copy())  # it goes back no further
        goes_on = with_missed(brought, (alone, spread), shown, bounds.flagged)
        before, standing = s, Standing(many, shadow, count, *squares, *paced, goes_on)
        done += 1
        end = MORE if points != count else ALL
        if max(error[j], told) > bounds.missed:
            few, added = _again(leg, stiff_flow, span, step, stiff, least[j]), np.nan
            if s.many.begun[0].size == 0:  # else it is the filter's
                added = _added((parts, few, *about[2:]), s, one, bounds.target, curve)
            end = end if added <= bounds.missed else MISSED if added > bounds.missed else JUDGE
    return (
        end,
        done,
        _bare(standing),
        _bare(before),
        (m, P, x, C, evidence, unsure, error, wider, off, S, flagged),
    )


@jit
def _left(cloud, found, lineage):
    """A cloud as a reading has left it, of such lineages."""
    return Cloud(found.x, found.w, lineage, nothing_begun(len(found.x)), cloud.nets)


@jit
def _again(leg, stiff_flow, span, step, stiff, least):
    """The model over a span, in steps of a length that is known; in its own, where it has such."""
    own = leg.drift == NOWHERE_AT or leg.kind == NORMAL
    steps = least if own else max(math.ceil((span[1] - span[0]) / step), 1)
    return over(leg, stiff_flow if stiff else leg.flow, span[0], span[1], steps)


@jit
def _added(about, s, one, target, curve):
    """The deciding error that a cycle has added, as `filter.by_cloud.error_added` tells it, or NaN."""
    nets, (x, w, lineage, begun, _) = s.shadow.nets, s.many
    n, many = nets[0].shape
    part = Cloud(taken(x, systematic(w, many, 0.5)), np.full(many, 1.0 / many), lineage[:0], begun, nets)
    few = _cycled(about, part, (stored(s.age, 1), stored(s.age + 1, 3)), curve)
    if not few.usual:
        return np.nan
    first, second, most = compared(one.found.mean, one.found.cov, few.found.mean, few.found.cov)
    off = control.error_by(control.apart_by(first, second))
    return control.decisive(off, control.error_by(most), target, n)


@jit
def _bare(s):
    """The values of a cloud's standing: an interrupt in the making of a named tuple is none to Python."""
    cloud, shadow = (s.many.x, s.many.w, s.many.lineage), (s.shadow.x, s.shadow.w, s.shadow.lineage)
    told = s.size, s.mean, s.variance, s.log_evidence, s.inherited
    return (*cloud, *shadow, *told, s.step, s.stiff, s.points, s.calm, s.age)


@jit
def _change(changes, j, n):
    """Φ, offset and L of an interval; none has any, of a model that is not linear."""
    flow, offset, lower = changes
    if len(flow) == 0:
        return np.empty((n, n)), np.empty(n), np.empty((n, n))
    return flow[j], offset[j], lower[j]


@jit
def _reads(reader, z, t):
    """A sensor that has read z (k,) at a time."""
    return Reader(reader.h, reader.p, reader.H, z, reader.angle, reader.R, reader.root, t)


@jit
def _paced(parts, leg, stiff_flow, span, s, least, bounds, curve):
    """The model over a span in steps of a bias that is allowed; the length of the next, and the `Bias`.

    Infinite where no steps will do.
    """
    if leg.drift == NOWHERE_AT:
        return leg, s.step, Bias(0.0, 0.0)
    if leg.kind == NORMAL:  # a map has the steps that it has
        return over(leg, leg.flow, span[0], span[1], least), s.step, Bias(0.0, 0.0)
    dt, told = span[1] - span[0], control.error_by(s.mean)
    allowed = control.bias_allowed(told, s.many.w.size, s.inherited.error, bounds.doubtful, bounds.target, 1)
    number = math.ceil(dt / s.step - 1e-9) if s.step > 0.0 else FIRST_TRIED
    about = (s.many.x, s.many.w), stored(s.age, 0), curve, Steps(number, s.stiff), (least, bounds.most)
    steps, stiff, off, lost = _chosen_at(parts[5])((leg, stiff_flow), span, *about, allowed)
    own = over(leg, stiff_flow if stiff else leg.flow, span[0], span[1], steps)
    if lost > 2.0 * MOST_LOST or steps > bounds.most:
        return own, s.step, Bias(np.inf, np.inf)
    bias = Bias(off[0], off[1])
    step = control.step_after(dt, steps, control.over_allowed(bias, allowed, len(s.many.x)))
    return own, step, bias


@jit
def nothing_begun(n):
    """What stands for what `begin` returns, of points that have not begun a way."""
    x, middle, lower = np.empty((n, 0)), np.empty((0, n)), np.empty((0, n, n))
    block, older = np.empty(0, np.int64), np.empty((0, 0), np.int64)
    return x, x, x, np.empty(0), block, middle, lower, lower, older


@jit
def _both(about, few, s, curve):
    """Cloud and shadow after a cycle, of few steps for that; of no worth where the cloud is of none."""
    one = _cycled(about, s.many, (stored(s.age, 0), stored(s.age + 1, 2)), curve)
    keys = stored(s.age, 1), stored(s.age + 1, 3)
    two = _cycled((about[0], few, about[2], about[3]), s.shadow, keys, curve)
    if few.steps < about[1].steps and any_beyond(two.y, one.y):
        two = _cycled(about, s.shadow, keys, curve)
    return one, two


@jit
def _cycled(about, cloud, keys, curve):
    """A cloud over an interval and a reading."""
    (parts, leg, change, reader), (x, w, lineage, begun, nets) = about, cloud
    first, second = nets[1], nets[2]
    (n, count), key = first.shape, keys[0]
    if begun[0].size == 0:
        begun = _begin_at(parts[0])(x, w, lineage, count, key, first, *curve)
    start, x, u, w, block, middle, lower, flow, older = begun
    kernel = Part(middle, middle, flow, lower, np.empty((1, 0, 0)))
    linear = leg.drift == NOWHERE_AT
    if linear:
        y, v, middle, end, flow, lower, rows = _linear_at(parts[2])(change, x, block, second, key)
    else:
        y, v, middle, end, flow, lower, rows = _carry_at(parts[1])(leg, x, block, second, key)
    moved = Part(middle, end, flow, lower, rows)
    way = reader, leg, linear, key, start, y, w, block, kernel, moved, u, v
    z, log_w, ancestor, wrong = y, np.full(count, -np.inf), np.empty(0, np.int64), 1
    if near_others(y)[1]:  # else what reads may be asked where no state is
        z, log_w, ancestor, wrong = _weigh_at(parts[3])(way, (nets[0], nets[1], nets[2]), keys[1])
    carried, number = _carried_at(parts[4]), effective(w)
    found = Carried(*carried(z, log_w, ancestor, w, older))
    unled = control.is_led(found.lineages, number, count)
    if unled and wrong == 0 and nets[3].size > 0:
        by = (nets[3], nets[4], nets[5]), keys[1], control.least_led(found.lineages), curve
        z, log_w, ancestor, wrong = _bridge_at(parts[6])(way, *by)
        unled = False
        if log_w.size > 0:
            led = Carried(*carried(z, log_w, ancestor, w, older))
            found = led if control.is_better(led, found) else found
    mean, cov = np.empty(n), np.empty((n, n))
    weighted_moments(y, w, mean, cov)
    few = unled or control.is_tempered(found.lineages, number, count, False)
    usual = not few and wrong == 0 and found.log_evidence > -np.inf
    return _Cycled(usual, start, y, w, mean, cov, found)


@jit
def _brought(inherited, one, own):
    """What a prior had inherited, and what a cycle has left of that; and what that adds to evidence, nats."""
    if not max(inherited.error, inherited.missed, inherited.wider) > 0.0:
        return inherited, inherited, 0.0
    if max(inherited.missed, inherited.wider) > 0.0:
        inherited = after_prediction(inherited, kept(one.begin, one.y, one.w, one.cov))
    found = one.found
    about = found.x, found.w, found.lineage, (found.mean, found.cov), own
    left, nats = left_by_reading(inherited, (one.mean, one.cov), *about)
    return inherited, Inherited(*left), nats


@jit
def _told(s, one, two, count):
    """Square that a cloud and its shadow tell of the prior's mean; and those after the reading."""
    n, times = one.mean.size, count / s.size
    mean, variance = control.square_of_more(s.mean, times), control.square_of_more(s.variance, times)
    first, second, _ = compared(one.mean, one.cov, two.mean, two.cov)
    new = control.apart_by(first, second)
    ahead = control.smoothed(mean, new, control.remembered(mean, new))
    if mean != mean:
        mean = control.expected_square(two.found.effective)
        variance = (n + 1.0) * mean
    first, second, most = compared(one.found.mean, one.found.cov, two.found.mean, two.found.cov)
    new = control.apart_by(first, second)
    part = control.remembered(mean, new)
    mean = control.smoothed(mean, new, part)
    off = one.found.log_evidence - two.found.log_evidence
    evidence = control.smoothed(control.square_of_more(s.log_evidence, times), off**2, part)
    return ahead, (mean, control.smoothed(variance, most, part), evidence)
