"""A reading before its time: ancestors chosen, and their noise led, as the linearised flow says.

Letters: y (n, N) ends of the first pass, u (n, N) what moved them, r (k, N) residuals z - h(y - L u) of
points without their noise, HL (blocks, k, n), R the covariance of the reading, with what linearity misses.
"""

import math
from typing import NamedTuple

import numpy as np
from numba.extending import register_jitable

from .._jit import jit
from .._views import lent, stretch
from ..elementary import FAST
from ..limits import LARGEST_EXPONENT
from ..small_matrices import cholesky, invert_lower, log_peak, solve_factored
from ..sums import summed
from .blocks import add_products, end_of_block, multiplied, products, squares
from .noise import OF_STATE, even_normals, uniform
from .weights import distances, oftener, prior_times, systematic, taken, weighted_moments

#: Neighbours to either side, that tell what the flow is without noise; and where that depends on the state.
#: Their noise is what its even points leave of a point's own, and rests hang on noise that depends on the
#: state. Measured: with 2 and 16 variances of one such posterior are .059 and .012 off.
NEAR, NEAR_OF_STATE = 2, 64
#: Times the reading's own noise that the guide sees: 1.2 has heavy weights on two wells, 2 is as good.
WIDER = 1.5


class Moved(NamedTuple):
    """Points that have gone a way, linearised in blocks: y ≈ Φ x + L u and what is the same for a block."""

    x: np.ndarray  # (n, N), where they began
    y: np.ndarray  # (n, N), where they came
    u: np.ndarray  # (n, N), normals that moved their ends
    w: np.ndarray  # (N,) weights
    block: np.ndarray  # (N,)
    flow: np.ndarray  # Φ, (blocks, n, n)
    lower: np.ndarray  # L, (blocks, n, n)


class Ahead(NamedTuple):
    """Points before a reading, as it sees them without the noise that moves their ends."""

    r: np.ndarray  # (k, N), what was read less what each would read
    y: np.ndarray  # (n, N), where they would come
    L: np.ndarray  # of that noise, (blocks, n, n)
    HL: np.ndarray  # (blocks, k, n)
    R: np.ndarray  # noise that a guide takes, with what linearity misses, (blocks, k, k)


@register_jitable
def near_of(kind):
    """How many neighbours to either side tell what a flow beside noise of this kind is without it."""
    return NEAR_OF_STATE if kind == OF_STATE else NEAR


@jit
def without_noise(moved, near):
    """Where each point (n, N) would go without the noise that moves the end, as so many neighbours tell.

    What its own noise did must not tell it: the proposal's density at a point would depend on the draw that
    it is to weigh, and the evidence would be wrong however many points there are.
    """
    (n, N), first, block = moved.y.shape, 0, moved.block
    out = products(moved.flow, moved.x, block)
    rest = moved.y - out
    add_products(rest, -1.0, moved.lower, moved.u, block)
    while first < N:
        last = end_of_block(block, first)
        for a in range(n):
            own, given = stretch(out, a, first, last - first), stretch(rest, a, first, last - first)
            _add_of_neighbours(given, own, near)
        first = last
    return out


@jit
def _add_of_neighbours(rest, out, near):
    """Add to each of some numbers (K,) the mean of the rests (K,) of so many neighbours to either side."""
    K = out.size
    inside = max(K - 2 * near, 0)
    for i in range(inside):
        s = -rest[i + near]
        for k in range(2 * near + 1):
            s += rest[i + k]
        out[i + near] += s / (2 * near)
    for j in range(K - inside):  # at both ends
        i = j if j < near else inside + j
        low, high = max(i - near, 0), min(i + near + 1, K)
        s = -rest[i]
        for k in range(low, high):
            s += rest[k]
        out[i] += s / max(high - low - 1, 1)


@jit
def over_both(log_l, log_ratio, w):
    """Logarithms (N + count,) of the weights of both passes, whose sum is the evidence.

    What either may have drawn has half the prior's density and half the guide's: log-likelihoods log_l and
    ratios log_ratio of the guide's over the prior's, (N + count,); weights w (N,) of the first pass.
    """
    N, out = w.size, np.empty(log_l.size)
    for j in range(out.size):
        base = w[j] if j < N else 1.0 / (out.size - N)
        ratio = FAST.exp(min(max(log_ratio[j], -LARGEST_EXPONENT), LARGEST_EXPONENT))
        own = log_l[j] + FAST.log(base / (1.0 + ratio))
        out[j] = own if base > 0.0 and log_l[j] > -np.inf else -np.inf
    return out


