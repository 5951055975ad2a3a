"""Points led to a reading piece by piece of the way, in one call.

That is what `filter.bridged` does of any sensor and any way, for one prediction since the last reading and
noise that is the same in all states.
"""

import math

import numpy as np
from numba import types

from .._addresses import Entry
from .._jit import MATRIX, VECTOR, jit
from ..limits import TINY
from .blocks import blocks_of, centres, multiplied, products
from .curve import along_curve
from .guide import joined, look_ahead, over_both
from .linearise import linearise_at, lower_and_rows
from .noise import even_normals, mixed, stored
from .pace import over
from .reading import WAY, Part, as_seen, gone, likelihoods, read
from .way import AGAIN, FIRST, everywhere
from .weights import beside, effective, finite_rows, normalise, taken

#: Points for each of the prior: the first guide chooses few of these, and what remains of the way parts them.
#: Measured: with half, with itself and with twice errors of peaks of sin 4 x + y² are .008, .007, .003.
MORE = 4
#: Times what linearity misses on average, that a guide sees, which is more in the tails: of 1, 2, 4, 8 and an
#: outlier of twelve sigma, errors .14 .09 .06 .05. Measured: half and twice are .7 and .9 of an error.
MISSED = 8.0
#: Number of a stage's key from which on keys of the parts of the rest of the way are.
REST = 100


@jit
def bridge(reader, leg, linear, passage, x, y, w, block, kernel, moved, u, v, nets, key, least, table, bits):
    """Prior times likelihood by guides over ever shorter rests of the way.

    The arguments are those of `reading.weigh`, with nets of `MORE` times as many normals; the first guide
    chooses at least so many points, or none are led; table and bits are the curve's. Returns states,
    logarithms of weights and ancestors as `weigh` does, none where no guide can be made, and how many
    likelihoods are no number.
    """
    n, N = x.shape
    none = np.empty((n, 0)), np.empty(0), np.empty(0, np.int64), 0
    count, own, share = nets[0].shape[1], mixed(np.uint64(key), np.uint64(0)), np.empty(N)
    total = normalise(np.log(np.maximum(w, TINY)), share)
    flow, G = joined(kernel.flow, kernel.lower, moved.flow, moved.lower)
    lower, rows = lower_and_rows(G)
    whole = products(rows, np.concatenate((u, v)), block)
    way = flow, lower, moved.end, rows
    ancestor, new, log_ratio = _led(reader, way, x, y, whole, u, share, block, nets[0], own)
    if ancestor.size == 0 or effective(1.0 * np.bincount(ancestor)) < least:
        return none
    z = gone(leg, True, taken(x, ancestor), new, block[ancestor], kernel, np.uint64(0))
    log_w, lineage, stage = total - log_ratio[N:] - math.log(count), ancestor, 0
    while True:  # each stage takes half of what is left, or its only step
        stage += 1
        fine, every = finite_rows(z)
        at = 0
        while at < count and not fine[at]:
            at += 1
        if at == count:
            return none
        for i in range(0 if every else count):
            if not fine[i]:
                z[:, i], log_w[i] = z[:, at], -np.inf
        own = mixed(np.uint64(key), np.uint64(stage))
        order = along_curve(z, np.full(count, 1.0 / count), table, bits)
        x, log_w, lineage, block = taken(z, order), log_w[order], lineage[order], blocks_of(count)
        first, rest = leg, leg
        parted = not linear and leg.steps > 1
        if parted:
            half = (leg.steps + 1) // 2
            middle, end = leg.t + half * leg.h, leg.t + leg.steps * leg.h
            first = over(leg, leg.flow, leg.t, middle, half)
            rest = over(leg, leg.flow, middle, end, leg.steps - half)
        part, own_key = _linearised(first, linear, moved, centres(x)), stored(own, REST)
        u = even_normals(nets[1], np.uint64(stored(own, 0)))
        y = gone(first, linear, x, u, block, part, mixed(np.uint64(own_key), np.uint64(FIRST)))
        way, whole = (part.flow, part.lower, part.end, np.empty((0, n, n))), u
        if parted:
            later, later_key = _linearised(rest, False, moved, part.end), stored(own, REST + 1)
            v = even_normals(nets[2], np.uint64(stored(own, 1)))
            y = gone(rest, False, y, v, block, later, mixed(np.uint64(later_key), np.uint64(FIRST)))
            flow, G = joined(part.flow, part.lower, later.flow, later.lower)
            lower, rows = lower_and_rows(G)
            way, whole = (flow, lower, later.end, rows), products(rows, np.concatenate((u, v)), block)
        share = np.empty(count)
        total = normalise(log_w, share)
        ancestor, new, log_ratio = _led(reader, way, x, y, whole, u, share, block, nets[0], own)
        if ancestor.size == 0:
            return none
        again = mixed(np.uint64(own_key), np.uint64(AGAIN))
        z = gone(first, linear, taken(x, ancestor), new, block[ancestor], part, again)
        if not parted:
            ends, lineage = beside(y, z), np.concatenate((lineage, lineage[ancestor]))
            log_l, wrong = likelihoods(reader, ends, read(reader, ends))
            return ends, total + over_both(log_l, log_ratio, share), lineage, wrong
        log_w, lineage, leg = total - log_ratio[count:] - math.log(count), lineage[ancestor], rest


@jit
def _linearised(leg, linear, moved, start):
    """The prediction `moved`, or a leg of it, linearised about other centres (blocks, n)."""
    if linear:  # the same in all blocks
        Phi, L = moved.flow[:1], moved.lower[0]
        offset = moved.end[0] - multiplied(Phi, moved.start[0].copy().reshape(1, len(L), 1))[0, :, 0]
        end, flow, lower = everywhere((Phi[0], offset, L), start)
        return Part(start, end, flow, lower, np.empty((1, 0, 0)))
    end = start.copy()
    flow, B = linearise_at(leg.linearise)(leg, end)
    lower, rows = lower_and_rows(B)
    return Part(start, end, flow, lower, rows)


@jit
def _led(reader, way, x, y, whole, u, share, block, net, key):
    """Ancestors (count,), what leads them over the first part of a way, (n, count), and what that is worth.

    The way is Φ, L, ends of the centres, and the rows of what moves the end among what moves both parts, or
    none; points of shares (N,) go from x to y (n, N), moved by `whole`, in the first part by u.
    """
    (flow, lower, end, rows), (n, N) = way, x.shape
    h, w = read(reader, y), np.full(N, 1.0 / N)
    r, HL, R = as_seen(reader, flow, lower, end, x, y, h, whole, w, block, MISSED)
    first = HL
    if len(rows) > 0:  # what moves points later is noise of the reading
        first = multiplied(HL, rows[:, :, :n].copy())
        R = R + _squared(HL) - _squared(first)
    return look_ahead(r, u, share, block, first, R, net, key)


@jit
def _squared(A):
    """A Aᵀ of matrices (blocks, k, n)."""
    return multiplied(A, np.ascontiguousarray(A.transpose(0, 2, 1)))


_NET = types.Array(types.float64, 2, "C", readonly=True)
_ABOUT = types.UniTuple(_NET, 3), types.int64, types.float64, types.uint32[::1], types.int64
_FOUND = types.Tuple([MATRIX, VECTOR, types.int64[::1], types.int64])
BRIDGE = Entry(bridge, (*WAY, *_ABOUT), _FOUND)
