"""The FPK equation for a family: rates of its frame and of the coefficients of log p in it.

With L = log p in the frame x = mu + A xi, f the drift in it, B = A^-1 2 D A^-T, g = grad L, H its curvature,
and weights u of the rule:

    m = sum u f,   S = sum u f xi^T,   K = (S + S^T + sum u B) / 2,      dmu/dt = A m,   dA/dt = A K
    R = -div f + div div D - (f - 2 div D - m - K xi) . g + (g.B g + B:H) / 2,      dc/dt = F R

in the ordinary terms of Ito. What the polynomials cannot follow is R less its projection.
"""

from typing import NamedTuple

import numpy as np

from .._addresses import function_at
from .._jit import jit
from .frame import inverse

__all__ = ["Flow", "Work", "rates", "work"]


class Flow(NamedTuple):
    """A model as families are carried by it: addresses of batch functions, and what needs no asking."""

    drift: tuple
    divergence: tuple  # of the drift
    diffusion: tuple  # D
    diffusion_divergence: tuple  # div D
    diffusion_curvature: tuple  # div div D
    p: np.ndarray
    D: np.ndarray  # (n, n), used where neither time nor state changes it
    time_dependent: bool  # D depends on time
    state_dependent: bool  # D depends on the state


class Work(NamedTuple):
    """Arrays that the rates are computed in."""

    x: np.ndarray  # (N, n)
    f: np.ndarray  # (N, n)
    d: np.ndarray  # (N, 1)
    D: np.ndarray  # (N, n n) where D depends on the state, else one row
    e: np.ndarray  # (N, n) div D, in the frame: where it depends on the state
    curvature: np.ndarray  # (N, 1) div div D
    g: np.ndarray  # (n, N)
    slope: np.ndarray  # (n, M) coefficients of the gradient
    bend: np.ndarray  # (M,) of the second derivatives
    H: np.ndarray  # (N,)
    R: np.ndarray  # (N,)
    B: np.ndarray  # (n, n)
    K: np.ndarray  # (n, n)
    inverse: np.ndarray  # (n, n) of A


@jit
def work(basis, state_dependent):
    """New arrays."""
    (N, n), M = basis.xi.shape, basis.V.shape[0]
    rows = N if state_dependent else 1
    return Work(
        np.empty((N, n)),
        np.empty((N, n)),
        np.empty((N, 1)),
        np.empty((rows, n * n)),
        np.empty((rows, n)),
        np.empty((rows, 1)),
        np.empty((n, N)),
        np.empty((n, M)),
        np.empty(M),
        np.empty(N),
        np.empty(N),
        np.empty((n, n)),
        np.empty((n, n)),
        np.empty((n, n)),
    )


@jit
def rates(flow, basis, own, t, y, dy):
    """Rates dy of y = (mu, A, c) at time t; returns the square of what the family cannot follow, per second²."""
    (N, n), c = basis.xi.shape, y[basis.xi.shape[1] * (1 + basis.xi.shape[1]) :]
    A, dA = y[n : n + n * n].reshape((n, n)), dy[n : n + n * n].reshape((n, n))
    inverse(A, own.inverse)
    _ask(flow, basis, own, t, y[:n], A)
    m = dy[:n]
    _linear_part(flow, basis, own, m)
    _gradient(basis, own, c)
    _residual(flow, basis, own, m)
    _add_curvature(flow, basis, own)
    for a in range(n):
        own.x[0, a] = 0.0
        for b in range(n):
            own.x[0, a] += A[a, b] * m[b]
            dA[a, b] = 0.0
            for k in range(n):
                dA[a, b] += A[a, k] * own.K[k, b]
    for a in range(n):
        dy[a] = own.x[0, a]
    return _projected(basis, own.R, dy[n + n * n :])


@jit
def _projected(basis, R, dc):
    """F R, and the mean square of what is left; the rule makes the polynomials orthonormal."""
    left = 0.0
    for j in range(dc.size):
        dc[j] = 0.0
    for i in range(R.size):
        left += basis.u[i] * R[i] ** 2
        for j in range(dc.size):
            dc[j] += basis.F[i, j] * R[i]
    for j in range(dc.size):
        left -= dc[j] ** 2
    return max(left, 0.0)


