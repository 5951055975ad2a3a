"""The FPK equation for a family: rates of its frame and of the coefficients of log p in it.

With L = log p in the frame x = mu + A xi, f the drift in it, B = A^-1 2 D A^-T, g = grad L, H its curvature,
and weights u of the rule:

    m = sum u f,   S = sum u f xi^T,   K = (S + S^T + sum u B) / 2,      dmu/dt = A m,   dA/dt = A K
    R = -div f + div div D - (f - 2 div D - m - K xi) . g + (g.B g + B:H) / 2,      dc/dt = F R

in the ordinary terms of Ito. What the polynomials cannot follow is R less its projection.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import typeof, types

from .._addresses import NOWHERE_AT, Entry, function_at
from .._jit import MATRIX, VECTOR, jit
from .._views import lent
from ..small_matrices import product
from .basis import BASIS
from .frame import inverse


class Flow(NamedTuple):
    """A model as families are carried by it: addresses of batch functions, and what needs no asking."""

    drift: int
    divergence: int  # of the drift
    diffusion: int  # D
    diffusion_divergence: int  # div D
    diffusion_curvature: int  # div div D
    p: np.ndarray
    D: np.ndarray  # (n, n), used where neither time nor state changes it
    time_dependent: bool  # D depends on time
    state_dependent: bool  # D depends on the state
    rates: int = NOWHERE_AT  # address of the function of that name
    defect: int = NOWHERE_AT  # and of `defect_rates`


class Work(NamedTuple):
    """Arrays that the rates are computed in; rows of nodes are what loops run along."""

    x: np.ndarray  # (N, n) states
    f: np.ndarray  # (N, n) drift there
    d: np.ndarray  # (N, 1) its divergence
    D: np.ndarray  # (N, n n) where D depends on the state, else one row; in the frame twice of it
    e: np.ndarray  # (N, n) div D where it depends on the state
    curvature: np.ndarray  # (N, 1) div div D
    v: np.ndarray  # (n, N) the drift in the frame
    g: np.ndarray  # (n, N) gradient of L
    slope: np.ndarray  # (n, M) its coefficients
    bend: np.ndarray  # (M,) those of second derivatives
    row: np.ndarray  # (N,)
    R: np.ndarray  # (N,)
    m: np.ndarray  # (n,)
    S: np.ndarray  # (n, n)
    K: np.ndarray  # (n, n)
    inverse: np.ndarray  # (n, n) of A


@jit
def work(basis, state_dependent):
    """New arrays, for the polynomials of a basis or fewer."""
    (N, n), M = basis.xi.shape, basis.V.shape[0]
    rows = N if state_dependent else 1
    asked = np.empty((N, n)), np.empty((N, n)), np.empty((N, 1))
    noise = np.empty((rows, n * n)), np.empty((rows, n)), np.empty((rows, 1))
    along = np.empty((n, N)), np.empty((n, N)), np.empty((n, M)), np.empty(M), np.empty(N), np.empty(N)
    return Work(*asked, *noise, *along, np.empty(n), np.empty((n, n)), np.empty((n, n)), np.empty((n, n)))


@jit
def rates(flow, basis, own, t, y, dy):
    """Rates dy of y = (mu, A, c) at time t; returns the mean square of R that the family cannot follow."""
    flow, basis, own, y, dy = lent((flow, basis, own, y, dy))
    n = basis.xi.shape[1]
    A, dA = y[n : n + n * n].reshape((n, n)), dy[n : n + n * n].reshape((n, n))
    dmu = dy[:n]
    inverse(A, own.inverse)
    _ask(flow, basis, own, t, y[:n], A)
    _linear_part(flow, basis, own)
    if flow.state_dependent:
        _less_noise(own)
    _of_density(flow, basis, own, y[n + n * n :])
    for a in range(n):
        dmu[a] = 0.0
        for b in range(n):
            dmu[a] += A[a, b] * own.m[b]
            dA[a, b] = 0.0
            for k in range(n):
                dA[a, b] += A[a, k] * own.K[k, b]
    return _projected(basis, own.R, dy[n + n * n :])


@jit
def _of_density(flow, basis, own, c):
    """R at the nodes, of a density that has coefficients c in a basis, for the drift that `own` has."""
    _gradient(basis, own, c)
    _residual(flow, basis, own)
    if flow.state_dependent:
        _add_noise(basis, own)
    else:
        _add_curvature(basis, own)


@jit
def defect_rates(flow, basis, beyond, own, y, dy, s, ds):
    """Rates ds[0] of the defect s of a family y, which changes by dy, and ds[1] how fast noise forgets it.

    In the place of the covariance ds[1] has the mean gradient G of the drift, and ds[0] nothing.

    `own` must be as `rates` has left it.

    A defect is in one array: what log p is beyond the family, in the polynomials of `beyond`; a covariance
    (n, n) of errors of the mean without a sign; and the size of what those polynomials do not follow either.
    The first goes as the density does that has both polynomials, the second as the drift bends on average,
    dU = G U + U G^T, and noise forgets the third. Of polynomials noise forgets more the higher they are.
    """
    flow, basis, beyond, own, y, dy, s, ds = lent((flow, basis, beyond, own, y, dy, s, ds))
    n, (M, N) = basis.xi.shape[1], beyond.V.shape
    first = n + n * n
    A, c, dc, whole = y[n:first].reshape((n, n)), y[first:], dy[first:], s[:M].copy()
    for j in range(c.size):
        whole[j] += c[j]
    _of_density(flow, beyond, own, whole)
    for j in range(c.size):
        for i in range(N):
            own.R[i] -= dc[j] * basis.V[j, i]
    for e in range(s.size):
        ds[0, e], ds[1, e] = 0.0, 0.0
    for i in range(N):
        for j in range(M):
            ds[0, j] += beyond.F[i, j] * own.R[i]
    for j in range(M):
        for i in range(N):
            own.R[i] -= ds[0, j] * beyond.V[j, i]
    lost, last = 0.0, s.size - 1
    for i in range(N):
        lost += basis.u[i] * own.R[i] ** 2
    for a in range(n):
        noise = own.K[a, a] - own.S[a, a]
        ds[1, last] += (beyond.power[M - 1].sum() + 1) * noise / n
        for j in range(M):
            ds[1, j] += beyond.power[j, a] * noise
    ds[0, last] = math.sqrt(lost) - ds[1, last] * s[last]
    gradient = multiplied(A, multiplied(own.S, own.inverse)).ravel()
    for e in range(n * n):
        ds[1, M + e] = gradient[e]


@jit
def multiplied(X, Y):
    """X Y, of square matrices."""
    out = np.empty(X.shape)
    product(X, Y, 1.0, out)
    return out


@jit
def _projected(basis, R, dc):
    """F R, and the mean square of what is left; the rule makes the polynomials orthonormal."""
    F, left = basis.F, 0.0
    for j in range(dc.size):
        dc[j] = 0.0
    for i in range(R.size):
        left += basis.u[i] * R[i] ** 2
        for j in range(dc.size):
            dc[j] += F[i, j] * R[i]
    for j in range(dc.size):
        left -= dc[j] ** 2
    return max(left, 0.0)


@jit
def _ask(flow, basis, own, t, mu, A):
    """Drift, its divergence and D at the nodes; vectors in the frame."""
    N, n = basis.xi.shape
    for a in range(n):
        for i in range(N):
            own.row[i] = mu[a]
        for k in range(n):
            for i in range(N):
                own.row[i] += A[a, k] * basis.V[1 + k, i]
        for i in range(N):
            own.x[i, a] = own.row[i]
    function_at(flow.drift)(own.x, t, flow.p, own.f)
    function_at(flow.divergence)(own.x, t, flow.p, own.d)
    _in_frame(own, own.f)
    if flow.state_dependent:
        function_at(flow.diffusion)(own.x, t, flow.p, own.D)
        function_at(flow.diffusion_divergence)(own.x, t, flow.p, own.e)
        function_at(flow.diffusion_curvature)(own.x, t, flow.p, own.curvature)
    elif flow.time_dependent:
        function_at(flow.diffusion)(own.x[:1], t, flow.p, own.D)
    else:
        for e in range(n * n):
            own.D[0, e] = flow.D[e // n, e % n]
    other = np.empty((n, n))
    for i in range(own.D.shape[0]):
        _twice_in_frame(own.inverse, own.D[i].reshape((n, n)), other)


@jit
def _in_frame(own, rows):
    """A^-1 times rows (N, n), into `own.v`."""
    n, N = own.v.shape
    for a in range(n):
        for i in range(N):
            own.v[a, i] = 0.0
    for k in range(n):
        for i in range(N):
            own.row[i] = rows[i, k]
        for a in range(n):
            for i in range(N):
                own.v[a, i] += own.inverse[a, k] * own.row[i]


@jit
def _twice_in_frame(inverse_A, D, other):
    """D <- A^-1 2 D A^-T."""
    n = D.shape[0]
    product(inverse_A, D, 1.0, other)
    for a in range(n):
        for b in range(n):
            D[a, b] = 0.0
            for k in range(n):
                D[a, b] += 2.0 * other[a, k] * inverse_A[b, k]


@jit
def _dot(x, y):
    """Sum of products, as four sums: one alone would wait for itself."""
    first, second, third, fourth, whole = 0.0, 0.0, 0.0, 0.0, x.size - x.size % 4
    for i in range(0, whole, 4):
        first += x[i] * y[i]
        second += x[i + 1] * y[i + 1]
        third += x[i + 2] * y[i + 2]
        fourth += x[i + 3] * y[i + 3]
    for i in range(whole, x.size):
        first += x[i] * y[i]
    return (first + second) + (third + fourth)


@jit
def _linear_part(flow, basis, own):
    """Mean m and gradient S of the drift in the frame, and K with that of the noise."""
    N, n = basis.xi.shape
    for a in range(n):
        for b in range(n):
            own.K[a, b] = 0.5 * own.D[0, a * n + b]
            if flow.state_dependent:
                for i in range(N):
                    own.row[i] = 0.5 * own.D[i, a * n + b]
                own.K[a, b] = _dot(own.row, basis.u)
    for a in range(n):
        for i in range(N):
            own.row[i] = basis.u[i] * own.v[a, i]
        own.m[a] = _dot(own.row, basis.V[0])
        for b in range(n):
            own.S[a, b] = _dot(own.row, basis.V[1 + b])
            own.K[a, b] += 0.5 * own.S[a, b]
            own.K[b, a] += 0.5 * own.S[a, b]


@jit
def _less_noise(own):
    """Take 2 div D from the drift in the frame: what is left moves the density."""
    n, N = own.v.shape
    for k in range(n):
        for i in range(N):
            own.row[i] = 2.0 * own.e[i, k]
        for a in range(n):
            for i in range(N):
                own.v[a, i] -= own.inverse[a, k] * own.row[i]


@jit
def _gradient(basis, own, c):
    """Gradient of L at the nodes, and its coefficients."""
    n, M = basis.below.shape
    for a in range(n):
        for j in range(M):
            own.slope[a, j] = 0.0
        for j in range(M):
            if basis.below[a, j] >= 0:
                own.slope[a, basis.below[a, j]] = basis.root[a, j] * c[j]
        for i in range(own.R.size):
            own.g[a, i] = 0.0
        _add(basis, own.slope[a], basis.lower[0], own.g[a])


@jit
def _add(basis, c, count, out):
    """Add the values of the first `count` polynomials with coefficients c at the nodes."""
    for j in range(count):
        for i in range(out.size):
            out[i] += c[j] * basis.V[j, i]


@jit
def _residual(flow, basis, own):
    """R but for second derivatives of L, and for noise that depends on the state."""
    N, n = basis.xi.shape
    for i in range(N):
        own.R[i] = -own.d[i, 0]
    if flow.state_dependent:
        for i in range(N):
            own.R[i] += own.curvature[i, 0]
    for a in range(n):
        for i in range(N):
            own.row[i] = own.m[a] - own.v[a, i]
        for b in range(n):
            half = 0.0 if flow.state_dependent else 0.5 * own.D[0, a * n + b]
            for i in range(N):
                own.row[i] += own.K[a, b] * basis.V[1 + b, i] + half * own.g[b, i]
        for i in range(N):
            own.R[i] += own.row[i] * own.g[a, i]


@jit
def _add_curvature(basis, own):
    """Add B:H / 2 to R, B the same at all nodes."""
    n, M = basis.below.shape
    for j in range(M):
        own.bend[j] = 0.0
    for a in range(n):
        for b in range(n):
            _bent(basis, own, a, b, 0.5 * own.D[0, a * n + b])
    _add(basis, own.bend, basis.lower[1], own.R)


@jit
def _bent(basis, own, a, b, factor):
    """Add the coefficients of a second derivative of L times a factor."""
    for j in range(basis.lower[0]):
        if basis.below[b, j] >= 0:
            own.bend[basis.below[b, j]] += factor * basis.root[b, j] * own.slope[a, j]


@jit
def _add_noise(basis, own):
    """Add (g.B g + B:H) / 2 to R, B of each node its own."""
    (n, M), N = basis.below.shape, own.R.size
    for a in range(n):
        for b in range(n):
            for j in range(M):
                own.bend[j] = 0.0
            for i in range(N):
                own.row[i] = own.g[a, i] * own.g[b, i]
            _bent(basis, own, a, b, 1.0)
            _add(basis, own.bend, basis.lower[1], own.row)
            for i in range(N):
                own.R[i] += 0.5 * own.D[i, a * n + b] * own.row[i]


_ROW, _ROWS = np.empty(1), np.empty((1, 1))
_FLOW = typeof(Flow(*[NOWHERE_AT] * 5, _ROW, _ROWS, False, False))
_WORK = types.NamedTuple([typeof(a) for a in [_ROWS] * 9 + [_ROW] * 4 + [_ROWS] * 3], Work)
#: `rates` by its address.
RATES = Entry(rates, (_FLOW, BASIS, _WORK, types.float64, VECTOR, VECTOR), types.float64)
#: `defect_rates` by its address.
DEFECT = Entry(defect_rates, (_FLOW, BASIS, BASIS, _WORK, *[VECTOR] * 3, MATRIX), types.void)
