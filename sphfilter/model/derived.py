"""Batch functions that follow from others: D from g, the Stratonovich term, derivatives by differences.

Indices of the papers: f drift (n,), g noise (n, m), Q (m, m), D = g Q gᵀ / 2 (n, n). Rows are states;
matrices are stored row-major in the columns.
"""

from typing import Any

import numpy as np
from numba import float64, types
from numba.extending import register_jitable

from .._types import BatchFunction, Floats
from ..core._addresses import ADDRESS, Entry, address_of, function_at
from ..core._jit import MATRIX, VECTOR, jit
from ..core.limits import DIFFERENCE
from .compile import batch


@register_jitable
def scales(D: Floats) -> Floats:
    """Return roots of the diagonal of D (n, n), one where it is zero: in units of them D has a unit diagonal.

    States have units of their own: what is small, or rounding, is judged in these.
    """
    d = np.sqrt(np.abs(np.diag(D)))
    return np.where(d > 0.0, d, 1.0)


# --- constants, read from the tail of p: [parameters, g (n m), D (n n)] ---


def constant_noise(x: Floats, t: float, p: Floats, out: Floats) -> None:
    """Fill g, constant."""
    n, k = x.shape[1], out.shape[1]
    g = p[p.size - n * n - k : p.size - n * n]
    for i in range(x.shape[0]):
        out[i, :] = g


def constant_diffusion(x: Floats, t: float, p: Floats, out: Floats) -> None:
    """Fill D, constant."""
    D = p[p.size - out.shape[1] :]
    for i in range(x.shape[0]):
        out[i, :] = D


def zeros(x: Floats, t: float, p: Floats, out: Floats) -> None:
    """Fill zeros: ∇·D where D does not depend on x."""
    out[:] = 0.0


# --- linear drift A x + b, read from the head of p: [A (n n), b (n)] ---


def linear_drift(x: Floats, t: float, p: Floats, out: Floats) -> None:
    """Fill A x + b."""
    n = x.shape[1]
    for i in range(x.shape[0]):
        for a in range(n):
            s = p[n * n + a]
            for j in range(n):
                s += p[a * n + j] * x[i, j]
            out[i, a] = s


def linear_jacobian(x: Floats, t: float, p: Floats, out: Floats) -> None:
    """Fill A."""
    for i in range(x.shape[0]):
        out[i, :] = p[: out.shape[1]]


def linear_divergence(x: Floats, t: float, p: Floats, out: Floats) -> None:
    """Fill the trace of A."""
    n = x.shape[1]
    s = 0.0
    for j in range(n):
        s += p[j * n + j]
    out[:] = s


# --- derived from other batch functions ---


def diffusion_from_noise(g: BatchFunction, Q: Floats) -> BatchFunction:
    """Return the batch function of D = g Q gᵀ / 2 (002 (5) with the erratum)."""
    m = len(Q)

    def fill(x: Floats, t: float, p: Floats, out: Floats) -> None:
        n = x.shape[1]
        G = np.empty((x.shape[0], n * m))
        g(x, t, p, G)
        for i in range(x.shape[0]):
            for a in range(n):
                for b in range(n):
                    s = 0.0
                    for k in range(m):
                        for r in range(m):
                            s += G[i, a * m + k] * Q[k, r] * G[i, b * m + r]
                    out[i, a * n + b] = 0.5 * s

    return batch(fill)


def noise_from_diffusion(D: BatchFunction) -> BatchFunction:
    """Return the batch function of the symmetric g with g gᵀ = 2 D."""
    at = _ROOTS.address

    def fill(x: Floats, t: float, p: Floats, out: Floats) -> None:
        D(x, t, p, out)
        _roots_at(at)(x.shape[1], out)

    return batch(fill)


@jit
def symmetric_roots(n: int, out: Floats) -> None:
    """Put g with g gᵀ = 2 D in the place of D (n, n) in each row; NaN where D is no number.

    That is the symmetric root of D of unit diagonal, smooth in D.
    """
    for i in range(out.shape[0]):
        if np.isfinite(out[i]).all():
            D = out[i].copy().reshape((n, n))
            d = scales(D)
            w, V = np.linalg.eigh(D / np.outer(d, d))
            out[i] = (((V * np.sqrt(2.0 * np.maximum(w, 0.0))) @ V.T) * d.reshape((-1, 1))).ravel()
        else:
            out[i] = np.nan


_ROOTS = Entry(symmetric_roots, (types.int64, MATRIX), types.void)
_roots_at = _ROOTS.at


@jit
def difference(f: int, x: Floats, t: float, p: Floats, j: int, step: float, out: Floats) -> None:
    """Fill ∂f/∂x_j by central differences, all rows at once; out (N, k). A batch function f, by address."""
    call, moved, below = function_at(f), x.copy(), np.empty_like(out)
    for i in range(x.shape[0]):
        moved[i, j] = x[i, j] - step * max(1.0, abs(x[i, j]))
    call(moved, t, p, below)
    for i in range(x.shape[0]):
        moved[i, j] = x[i, j] + step * max(1.0, abs(x[i, j]))
    call(moved, t, p, out)
    for i in range(x.shape[0]):
        h = 2.0 * step * max(1.0, abs(x[i, j]))
        for k in range(out.shape[1]):
            out[i, k] = (out[i, k] - below[i, k]) / h


