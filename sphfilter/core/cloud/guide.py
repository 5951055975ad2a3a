"""A reading before its time: ancestors chosen, and their noise led, as the linearised flow says.

Letters: y (N, n) ends of the first pass, u (N, n) what moved them, r (N, k) residuals z - h(y - L u) of
points without their noise, HL (blocks, k, n), R the covariance of the reading, with what linearity misses.
"""

import math

import numpy as np

from .._jit import jit
from ..elementary import FAST
from ..limits import LARGEST_EXPONENT, LOG_2_PI
from ..small_matrices import cholesky, invert_lower, white_square, whiten
from .linearise import end_of_block
from .noise import even_normals, uniform
from .weights import summed, systematic

#: Neighbours to either side, that tell what the flow is without noise.
NEAR = 2


@jit
def without_noise(y, x, u, L, Phi, block):
    """Where each point (N, n) would go without the noise that moves the end, as its neighbours tell.

    What its own noise did must not tell it: the proposal's density at a point would depend on the draw that
    it is to weigh, and the evidence would be wrong however many points there are.
    """
    N, n = y.shape
    rest, out, first = np.empty((N, n)), np.empty((N, n)), 0
    for i in range(N):
        b = block[i]
        for a in range(n):
            out[i, a], s = 0.0, y[i, a]
            for e in range(n):
                flowed = Phi[b, a, e] * x[i, e]
                out[i, a] += flowed
                s -= L[b, a, e] * u[i, e] + flowed
            rest[i, a] = s
    while first < N:
        b, end = block[first], end_of_block(block, first)
        for i in range(first, end):
            low, high = max(i - NEAR, first), min(i + NEAR + 1, end)
            share = 1.0 / max(high - low - 1, 1)
            for a in range(n):
                s = -rest[i, a]
                for k in range(low, high):
                    s += rest[k, a]
                out[i, a] += s * share
        first = end
    return out


@jit
def along_rows(V, block, U):
    """What moves the end of each point, V u (N, n), of all that moves it, U (N, d)."""
    N, d = U.shape
    n = V.shape[1]
    out = np.empty((N, n))
    for i in range(N):
        b = block[i]
        for a in range(n):
            s = 0.0
            for k in range(d):
                s += V[b, a, k] * U[i, k]
            out[i, a] = s
    return out


