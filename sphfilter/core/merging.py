"""Gaussians of a sum taken together in pairs, the most alike first.

Letters: log_w (K,), m (K, n) and L (K, n, n) are logarithms of weights, means and lower roots of covariances.
"""

import math

import numpy as np

from ._jit import jit
from .elementary import FAST
from .small_matrices import cholesky, invert_lower, product

#: Of a Gaussian, that it may be merged with. Measured: with half and twice errors are .95 and 1.1 times as
#: large.
_NEIGHBOURS = 6
_LIGHT = 0.02  # share from which on less is allowed; measured: half and twice move means by .001 at most


@jit
def merge(log_w, m, L, most, near, nodes, u):
    """Merge pairs of Gaussians until the logarithm of the sum would change by more than `most`.

    How much it changes is the rms over the pair, by nodes (n, N) and weights (N,) of a rule for the standard
    normal law, with the changes of earlier mergers added; of light ones it may be more. Only pairs whose
    middles lie within `near` widths of one of them are tried. Returns log_w, m, L, and how much each Gaussian
    has been changed.
    """
    K, n = m.shape
    log_w, m, L, inverse = _room(log_w, m, L)
    debt, alive = np.zeros(2 * K), np.zeros(2 * K, np.bool_)
    pair = np.empty((2 * K * _NEIGHBOURS, 2), np.int64)
    cost, owed = np.empty(len(pair)), np.empty(len(pair))
    total, known, first, count = _log_sum(log_w[:K]), 0, 0, K
    scratch, rule = (np.empty((n, n)), np.empty((3, u.size))), (nodes, u, 0.5 * (nodes * nodes).sum(axis=0))
    while count > first:
        for k in range(first, count):
            alive[k], inverse[k] = True, invert_lower(L[k])
        last = _with_neighbours(m, L, inverse, alive, (first, count), near, pair, known)
        for p in range(known, last):
            i, j = pair[p]
            new = _joined(log_w, m, L, i, j, m[count], L[count])
            change = _change(log_w, m, inverse, (i, j), (new, m[count], L[count]), rule, scratch)
            owed[p] = change + math.exp(log_w[i] - new) * debt[i] + math.exp(log_w[j] - new) * debt[j]
            cost[p] = owed[p] / max(1.0, math.sqrt(_LIGHT / math.exp(new - total)))
        first, order = count, np.argsort(cost[:last], kind="mergesort")
        for p in order:
            i, j = pair[p]
            if not cost[p] <= most:
                break
            if alive[i] and alive[j]:
                alive[i] = alive[j] = False
                log_w[count] = _joined(log_w, m, L, i, j, m[count], L[count])
                debt[count] = owed[p]
                count += 1
        known = 0
        for p in range(last):
            i, j = pair[p]
            if alive[i] and alive[j]:
                pair[known], cost[known], owed[known] = pair[p], cost[p], owed[p]
                known += 1
    left = np.flatnonzero(alive)
    return log_w[left], m[left], L[left], debt[left]


@jit
def _room(log_w, m, L):
    """Gaussians with room for as many more, one of which is never one; and for inverse roots."""
    K, n = m.shape
    more_w, more_m, more_L = np.empty(2 * K), np.empty((2 * K, n)), np.empty((2 * K, n, n))
    more_w[:K], more_m[:K], more_L[:K] = log_w, m, L
    return more_w, more_m, more_L, np.empty(more_L.shape)


@jit
def _log_sum(log_w):
    """Logarithm of the sum of weights."""
    top, total = log_w.max(), 0.0
    for k in range(log_w.size):
        total += math.exp(log_w[k] - top)
    return top + math.log(total)


@jit
def _with_neighbours(m, L, inverse, alive, new, near, pair, known):
    """Fill pairs (P, 2), of which so many are known, with new Gaussians and those most like each.

    Of the new ones, which are last, are the first number and the one after the last. Returns how many pairs
    there are then.
    """
    found, square = np.empty(_NEIGHBOURS, np.int64), np.empty(_NEIGHBOURS)
    (first, count), z, begun = new, np.empty(m.shape[1]), known
    for k in range(first, count):
        many = 0
        for j in range(count):
            if j == k or not alive[j]:
                continue
            apart = _squared(inverse[k], m[j], m[k], near * near, z)
            if not apart < near * near:
                continue
            apart += _wider(inverse[k], L[j])
            if many < _NEIGHBOURS or apart < square[many - 1]:
                many = min(many + 1, _NEIGHBOURS)
                at = many - 1
                while at > 0 and square[at - 1] > apart:
                    square[at], found[at] = square[at - 1], found[at - 1]
                    at -= 1
                square[at], found[at] = apart, j
        for s in range(many):
            if found[s] < first or not _has(pair, begun, known, found[s], k):
                pair[known, 0], pair[known, 1] = found[s], k
                known += 1
    return known