@jit
def _ask(flow, basis, own, t, mu, A):
    """Drift, its divergence and D at the nodes; vectors in the frame."""
    N, n = basis.xi.shape
    for i in range(N):
        for a in range(n):
            own.x[i, a] = mu[a]
            for k in range(n):
                own.x[i, a] += A[a, k] * basis.xi[i, k]
    function_at(flow.drift)(own.x, t, flow.p, own.f)
    function_at(flow.divergence)(own.x, t, flow.p, own.d)
    if flow.state_dependent:
        function_at(flow.diffusion)(own.x, t, flow.p, own.D)
        function_at(flow.diffusion_divergence)(own.x, t, flow.p, own.e)
        function_at(flow.diffusion_curvature)(own.x, t, flow.p, own.curvature)
        _whitened(own.inverse, own.e)
    elif flow.time_dependent:
        function_at(flow.diffusion)(own.x[:1], t, flow.p, own.D)
    else:
        own.D[0] = flow.D.reshape(n * n)
    _whitened(own.inverse, own.f)
    for i in range(own.D.shape[0]):
        _whitened_square(own.inverse, own.D[i].reshape((n, n)), own.B)


@jit
def _whitened(inverse_A, rows):
    """Multiply each row by A^-1."""
    n, v = rows.shape[1], np.empty(rows.shape[1])
    for i in range(rows.shape[0]):
        for a in range(n):
            v[a] = 0.0
            for k in range(n):
                v[a] += inverse_A[a, k] * rows[i, k]
        for a in range(n):
            rows[i, a] = v[a]


@jit
def _whitened_square(inverse_A, D, other):
    """D <- A^-1 2 D A^-T."""
    n = D.shape[0]
    for a in range(n):
        for b in range(n):
            other[a, b] = 0.0
            for k in range(n):
                other[a, b] += inverse_A[a, k] * D[k, b]
    for a in range(n):
        for b in range(n):
            D[a, b] = 0.0
            for k in range(n):
                D[a, b] += 2.0 * other[a, k] * inverse_A[b, k]


@jit
def _linear_part(flow, basis, own, m):
    """Mean m of the drift in the frame and its symmetric gradient K, with that of the noise."""
    N, n = basis.xi.shape
    for a in range(n):
        m[a] = 0.0
        for b in range(n):
            own.K[a, b] = 0.5 * own.D[0, a * n + b] if not flow.state_dependent else 0.0
    for i in range(N):
        for a in range(n):
            moment = basis.u[i] * own.f[i, a]
            m[a] += moment
            for b in range(n):
                own.K[a, b] += 0.5 * moment * basis.xi[i, b]
                own.K[b, a] += 0.5 * moment * basis.xi[i, b]
                if flow.state_dependent:
                    own.K[a, b] += 0.5 * basis.u[i] * own.D[i, a * n + b]


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
        _summed(basis, own.slope[a], basis.lower[0], own.g[a])


@jit
def _summed(basis, c, count, out):
    """Values of the first `count` polynomials with coefficients c at the nodes."""
    for i in range(out.size):
        out[i] = 0.0
    for j in range(count):
        for i in range(out.size):
            out[i] += c[j] * basis.V[j, i]


@jit
def _residual(flow, basis, own, m):
    """R but for the second derivatives of L."""
    N, n = basis.xi.shape
    for i in range(N):
        B = own.D[i if flow.state_dependent else 0]
        total = -own.d[i, 0]
        if flow.state_dependent:
            total += own.curvature[i, 0]
        for a in range(n):
            velocity, pushed = own.f[i, a] - m[a], 0.0
            if flow.state_dependent:
                velocity -= 2.0 * own.e[i, a]
            for b in range(n):
                velocity -= own.K[a, b] * basis.xi[i, b]
                pushed += B[a * n + b] * own.g[b, i]
            total += (0.5 * pushed - velocity) * own.g[a, i]
        own.R[i] = total


@jit
def _add_curvature(flow, basis, own):
    """Add B:H / 2 to R."""
    (n, M), count = basis.below.shape, basis.lower[1]
    for j in range(M):
        own.bend[j] = 0.0
    for a in range(n):
        for b in range(n):
            half = 0.5 * own.D[0, a * n + b]
            for j in range(basis.lower[0]):
                if basis.below[b, j] >= 0:
                    value = basis.root[b, j] * own.slope[a, j]
                    own.bend[basis.below[b, j]] += value if flow.state_dependent else half * value
            if flow.state_dependent:
                _summed(basis, own.bend, count, own.H)
                for i in range(own.R.size):
                    own.R[i] += 0.5 * own.D[i, a * n + b] * own.H[i]
                for j in range(count):
                    own.bend[j] = 0.0
    if not flow.state_dependent:
        _summed(basis, own.bend, count, own.H)
        for i in range(own.R.size):
            own.R[i] += own.H[i]
