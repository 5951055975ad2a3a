"""Kernel sums: density and its gradient at the particles, and density at arbitrary points.

At the particles the pair-averaged kernel is used (002 (15)), at arbitrary points each particle's own
smoothing length (002 (16): it conserves mass). Every sum is a gather, so that row i is written by one
thread alone and in list order.
"""

import math

import numpy as np
from numba import prange

from .._addresses import Entry
from .._jit import jit, parallel_jit
from ..domain import refresh
from .kernels import GAUSSIAN, RADIUS, shape, slope
from .neighbors import query
from .state import CLOUD, NEAR, OPTIONS, WORK


def _density_and_gradient(x, m, h, lists, kernel, rho, grad, r):
    """Summation density 002 (19) and gradient (20) with the averaged kernel (15).

    The last G of the particles x (N + G, n), m and h (N + G,) are images, which count as neighbours only;
    `lists` are (start, neighbors), and `kernel` is (kind, C_n). Written are rho (N,), grad (N, n), and a
    distance r for each entry of the neighbour lists.
    """
    start, neighbors = lists
    kind, C = kernel
    N, n = grad.shape
    K = RADIUS[kind]
    inv = 1.0 / h
    a = 0.5 * C * inv**n
    for i in prange(N):
        total = 2.0 * m[i] * a[i] * shape(kind, 0.0)
        for d in range(n):
            grad[i, d] = 0.0
        for s in range(start[i], start[i + 1]):
            j = neighbors[s]
            if n == 2:  # written out: loops over two axes cost more than what they do
                u0, u1 = x[i, 0] - x[j, 0], x[i, 1] - x[j, 1]
                r2 = u0 * u0 + u1 * u1
            else:
                r2 = 0.0
                for d in range(n):
                    r2 += (x[i, d] - x[j, d]) ** 2
            r_ij = math.sqrt(r2)
            r[s] = r_ij
            if r_ij >= K * max(h[i], h[j]):
                continue
            q_i, q_j = r_ij * inv[i], r_ij * inv[j]
            W_i, W_j = shape(kind, q_i), shape(kind, q_j)
            total += m[j] * (a[i] * W_i + a[j] * W_j)
            if kind == GAUSSIAN:  # its slope is minus twice its value: half as many exponentials
                pull = -2.0 * (a[i] * inv[i] ** 2 * W_i + a[j] * inv[j] ** 2 * W_j)
            else:
                pull = a[i] * inv[i] ** 2 * slope(kind, q_i) + a[j] * inv[j] ** 2 * slope(kind, q_j)
            pull *= m[j]
            if n == 2:
                grad[i, 0] += pull * u0
                grad[i, 1] += pull * u1
            else:
                for d in range(n):
                    grad[i, d] += pull * (x[i, d] - x[j, d])
        rho[i] = total


density_and_gradient = jit(_density_and_gradient)
density_and_gradient_parallel = parallel_jit(_density_and_gradient)


@jit
def update_density(cloud, near, work, options):
    """Bring densities and their gradients to where the particles of a march are now."""
    seen, kernel = near.seen, (options.kernel, options.normalisation)
    refresh(seen, cloud.x, cloud.h)
    if options.parallel:
        density_and_gradient_parallel(
            seen.x, seen.m, seen.h, near.lists, kernel, cloud.rho, work.grad, near.r
        )
    else:
        density_and_gradient(seen.x, seen.m, seen.h, near.lists, kernel, cloud.rho, work.grad, near.r)


#: `update_density` by its address.
DENSITY = Entry(update_density, (CLOUD, NEAR, WORK, OPTIONS))


@jit
def own_density(i, m, h_i, lists, r, kernel, n):
    """Density at particle i with the kernels of its own h, and its derivative in h (000 (117), mended)."""
    start, neighbors = lists
    kind, C = kernel
    a = C / h_i**n
    rho, slope_h = m[i] * a * shape(kind, 0.0), -n / h_i * m[i] * a * shape(kind, 0.0)
    for s in range(start[i], start[i + 1]):
        q = r[s] / h_i
        if q < RADIUS[kind]:
            W = a * shape(kind, q)
            rho += m[neighbors[s]] * W
            slope_h -= m[neighbors[s]] * (n * W + a * q * q * slope(kind, q)) / h_i
    return rho, slope_h


def _sample_density(y, x, m, h, index, kernel, out):
    """Density at the points y (M, n), each particle with its own h (002 (16)): it conserves mass."""
    kind, C = kernel
    n = x.shape[1]
    reach = RADIUS[kind] * h.max()
    for k in prange(y.shape[0]):
        found, r2 = np.empty(x.shape[0], np.int64), np.empty(x.shape[0])
        total = 0.0
        for s in range(query(index, x, y, k, reach, found, r2)):
            j = found[s]
            total += m[j] * C / h[j] ** n * shape(kind, math.sqrt(r2[s]) / h[j])
        out[k] = total


sample_density = jit(_sample_density)
sample_density_parallel = parallel_jit(_sample_density)


@jit
def sample_gradient(y, x, m, h, index, kernel, out):
    """Gradient (M, n) of `sample_density` at the points y (M, n)."""
    kind, C = kernel
    n = x.shape[1]
    reach = RADIUS[kind] * h.max()
    found, r2 = np.empty(x.shape[0], np.int64), np.empty(x.shape[0])
    out[:] = 0.0
    for k in range(y.shape[0]):
        for s in range(query(index, x, y, k, reach, found, r2)):
            j = found[s]
            pull = m[j] * C / h[j] ** (n + 2) * slope(kind, math.sqrt(r2[s]) / h[j])
            for d in range(n):
                out[k, d] += pull * (y[k, d] - x[j, d])


@jit
def deposit(origin, spacing, dims, x, m, h, kernel, out):
    """Density 002 (16) at every node of a lattice; no search, each particle visits the nodes it reaches.

    `out` is flat, the last axis runs fastest; `origin` (n,) is node zero, `spacing` (n,), `dims` (n,).
    """
    kind, C = kernel
    N, n = x.shape
    first, last, at = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
    out[:] = 0.0
    for j in range(N):
        reach = RADIUS[kind] * h[j]
        empty = False
        for d in range(n):
            u = (x[j, d] - origin[d]) / spacing[d]
            first[d] = int(max(math.ceil(u - reach / spacing[d]), 0.0))
            last[d] = int(min(math.floor(u + reach / spacing[d]), dims[d] - 1.0))
            at[d] = first[d]
            empty = empty or first[d] > last[d]
        weight = m[j] * C / h[j] ** n
        while not empty:
            node, r2 = 0, 0.0
            for d in range(n):
                node = node * dims[d] + at[d]
                r2 += (origin[d] + at[d] * spacing[d] - x[j, d]) ** 2
            out[node] += weight * shape(kind, math.sqrt(r2) / h[j])
            d = n - 1
            while d >= 0 and at[d] == last[d]:
                at[d] = first[d]
                d -= 1
            empty = d < 0
            if d >= 0:
                at[d] += 1
