"""Kernel sums in whitened coordinates, with smoothing lengths that follow the number of particles.

h_i = eta n_i^(-1/n) with n_i = sum_j W(r_ij, h_i): unlike lengths that follow the mass density, these
exist and converge on clouds where light and heavy particles have mixed. The volume of a particle is
1/n_i = (h_i/eta)^n, so that m_i n_i is its density.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import prange

from .._jit import jit, parallel_jit
from ..sph.kernels import GAUSSIAN, RADIUS, shape, slope
from .blocks import BLOCKS, PARALLEL_FROM, add_parts, even_pairs

__all__ = [
    "Sums",
    "density_sums",
    "solve_lengths",
    "transform",
    "whiten",
]


class Sums(NamedTuple):
    """Kernel sums at the particles."""

    rho: np.ndarray  # (N,) density
    grad: np.ndarray  # (N, n) its gradient
    number: np.ndarray  # (N,) number density


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
    for d in range(n):
        mean[d] /= total
    transform(x, mean, inverse, z)


@jit
def density_sums(z, m, h, pairs, kernel, sums):
    """Density, its gradient, and number density at the particles, with kernels of the pair's mean h.

    Parameters
    ----------
    z : ndarray, shape (N, n)
    m, h : ndarray, shape (N,)
    pairs : (order, start, neighbors)
        Every pair once, from `pairs.pair_lists`.
    kernel : (kind, C_n)
    sums : Sums, written
    """
    N, n = z.shape
    rho, grad, number = sums
    W0 = kernel[1] * shape(kernel[0], 0.0)
    for i in range(N):
        number[i] = W0 / h[i] ** n
        rho[i] = m[i] * number[i]
        for d in range(n):
            grad[i, d] = 0.0
    if N < PARALLEL_FROM:
        _add_rows(z, m, h, pairs, kernel, (0, N), sums)
        return
    parts = Sums(np.empty((BLOCKS, N)), np.empty((BLOCKS, N, n)), np.empty((BLOCKS, N)))
    _add_blocks(z, m, h, pairs, kernel, even_pairs(pairs[1]), parts)
    add_parts(parts.rho, rho)
    add_parts(parts.grad, grad)
    add_parts(parts.number, number)


@jit
def _add_rows(z, m, h, pairs, kernel, rows, sums):
    """Add what the pairs of some rows give to both of their particles."""
    (order, start, neighbors), (rho, grad, number) = pairs, sums
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
def _add_blocks(z, m, h, pairs, kernel, edges, parts):
    """As `_add_rows` for blocks of rows, each into sums of its own; spread over threads."""
    for b in prange(edges.size - 1):
        rho, grad, number = parts.rho[b], parts.grad[b], parts.number[b]
        rho[:] = 0.0
        grad[:] = 0.0
        number[:] = 0.0
        _add_rows(z, m, h, pairs, kernel, (edges[b], edges[b + 1]), Sums(rho, grad, number))


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
    parts = np.empty((BLOCKS, N)), np.empty((BLOCKS, N))
    _own_blocks(z, h, pairs, kind, even_pairs(pairs[1]), *parts)
    add_parts(parts[0], total)
    add_parts(parts[1], steep)


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
def _own_blocks(z, h, pairs, kind, edges, total, steep):
    """As `_own_rows` for blocks of rows, each into sums of its own; spread over threads."""
    for b in prange(edges.size - 1):
        total[b] = 0.0
        steep[b] = 0.0
        _own_rows(z, h, pairs, kind, (edges[b], edges[b + 1]), total[b], steep[b])


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
