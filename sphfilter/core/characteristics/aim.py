"""Where the noise of paths goes: to where they find the density.

Where paths end is known to first order in their noise, and log p there to second: with its noise drawn around
that Gaussian's centre, with that Gaussian's spread, a Gaussian density and linear paths give the expectation
exactly, whatever the step.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import typeof, types

from .._addresses import Entry
from .._jit import BATCH_FUNCTION, VECTOR, jit
from ..field.field import FIELD
from ..limits import EDGE
from ..small_matrices import cholesky, invert_lower
from .noise_paths import NOISE, Begin, Span, along_at, displace, pushes, unblurred


class Aim(NamedTuple):
    """Noise of a path back given where it starts: exact for Gaussian densities, linear paths."""

    B: np.ndarray  # (n, K) response of a path's end to its noise, in units of the lattice
    root: np.ndarray  # (N, K, K) lower; its transpose times standard normals has the Gaussian's spread
    log_det: np.ndarray  # (N,)


@jit
def aimed(drift, noise, field, y, t1, h, parts):
    """The `Aim` of paths back from t1, by the node whose polynomial they end in.

    y: (n,) state around which the response of the paths' ends to their noise is measured.
    """
    return rooted(response(drift, noise, field, y, t1, h, parts, 1), field.tail)


@jit
def leg_ends(drift, noise, Y, t1, h, parts, legs, w):
    """Ends (M, n) of paths back from states Y (M, n), in legs of like length, with noise w (M, K).

    The noise of the first leg comes last: see `expectation.expected`.
    """
    M, n = Y.shape
    K = w.shape[1] // legs
    f, own, along, unasked = np.empty((M, n)), np.empty(K), along_at(noise.along), np.empty(0)
    push, start, end = pushes(noise, h / legs), Y.copy(), np.empty((M, n))
    pull = unblurred(M, push.shape[1])
    for leg in range(legs):
        t, first = t1 - leg * h / legs, (legs - 1 - leg) * K
        for i in range(M):
            for k in range(K):
                own[k] = w[i, first + k]
            displace(push, own, pull, i)
        drift(start, t, noise.p, f)
        along(drift, drift, noise, Begin(start, f, f), Span(t, -h / legs, parts), pull, end, unasked)
        for i in range(M):
            for a in range(n):
                start[i, a] = end[i, a]
    return end


@jit
def response(drift, noise, field, y, t1, h, parts, legs):
    """B (n, K): what one standard deviation of each noise does to the end of a path back from y, in units of
    the lattice.
    """
    n, K = field.mu.size, 2 * noise.G.shape[1] * legs
    Y, w = np.empty((2 * K, n)), np.zeros((2 * K, K))
    for k in range(2 * K):
        w[k, k // 2] = 1.0 if k % 2 else -1.0
        for a in range(n):
            Y[k, a] = y[a]
    end = leg_ends(drift, noise, Y, t1, h, parts, legs, w)
    B = np.zeros((n, K))
    for a in range(n):
        for k in range(K):
            for c in range(n):
                B[a, k] += field.inverse[a, c] * 0.5 * (end[2 * k + 1, c] - end[2 * k, c])
    return B


@jit
def rooted(B, tail):
    """The `Aim` of a response and second derivatives (N, n, n) of log p where paths end."""
    N, (n, K) = tail.shape[0], B.shape
    root, log_det = np.zeros((N, K, K)), np.zeros(N)
    R, HB, precision = np.empty((K, K)), np.empty((n, K)), np.empty((K, K))
    for i in range(N):
        if tail[i, 0, 0] == 0.0:  # no complete node: its polynomial is never used
            continue
        for a in range(n):
            for k in range(K):
                HB[a, k] = 0.0
                for c in range(n):
                    HB[a, k] += tail[i, a, c] * B[c, k]
        for k in range(K):
            for j in range(K):
                v = 1.0 if j == k else 0.0
                for a in range(n):
                    v -= B[a, j] * HB[a, k]
                precision[j, k] = v
        cholesky(precision, R)
        inverse = invert_lower(R)
        for k in range(K):
            for j in range(k + 1):
                root[i, k, j] = inverse[k, j]
        for k in range(K):
            log_det[i] -= math.log(R[k, k])
    return Aim(B, root, log_det)


@jit
def centred(aim, owner, slope):
    """The noise (M, K) that leads to where the density is, as far as a quadratic knows; at most `EDGE` away.

    owner, slope: (M,), (M, n), whose polynomial paths without noise end in, and the slope of log p there.
    """
    n, K = aim.B.shape
    centre, g, r = np.zeros((owner.size, K)), np.empty(K), np.empty(K)
    for i in range(owner.size):
        size = 0.0
        for k in range(K):
            g[k] = 0.0
            for a in range(n):
                g[k] += aim.B[a, k] * slope[i, a]
        for k in range(K):
            r[k] = 0.0
            for j in range(k + 1):
                r[k] += aim.root[owner[i], k, j] * g[j]
        for k in range(K):
            for j in range(k, K):
                centre[i, k] += aim.root[owner[i], j, k] * r[j]
            size += centre[i, k] ** 2
        if not size <= EDGE**2:
            for k in range(K):
                centre[i, k] = centre[i, k] * EDGE / math.sqrt(size) if math.isfinite(size) else 0.0
    return centre


#: Numba's type of an `Aim`, and `aimed` by its address.
AIM = typeof(Aim(np.empty((1, 1)), np.empty((1, 1, 1)), np.empty(1)))
AIMED = Entry(aimed, (BATCH_FUNCTION, NOISE, FIELD, VECTOR, types.float64, types.float64, types.int64))
