"""Steps whose bias is small: how far apart half as long ones lead, and so how many it takes."""

import math
from typing import NamedTuple

import numpy as np

from .._jit import jit
from ..limits import LOOK, ROUNDING, TINY, WRONG
from ..small_matrices import add_squared, product
from ..step_control import HELPED, MORE
from .control import SHADOW, STEPS_ORDER, over_allowed
from .curve import along_curve
from .move import over
from .noise import LANES, OF_STATE, fill_noise, mixed
from .steps import GIVEN, LEFT, new_room, same_path, walk
from .way import PILOT
from .weights import eighths, finite_rows, systematic, taken

#: Groups of the points that tell the bias of steps; where what they show may be chance, more are asked, up to
#: as many as a shadow has, as long as that costs less than the steps that chance would ask for.
_GROUPS = 4
#: Neighbours along the same noise but for its signs: those of two noises, and their product. Measured:
#: volatility at an asked .01 takes 2 to 8 steps for 50 to 250 of points that have a noise each.
_MIRRORED = 4
#: Of what shorter steps show, beyond which the means of all points have been found to part (measured on six
#: scenes: 1.2 to 1.6).
_BEYOND = 1.5
_CHANCE = 0.25  # of the square by chance, the least that counts: χ² of four is below 1 in nine of a hundred
#: Standard deviations: rms distance of paths that have parted (√2 where nothing hangs together), and
#: parts of an interval, of which the first is looked at then.
_ASTRAY, _PARTS = 0.5, 64
MOST_LOST = 0.1  # probability of points that were given up
FIRST_TRIED = 4  # steps tried first, of stiff drifts, too; measured: 2 and 8 take .92 to 1.06 times the work


class Bias(NamedTuple):
    """What steps leave a mean off by, in standard deviations, and a variance, in parts of it."""

    mean: float
    variance: float


class Steps(NamedTuple):
    """Steps of an interval, and whether its drift is too stiff to be followed in one step each."""

    number: int
    stiff: bool = False


