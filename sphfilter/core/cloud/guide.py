"""A reading before its time: ancestors chosen, and their noise led, as the linearised flow says.

Letters: y (n, N) ends of the first pass, u (n, N) what moved them, r (k, N) residuals z - h(y - L u) of
points without their noise, HL (blocks, k, n), R the covariance of the reading, with what linearity misses.
"""

import math

import numpy as np

from .._jit import jit
from .._views import stretch
from ..elementary import FAST
from ..limits import LARGEST_EXPONENT, LOG_2_PI
from ..small_matrices import cholesky, invert_lower, whiten
from .linearise import end_of_block
from .noise import even_normals, uniform
from .weights import summed, systematic, taken, white_squares

#: Neighbours to either side, that tell what the flow is without noise.
NEAR = 2


@jit
def without_noise(y, x, u, L, Phi, block):
    """Where each point (n, N) would go without the noise that moves the end, as its neighbours tell.

    What its own noise did must not tell it: the proposal's density at a point would depend on the draw that
    it is to weigh, and the evidence would be wrong however many points there are.
    """
    (n, N), first = y.shape, 0
    rest, out = np.empty(N), np.empty((n, N))
    while first < N:
        b, size = block[first], end_of_block(block, first) - first
        for a in range(n):
            own, end = stretch(out, a, first, size), stretch(y, a, first, size)
            for i in range(size):
                own[i], rest[i] = 0.0, end[i]
            for e in range(n):
                on, drawn = Phi[b, a, e], L[b, a, e]
                begun, given = stretch(x, e, first, size), stretch(u, e, first, size)
                for i in range(size):
                    flowed = on * begun[i]
                    own[i] += flowed
                    rest[i] -= drawn * given[i] + flowed
            _add_of_neighbours(rest, own)
        first += size
    return out


@jit
def _add_of_neighbours(rest, out):
    """Add to each of some numbers (K,) the mean of its neighbours' rests (K or more,)."""
    K = out.size
    inside = max(K - 2 * NEAR, 0)
    for i in range(inside):
        s = -rest[i + NEAR]
        for k in range(2 * NEAR + 1):
            s += rest[i + k]
        out[i + NEAR] += s / (2 * NEAR)
    for j in range(K - inside):  # at both ends
        i = j if j < NEAR else inside + j
        low, high = max(i - NEAR, 0), min(i + NEAR + 1, K)
        s = -rest[i]
        for k in range(low, high):
            s += rest[k]
        out[i] += s / max(high - low - 1, 1)


@jit
def along_rows(V, block, U):
    """What moves the end of each point, V u (n, N), of all that moves it, U (d, N)."""
    (d, N), n, first = U.shape, V.shape[1], 0
    out = np.zeros((n, N))
    while first < N:
        b, size = block[first], end_of_block(block, first) - first
        for a in range(n):
            own = stretch(out, a, first, size)
            for k in range(d):
                v, given = V[b, a, k], stretch(U, k, first, size)
                for i in range(size):
                    own[i] += v * given[i]
        first += size
    return out


@jit
def spread(V, block, u, U):
    """Change what moves each point, U (d, N), in place, by as little as makes it u (n, N) for the end."""
    (d, N), n, first, missing = U.shape, V.shape[1], 0, np.empty(U.shape[1])
    while first < N:
        b, size = block[first], end_of_block(block, first) - first
        for a in range(n):
            wanted = stretch(u, a, first, size)
            for i in range(size):
                missing[i] = wanted[i]
            for k in range(d):
                v, own = V[b, a, k], stretch(U, k, first, size)
                for i in range(size):
                    missing[i] -= v * own[i]
            for k in range(d):
                v, own = V[b, a, k], stretch(U, k, first, size)
                for i in range(size):
                    own[i] += v * missing[i]
        first += size


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
    (nb, n, d), G = G.shape, G
    new, whole = np.empty((nb, n, n)), np.empty((nb, n, d + n))
    for b in range(nb):
        for a in range(n):
            for c in range(d):
                s = 0.0
                for e in range(n):
                    s += flow[b, a, e] * G[b, e, c]
                whole[b, a, c] = s
            for c in range(n):
                s = 0.0
                for e in range(n):
                    s += flow[b, a, e] * Phi[b, e, c]
                new[b, a, c], whole[b, a, d + c] = s, lower[b, a, c]
    return new, whole


