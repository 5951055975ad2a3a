"""Kernel sums in whitened coordinates, with smoothing lengths that follow the number of particles.

h_i = eta n_i^(-1/n) with n_i = sum_j W(r_ij, h_i): unlike lengths that follow the mass density, these
exist and converge on clouds where light and heavy particles have mixed. The volume of a particle is
1/n_i = (h_i/eta)^n, so that m_i n_i is its density.
"""

import math

import numpy as np

from ._jit import jit
from .kernels import GAUSSIAN, RADIUS, shape, slope

__all__ = [
    "cholesky",
    "density_sums",
    "pair_lists",
    "solve_lengths",
    "transform",
    "whiten",
]


@jit
def cholesky(C, L, inverse):
    """Lower factor L of C and its inverse; False where C is not positive definite to rounding."""
    n = C.shape[0]
    L[:] = 0.0
    inverse[:] = 0.0
    for a in range(n):
        for b in range(a + 1):
            s = C[a, b]
            for c in range(b):
                s -= L[a, c] * L[b, c]
            if a > b:
                L[a, b] = s / L[b, b]
            elif s > 1e-14 * C[a, a]:
                L[a, a] = math.sqrt(s)
            else:
                return False
        inverse[a, a] = 1.0 / L[a, a]
        for b in range(a):
            s = 0.0
            for c in range(b, a):
                s -= L[a, c] * inverse[c, b]
            inverse[a, b] = s / L[a, a]
    return True


@jit
def transform(x, centre, inverse, z):
    """z = L^-1 (x - centre) for each row of x."""
    N, n = x.shape
    for i in range(N):
        for d in range(n):
            s = 0.0
            for c in range(d + 1):
                s += inverse[d, c] * (x[i, c] - centre[c])
            z[i, d] = s


@jit
def whiten(x, m, inverse, z):
    """z = L^-1 (x - mean), the mean being that of the particles where they are."""
    N, n = x.shape
    mean, total = np.zeros(n), 0.0
    for i in range(N):
        total += m[i]
        for d in range(n):
            mean[d] += m[i] * x[i, d]
    mean /= total
    transform(x, mean, inverse, z)


@jit
def density_sums(z, m, h, pairs, kernel, rho, grad, number):
    """Density, its gradient, and number density at the particles, with kernels of the pair's mean h.

    Parameters
    ----------
    z : ndarray, shape (N, n)
    m, h : ndarray, shape (N,)
    pairs : (order, start, neighbors)
        Every pair once, from `pair_lists`.
    kernel : (kind, C_n)
    rho, number : ndarray, shape (N,), written
    grad : ndarray, shape (N, n), written
    """
    order, start, neighbors = pairs
    kind, C = kernel
    N, n = z.shape
    K = RADIUS[kind]
    for i in range(N):
        number[i] = C * shape(kind, 0.0) / h[i] ** n
        rho[i] = m[i] * number[i]
        for d in range(n):
            grad[i, d] = 0.0
    for row in range(N):
        i = order[row]
        total, count = 0.0, 0.0
        for s in range(start[row], start[row + 1]):
            j = neighbors[s]
            if n == 2:  # written out: loops over two axes cost more than what they do
                u0, u1 = z[i, 0] - z[j, 0], z[i, 1] - z[j, 1]
                r2 = u0 * u0 + u1 * u1
            else:
                r2 = 0.0
                for d in range(n):
                    r2 += (z[i, d] - z[j, d]) ** 2
            W, pull = _pair(kind, C, n, r2, 0.5 * K * (h[i] + h[j]), K)
            if W == 0.0:
                continue
            total += m[j] * W
            count += W
            rho[j] += m[i] * W
            number[j] += W
            if n == 2:
                grad[i, 0] += m[j] * pull * u0
                grad[i, 1] += m[j] * pull * u1
                grad[j, 0] -= m[i] * pull * u0
                grad[j, 1] -= m[i] * pull * u1
            else:
                for d in range(n):
                    step = pull * (z[i, d] - z[j, d])
                    grad[i, d] += m[j] * step
                    grad[j, d] -= m[i] * step
        rho[i] += total
        number[i] += count


@jit
def _pair(kind, C, n, r2, reach, K):
    """Kernel W and pull, with pull (z_i - z_j) its gradient, of a pair whose mean support is `reach`."""
    if r2 >= reach * reach:
        return 0.0, 0.0
    inv = K / reach
    q = math.sqrt(r2) * inv
    a = C
    for _ in range(n):
        a *= inv
    W = a * shape(kind, q)
    # the slope of the Gaussian is minus twice its value: half as many exponentials
    return W, inv * inv * (-2.0 * W if kind == GAUSSIAN else a * slope(kind, q))