@jit
def spread(V, block, u, U):
    """Change what moves each point, U (N, d), in place, by as little as makes it u (N, n) for the end."""
    N, d = U.shape
    n = V.shape[1]
    for i in range(N):
        b = block[i]
        for a in range(n):
            s = u[i, a]
            for k in range(d):
                s -= V[b, a, k] * U[i, k]
            for k in range(d):
                U[i, k] += V[b, a, k] * s


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
    hy (N, k) are readings of the ends, and x, u, w, block of N points, start, Phi, L of blocks are a way's.
    """
    (N, k), n, nb = hy.shape, x.shape[1], start.shape[0]
    HL, HPhi = np.zeros((nb, k, n)), np.zeros((nb, k, n))
    for b in range(nb):
        own = b if len(H) > 1 else 0
        for a in range(k):
            for e in range(n):
                for c in range(n):
                    HL[b, a, c] += H[own, a, e] * L[b, e, c]
                    HPhi[b, a, c] += H[own, a, e] * Phi[b, e, c]
    C, before, now, total = np.zeros((k, k)), np.empty(k), np.empty(k), 0.0
    for i in range(N):
        b, finite = block[i], True
        follows = i > 0 and block[i - 1] == b
        for a in range(k):
            s = hy[i, a]
            for e in range(n):
                s -= HL[b, a, e] * u[i, e] + HPhi[b, a, e] * (x[i, e] - start[b, e])
            now[a] = s
            d = s - before[a]
            before[a] = wrapped(d, angle[a] and follows)
            finite &= abs(before[a]) < np.inf
        if follows and finite:
            v = 0.5 * (w[i] + w[i - 1])
            total += v
            for a in range(k):
                for e in range(k):
                    C[a, e] += 0.5 * v * before[a] * before[e]
        for a in range(k):
            before[a] = now[a]
    noise = np.empty((nb, k, k))
    for b in range(nb):
        own = b if len(R) > 1 else 0
        for a in range(k):
            for e in range(k):
                noise[b, a, e] = wider * R[own, a, e] + (misses * C[a, e] / total if total > 0.0 else 0.0)
    return HL, noise


@jit
def log_normals(z, h, angle, F):
    """Logarithms (N,) of N(z; h, F Fᵀ) at readings h (N, k), angles wrapped; and how many are NaN."""
    N, k = h.shape
    out, r, wrong, peak, white = np.empty(N), np.empty(k), 0, _log_peak(F), invert_lower(F)
    for i in range(N):
        for a in range(k):
            r[a] = wrapped(z[a] - h[i, a], angle[a])
        out[i] = peak - 0.5 * white_square(white, r)
        wrong += out[i] != out[i]
    return out, wrong


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
    r, u, w, block : ndarray, shapes (N, k), (N, n), (N,), (N,)
    HL, R : ndarray, shapes (blocks, k, n), (blocks, k, k)
    net : ndarray, shape (count, n)
        Standard normals that are even along the curve, and are turned and shifted by the key.
    key : int

    Returns
    -------
    ancestor, new : ndarray, shapes (count,), (count, n)
        Numbers of points, in order, and their u; none where no block can be guided.
    log_ratio : ndarray, shape (N + count,)
        Logarithm of the proposal's density of (point, u) over the prior's: of the N of the first pass, then
        of the new ones.
    """
    (N, k), (count, n), blocks = r.shape, net.shape, HL.shape[0]
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
    log_ratio, new = np.empty(N + count), np.empty((count, n))
    if top == -np.inf:
        return np.empty(0, np.int64), new, log_ratio
    for i in range(N):
        a[i] = FAST.exp(a[i] - top)
    total = summed(a)
    ancestor, known = systematic(a, count, cut), top + math.log(total)
    for j in range(count):
        i, b = ancestor[j], block[ancestor[j]]
        for c in range(n):
            s = 0.0
            for e in range(k):
                s += K[b, c, e] * r[i, e]
            for e in range(c + 1):
                s += T[b, c, e] * z[j, e]
            new[j, c] = s
    _ratios(r, u, block, np.arange(N), HL, of_R, peak_R, fine, known, log_ratio[:N])
    _ratios(r, new, block, ancestor, HL, of_R, peak_R, fine, known, log_ratio[N:])
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
    """Logarithms (N,) of weights w times what a guide says of residuals r (N, k); and their largest."""
    N, top, before, log_w, last = w.size, -np.inf, 0.0, 0.0, -1
    a, W = np.empty(N), white[0]
    for i in range(N):
        b = block[i]
        if b != last:
            last, W = b, white[b]
        a[i] = -np.inf
        if fine[b] and w[i] > 0.0:
            if w[i] != before:  # most are the same
                before, log_w = w[i], math.log(w[i])
            s = peak[b] - 0.5 * white_square(W, r[i]) + log_w
            a[i] = s if abs(s) < np.inf else -np.inf
            top = max(top, a[i])
    return a, top


@jit
def _ratios(r, u, block, ancestor, HL, white, peak, fine, known, out):
    """Fill logarithms (M,) of the proposal's density over the prior's, of points by number and their u."""
    (M, n), k, last = u.shape, r.shape[1], -1
    own, W, H = np.empty(k), white[0], HL[0]
    for j in range(M):
        i, b = ancestor[j], block[ancestor[j]]
        if b != last:
            last, W, H = b, white[b], HL[b]
        out[j] = -np.inf
        if fine[b]:
            for c in range(k):
                s = r[i, c]
                for e in range(n):
                    s -= H[c, e] * u[j, e]
                own[c] = s
            s = peak[b] - 0.5 * white_square(W, own) - known
            if abs(s) < np.inf:  # else it was never proposed: h has no value where the guide looked
                out[j] = s