@jit
def linear_reading(hy, x, u, w, block, start, Phi, L, H, R, angle, wider, misses):
    """What a reading sees of a way of points, linearised in blocks: HL (blocks, k, n), and the noise
    (blocks, k, k) that a guide takes.

    What linearity misses is half the mean square difference of neighbours' readings less their linear parts.
    Neighbours on the curve stand for the second derivatives of a block: what is the same for both cancels.
    The noise is `wider` times R and `misses` times what linearity misses; H and R are of one or all blocks,
    hy (k, N) are readings of the ends, and x, u, w, block of N points, start, Phi, L of blocks are a way's.
    """
    (k, N), n, nb = hy.shape, len(x), start.shape[0]
    HL, HPhi = np.zeros((nb, k, n)), np.zeros((nb, k, n))
    for b in range(nb):
        own = b if len(H) > 1 else 0
        for a in range(k):
            for e in range(n):
                for c in range(n):
                    HL[b, a, c] += H[own, a, e] * L[b, e, c]
                    HPhi[b, a, c] += H[own, a, e] * Phi[b, e, c]
    C, off, rest, total, first = np.zeros((k, k)), np.empty(k), hy.copy(), 0.0, 0
    while first < N:
        b, end = block[first], end_of_block(block, first)
        for a in range(k):
            own = stretch(rest, a, first, end - first)
            for e in range(n):
                on, drawn, about = HPhi[b, a, e], HL[b, a, e], start[b, e]
                begun, given = stretch(x, e, first, own.size), stretch(u, e, first, own.size)
                for i in range(own.size):
                    own[i] -= drawn * given[i] + on * (begun[i] - about)
        for i in range(first + 1, end):
            finite, v = True, 0.5 * (w[i] + w[i - 1])
            for a in range(k):
                off[a] = wrapped(rest[a, i] - rest[a, i - 1], angle[a])
                finite &= abs(off[a]) < np.inf
            total += v if finite else 0.0
            for a in range(k if finite else 0):
                for e in range(k):
                    C[a, e] += 0.5 * v * off[a] * off[e]
        first = end
    noise = np.empty((nb, k, k))
    for b in range(nb):
        own = b if len(R) > 1 else 0
        for a in range(k):
            for e in range(k):
                noise[b, a, e] = wider * R[own, a, e] + (misses * C[a, e] / total if total > 0.0 else 0.0)
    return HL, noise


@jit
def log_normals(z, h, angle, F):
    """Logarithms (N,) of N(z; h, F Fᵀ) at readings h (k, N), angles wrapped; and how many are NaN."""
    (k, N), wrong, peak, out = h.shape, 0, _log_peak(F), np.empty(h.shape[1])
    white_squares(invert_lower(F), residuals(z, h, angle), np.zeros(k), 0, out)
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
            r[a, i] = z[a] - h[a, i]
        for i in range(h.shape[1] if angle[a] else 0):
            r[a, i] = wrapped(r[a, i], True)
    return r


@jit
def _gain(HL, R, S, K, T):
    """Fill S = HL HLᵀ + R, K = HLᵀ S⁻¹ (n, k) and T with T Tᵀ = I - K HL; False where there is none."""
    k, n = HL.shape
    F, column, rest = np.empty((k, k)), np.empty(k), np.empty((n, n))
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
            column[a] = HL[a, c]
        whiten(F, column)
        for a in range(k - 1, -1, -1):
            s = column[a]
            for e in range(a + 1, k):
                s -= F[e, a] * K[c, e]
            K[c, a] = s / F[a, a]
    for a in range(n):
        for e in range(n):
            s = 1.0 if a == e else 0.0
            for c in range(k):
                s -= K[a, c] * HL[c, e]
            rest[a, e] = s
    return cholesky(rest, T)


@jit
def _log_peak(F):
    """Logarithm of N(0; 0, F Fᵀ), F (k, k) lower."""
    s = -0.5 * LOG_2_PI * len(F)
    for a in range(len(F)):
        s -= math.log(F[a, a])
    return s