@jit
def wrapped(r, angle):
    """A difference, of angles in (-π, π]."""
    return r - 2.0 * math.pi * round(r / (2.0 * math.pi)) if angle else r


@jit
def joined(Phi, G, flow, lower):
    """A linear change Φ x + G u and one after it, as one: Φ (blocks, n, n), G (blocks, n, d + n)."""
    d, whole = G.shape[2], np.empty((len(G), G.shape[1], G.shape[2] + G.shape[1]))
    whole[:, :, :d], whole[:, :, d:] = multiplied(flow, G), lower
    return multiplied(flow, Phi), whole


@jit
def of_first(ahead, rows):
    """Points `Ahead`, of which the noise of a way's first part alone moves the ends.

    What moves them later is noise of the reading: to the end of the way `rows` (blocks, n, d) bring the noise
    of all parts; without any there is but one.
    """
    r, y, L, HL, R = ahead
    if len(rows) == 0:
        return ahead
    part = rows[:, :, : L.shape[2]].copy()
    first = multiplied(HL, part)
    return Ahead(r, y, multiplied(L, part), first, R + _squared(HL) - _squared(first))


@jit
def _squared(A):
    """A Aᵀ of matrices (blocks, k, n)."""
    return multiplied(A, np.ascontiguousarray(A.transpose(0, 2, 1)))


@jit
def linear_reading(moved, h, H, R, angle, misses):
    """What a reading sees of points that have `Moved`: HL (blocks, k, n), and the noise (blocks, k, k) that a
    guide takes.

    What linearity misses is half the mean square difference of neighbours' readings less their linear parts.
    Neighbours on the curve stand for the second derivatives of a block: what is the same for both cancels.
    The noise is `WIDER` times R and `misses` times what linearity misses; H and R are of one or all blocks,
    h (k, N) are readings of the ends.
    """
    (k, N), nb, HL = h.shape, len(moved.lower), multiplied(H, moved.lower)
    w, block = moved.w, moved.block
    C, off, rest, total = np.zeros((k, k)), np.empty(k), h.copy(), 0.0
    add_products(rest, -1.0, HL, moved.u, block)
    add_products(rest, -1.0, multiplied(H, moved.flow), moved.x, block)
    for i in range(1, N):
        finite, v = block[i] == block[i - 1], 0.5 * (w[i] + w[i - 1])
        for a in range(k):
            off[a] = wrapped(rest[a, i] - rest[a, i - 1], angle[a])
            finite &= abs(off[a]) < np.inf
        total += v if finite else 0.0
        for a in range(k if finite else 0):
            for e in range(k):
                C[a, e] += 0.5 * v * off[a] * off[e]
    noise = np.empty((nb, k, k))
    noise[:] = WIDER * R + C * (misses / total if total > 0.0 else 0.0)
    return HL, noise


@jit
def log_normals(z, h, angle, F):
    """Logarithms (N,) of N(z; h, F Fᵀ) at readings h (k, N), angles wrapped; and how many are NaN."""
    (k, N), wrong, peak = h.shape, 0, log_peak(F)
    out = squares(invert_lower(F).reshape(1, k, k), residuals(z, h, angle), np.zeros(N, np.int64))
    for i in range(N):
        out[i] = peak - 0.5 * out[i]
        wrong += out[i] != out[i]
    return out, wrong


@jit
def residuals(z, h, angle):
    """What was read, z (k,), less readings h (k, N), angles wrapped."""
    r = np.empty(h.shape)
    for a in range(z.size):
        for i in range(h.shape[1]):
            r[a, i] = wrapped(z[a] - h[a, i], angle[a])
    return r


@jit
def _fill_gains(HL, R, gains, ahead, rest):
    """Fill gains K and T of all blocks, and inverse roots and peaks of the noise ahead, HL HLᵀ + R, and of R.

    They are left as they are where there are none.
    """
    (blocks, k, _), (K, T), (of_S, peak_S), (of_R, peak_R) = HL.shape, lent(gains), lent(ahead), lent(rest)
    S, F = np.empty((k, k)), np.empty((k, k))
    for b in range(blocks):
        if _gain(HL[b], R[b], S, K[b], T[b]) and cholesky(S, F) and cholesky(R[b], S):
            peak_S[b], peak_R[b] = _inverse(F, of_S[b]), _inverse(S, of_R[b])


