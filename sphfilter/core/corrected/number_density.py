"""Kernel sums in whitened coordinates, with smoothing lengths that follow the number of particles.

h_i = eta n_i^(-1/n) with n_i = sum_j W(r_ij, h_i): unlike lengths that follow the mass density, these
exist and converge on clouds where light and heavy particles have mixed. The volume of a particle is
1/n_i = (h_i/eta)^n, so that m_i n_i is its density.
"""

import math

import numpy as np
from numba import prange

from .._jit import jit, parallel_jit
from ..sph.kernels import GAUSSIAN, RADIUS, shape, slope
from .blocks import BLOCKS, PARALLEL_FROM, even_pairs

__all__ = [
    "cholesky",
    "density_sums",
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
        Every pair once, from `pairs.pair_lists`.
    kernel : (kind, C_n)
    rho, number : ndarray, shape (N,), written
    grad : ndarray, shape (N, n), written
    """
    N, n = z.shape
    W0 = kernel[1] * shape(kernel[0], 0.0)
    for i in range(N):
        number[i] = W0 / h[i] ** n
        rho[i] = m[i] * number[i]
        for d in range(n):
            grad[i, d] = 0.0
    if N < PARALLEL_FROM:
        _add_rows(z, m, h, pairs, kernel, (0, N), rho, grad, number)
        return
    edges, (order, start, neighbors) = even_pairs(pairs[1]), pairs
    parts = np.empty((BLOCKS, N)), np.empty((BLOCKS, N, n)), np.empty((BLOCKS, N))
    _add_blocks(z, m, h, order, start, neighbors, kernel[0], kernel[1], edges, *parts)
    for b in range(BLOCKS):
        rho += parts[0][b]
        grad += parts[1][b]
        number += parts[2][b]


@jit
def _add_rows(z, m, h, pairs, kernel, rows, rho, grad, number):
    """Add what the pairs of some rows give to both of their particles."""
    order, start, neighbors = pairs
    kind, C = kernel
    n, K = z.shape[1], RADIUS[kind]
    for row in range(rows[0], rows[1]):
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


@parallel_jit
def _add_blocks(z, m, h, order, start, neighbors, kind, C, edges, rho, grad, number):
    """As `_add_rows` for blocks of rows, each into sums of its own; spread over threads."""
    for b in prange(edges.size - 1):
        rho[b] = 0.0
        grad[b] = 0.0
        number[b] = 0.0
        pairs, rows = (order, start, neighbors), (edges[b], edges[b + 1])
        _add_rows(z, m, h, pairs, (kind, C), rows, rho[b], grad[b], number[b])


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
def _own_sums(z, h, pairs, kind, total, steep):
    """sum_j W1(r_ij / h_i) with each particle's own h, and its derivative in log h_i."""
    N = h.size
    total[:] = shape(kind, 0.0)
    steep[:] = 0.0
    if N < PARALLEL_FROM:
        _own_rows(z, h, pairs, kind, (0, N), total, steep)
        return
    edges, (order, start, neighbors) = even_pairs(pairs[1]), pairs
    parts = np.empty((BLOCKS, N)), np.empty((BLOCKS, N))
    _own_blocks(z, h, order, start, neighbors, kind, edges, *parts)
    for b in range(BLOCKS):
        total += parts[0][b]
        steep += parts[1][b]


@jit
def _own_rows(z, h, pairs, kind, rows, total, steep):
    """Add what the pairs of some rows give to both of their particles."""
    order, start, neighbors = pairs
    for row in range(rows[0], rows[1]):
        i = order[row]
        for s in range(start[row], start[row + 1]):
            j = neighbors[s]
            r2 = 0.0
            for d in range(z.shape[1]):
                r2 += (z[i, d] - z[j, d]) ** 2
            r = math.sqrt(r2)
            q_i, q_j = r / h[i], r / h[j]
            total[i] += shape(kind, q_i)
            total[j] += shape(kind, q_j)
            steep[i] -= q_i * q_i * slope(kind, q_i)
            steep[j] -= q_j * q_j * slope(kind, q_j)


@parallel_jit
def _own_blocks(z, h, order, start, neighbors, kind, edges, total, steep):
    """As `_own_rows` for blocks of rows, each into sums of its own; spread over threads."""
    for b in prange(edges.size - 1):
        total[b] = 0.0
        steep[b] = 0.0
        pairs, rows = (order, start, neighbors), (edges[b], edges[b + 1])
        _own_rows(z, h, pairs, kind, rows, total[b], steep[b])


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
        _own_sums(z, h, pairs, kernel[0], total, steep)
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
