"""Blocks of neighbouring points, each of which has matrices of its own.

Letters: x (n, N) points as columns, block (N,) the number of each one's block, which never decreases.
"""

import math

import numpy as np

from .._jit import jit
from .._views import stretch
from ..limits import LOOK, ROUNDING
from ..sums import dot, summed


@jit
def block_size(N):
    """Points in a block of a cloud of N: they tell directions, and so few blocks cost a tenth."""
    return max(LOOK, -(-N // LOOK))


@jit
def blocks_of(count):
    """Numbers (count,) of the blocks of as many points."""
    out, size = np.empty(count, np.int64), block_size(count)
    for b in range(-(-count // size)):
        out[b * size : (b + 1) * size] = b
    return out


@jit
def end_of_block(block, first):
    """Number after the last of the points that are in the block of one."""
    end, other = first + 1, block.size
    while end < other:
        middle = (end + other) // 2
        if block[middle] == block[first]:
            end = middle + 1
        else:
            other = middle
    return end


@jit
def centres(x):
    """Means (blocks, n) of blocks of consecutive points of x (n, N)."""
    n, N = x.shape
    size = block_size(N)
    c = np.empty((-(-N // size), n))
    for b in range(c.shape[0]):
        K = min(size, N - b * size)
        for a in range(n):
            c[b, a] = summed(stretch(x, a, b * size, K)) / K
    return c


@jit
def block_roots(x):
    """Lower roots (blocks, n, n) of the covariances of blocks of consecutive points of x (n, N)."""
    n, N = x.shape
    size, c = block_size(N), centres(x)
    L, S, off = np.zeros((c.shape[0], n, n)), np.empty((n, n)), np.empty((n, size))
    for b in range(c.shape[0]):
        K = min(size, N - b * size)
        for a in range(n):
            own, middle = stretch(x, a, b * size, K), c[b, a]
            for i in range(K):
                off[a, i] = own[i] - middle
            for e in range(a + 1):
                S[a, e] = S[e, a] = dot(stretch(off, a, 0, K), stretch(off, e, 0, K)) / K
        for a in range(n):
            for e in range(a + 1):
                s = S[a, e]
                for k in range(e):
                    s -= L[b, a, k] * L[b, e, k]
                if a == e:
                    L[b, a, a] = math.sqrt(s) if s > ROUNDING * S[a, a] else 0.0
                else:
                    L[b, a, e] = s / L[b, e, e] if L[b, e, e] > 0.0 else 0.0
    return L


@jit
def combined(p, x, q, c, block):
    """Points p x + q c (n, N) of points x and centres c (blocks, n) of their blocks, p and q (blocks,)."""
    out, first = np.empty(x.shape), 0
    while first < block.size:
        b, size = block[first], end_of_block(block, first) - first
        for a in range(len(x)):
            own, given, middle = stretch(out, a, first, size), stretch(x, a, first, size), q[b] * c[b, a]
            for i in range(size):
                own[i] = p[b] * given[i] + middle
        first += size
    return out


@jit
def add_products(out, factor, A, x, block, turned=False):
    """Add so many times A x of each point's block to out (m, N or more), A (blocks, m, n), x (n, N or more).

    A may be `turned`, its rows for its columns.
    """
    first, n = 0, len(x)
    while first < block.size:
        b, size = block[first], end_of_block(block, first) - first
        for a in range(len(out)):
            own, e = stretch(out, a, first, size), 0
            while e < n:  # two at a time: half as often a result is read and written
                f = min(e + 1, n - 1)
                one = factor * (A[b, e, a] if turned else A[b, a, e])
                two = factor * (A[b, f, a] if turned else A[b, a, f]) if f > e else 0.0
                given, other = stretch(x, e, first, size), stretch(x, f, first, size)
                for i in range(size if one != 0.0 or two != 0.0 else 0):
                    own[i] += one * given[i] + two * other[i]
                e += 2
        first += size


@jit
def products(A, x, block):
    """Products A x (m, N) of each point's block, A (blocks, m, n) and x (n, N)."""
    out = np.zeros((A.shape[1], block.size))
    add_products(out, 1.0, A, x, block)
    return out


@jit
def squares(A, x, block):
    """Squares (N,) of the lengths of A x of each point's block, A (blocks, m, n) and x (n, N)."""
    y, out = products(A, x, block), np.zeros(block.size)
    for a in range(len(y)):
        for i in range(block.size):
            out[i] += y[a, i] * y[a, i]
    return out


@jit
def steered(V, block, u, W):
    """Change W (d, N or more) in place by as little as makes V W u (n, N or more), rows of V orthonormal.

    V is (blocks, n, d): of noise W of all steps of each point, V W moves its end.
    """
    missing = u.copy()
    add_products(missing, -1.0, V, W, block)
    add_products(W, 1.0, V, missing, block, True)


@jit
def multiplied(A, B):
    """Products (blocks, m, d) of matrices A (blocks or 1, m, n) and B (blocks, n, d)."""
    out = np.zeros((len(B), A.shape[1], B.shape[2]))
    for b in range(len(B)):
        own = A[b if len(A) > 1 else 0]
        for a in range(out.shape[1]):
            for e in range(A.shape[2]):
                for c in range(out.shape[2]):
                    out[b, a, c] += own[a, e] * B[b, e, c]
    return out
