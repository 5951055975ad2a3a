"""Blocks of neighbouring points, linearised along the path of their centre without noise.

In the linearised flow of a block the end of a point is c_T + Φ (x - c_0) + Σ_s B_s ξ_s. L and V with
L V = B, rows of V orthonormal, say what of all the noise moves the end: u = V ξ, standard normal.
"""

import math

import numpy as np
from numba import types

from .._addresses import Entry, function_at
from .._jit import MATRIX, jit
from .._views import lent, rows_at, stretch
from ..limits import ROUNDING
from ..small_matrices import product
from ..sums import dot, summed
from .blocks import block_size
from .noise import OF_STATE
from .steps import CUBE, LEG, flow, new_room, scaled, times_root

_TERMS = 4  # of an exponential at half a norm, (1/2)⁴ / 4! = 2.6e-3 of what only guides is left out


@jit
def widths(x, lineage, power):
    """Widths (blocks,) of what points x (n, N) stand for, over the standard deviation of their block.

    Points of one `lineage` (N,) that have not moved apart count as one. Squares of K are K^-power: with 2 / n
    as far as they are apart; with 1 they smooth a density by no more than K draws miss it.
    """
    n, N = x.shape
    size, count = block_size(N), lineage.max() + 1
    out, sums, members = np.empty(-(-N // size)), np.empty((count, n)), np.zeros(count, np.int64)
    own, variances = np.empty(size, np.int64), np.empty(n)
    for b in range(out.size):
        first, last = b * size, min((b + 1) * size, N)
        K, lineages = last - first, 0
        for i in range(first, last):
            k = lineage[i]
            if members[k] == 0:
                own[lineages] = k
                lineages += 1
                for a in range(n):
                    sums[k, a] = 0.0
            members[k] += 1
        ratio = 0.0
        for a in range(n):
            values = stretch(x, a, first, K)
            mean, square = summed(values) / K, dot(values, values) / K
            for i in range(K):
                sums[lineage[first + i], a] += values[i]
            variance, between = square - mean * mean, -mean * mean
            for j in range(lineages):
                between += sums[own[j], a] ** 2 / (members[own[j]] * K)
            variances[a] = variance if variance > ROUNDING * square else np.inf
            ratio += between / (variances[a] * n)
        for j in range(lineages):
            members[own[j]] = 0
        # of as many points as lineages the means part by chance, too
        chance = lineages / K
        ratio = min(max((ratio - chance) / max(1.0 - chance, 1e-9), 0.0), 1.0) if lineages < K else 0.0
        narrower = 4.0 * (_within(x, first, last, variances) + lineages**-2.0)  # of two nothing is within
        out[b] = min(math.sqrt(max(K**-power, ratio * lineages**-power) * min(narrower, 1.0)), 1.0)
    return out


@jit
def _within(x, first, last, variances):
    """Part of the variances (n,) of consecutive points of x (n, N) that is within two groups of neighbours.

    They part where neighbours are farthest apart; of the states the least counts. It is 1/4 of an even patch.
    """
    n, K, at, most, least = len(x), last - first, first + 1, -1.0, 1.0
    for i in range(first + 1, last):
        step = 0.0
        for a in range(n):
            step += (x[a, i] - x[a, i - 1]) ** 2 / variances[a]
        if step > most:
            at, most = i, step
    size = at - first
    for a in range(n):
        off = summed(stretch(x, a, at, last - at)) / (last - at) - summed(stretch(x, a, first, size)) / size
        least = min(least, 1.0 - off * off * size * (last - at) / (K * K * variances[a]))
    return max(least, 0.0)


@jit
def _flow_matrices(J, h, M, N, term, new):
    """Fill exp(hJ) and its mean over a step, (n, n) each: a series, and doubling where it is stiff.

    Two more such matrices are scratch.
    """
    n, norm, doublings = J.shape[0], 0.0, 0
    for a in range(n):
        for b in range(n):
            norm = max(norm, h * abs(J[a, b]))
    while norm > 0.5 and doublings < 60:
        norm, doublings = 0.5 * norm, doublings + 1
    part = h * 0.5**doublings
    for a in range(n):
        for b in range(n):
            term[a, b] = M[a, b] = N[a, b] = 1.0 if a == b else 0.0
    for k in range(1, _TERMS):
        product(J, term, part / k, new)
        for a in range(n):
            for b in range(n):
                term[a, b] = new[a, b]
                M[a, b] += term[a, b]
                N[a, b] += term[a, b] / (k + 1)
    for _ in range(doublings):
        product(M, N, 1.0, new)
        product(M, M, 1.0, term)
        for a in range(n):
            for b in range(n):
                N[a, b] = 0.5 * (N[a, b] + new[a, b])
                M[a, b] = term[a, b]


@jit
def linearise(leg, c):
    """Move centres c (blocks, n) to the end of a leg, and return Φ (blocks, n, n) and B (blocks, n, d).

    d = steps m. The Jacobian of each step is that in its middle; what is wrong with it costs a guide nothing
    but efficiency.
    """
    leg, c = lent((leg, c))
    (nb, n), m, h = c.shape, leg.root.shape[0], leg.h
    room, middle = new_room(m), np.empty((nb, n))
    J, g, sigma = np.empty((nb, n * n)), np.empty((nb, n * m)), np.empty((n, m))
    M, A = np.empty((leg.steps, nb, n, n)), np.empty((leg.steps, nb, n, m))
    N, term, new = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    slopes, steps = J.reshape(-1), M.reshape(-1)
    for s in range(leg.steps):
        t = leg.t + s * h
        for b in range(nb):
            for a in range(n):
                middle[b, a] = 0.5 * c[b, a]
        flow(leg, c, t, h, room)
        for b in range(nb):
            for a in range(n):
                middle[b, a] += 0.5 * c[b, a]
        function_at(leg.jacobian)(middle, t + 0.5 * h, leg.p, J)
        if leg.kind == OF_STATE:
            function_at(leg.noise)(middle, t + 0.5 * h, leg.p, g)
        elif s == 0 or not leg.constant:
            scaled(leg, c, t + 0.5 * h, sigma)
        for b in range(nb):
            own = rows_at(steps, (s * nb + b) * n * n, n, n)
            _flow_matrices(rows_at(slopes, b * n * n, n, n), h, own, N, term, new)
            if leg.kind == OF_STATE:
                times_root(g[b], leg.root, sigma)
            for a in range(n):
                for k in range(m):
                    A[s, b, a, k] = 0.0
                    for e in range(n):
                        A[s, b, a, k] += math.sqrt(h) * N[a, e] * sigma[e, k]
    return backwards(M, A)


LINEARISE = Entry(linearise, (LEG, MATRIX), types.UniTuple(CUBE, 2))
linearise_at = LINEARISE.at


@jit
def linearised(leg, start):
    """Ends of centres (blocks, n) over a leg, without noise; Φ, L and V."""
    end = start.copy()
    flow, B = linearise_at(leg.linearise)(leg, end)
    lower, rows = lower_and_rows(B)
    return end, flow, lower, rows


@jit
def backwards(M, A):
    """Φ (blocks, n, n) and B (blocks, n, steps m) from those of all steps, from the last one back."""
    steps, nb, n, m = A.shape
    Phi, B, row = np.zeros((nb, n, n)), np.empty((nb, n, steps * m)), np.empty(n)
    for b in range(nb):
        for a in range(n):
            Phi[b, a, a] = 1.0
            for s in range(steps - 1, -1, -1):
                for k in range(m):
                    v = 0.0
                    for e in range(n):
                        v += Phi[b, a, e] * A[s, b, e, k]
                    B[b, a, s * m + k] = v
                for e in range(n):
                    row[e] = 0.0
                    for f in range(n):
                        row[e] += Phi[b, a, f] * M[s, b, f, e]
                for e in range(n):
                    Phi[b, a, e] = row[e]
    return Phi, B


@jit
def lower_and_rows(B):
    """L (blocks, n, n), lower, and V (blocks, n, d), of orthonormal rows, with L V = B.

    A row that others span already, or that is not finite, is left out: zero in V, and on L's diagonal.
    """
    nb, n, d = B.shape
    L, V, row = np.zeros((nb, n, n)), np.zeros((nb, n, d)), np.empty(d)
    for b in range(nb):
        for a in range(n):
            whole, left = 0.0, 0.0
            for k in range(d):
                row[k] = B[b, a, k]
                whole += row[k] * row[k]
            for _ in range(2):  # once more against what rounding leaves
                for e in range(a):
                    s = 0.0
                    for k in range(d):
                        s += row[k] * V[b, e, k]
                    L[b, a, e] += s
                    for k in range(d):
                        row[k] -= s * V[b, e, k]
            for k in range(d):
                left += row[k] * row[k]
            if left > ROUNDING * whole and left < np.inf:
                L[b, a, a] = math.sqrt(left)
                for k in range(d):
                    V[b, a, k] = row[k] / L[b, a, a]
            elif not whole < np.inf:
                for e in range(n):
                    L[b, a, e] = 0.0
    return L, V
