"""Points led to a reading piece by piece of the way, in one call.

That is what `filter.bridged` does of any sensor and any way, for one prediction since the last reading and
noise that is the same in all states.
"""

import math

import numpy as np
from numba import types

from .._addresses import Entry
from .._jit import MATRIX, VECTOR, jit
from ..elementary import FAST
from ..limits import LARGEST_EXPONENT, TINY
from .blocks import blocks_of, centres, multiplied
from .curve import along_curve
from .guide import Moved, look_ahead, near_of, of_first, over_both
from .linearise import linearised
from .move import over, shifted
from .noise import even_normals, mixed, stored, uniform
from .reader import NET, PARTS, WAY, Part, as_one, as_seen, gone, likelihoods, read
from .way import AGAIN, FIRST, everywhere
from .weights import beside, effective, finite_rows, normalise, systematic, taken

#: Points for each of the prior: the first guide chooses few of these, and what remains of the way parts them.
#: Measured: with half, with itself and with twice errors of peaks of sin 4 x + y² are .008, .007, .003.
MORE = 4
#: Times what linearity misses on average, that a guide sees, which is more in the tails: of 1, 2, 4, 8 and an
#: outlier of twelve sigma, errors .14 .09 .06 .05. Measured: half and twice are .7 and .9 of an error.
MISSED = 8.0


@jit
def bridge(given, nets, key, least, curve):
    """Prior times likelihood by guides over ever shorter rests of the way.

    Given is the way of `reading.weigh`; nets are of `MORE` times as many normals; the first guide chooses at
    least so many points, or none are led; the curve is a table and its bits. Returns states, logarithms of
    weights and ancestors as `weigh` does, none where no guide can be made, and how many likelihoods are no
    number.
    """
    reader, leg, linear, _, x, y, w, block, kernel, moved, u, v = given
    (n, N), count, key, share = x.shape, nets[0].shape[1], np.uint64(key), np.empty(len(w))
    none = np.empty((n, 0)), np.empty(0), np.empty(0, np.int64), 0
    total = normalise(np.log(np.maximum(w, TINY)), share)
    flow, lower, rows, whole = as_one(kernel, moved, u, v, block)
    way = Moved(x, y, whole, np.full(N, 1.0 / N), block, flow, lower), moved.end, rows, u
    own, near = mixed(key, np.uint64(0)), near_of(leg.kind)
    found, log_l, _ = _led(reader, way, share, nets[0], own, near)
    if found[0].size == 0 or effective(1.0 * np.bincount(found[0])) < least:
        return none
    ancestor, new, log_ratio = some_free(found, log_l, share, u, own)
    z = shifted(taken(x, ancestor), new, block[ancestor], kernel.lower)
    log_w, lineage, stage = total - log_ratio - math.log(count), ancestor, 0
    while _kept(z, log_w):  # each stage takes half of what is left, or its only step
        stage += 1
        own = mixed(key, np.uint64(stage))
        order = along_curve(z, np.full(count, 1.0 / count), *curve)
        x, log_w, lineage, share = taken(z, order), log_w[order], lineage[order], np.empty(count)
        first, rest = _halved(leg, linear)
        last, total = rest.steps == 0, normalise(log_w, share)
        part, way = _anew(first, rest, linear, moved, x, nets, own)
        found, log_l, wrong = _led(reader, way, share, nets[0], own, near)
        ancestor, new, log_ratio = found
        if ancestor.size == 0:
            break
        if not last:
            ancestor, new, log_ratio = some_free(found, log_l, share, way[3], own)
        again = mixed(np.uint64(stored(own, PARTS)), np.uint64(AGAIN))
        z = gone(first, linear, taken(x, ancestor), new, way[0].block[ancestor], part, again)
        if last:
            ends, lineage = beside(way[0].y, z), np.concatenate((lineage, lineage[ancestor]))
            of_z, wrong_z = likelihoods(reader, z, read(reader, z))
            both = over_both(np.concatenate((log_l, of_z)), log_ratio, share)
            return ends, total + both, lineage, wrong + wrong_z
        log_w, lineage, leg = total - log_ratio - math.log(count), lineage[ancestor], rest
    return none


