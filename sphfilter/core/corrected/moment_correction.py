"""Polynomial correction of the diffusion velocity that makes the moment equations hold on the particles.

The exact u = -div D - D grad p / p satisfies E[q . u] = E[D : grad q] for every smooth vector field q
(integrate -q_c d_d(D_cd p) by parts). Kernel sums satisfy it up to their own error only. To each row of u a
polynomial of the whitened state is added that makes it hold for all polynomials q of the same degree, as
sums over particles: degree one makes the equations of mean and covariance exact.

The correction keeps to the range of a constant D by itself: D grad phi and u both lie in it.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import prange

from .._jit import jit, parallel_jit
from ..monomials import up_to
from .blocks import BLOCKS, PARALLEL_FROM, add_parts, even

__all__ = ["Diffusion", "Polynomials", "basis", "correct", "exponents", "keep_affine"]

#: Radius, in standard deviations, beyond which polynomials of degree two and more stay what they are there.
CLIP = 5.0
_RIDGE = 1e-10
_LEAST_PIVOT = 1e-8
_ROOT = np.sqrt(np.arange(8.0))
_INVERSE_ROOT = 1.0 / np.sqrt(np.maximum(np.arange(8.0), 1.0))


class Diffusion(NamedTuple):
    """Diffusion matrix, and the coordinates that the correction is made in."""

    D: np.ndarray  # (1, n n) or (N, n n), row-major, in the units of x
    rows: np.ndarray  # int, numbers of the rows of D that are not zero
    inverse: np.ndarray  # (n, n) L^-1 of z = L^-1 (x - mean)


class Polynomials(NamedTuple):
    """The functions that the moment equations are to hold for; the last two are written by `correct`."""

    powers: np.ndarray  # (q, n) exponents
    phi: np.ndarray  # (N, q) values at the particles
    A: np.ndarray  # (q, q) Cholesky factor of their normal matrix, lower half


def exponents(dim, degree):
    """Exponents (q, dim) of the monomials of total degree 0 .. degree, lower degrees first."""
    return np.array(sorted(up_to(degree, dim), key=lambda a: (sum(a), a[::-1])))


@jit
def _tables(z, i, scale, h):
    """Normalised Hermite polynomials h[0, d, k] = He_k / sqrt(k!) of scale z_i; h[1] their derivatives."""
    for d in range(z.shape[1]):
        a = scale * z[i, d]
        h[0, d, 0], h[0, d, 1], h[1, d, 0], h[1, d, 1] = 1.0, a, 0.0, 1.0
        for k in range(2, h.shape[2]):
            h[0, d, k] = (a * h[0, d, k - 1] - _ROOT[k - 1] * h[0, d, k - 2]) * _INVERSE_ROOT[k]
            h[1, d, k] = _ROOT[k] * h[0, d, k - 1]


@jit
def basis(z, i, powers, h, phi, dphi):
    """Hermite products phi (q,) at z_i and their gradients dphi (q, n) in z; h (2, n, degree + 1) is scratch.

    Beyond the radius `CLIP` products of degree two and more take their values on that sphere; a sphere,
    unlike a box, looks the same from all whitened coordinates.
    """
    q, n = powers.shape
    r2 = 0.0
    for d in range(n):
        r2 += z[i, d] * z[i, d]
    scale = min(1.0, CLIP / math.sqrt(max(r2, 1e-300)))
    _tables(z, i, scale, h)
    if n == 2:  # written out: loops over two axes cost more than what they do
        for k in range(q):
            a, b = powers[k, 0], powers[k, 1]
            phi[k] = h[0, 0, a] * h[0, 1, b]
            dphi[k, 0] = h[1, 0, a] * h[0, 1, b]
            dphi[k, 1] = h[0, 0, a] * h[1, 1, b]
    else:
        for k in range(q):
            product = 1.0
            for d in range(n):  # the products of all factors before each, then times those after it
                dphi[k, d] = product * h[1, d, powers[k, d]]
                product *= h[0, d, powers[k, d]]
            phi[k] = product
            after = 1.0
            for d in range(n - 1, -1, -1):
                dphi[k, d] *= after
                after *= h[0, d, powers[k, d]]
    if scale < 1.0:
        _project(z, i, r2, scale, powers, phi, dphi)


@jit
def _project(z, i, r2, scale, powers, phi, dphi):
    """Chain rule of the clipping; functions of degree one are not clipped."""
    q, n = powers.shape
    for k in range(1, q):
        if k <= n:
            phi[k] /= scale
            continue
        radial = 0.0
        for d in range(n):
            radial += dphi[k, d] * z[i, d]
        for d in range(n):
            dphi[k, d] = scale * (dphi[k, d] - radial * z[i, d] / r2)


@jit
def _assemble(z, m, diffusion, polynomials, u, b):
    """Normal matrix A_kl = sum m phi_k phi_l and right-hand sides b_cl = sum m (D grad phi_l - phi_l u)_c."""
    A, N, q = polynomials.A, z.shape[0], polynomials.powers.shape[0]
    if N < PARALLEL_FROM:
        _assemble_rows(z, m, diffusion, polynomials, u, b)
        return
    parts = np.empty((BLOCKS, q, q)), np.empty((BLOCKS, b.shape[0], q))
    _assemble_blocks(z, m, diffusion, polynomials, u, even(N), *parts)
    A[:] = 0.0
    b[:] = 0.0
    add_parts(parts[0], A)
    add_parts(parts[1], b)


@parallel_jit
def _assemble_blocks(z, m, diffusion, polynomials, u, edges, A, b):
    """As `_assemble_rows` for blocks of particles, each into sums of its own; spread over threads."""
    (D, rows, inverse), (powers, phi, _) = diffusion, polynomials
    for k in prange(edges.size - 1):
        own = slice(edges[k], edges[k + 1])
        here = Diffusion(D[own] if D.shape[0] > 1 else D, rows, inverse)
        _assemble_rows(z[own], m[own], here, Polynomials(powers, phi[own], A[k]), u[own], b[k])


@jit
def _assemble_rows(z, m, diffusion, polynomials, u, b):
    """The sums of `_assemble` over particles, one after the other."""
    (D, rows, inverse), (powers, phi, A) = diffusion, polynomials
    N, n = z.shape
    q = powers.shape[0]
    h = np.empty((2, n, max(2, powers[q - 1].sum() + 1)))
    dphi, T = np.empty((q, n)), np.empty((rows.size, n))
    b[:] = 0.0
    for i in range(N):
        if i < D.shape[0]:  # one D for all particles, or one for each; T = D L^-T takes gradients in z
            for c in range(rows.size):
                for e in range(n):
                    T[c, e] = 0.0
                    for d in range(n):
                        T[c, e] += D[i, rows[c] * n + d] * inverse[e, d]
        basis(z, i, powers, h, phi[i], dphi)
        for c in range(rows.size):
            for k in range(q):
                pull = -phi[i, k] * u[i, rows[c]]
                for e in range(n):
                    pull += T[c, e] * dphi[k, e]
                b[c, k] += m[i] * pull
    _normal_matrix(m, phi, A)


@jit
def _normal_matrix(m, phi, A):
    """A_kl = sum m phi_k phi_l, lower half; four particles at a time spare three in four stores."""
    N, q = phi.shape
    A[:] = 0.0
    last = N - N % 4
    for i in range(0, last, 4):
        for k in range(q):
            w0, w1 = m[i] * phi[i, k], m[i + 1] * phi[i + 1, k]
            w2, w3 = m[i + 2] * phi[i + 2, k], m[i + 3] * phi[i + 3, k]
            for j in range(k + 1):
                A[k, j] += (w0 * phi[i, j] + w1 * phi[i + 1, j]) + (w2 * phi[i + 2, j] + w3 * phi[i + 3, j])
    for i in range(last, N):
        for k in range(q):
            for j in range(k + 1):
                A[k, j] += m[i] * phi[i, k] * phi[i, j]


@jit
def _factor(A, powers):
    """Cholesky factor of A + ridge in its lower half; returns how many leading functions it holds for.

    Functions are ordered by degree: where a pivot says that the particles cannot tell a function from
    those before it, all functions of its degree are left out, and the factor of the rest stays valid.
    """
    q = A.shape[0]
    trace = 0.0
    for k in range(q):
        trace += A[k, k]
    for k in range(q):
        diagonal = A[k, k]
        A[k, k] += _RIDGE * trace / q
        for j in range(k + 1):
            s = A[k, j]
            for c in range(j):
                s -= A[k, c] * A[j, c]
            if j < k:
                A[k, j] = s / A[j, j]
            elif s > _LEAST_PIVOT * diagonal:
                A[k, k] = math.sqrt(s)
            else:
                degree = powers[k].sum()
                while k > 0 and powers[k - 1].sum() == degree:
                    k -= 1
                return k
    return q


@jit
def _solve(A, q, b):
    """Solve L L' a = b in place for the leading q unknowns."""
    for k in range(q):
        s = b[k]
        for j in range(k):
            s -= A[k, j] * b[j]
        b[k] = s / A[k, k]
    for k in range(q - 1, -1, -1):
        s = b[k]
        for j in range(k + 1, q):
            s -= A[j, k] * b[j]
        b[k] = s / A[k, k]