_DIFFERENCE = Entry(difference, (ADDRESS, MATRIX, float64, VECTOR, types.int64, float64, MATRIX), types.void)
_difference_at = _DIFFERENCE.at


def _using(fill: BatchFunction, f: BatchFunction) -> BatchFunction:
    """The batch function of one that calls another by address, which lives as long."""
    made: Any = batch(fill)
    made.calls = f
    return made


def stratonovich_drift(f: BatchFunction, g: BatchFunction, Q: Floats) -> BatchFunction:
    """Return the Itô drift f_i + ½ Σ_jkl g_jk Q_kl ∂_j g_il of a Stratonovich equation (002 (4), erratum)."""
    m, step = len(Q), DIFFERENCE
    at, own = _DIFFERENCE.address, address_of(g)

    def fill(x: Floats, t: float, p: Floats, out: Floats) -> None:
        n = x.shape[1]
        f(x, t, p, out)
        G = np.empty((x.shape[0], n * m))
        dG = np.empty((x.shape[0], n * m))
        g(x, t, p, G)
        for j in range(n):
            _difference_at(at)(own, x, t, p, j, step, dG)
            for i in range(x.shape[0]):
                for k in range(m):
                    for r in range(m):
                        c = 0.5 * G[i, j * m + k] * Q[k, r]
                        for a in range(n):
                            out[i, a] += c * dG[i, a * m + r]

    return _using(fill, g)


def noise_columns(g: BatchFunction, R: Floats) -> BatchFunction:
    """Return the batch function of c = g R, shape (n, r) per row, then Σ_a ∂_a c_ak of its columns."""
    (m, r), step = R.shape, DIFFERENCE
    at, own = _DIFFERENCE.address, address_of(g)

    def fill(x: Floats, t: float, p: Floats, out: Floats) -> None:
        n = x.shape[1]
        G, dG = np.empty((x.shape[0], n * m)), np.empty((x.shape[0], n * m))
        out[:] = 0.0
        g(x, t, p, G)
        for a in range(n):
            _difference_at(at)(own, x, t, p, a, step, dG)
            for i in range(x.shape[0]):
                for k in range(r):
                    for j in range(m):
                        out[i, a * r + k] += G[i, a * m + j] * R[j, k]
                        out[i, n * r + k] += dG[i, a * m + j] * R[j, k]

    return _using(fill, g)


def jacobian_from(f: BatchFunction, k: int) -> BatchFunction:
    """Return the batch function of ∂_j f_a, shape (k, n) per row, by central differences."""
    step, at, own = DIFFERENCE, _DIFFERENCE.address, address_of(f)

    def fill(x: Floats, t: float, p: Floats, out: Floats) -> None:
        n = x.shape[1]
        df = np.empty((x.shape[0], k))
        for j in range(n):
            _difference_at(at)(own, x, t, p, j, step, df)
            for i in range(x.shape[0]):
                for a in range(k):
                    out[i, a * n + j] = df[i, a]

    return _using(fill, f)


def noisy_map(f: BatchFunction, g: BatchFunction, n: int, m: int) -> BatchFunction:
    """Return the batch function of f(x) + g(x) w of rows (x, w), n and m columns."""

    def fill(x: Floats, t: float, p: Floats, out: Floats) -> None:
        G, states = np.empty((x.shape[0], n * m)), x[:, :n].copy()
        f(states, t, p, out)
        g(states, t, p, G)
        for i in range(x.shape[0]):
            for a in range(n):
                for k in range(m):
                    out[i, a] += G[i, a * m + k] * x[i, n + k]

    return batch(fill)


def row_divergence_from(D: BatchFunction) -> BatchFunction:
    """Return the batch function of (∇·D)_a = Σ_j ∂_j D_aj by central differences."""
    step, at, own = DIFFERENCE, _DIFFERENCE.address, address_of(D)

    def fill(x: Floats, t: float, p: Floats, out: Floats) -> None:
        n = x.shape[1]
        out[:] = 0.0
        dD = np.empty((x.shape[0], n * n))
        for j in range(n):
            _difference_at(at)(own, x, t, p, j, step, dD)
            for i in range(x.shape[0]):
                for a in range(n):
                    out[i, a] += dD[i, a * n + j]

    return _using(fill, D)


def trace_from(J: BatchFunction) -> BatchFunction:
    """Return the batch function of the trace of a Jacobian."""

    def fill(x: Floats, t: float, p: Floats, out: Floats) -> None:
        n = x.shape[1]
        full = np.empty((x.shape[0], n * n))
        J(x, t, p, full)
        for i in range(x.shape[0]):
            out[i, 0] = 0.0
            for j in range(n):
                out[i, 0] += full[i, j * n + j]

    return batch(fill)