@jit
def some_free(found, log_l, share, u, key):
    """What `look_ahead` found for N points, but one of `MORE` goes on as it fell, where that is better.

    A guide that thinks little of a tail draws it never, and heavy weights that nothing has drawn are not
    missed: better is what has the smaller second moment of weights, as the N points say, that have been
    everywhere, if it does not hang on the few that came nearest: four alike know it to a half. They have
    log-likelihoods log_l (N,) at the end, shares (N,) and noise u (n, N). Returns ancestors in order, their
    noise, and logarithms (count,) of the density over the prior's.
    """
    ancestor, new, log_ratio = found
    N, best, won, total, squares = share.size, log_l.max(), 0.0, 0.0, 0.0
    for i in range(N if best > -np.inf else 0):
        ratio = FAST.exp(min(max(log_ratio[i], -LARGEST_EXPONENT), LARGEST_EXPONENT))
        square = share[i] * FAST.exp(2.0 * (log_l[i] - best))
        won += square * (1.0 / ratio - MORE / (1.0 + (MORE - 1.0) * ratio))
        total, squares = total + square, squares + square**2
    ratio = log_ratio[N:]
    if won <= 0.0 or total**2 < 4.0 * squares:
        return ancestor, new, ratio
    free = systematic(share, ancestor.size // MORE, uniform(key, np.uint64(1)))
    for j in range(free.size):
        at, i = (j + 1) * MORE - 1, free[j]
        ancestor[at], new[:, at], ratio[at] = i, u[:, i], log_ratio[i]
    order = np.argsort(ancestor, kind="mergesort")
    mixture = np.log((1.0 + (MORE - 1.0) * np.exp(np.minimum(ratio[order], LARGEST_EXPONENT))) / MORE)
    return ancestor[order], taken(new, order), mixture


@jit
def _kept(z, log_w):
    """Whether some states z (n, N) are numbers; those that are none become one of them, weighing nothing."""
    fine, every = finite_rows(z)
    at = 0
    while at < fine.size and not fine[at]:
        at += 1
    for i in range(0 if every or at == fine.size else fine.size):
        if not fine[i]:
            z[:, i], log_w[i] = z[:, at], -np.inf
    return at < fine.size


@jit
def _halved(leg, linear):
    """The first half of the steps of a leg, and the rest; all of it and none, where it has but one."""
    end, steps = leg.t + leg.steps * leg.h, leg.steps
    half = steps if linear else (steps + 1) // 2
    middle = leg.t + half * leg.h
    first = over(leg, leg.flow, leg.t, middle, max(half, 1))
    return first, over(leg, leg.flow, middle, end, steps - half if steps > half else 0)


@jit
def _anew(first, rest, linear, moved, x, nets, key):
    """The rest of the way from points x (n, N), of one part or two: the first, and what `_led` takes."""
    N = x.shape[1]
    part, block, even = _linearised(first, linear, moved, centres(x)), blocks_of(N), np.full(N, 1.0 / N)
    u = even_normals(nets[1], np.uint64(stored(key, 0)))
    y = gone(first, linear, x, u, block, part, mixed(np.uint64(stored(key, PARTS)), np.uint64(FIRST)))
    if rest.steps == 0:
        return part, (Moved(x, y, u, even, block, part.flow, part.lower), part.end, np.empty((0, 1, 1)), u)
    later, v = _linearised(rest, False, moved, part.end), even_normals(nets[2], np.uint64(stored(key, 1)))
    y = gone(rest, False, y, v, block, later, mixed(np.uint64(stored(key, PARTS + 1)), np.uint64(FIRST)))
    flow, lower, rows, whole = as_one(part, later, u, v, block)
    return part, (Moved(x, y, whole, even, block, flow, lower), later.end, rows, u)


@jit
def _linearised(leg, linear, moved, start):
    """The prediction `moved`, or a leg of it, linearised about other centres (blocks, n)."""
    if linear:  # the same in all blocks
        Phi, L = moved.flow[:1], moved.lower[0]
        offset = moved.end[0] - multiplied(Phi, moved.start[0].copy().reshape(1, len(L), 1))[0, :, 0]
        end, flow, lower = everywhere((Phi[0], offset, L), start)
        return Part(start, end, flow, lower, np.empty((1, 0, 0)))
    end, flow, lower, rows = linearised(leg, start)
    return Part(start, end, flow, lower, rows)


@jit
def _led(reader, way, share, net, key, near):
    """What `look_ahead` finds over the first part of a way; and the `likelihoods` at the end of all of it.

    The way: points that have `Moved` along it, of shares (N,); ends of its blocks; rows of what moves points
    in all of its parts, none where there is but one; and what moves them in the first, (n, N).
    """
    moved, end, rows, u = way
    h = read(reader, moved.y)
    seen = as_seen(reader, moved, h, end, MISSED, near)
    found = look_ahead(of_first(seen, rows), u, share, moved.block, net, key)
    log_l, wrong = likelihoods(reader, moved.y, h)
    return found, log_l, wrong


_CURVE = types.Tuple([types.uint32[::1], types.int64])
_FOUND = types.Tuple([MATRIX, VECTOR, types.int64[::1], types.int64])
BRIDGE = Entry(bridge, (WAY, types.UniTuple(NET, 3), types.int64, types.float64, _CURVE), _FOUND)