@jit
def _squares(y, s, last, gap2):
    """Squared distances of the points y[:, s+1:last] from y[:, s]; slices let the loops be vectorised."""
    along = y[0, s + 1 : last]
    for c in range(gap2.size):
        gap2[c] = (along[c] - y[0, s]) ** 2
    for d in range(1, y.shape[0]):
        along = y[d, s + 1 : last]
        for c in range(gap2.size):
            gap2[c] += (along[c] - y[d, s]) ** 2


@jit
def pair_lists(z, reach):
    """Every pair closer than the larger reach of the two, once; by sorting and sweeping along the first axis.

    Returns (order, start, neighbors): row s holds partners of particle ``order[s]``; and the nearest
    neighbour of each particle.
    """
    N, n = z.shape
    order = np.argsort(z[:, 0])
    y, R2 = np.empty((n, N)), np.empty(N)
    for s in range(N):
        R2[s] = reach[order[s]] ** 2
        for d in range(n):
            y[d, s] = z[order[s], d]
    widest, last = reach.max(), 0
    start, pairs, n_pairs = np.zeros(N + 1, np.int64), np.empty(32 * N, np.int32), 0
    nearest, best, r2 = np.arange(N), np.full(N, np.inf), np.empty(N)
    for s in range(N):
        last = max(last, s + 1)
        while last < N and y[0, last] - y[0, s] < widest:
            last += 1
        gap2, partner = r2[s + 1 : last], R2[s + 1 : last]
        _squares(y, s, last, gap2)
        if n_pairs + last - s > pairs.size:
            more = np.empty(2 * pairs.size + N, np.int32)
            more[:n_pairs] = pairs[:n_pairs]
            pairs = more
        first = n_pairs
        for c in range(gap2.size):
            pairs[n_pairs] = s + 1 + c  # the count is advanced only for a pair: no branch to mispredict
            n_pairs += gap2[c] < max(R2[s], partner[c])
        for k in range(first, n_pairs):
            c = pairs[k]
            pairs[k] = order[c]
            if r2[c] < best[s]:
                best[s], nearest[order[s]] = r2[c], order[c]
            if r2[c] < best[c]:
                best[c], nearest[order[c]] = r2[c], order[s]
        start[s + 1] = n_pairs
    return (order, start, pairs[:n_pairs].copy()), nearest


@jit
def _own_sums(z, h, pairs, kernel, total, steep):
    """sum_j W1(r_ij / h_i) with each particle's own h, and its derivative in log h_i."""
    order, start, neighbors = pairs
    kind = kernel[0]
    N, n = z.shape
    total[:] = shape(kind, 0.0)
    steep[:] = 0.0
    for row in range(N):
        i = order[row]
        for s in range(start[row], start[row + 1]):
            j = neighbors[s]
            r2 = 0.0
            for d in range(n):
                r2 += (z[i, d] - z[j, d]) ** 2
            r = math.sqrt(r2)
            q_i, q_j = r / h[i], r / h[j]
            total[i] += shape(kind, q_i)
            total[j] += shape(kind, q_j)
            steep[i] -= q_i * q_i * slope(kind, q_i)
            steep[j] -= q_j * q_j * slope(kind, q_j)


@jit
def solve_lengths(z, h, eta, pairs, reach, kernel, tolerance):
    """Newton's method for C_n sum_j W1(r_ij / h_i) = eta^n in log h, for all particles; h changes in place.

    The sum grows with h. Returns the number of particles whose length wants to pass what the lists cover,
    `reach` (N,) over K: they are left at that length.
    """
    N, n = z.shape
    K, target = RADIUS[kernel[0]], n * math.log(eta) - math.log(kernel[1])
    low, high, total, steep = np.zeros(N), reach / K, np.empty(N), np.empty(N)
    for i in range(N):
        h[i] = min(h[i], high[i])
    for _ in range(60):
        _own_sums(z, h, pairs, kernel, total, steep)
        blind, unsettled = 0, 0
        for i in range(N):
            gap = target - math.log(total[i])
            if gap > 0.0 and h[i] >= reach[i] / K:
                blind += 1
                continue
            if abs(gap) < tolerance * n:
                continue
            unsettled += 1
            if gap > 0.0:
                low[i] = h[i]
            else:
                high[i] = h[i]
            new = h[i] * math.exp(min(max(gap / max(steep[i] / total[i], 0.2 * n), -0.7), 0.7))
            if not low[i] < new < high[i]:
                new = 0.5 * (low[i] + high[i]) if high[i] < reach[i] / K or gap < 0.0 else high[i]
            h[i] = new
        if unsettled == 0:
            break
    return blind