@jit
def correct(z, m, diffusion, polynomials, u):
    """Add to the rows of u the polynomials that make the moment equations hold.

    Parameters
    ----------
    z : ndarray, shape (N, n)
        Whitened positions z = L^-1 (x - mean).
    m : ndarray, shape (N,)
    diffusion : Diffusion
    polynomials : Polynomials
        `phi` and `A` are written.
    u : ndarray, shape (N, n), changed
        -div D - D grad p / p in the units of x.

    Returns
    -------
    int
        Number of functions used, at most q.
    """
    rows, (powers, phi, A) = diffusion.rows, polynomials
    b = np.empty((rows.size, powers.shape[0]))
    _assemble(z, m, diffusion, polynomials, u, b)
    used = _factor(A, powers)
    for c in range(rows.size):
        _solve(A, used, b[c])
        for i in range(z.shape[0]):
            for k in range(used):
                u[i, rows[c]] += b[c, k] * phi[i, k]
    return used


@jit
def keep_affine(m, polynomials, v):
    """Replace vectors v (N, n) by the affine function of the state nearest to them, weighted by mass."""
    phi, A = polynomials.phi, polynomials.A
    N, n = v.shape
    b = np.zeros((n, n + 1))
    for i in range(N):
        for c in range(n):
            for k in range(n + 1):
                b[c, k] += m[i] * v[i, c] * phi[i, k]
    for c in range(n):
        _solve(A, n + 1, b[c])
        for i in range(N):
            v[i, c] = 0.0
            for k in range(n + 1):
                v[i, c] += b[c, k] * phi[i, k]