@jit
def _has(pair, begun, known, i, j):
    """Whether a pair in the other order is among those from number `begun` on."""
    found = False
    for p in range(begun, known):
        found |= pair[p, 0] == j and pair[p, 1] == i
    return found


@jit
def _squared(inverse, x, middle, most, z):
    """Square of how far a state (n,) is from a middle, in widths, or more than `most`; z (n,) is scratch."""
    s, a = 0.0, 0
    while a < z.size and s < most:
        z[a], y = x[a] - middle[a], 0.0
        for b in range(a + 1):
            y += inverse[a, b] * z[b]
        s, a = s + y * y, a + 1
    return s


@jit
def _wider(inverse, L):
    """Square of how far a root (n, n) is from another, whose inverse is given, in units of that."""
    s = 0.0
    for a in range(len(L)):
        for b in range(a + 1):
            y = -1.0 if a == b else 0.0
            for c in range(b, a + 1):
                y += inverse[a, c] * L[c, b]
            s += y * y
    return s


@jit
def _joined(log_w, m, L, i, j, mean, root):
    """Fill mean (n,) and root (n, n) of two Gaussians as one; returns the logarithm of its weight.

    The root is no number where it has none.
    """
    top = max(log_w[i], log_w[j])
    log_both = top + math.log(math.exp(log_w[i] - top) + math.exp(log_w[j] - top))
    p, q = math.exp(log_w[i] - log_both), math.exp(log_w[j] - log_both)
    n = mean.size
    cov = np.empty((n, n))
    for a in range(n):
        mean[a] = p * m[i, a] + q * m[j, a]
        for b in range(a + 1):
            s = p * q * (m[i, a] - m[j, a]) * (m[i, b] - m[j, b])
            for c in range(b + 1):
                s += p * L[i, a, c] * L[i, b, c] + q * L[j, a, c] * L[j, b, c]
            cov[a, b] = cov[b, a] = s
    if not cholesky(cov, root):
        root[:] = np.nan
    return log_both


@jit
def _change(log_w, m, inverse, pair, one, rule, scratch):
    """Rms over one Gaussian of what log p changes by where it takes the place of a pair.

    It is the logarithm of its weight, its mean and its root; the rule has nodes (n, N), weights and halves of
    the squares (N,) of the nodes.
    """
    (turned, logs), (new, mean, root), (nodes, u, half) = scratch, one, rule
    square, peak, N = 0.0, 0.0, u.size
    for a in range(mean.size):
        peak -= math.log(root[a, a])
    for s in range(2):
        k = pair[s]
        product(inverse[k], root, 1.0, turned)
        _log_normals(inverse[k], m[k], log_w[k] - new, mean, turned, nodes, logs[s], logs[2])
    for i in range(N):
        low, high = min(logs[0, i], logs[1, i]), max(logs[0, i], logs[1, i])
        change = high + FAST.log(1.0 + FAST.exp(low - high)) - (peak - half[i])
        square += u[i] * change * change
    return math.sqrt(square)


@jit
def _log_normals(inverse, middle, log_w, mean, turned, nodes, out, y):
    """Fill logarithms (N,) of a Gaussian, but for a constant, at the nodes about a mean that are `turned`.

    Its middle is (n,), the inverse of its root (n, n), that of its weight is given; y (N,) is scratch.
    """
    out[:] = log_w
    for a in range(mean.size):
        off, peak = 0.0, math.log(inverse[a, a])
        for b in range(a + 1):
            off += inverse[a, b] * (mean[b] - middle[b])
        y[:] = off
        for b in range(a + 1):
            on, own = turned[a, b], nodes[b]
            for i in range(y.size):
                y[i] += on * own[i]
        for i in range(y.size):
            out[i] += peak - 0.5 * y[i] * y[i]