@jit
def _gain(HL, R, S, K, T):
    """Fill S = HL HLᵀ + R, K = HLᵀ S⁻¹ (n, k) and T with T Tᵀ = I - K HL; False where there is none."""
    k, n = HL.shape
    F, rest = np.empty((k, k)), np.empty((n, n))
    for a in range(k):
        for e in range(k):
            s = R[a, e]
            for c in range(n):
                s += HL[a, c] * HL[e, c]
            S[a, e] = s
    if not cholesky(S, F):
        return False
    for c in range(n):
        for a in range(k):
            K[c, a] = HL[a, c]
        solve_factored(F, K[c])
    for a in range(n):
        for e in range(n):
            s = 1.0 if a == e else 0.0
            for c in range(k):
                s -= K[a, c] * HL[c, e]
            rest[a, e] = s
    return cholesky(rest, T)


@jit
def look_ahead(ahead, u, w, block, net, key):
    """Choose ancestors of a reading, and what shall move their ends.

    Those that will come d standard deviations from the mean are chosen up to 1 + d/√n times as often as the
    reading says: a mode of little weight, on which half of a variance may hang, would else have no point.

    Points have u (n, N), weights w (N,) and blocks (N,); the net (n, count) is of standard normals that are
    even along the curve, and are turned and shifted by the key. Returns numbers (count,) of the points, in
    order, and their u (n, count), none where no block can be guided; and the logarithm (N + count,) of the
    proposal's density of (point, u) over the prior's: of the N of the first pass, then of the new ones.
    """
    ahead, u, w, block, net = lent((ahead, u, w, block, net))
    r, y, L, HL, R = ahead
    (k, N), (n, count), blocks = r.shape, net.shape, HL.shape[0]
    z, cut = even_normals(net, key), uniform(key, np.uint64(0))
    K, T = np.zeros((blocks, n, k)), np.zeros((blocks, n, n))
    of_S, of_R = np.zeros((blocks, k, k)), np.zeros((blocks, k, k))
    peak_S, peak_R = np.full(blocks, -np.inf), np.full(blocks, -np.inf)
    _fill_gains(HL, R, (K, T), (of_S, peak_S), (of_R, peak_R))
    a = prior_times(w, _said(r, block, of_S, peak_S))
    top, log_ratio = a.max(), np.empty(N + count)
    if top == -np.inf:
        return np.empty(0, np.int64), np.empty((n, count)), log_ratio
    for i in range(N):
        a[i] = FAST.exp(a[i] - top)
    total = summed(a)
    often, ratio = _how_often(a / total, y, (multiplied(L, K), r, block), count)
    ancestor, known = systematic(often, count, cut), top + math.log(total * summed(often))
    rest = r.copy()
    add_products(rest, -1.0, HL, u, block)
    log_ratio[:N] = _said(rest, block, of_R, peak_R) + ratio - known
    rest, block = taken(r, ancestor), block[ancestor]
    new = products(K, rest, block)
    add_products(new, 1.0, T, z, block)
    add_products(rest, -1.0, HL, new, block)
    log_ratio[N:] = _said(rest, block, of_R, peak_R) + ratio[ancestor] - known
    return ancestor, new, log_ratio


@jit
def _how_often(a, y, led, count):
    """How often (N,) ancestors of weights a (N,) are chosen, and logarithms of that over their weights.

    Their ends without noise y (n, N) are led by so much (blocks, n, k) of residuals (k, N) of blocks (N,).
    """
    (n, N), end, ratio = y.shape, y.copy(), np.zeros(len(a))
    mean, cov = np.empty(n), np.empty((n, n))
    add_products(end, 1.0, *led)
    for i in range(N):
        if a[i] == 0.0:
            end[:, i] = 0.0  # it may be no number
    weighted_moments(end, a, mean, cov)
    often = oftener(a, np.sqrt(distances(end, mean, cov)), count)
    for i in range(N):
        if a[i] > 0.0:
            ratio[i] = FAST.log(often[i] / a[i])
    return often, ratio


@jit
def _inverse(F, out):
    """Fill the inverse of a lower F (k, k); return the logarithm of N(0; 0, F Fᵀ)."""
    out[:] = invert_lower(F)
    return log_peak(F)


@jit
def _said(r, block, white, peak):
    """Logarithms (N,) of N(r; 0, F Fᵀ) of residuals r (k, N), by white = F⁻¹ and the peak of each block.

    -inf where there is no F, or no value: h has none where the guide looked, and nothing was proposed.
    """
    out = squares(white, r, block)
    for i in range(block.size):
        s = peak[block[i]] - 0.5 * out[i]
        out[i] = s if abs(s) < np.inf else -np.inf
    return out
