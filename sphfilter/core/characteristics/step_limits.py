"""What a step of the log-density scheme may not exceed, measured on the density's own nodes."""

import math

import numpy as np

from .._jit import jit
from ..field.walls import fold
from ..small_matrices import moments, whiten
from .noise_paths import Span, along_at, averaged, displace, pushes, unblurred


@jit
def noise_limit(G, L):
    """Largest eigenvalue, bounded by the trace, of L^-1 G G^T L^-T: variance per second, in the density's."""
    total, v = 0.0, np.empty(L.shape[0])
    for k in range(G.shape[1]):
        for a in range(v.size):
            v[a] = G[a, k]
        whiten(L, v)
        for a in range(v.size):
            total += v[a] * v[a]
    return total


@jit
def blur_share(drift, noise, begin, m, span, L):
    """What averaging the drift over the bridge that a path leaves of the noise does to the path's end: rms
    over the mass, in standard deviations, all noises together.
    """
    (x, f, _), (t, h, _) = begin, span
    N, n = x.shape
    g, mean, other, v, total = np.empty((N, n)), np.empty((N, n)), np.empty((N, n)), np.empty(n), 0.0
    for k in range(noise.G.shape[1]):
        for i in range(N):
            for a in range(n):
                g[i, a] = noise.G[a, k]
        averaged(drift, x, t, noise.p, g, 0.25 * math.sqrt(h), other, mean)  # the bridge's at mid-step
        for i in range(N):
            for a in range(n):
                v[a] = h * (mean[i, a] - f[i, a])
            whiten(L, v)
            for a in range(n):
                total += m[i] * v[a] * v[a]
    return math.sqrt(total)


@jit
def path_error(once, twice, m, L):
    """Mass-weighted rms distance of two results, in standard deviations; infinite if any is not finite."""
    total, v = 0.0, np.empty(L.shape[0])
    for i in range(m.size):
        for a in range(v.size):
            v[a] = once[i, a] - twice[i, a]
        whiten(L, v)
        for a in range(v.size):
            total += m[i] * v[a] * v[a]
    return math.sqrt(total) if math.isfinite(total) else np.inf


@jit
def driven_ends(drift, noise, begin, span):
    """Ends (N, n) of paths that noise, which depends on the state, drives to one side or the other.

    Of so many parts, and of twice as many, for `path_error`.
    """
    shape, push, w = begin.x.shape, pushes(noise, span.h), np.empty(2 * noise.G.shape[1])
    pull, once, twice = unblurred(shape[0], push.shape[1]), np.empty(shape), np.empty(shape)
    for i in range(shape[0]):
        for k in range(w.size):
            w[k] = math.sqrt(3.0) if (i >> k) % 2 else -math.sqrt(3.0)
        displace(push, w, pull, i)
    once_and_twice(drift, noise, begin, span, pull, (once, twice))
    return once, twice


@jit
def once_and_twice(drift, noise, begin, span, pull, ends):
    """Fill ends (N, n) of paths of so many parts, and of twice as many."""
    along, unasked = along_at(noise.along), np.empty(0)
    along(drift, drift, noise, begin, span, pull, ends[0], unasked)
    along(drift, drift, noise, begin, Span(span.t, span.h, 2 * span.parts), pull, ends[1], unasked)


@jit
def predicted(drift, noise, begin, ahead, m, span):
    """Mean and covariance after a step: of the cloud undisturbed, and pushed to and fro by every noise.

    Straight pushes and bent ones: their covariance with each other is what keeps a thin density from being
    taken for a still thinner one. Nodes that begin with masses m go `ahead` without noise.
    """
    N, n = ahead.shape
    mean, cov = np.empty(n), np.empty((n, n))
    n_pushes = 4 * noise.G.shape[1]
    width = max(3.0, 0.5 * n_pushes)
    share = 0.5 / width
    X, M = np.empty(((n_pushes + 1) * N, n)), np.empty((n_pushes + 1) * N)
    for i in range(N):
        M[i] = m[i] * (1.0 - n_pushes * share)
        for a in range(n):
            X[i, a] = ahead[i, a]
    pushed, w = pushes(noise, span.h), np.zeros(2 * noise.G.shape[1])
    pull, along, unasked = unblurred(N, pushed.shape[1]), along_at(noise.along), np.empty(0)
    for push in range(n_pushes):
        w[push // 2] = (1.0 if push % 2 else -1.0) * math.sqrt(width)
        for i in range(N):
            displace(pushed, w, pull, i)
        w[push // 2] = 0.0
        first = (push + 1) * N
        along(drift, drift, noise, begin, span, pull, X[first : first + N], unasked)
        for i in range(N):
            M[first + i] = m[i] * share
    fold(noise.low, noise.high, X)
    moments(X, M, mean, cov)
    return mean, cov