@jit
def look_ahead(r, u, w, block, HL, R, net, key):
    """Choose ancestors of a reading, and what shall move their ends.

    Parameters
    ----------
    r, u, w, block : ndarray, shapes (k, N), (n, N), (N,), (N,)
    HL, R : ndarray, shapes (blocks, k, n), (blocks, k, k)
    net : ndarray, shape (n, count)
        Standard normals that are even along the curve, and are turned and shifted by the key.
    key : int

    Returns
    -------
    ancestor, new : ndarray, shapes (count,), (n, count)
        Numbers of points, in order, and their u; none where no block can be guided.
    log_ratio : ndarray, shape (N + count,)
        Logarithm of the proposal's density of (point, u) over the prior's: of the N of the first pass, then
        of the new ones.
    """
    (k, N), (n, count), blocks = r.shape, net.shape, HL.shape[0]
    z, cut = even_normals(net, key), uniform(key, np.uint64(0))
    K, T, S, L = np.zeros((blocks, n, k)), np.zeros((blocks, n, n)), np.empty((k, k)), np.empty((k, k))
    of_S, of_R, fine = np.zeros((blocks, k, k)), np.zeros((blocks, k, k)), np.zeros(blocks, np.bool_)
    peak_S, peak_R = np.empty(blocks), np.empty(blocks)
    for b in range(blocks):
        fine[b] = _gain(HL[b], R[b], S, K[b], T[b]) and cholesky(S, L)
        peak_S[b] = _inverse(L, of_S[b])
        fine[b] = fine[b] and cholesky(R[b], L)
        peak_R[b] = _inverse(L, of_R[b])
    a, top = _ahead(r, w, block, of_S, peak_S, fine)
    log_ratio, new = np.empty(N + count), np.zeros((n, count))
    if top == -np.inf:
        return np.empty(0, np.int64), new, log_ratio
    for i in range(N):
        a[i] = FAST.exp(a[i] - top)
    total = summed(a)
    ancestor, known = systematic(a, count, cut), top + math.log(total)
    _ratios(r, u, block, HL, of_R, peak_R, fine, known, log_ratio[:N])
    r, block, first = taken(r, ancestor), block[ancestor], 0
    while first < count:
        b, size = block[first], end_of_block(block, first) - first
        for c in range(n):
            own = stretch(new, c, first, size)
            for e in range(k):
                on, off = K[b, c, e], stretch(r, e, first, size)
                for i in range(size):
                    own[i] += on * off[i]
            for e in range(c + 1):
                on, given = T[b, c, e], stretch(z, e, first, size)
                for i in range(size):
                    own[i] += on * given[i]
        first += size
    _ratios(r, new, block, HL, of_R, peak_R, fine, known, log_ratio[N:])
    return ancestor, new, log_ratio


@jit
def _inverse(F, out):
    """Fill the inverse of a lower F (k, k); return the logarithm of N(0; 0, F Fᵀ)."""
    white = invert_lower(F)
    for a in range(len(F)):
        for e in range(len(F)):
            out[a, e] = white[a, e]
    return _log_peak(F)


@jit
def _ahead(r, w, block, white, peak, fine):
    """Logarithms (N,) of weights w times what a guide says of residuals r (k, N); and their largest."""
    N, top, before, log_w, first = w.size, -np.inf, 0.0, 0.0, 0
    a, zero = np.full(N, -np.inf), np.zeros(len(r))
    while first < N:
        b, end = block[first], end_of_block(block, first)
        if fine[b]:
            own = a[first:end]
            white_squares(white[b], r, zero, first, own)
            for i in range(own.size):
                heavy = w[first + i]
                if heavy != before and heavy > 0.0:  # most are the same
                    before, log_w = heavy, math.log(heavy)
                s = peak[b] - 0.5 * own[i] + log_w
                own[i] = s if heavy > 0.0 and abs(s) < np.inf else -np.inf
                top = max(top, own[i])
        first = end
    return a, top


@jit
def _ratios(r, u, block, HL, white, peak, fine, known, out):
    """Fill logarithms (M,) of the proposal's density over the prior's, of points of r (k, M) and u (n, M)."""
    (n, M), (k, _), first, rest = u.shape, r.shape, 0, r.copy()
    zero = np.zeros(k)
    while first < M:
        b, end = block[first], end_of_block(block, first)
        own = out[first:end]
        for c in range(k):
            left = stretch(rest, c, first, own.size)
            for e in range(n):
                on, given = HL[b, c, e], stretch(u, e, first, own.size)
                for i in range(own.size):
                    left[i] -= on * given[i]
        white_squares(white[b], rest, zero, first, own)
        for i in range(own.size):  # else it was never proposed: h has no value where the guide looked
            s = peak[b] - 0.5 * own[i] - known
            own[i] = s if fine[b] and abs(s) < np.inf else -np.inf
        first = end
