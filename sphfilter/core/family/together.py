"""Several families of one degree: frames that follow their products with something, and their sum."""

import math

import numpy as np

from .._jit import jit
from ..limits import TINY
from ..step_control import GROW, SHRINK
from .basis import values_at
from .frame import FAR, inverse, moments_of, moved, root_between, weigh


@jit
def nodes_of(xi, mu, A, x):
    """Nodes xi (N, n) in frames mu (K, n), A (K, n, n), into x (K, N, n)."""
    (K, n), N = mu.shape, xi.shape[0]
    for k in range(K):
        for i in range(N):
            for a in range(n):
                x[k, i, a] = mu[k, a]
                for b in range(n):
                    x[k, i, a] += A[k, a, b] * xi[i, b]


@jit
def own_logs(power, mu, A, c, own, x, bound, out):
    """Logarithms of families mu (K, n), A, c, of numbers own (J,), at states x (J, N, n), into out (J, N)."""
    J, N, n = x.shape
    back, xi = np.empty((n, n)), np.empty((N, n))
    for j in range(J):
        k = own[j]
        inverse(A[k], back)
        _in_frame(mu[k], back, x[j], xi)
        values_at(power, c[k], xi, bound, out[j])


@jit
def _in_frame(mu, back, x, xi):
    N, n = x.shape
    for i in range(N):
        for a in range(n):
            xi[i, a] = 0.0
            for b in range(n):
                xi[i, a] += back[a, b] * (x[i, b] - mu[b])


@jit
def log_sum(power, log_w, mu, A, c, x, bound, out):
    """Logarithm of the sum of families with logarithms of weights (K,) at states x (N, n), into out (N,)."""
    (K, n), N = mu.shape, x.shape[0]
    back, xi, one, top = np.empty((n, n)), np.empty((N, n)), np.empty(N), np.full(N, -np.inf)
    out[:] = 0.0
    for k in range(K):
        inverse(A[k], back)
        _in_frame(mu[k], back, x, xi)
        values_at(power, c[k], xi, bound, one)
        for i in range(N):
            value = one[i] + log_w[k]
            if value > top[i]:
                out[i] = out[i] * math.exp(top[i] - value) + 1.0
                top[i] = value
            elif value > -np.inf:
                out[i] += math.exp(value - top[i])
    for i in range(N):
        out[i] = top[i] + math.log(out[i]) if out[i] > 0.0 else -np.inf


@jit
def settled_round(basis, log_p, settled, mu, A, total, mean, cov, off):
    """Look at densities of logarithms log_p (K, N) at nodes of frames; move those that are not `settled`.

    Into `total` (K,) go the logarithms of their integrals, into `mean` (K, n) and `cov` (K, n, n) the moments
    in the frames as they were, and into `off` (K,) by how much these were off.
    """
    (K, n), w = mu.shape, np.empty(log_p.shape[1])
    back, root = np.empty((n, n)), np.empty((n, n))
    for k in range(K):
        total[k] = weigh(basis.log_w, n, log_p[k], w) + inverse(A[k], back)
        moments_of(basis.xi, w, mean[k], cov[k])
        off[k] = moved(mean[k], cov[k])
        if off[k] < settled or not off[k] < np.inf:
            continue
        root_between(cov[k], SHRINK, GROW, root)
        far = 0.0
        for a in range(n):
            far += mean[k, a] ** 2
        short = min(1.0, FAR / max(math.sqrt(far), TINY))
        before = A[k].copy()
        for a in range(n):
            for b in range(n):
                mu[k, a] += short * before[a, b] * mean[k, b]
                A[k, a, b] = 0.0
                for e in range(n):
                    A[k, a, b] += before[a, e] * root[e, b]
