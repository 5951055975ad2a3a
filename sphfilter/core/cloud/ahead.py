"""What is to come, λ(x) = log E[exp λ'(X') | X = x], where X' is Gaussian and λ' quadratic about each block.

No transition is too narrow for that, and none has to have a density: points lie where λ' is fitted, and the
mean of its exponential over m + L u, u standard normal, is known.
"""

import math

import numpy as np
from numba import prange

from .._jit import jit, parallel_jit
from ..limits import NOTHING
from ..small_matrices import cholesky, invert_lower, whiten
from .noise import LANES

#: Points that a fit has at least, effectively, over its coefficients: residuals of fewer tell nothing.
_EACH = 3.0  # measured: half and twice leave 1.04 and 1.3 times the errors of Van der Pol's means
_WIDER, _MOST = 1.5, 24  # times the variance, each time; 1.5^24 = 1.7e4 reaches any cloud's end
_REACH = 18.0  # of -log of a point's part of the nearest one's, e^-18 = 1.5e-8, beyond which it is rounding
FREE = 10  # one of so many is drawn without λ: no weight is more than 1 / (1/10) = 10 times what it would be
#: Least part of the noise's precision that λ leaves where it curves upwards: what is to come is no more than
#: 1/√LEAST = 2 times as wide as without it.
LEAST = 0.25


@parallel_jit
def fitted(x, w, values, centre, root, out):
    """Fit a quadratic to values (N,) at points x (N, n) of weights w (N,), about every block's centre.

    Points count by a Gaussian about the centre (blocks, n), of root (blocks, n, n) of its covariance.
    Rows of `out` (blocks, 1 + n + n n) are filled with the value, gradient and second derivatives there.
    """
    for b in prange(centre.shape[0]):
        _fit(x, w, values, centre[b], root[b], out[b])


@jit
def _fit(x, w, values, centre, root, out):
    """One block's fit."""
    (N, n), white = x.shape, invert_lower(root)
    K, terms = 1 + n + n * (n + 1) // 2, np.empty(1 + n + n * (n + 1) // 2)
    square, off = np.empty(N), np.empty(n)
    for i in range(N):
        _in_units(white, x[i], centre, off)
        square[i] = np.inf
        if abs(values[i]) < np.inf and w[i] > 0.0:
            square[i] = 0.0
            for a in range(n):
                square[i] += off[a] * off[a]
    nearest, width = square.min(), 1.0
    for _ in range(_MOST):
        total = squares = 0.0
        for i in range(N):
            own = w[i] * math.exp(-0.5 * (square[i] - nearest) / width)
            total += own
            squares += own * own
        if total * total >= _EACH * K * squares:
            break
        width *= _WIDER
    A, y = np.zeros((K, K)), np.zeros(K)
    for i in range(N):
        if square[i] - nearest < 2.0 * _REACH * width:
            own = w[i] * math.exp(-0.5 * (square[i] - nearest) / width) / total
            _in_units(white, x[i], centre, off)
            _monomials(off, terms)
            for k in range(K):
                y[k] += own * terms[k] * values[i]
                for j in range(k + 1):
                    A[k, j] += own * terms[k] * terms[j]
    _solved(A, y, n)
    _derivatives(white, y, out)


@jit
def _in_units(white, x, centre, off):
    for a in range(x.size):
        off[a] = 0.0
        for e in range(a + 1):
            off[a] += white[a, e] * (x[e] - centre[e])


@jit
def _monomials(off, terms):
    n = off.size
    terms[0], k = 1.0, 1 + n
    for a in range(n):
        terms[1 + a] = off[a]
        for e in range(a + 1):
            terms[k] = off[a] * off[e]
            k += 1


@jit
def _solved(A, y, n):
    """Replace y by the solution of A c = y, A (K, K) lower; what no point tells is zero."""
    K, L = y.size, np.empty(A.shape)
    for k in range(K):
        for j in range(k):
            A[j, k] = A[k, j]
        A[k, k] *= 1.0 + 1e-10
    cholesky(A, L)
    whiten(L, y)
    for k in range(K - 1, -1, -1):
        for j in range(k + 1, K):
            y[k] -= L[j, k] * y[j]
        y[k] /= L[k, k]


@jit
def _derivatives(white, y, out):
    """Value, gradient and second derivatives in the units of the states."""
    n, k = white.shape[0], 1 + white.shape[0]
    H, out[:] = np.zeros((n, n)), 0.0
    for a in range(n):
        for e in range(a + 1):
            H[a, e] += y[k]
            H[e, a] += y[k]
            k += 1
    out[0] = y[0]
    for a in range(n):
        for e in range(n):
            out[1 + a] += white[e, a] * y[1 + e]
            for c in range(n):
                for f in range(n):
                    out[1 + n + a * n + e] += white[c, a] * H[c, f] * white[f, e]