@jit
def chosen(motion, span, cloud, key, curve, begin, bounds, allowed):
    """How many steps points need for a bias that is allowed: tried with more and more of them.

    Their bias is how far apart the means of a few points are after steps and after half as long ones, along
    the same noise: so much steps of that length are off, or a little more. Over long intervals paths of both
    part whatever their steps, and means are apart by chance: those that have parted forget their bias, and it
    is looked at over the first part of the interval, in which they do not.

    The motion is a leg, and what moves points along its drift where that is stiff; the span begin and end,
    seconds; the cloud points x (n, N) and weights w (N,); the curve a table and its bits. It is begun with
    `Steps` of a model; there are a least and a most number, and more than these where that is not enough.
    Returns number and `stiff` as of `Steps`, the values of their `Bias` (see `cycle`), and the part of the
    points that the model carries to infinity.
    """
    parts, part, (least, most) = 1, span, bounds
    while True:
        first, own = Steps(max(begin.number // parts, 1), begin.stiff), (-(-least // parts), most // parts)
        steps, stiff, bias, lost, astray = tried(motion, part, cloud, key, curve, first, own, allowed)
        if not astray or parts >= _PARTS:
            return parts * steps, stiff, (bias.mean, bias.variance), lost
        parts *= 4
        part = span[0], span[0] + (span[1] - span[0]) / parts


@jit
def tried(motion, span, cloud, key, curve, begin, bounds, allowed):
    """The result of `chosen` over one span, and whether no steps do because paths part."""
    (leg, stiff_flow), (every, w), (number, stiff), (least, most) = motion, cloud, begin, bounds
    x, before, again, astray = few(every, w, LOOK, *curve), np.inf, False, False
    far, best, n = farthest(every, w), number, len(every)
    ends = np.ascontiguousarray(taken(every, far).T)
    number, own = max(least, number), mixed(np.uint64(key), np.uint64(PILOT))
    while number <= most:
        flow = stiff_flow if stiff else leg.flow
        steps, half = over(leg, flow, *span, number), over(leg, flow, *span, 2 * number)
        coarse, fine = moved_twice(steps, half, np.concatenate((x, ends)), own)
        alone = 0.0 if stiff else _alone((steps, half, stiff_flow), coarse, fine, (ends, w[far]), own)
        coarse, fine = coarse[: len(x)], fine[: len(x)]
        ends_of = eighths_of(fine, _GROUPS)
        apart, chance = parted(coarse, fine, ends_of)
        wide = wider(steps, half, fine, ends_of)
        bias = Bias(_BEYOND * apart, _BEYOND * math.hypot(math.sqrt(2.0) * apart, wide))
        too_much = over_allowed(bias, allowed, n)
        more = math.ceil(number * min(max(too_much ** (1.0 / STEPS_ORDER), 1.2), MORE))
        if bias.mean > allowed and _may_be_chance(len(x), w.size, number, more, apart, chance, allowed):
            x, before, again = few(every, w, 4 * len(x), *curve), np.inf, False  # a new look
            continue
        if not too_much > 1.0 and alone > allowed:
            number, stiff = 2 * number, 2 * number > MORE * max(least, FIRST_TRIED)
            number, before, again = max(least, FIRST_TRIED) if stiff else number, np.inf, False
            continue
        astray = too_much > 1.0 and chance * math.sqrt(len(x) / _GROUPS) > _ASTRAY
        # steps that forget all that was before them get all of a variance wrong, twice as many steps too
        helped = too_much < (HELPED if stiff else 1.0) * before or (stiff and wide > WRONG)
        in_vain = again and not helped and number >= 2 * best  # not even twice the steps help
        if not too_much > 1.0 or (stiff and (2 * number > most or in_vain)):
            return number, stiff, bias, 1.0 - finite_rows(np.ascontiguousarray(fine.T))[0].mean(), astray
        if in_vain:
            number, stiff, before, again = max(least, FIRST_TRIED), True, np.inf, False
            continue
        if again and not helped:  # by chance, perhaps
            more = max(2 * best, number + 1)
        else:
            before, best = too_much, number
        number, again = more, True
    return number, stiff, Bias(np.inf, np.inf), 0.0, astray


@jit
def _alone(motion, coarse, fine, last, key):
    """The result of `thrown`, of the last points that have weights, whatever steps throw them out."""
    (steps, half, stiff_flow), (ends, w) = motion, last
    alone, gone = thrown(coarse, fine, w)
    if gone:  # by half as long steps, too, unless the model does it
        steady = over(steps, stiff_flow, steps.t, steps.t + steps.steps * steps.h, steps.steps)
        fine[len(fine) - len(ends) :] = moved_twice(steady, half, ends, key)[0]
        alone, _ = thrown(coarse, fine, w)
    return alone


@jit
def _may_be_chance(looked, every, number, more, apart, chance, allowed):
    """Whether chance may be all of a bias, the most points would tell, and more cost less than more steps."""
    least = _BEYOND * math.sqrt(_CHANCE * SHADOW * looked / every) * chance
    may_be = apart < chance and least < allowed and 4 * SHADOW * looked <= every
    return may_be and 3 * 4 * looked * number < (more - number) * every


@jit
def few(x, w, count, table, bits):
    """Rows (count, n) of points of x (n, N) with weights w (N,), in order along the curve."""
    x = taken(x, systematic(w, count, 0.5))
    return np.ascontiguousarray(taken(x, along_curve(x, np.full(count, 1.0 / count), table, bits)).T)


@jit
def farthest(x, w):
    """Numbers (2 n,) of the least and the greatest of points x (n, N), with weights w (N,), in each state."""
    n, N = x.shape
    far = np.full(2 * n, np.argmax(w))
    for a in range(n):
        low = high = x[a, far[2 * a]]
        for i in range(N):
            if w[i] > 0.0 and x[a, i] < low:
                low, far[2 * a] = x[a, i], i
            elif w[i] > 0.0 and x[a, i] > high:
                high, far[2 * a + 1] = x[a, i], i
    return far


@jit
def thrown(coarse, fine, w):
    """Part of a variance that coarse steps add by one of the last points, whose weights are w (k,), at most.

    It is of what their ends (K, n) lie beyond all of the fine ones. A few dozen points do not see what steps
    do to the farthest of many: those that are too long for a drift that pulls harder there throw them out.
    And whether fine ends of the last lie beyond those of the others by more than these are apart.
    """
    K, n = fine.shape
    most, gone = 0.0, False
    for a in range(n):
        first, last, _ = eighths(fine[:, a], 1)
        spread = max(last - first, ROUNDING * abs(first), TINY)
        low, high = np.inf, -np.inf
        for i in range(K):
            if abs(fine[i, a] - first) < spread / ROUNDING:  # else it is given up
                low, high = min(low, fine[i, a]), max(high, fine[i, a])
        for j in range(K - w.size, K):
            gone |= not abs(2.0 * fine[j, a] - low - high) <= 3.0 * (high - low)
            off = max(low - coarse[j, a], coarse[j, a] - high) / spread
            if low <= fine[j, a] <= high and not off <= 0.0:
                most = max(most, w[j - K + w.size] * off * off if off < np.inf else np.inf)
    return most, gone


@jit
def eighths_of(x, groups):
    """An eighth and seven of the values of points x (K, n) of each group, and how many: (groups, n, 3)."""
    size, out = len(x) // groups, np.empty((groups, x.shape[1], 3))
    for g in range(groups):
        for a in range(x.shape[1]):
            out[g, a, 0], out[g, a, 1], out[g, a, 2] = eighths(x[g * size : (g + 1) * size, a], 1)
    return out


@jit
def parted(coarse, fine, ends):
    """How far apart means of coarse and fine ends (K, n) are, or infinite; and how far they are by chance.

    Both are standard deviations, the root of the mean square over groups of neighbours and states: what steps
    do to one branch of a density is judged by the width of that branch, which a few that steps threw out do
    not make wider. Those that the model carries to infinity do not count, as long as they are few; `ends` are
    `eighths_of` the fine ones.
    """
    (K, n), groups = fine.shape, len(ends)
    size, total, chance = K // groups, 0.0, 0.0
    for g in range(groups):
        for a in range(n):
            low, high, count = ends[g, a, 0], ends[g, a, 1], ends[g, a, 2]
            reach = (high - low) / ROUNDING + abs(low) + abs(high)
            if count < (1.0 - 2.0 * MOST_LOST) * size:
                return np.inf, 0.0
            count, mean, square, off, scatter, together = 0, 0.0, 0.0, 0.0, 0.0, 0.0
            for i in range(g * size, (g + 1) * size):
                if low - reach <= fine[i, a] <= high + reach:
                    d = coarse[i, a] - fine[i, a]
                    if not abs(d) < np.inf:
                        return np.inf, 0.0
                    count += 1
                    mean, square = mean + fine[i, a], square + fine[i, a] ** 2
                    together += d
                if (i + 1) % _MIRRORED == 0:
                    off, scatter, together = off + together, scatter + together**2, 0.0
            if count < (1.0 - 2.0 * MOST_LOST) * size:
                return np.inf, 0.0
            mean, square, off = mean / count, square / count, off / count
            variance = max(square - mean * mean, TINY + 1e-24 * square)
            if high > low and count == size:  # of a Gaussian, 2.3 standard deviations
                variance = min(variance, (high - low) ** 2)
            total += off * off / (variance * n * groups)
            alone = max(scatter - _MIRRORED * count * off * off, 0.0) / (count * (count - _MIRRORED))
            chance += alone / (variance * n * groups)
    apart = math.sqrt(max(total - chance, _CHANCE * chance)) if total < np.inf else np.inf
    return apart, math.sqrt(chance)


@jit
def wider(coarse, fine, x, ends):
    """How far apart variances are after legs that end at x (K, n): parts of them, in the root mean square.

    Noise that a stiff drift damps is wrong where no mean is. What each step adds to a covariance, and what it
    leaves of it, is that about one end of each group: no chance is in it, as there is in variances of points.
    `ends` are `eighths_of` x.
    """
    (K, n), groups, end, total = x.shape, len(ends), coarse.t + coarse.steps * coarse.h, 0.0
    size, scratch = K // groups, np.empty((n, n))
    width = 0.5 * (ends[:, :, 1] - ends[:, :, 0])  # of a Gaussian, 1.15 standard deviations
    about = x[size // 2 : groups * size : size].copy()
    (_, wrong), (M, P) = one_step(coarse, end, about, width), one_step(fine, end, about, width)
    for g in range(groups):
        add_squared(M[g], P[g], scratch, P[g])  # two of the fine steps
        wrong[g] -= P[g]
        steps, more = 1, True
        while steps < coarse.steps and more:
            product(M[g], M[g], 1.0, scratch)
            M[g] = scratch
            add_squared(M[g], wrong[g], scratch, wrong[g])
            add_squared(M[g], P[g], scratch, P[g])
            steps *= 2
            for a in range(n):
                more &= P[g, a, a] <= width[g, a] ** 2  # else it has all that there is
        for a in range(n):
            off = wrong[g, a, a] / max(P[g, a, a], width[g, a] ** 2, TINY)
            total += off * off / (n * groups) if off == off else 0.0
    return math.sqrt(total)


@jit
def one_step(leg, end, x, width):
    """What the last step of a leg leaves of a difference about states x (K, n), and what noise it adds.

    Both (K, n, n), the second covariances, are secants over ± width (K, n) and over ± noise.
    """
    (K, n), m, last = x.shape, leg.root.shape[0], over(leg, leg.flow, end - leg.h, end, 1)
    count, room = 2 * (n + 3 * m), new_room(m)
    ends, Z = np.empty((K * count, n)), np.zeros((GIVEN, max(m, n), K * count))
    for i in range(K * count):
        k, sign = i % count // 2, 1.0 - 2.0 * (i % 2)
        for a in range(n):
            ends[i, a] = x[i // count, a] + (sign * width[i // count, a] if a == k else 0.0)
        if k >= n:
            Z[(k - n) // m, (k - n) % m, i] = sign
    for i in range(0, K * count, LANES):
        walk(last, ends[i : i + LANES], Z[:, :, i:].copy(), False, room)
    M, Q = np.zeros((K, n, n)), np.zeros((K, n, n))
    for i in range(0, K * count, 2):
        g, k = i // count, i % count // 2
        for a in range(n):
            secant = 0.5 * (ends[i, a] - ends[i + 1, a])
            if k < n:
                M[g, a, k] = secant / width[g, k] if width[g, k] > 0.0 else 0.0
            for b in range(n if k >= n else 0):
                Q[g, a, b] += secant * 0.5 * (ends[i, b] - ends[i + 1, b])
    return M, Q


@jit
def moved_twice(leg, half, x, key):
    """Points x (K, n) at the end of a leg, and of one in steps of half the length along the same noise.

    The noise of a step is that of the two that are its halves. Where it depends on the state, neighbours have
    it mirrored: what is odd in any noise, most of what such paths are apart by, hardly moves their mean.
    """
    n, m = x.shape[1], leg.root.shape[0]
    d, rows = leg.steps * m, leg.steps * (max(m, n) if leg.walls else m)
    state, fine = np.empty(LANES, np.uint64), np.empty((LEFT if leg.walls else 3, 2 * rows, LANES))
    Z = np.empty((GIVEN if leg.walls else 3, rows, LANES))
    ends, middle, room = x.copy(), x.copy(), new_room(m)
    for k in range(0, len(x), LANES):
        fill_noise(key, np.uint64(k // LANES), leg.kind, leg.walls, state, fine)
        if leg.kind == OF_STATE:
            _mirror(fine, m)
        for r in range(d):
            one = 2 * (r // m) * m + r % m
            for i in range(LANES):
                first, second = fine[0, one, i], fine[0, one + m, i]
                Z[0, r, i] = math.sqrt(0.5) * (first + second)
                Z[1, r, i] = math.sqrt(0.125) * (fine[1, one, i] + fine[1, one + m, i])
                Z[1, r, i] += math.sqrt(0.375) * (first - second)
                Z[2, r, i] = fine[2, one, i]
        walk(half, ends[k : k + LANES], fine, False, room)
        if leg.walls:
            same_path(fine, n, Z)
        walk(leg, middle[k : k + LANES], Z, False, room)
    return middle, ends


@jit
def _mirror(Z, m):
    """Give neighbouring lanes of Z (3, d, LANES), noise in m dimensions, that of their first mirrored."""
    for part in range(Z.shape[0]):
        for r in range(Z.shape[1]):
            seen = r % m % (_MIRRORED - 1) + 1
            for i in range(Z.shape[2]):
                first = Z[part, r, i - i % _MIRRORED]
                Z[part, r, i] = -first if 0 < (seen & i % _MIRRORED) < 3 else first