@parallel_jit
def expected(end, lower, block, about, out):
    """Fill out (N,) with log E exp of a block's quadratic of end + L u, u standard normal.

    Ends (N, n) and L (N, n, n) are those of points in blocks (N,); `about` is centre and fits of `fitted`.
    """
    centre, fits = about
    for i in prange(end.shape[0]):
        out[i] = _tilted(end[i], lower[i], centre[block[i]], fits[block[i]])[0]


@parallel_jit
def led(end, lower, block, about, chosen, z, told):
    """Turn standard normals z (M, n) into u that lead points of numbers chosen (M,) to what is to come.

    In place, but for every tenth, which stays free. The logarithm of how many times as often as a standard
    normal the two together draw each u fills told (M,).
    """
    centre, fits = about
    for j in prange(z.shape[0]):
        i = chosen[j]
        told[j] = _drawn(
            *_tilted(end[i], lower[i], centre[block[i]], fits[block[i]])[1:], j % FREE == 0, z[j]
        )


@jit
def _tilted(end, L, centre, fit):
    """Log-mean of a fit; and r and F of the law of u, Fᵀ u - r standard normal."""
    n = end.size
    off, F, H = end - centre, np.empty((n, n)), fit[1 + n :].reshape((n, n))
    across, bent = L.T.copy(), H @ off
    r, M = across @ (fit[1 : 1 + n] + bent), np.eye(n) - across @ (H @ L)
    value = fit[0] + np.sum(off * (fit[1 : 1 + n] + 0.5 * bent))
    cholesky(M, F)
    for a in range(n):
        F[a, a] = F[a, a] if F[a, a] > LEAST else LEAST
    whiten(F, r)
    for a in range(n):
        value += 0.5 * r[a] * r[a] - math.log(F[a, a])
    return value, r, F


@jit
def _drawn(r, F, free, z):
    """Replace standard normals z (n,), unless they are free, by F⁻ᵀ (r + z), and return what `led` tells."""
    n, log_ratio = z.size, 0.0
    if not free:
        for a in range(n):
            log_ratio -= 0.5 * z[a] * z[a]
        for a in range(n - 1, -1, -1):
            z[a] += r[a]
            for e in range(a + 1, n):
                z[a] -= F[e, a] * z[e]
            z[a] /= F[a, a]
    for a in range(n):
        log_ratio += math.log(F[a, a]) + 0.5 * z[a] * z[a]
        if free:
            along = -r[a]
            for e in range(a, n):
                along += F[e, a] * z[e]
            log_ratio -= 0.5 * along * along
    return math.log((1.0 - 1.0 / FREE) * math.exp(min(log_ratio, 600.0)) + 1.0 / FREE)


@parallel_jit
def shared_out(end, root, w, y, later, out):
    """Fill `out` (N,) with weights that points of weights w (N,) have of those, `later` (M,), at y (M, n).

    Points come to N(end, L Lᵀ), of ends (N, n) and lower L (N, n, n). Each y shares its weight out among them
    by how likely it is to come from each (Doucet, Godsill, Andrieu 2000).
    """
    N, n = end.shape
    white, size, some = np.empty((n, n, N)), np.empty(N), np.empty((-(-len(y) // LANES), N))
    for i in prange(N):
        _inverted(root[i], w[i], white[:, :, i], size[i : i + 1])
    ends = end.T.copy()
    for k in prange(len(some)):
        own = slice(k * LANES, (k + 1) * LANES)
        _share_out(ends, white, size, y[own], later[own], some[k])
    _summed(some, out)


@jit
def _inverted(root, w, white, size):
    """L⁻¹ (n, n) of lower L, and the logarithm (1,) of a weight over its determinant."""
    white[:] = invert_lower(root)
    size[0] = math.log(w) if w > 0.0 else -np.inf
    for a in range(len(root)):
        size[0] -= math.log(root[a, a])


@jit
def _share_out(end, white, size, y, later, out):
    """Fill `out` (N,) with what points have of some y (M, n)."""
    part, along = np.empty(size.size), np.empty(size.size)
    out[:] = 0.0
    for j in range(len(y)):
        _parts(end, white, size, y[j], along, part)
        for i in range(out.size):
            out[i] += later[j] * part[i]


@jit
def _summed(some, out):
    """Sum of rows (K, N)."""
    out[:] = 0.0
    for k in range(len(some)):
        for i in range(out.size):
            out[i] += some[k, i]


@jit
def _parts(end, white, size, y, along, out):
    """Probabilities (N,) that y (n,) comes from each point, of ends (n, N) and L⁻¹ (n, n, N)."""
    n, N = end.shape
    out[:] = size
    for a in range(n):
        along[:] = 0.0
        for b in range(a + 1):
            for i in range(N):
                along[i] += white[a, b, i] * (y[b] - end[b, i])
        for i in range(N):
            out[i] -= 0.5 * along[i] * along[i]
    most, total = out.max(), 0.0
    for i in range(N):
        out[i] = math.exp(out[i] - most) if out[i] > most - NOTHING else 0.0
        total += out[i]
    for i in range(N):
        out[i] /= total
