"""Log-density between particles that lie on no lattice: smooth polynomials through the neighbours of each."""

import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .._types import Floats, OfStates
from ..core.sph.neighbors import build_index, choose_method
from ..core.sph.summation import sample_density

if TYPE_CHECKING:
    from .particle_density import ParticleDensity

__all__ = ["interpolant", "normalised", "smoothed"]

_NEIGHBORS_A_TERM = 3
_CUBIC_UP_TO = 2  # states; beyond, cubic polynomials have too many terms for the particles at hand
_NEAR = 1.5  # distances to the nearest neighbour, up to which a polynomial is taken as it is


def interpolant(x: Floats, log_p: Floats, factor: Floats) -> OfStates:
    """Return a function of states X (M, n) that gives log p (M,).

    Around each particle log p is the weighted least-squares polynomial through its neighbours in whitened
    coordinates, which averages out what single particles know wrong; a state gets the mean of the nearest
    particles' polynomials, with weights that make it continuous. Away from all particles the concave part of
    the nearest one's quadratic goes on, never rising.

    Parameters
    ----------
    x, log_p : ndarray, shape (N, n), (N,)
    factor : ndarray, shape (n, n)
        Lower factor of the covariance that whitens.
    """
    from scipy.spatial import cKDTree  # on use: import time

    whiten = np.linalg.inv(factor).T
    z = x @ whiten
    N, n = z.shape
    terms = _terms(n, 3 if n <= _CUBIC_UP_TO else 2, N)
    tree = cKDTree(z)
    c, reach, nearest = _fit(tree, z, log_p, terms)
    gradient, concave = _tail(c, reach, terms, n)
    blended = min(2 * n + 3, N)

    def log_density(X: Floats) -> Floats:
        Y = np.atleast_2d(X) @ whiten
        r, j = (a.reshape(len(Y), -1) for a in tree.query(Y, blended))
        weight = _weight(r / (r[:, -1:] * (1.0 + 1e-9)))
        values = np.einsum("mbp,mbp->mb", _monomials((Y[:, None] - z[j]) / reach[j][..., None], terms), c[j])
        inside = (weight * values).sum(axis=1) / weight.sum(axis=1)
        j, d = j[:, 0], Y - z[j[:, 0]]
        fall = np.einsum("ia,ia->i", d, gradient[j]) + 0.5 * np.einsum("ia,iab,ib->i", d, concave[j], d)
        return np.where(r[:, 0] <= _NEAR * nearest[j], inside, c[j, 0] + np.minimum(fall, 0.0))

    return log_density


def smoothed(z: Floats, values: Floats) -> tuple[Floats, Floats]:
    """What quadratic polynomials through the neighbours of each point make of values there.

    Parameters
    ----------
    z : ndarray, shape (N, n)
        Two points at least.
    values : ndarray, shape (N,)

    Returns
    -------
    smooth, nearest : ndarray, shape (N,)
        Values of the polynomials at their own points, and distances to the nearest point.
    """
    from scipy.spatial import cKDTree  # on use: import time

    tree = cKDTree(z)
    c, _, nearest = _fit(tree, z, values, _terms(z.shape[1], 2, len(z)))
    return c[:, 0], nearest


def _terms(n: int, degree: int, N: int) -> list[tuple[int, ...]]:
    """Monomials as tuples of axes, by degree; of lower degree where particles are few."""
    every = [t for k in range(degree + 1) for t in itertools.combinations_with_replacement(range(n), k)]
    while len(every) > max(n + 1, N // 2):
        degree -= 1
        every = [t for t in every if len(t) <= degree]
    return every


def _monomials(d: Floats, terms: Sequence[tuple[int, ...]]) -> Floats:
    """Values of the monomials at displacements d (..., n), shape (..., T)."""
    values = np.empty((*d.shape[:-1], len(terms)))
    for k, axes in enumerate(terms):
        values[..., k] = 1.0 if not axes else d[..., axes[-1]]
        if len(axes) > 1:
            values[..., k] *= values[..., terms.index(axes[:-1])]
    return values


def _weight(q: Floats) -> Floats:
    """Wendland's C2 function."""
    return (1.0 - q) ** 4 * (1.0 + 4.0 * q)


def _fit(
    tree: Any, z: Floats, log_p: Floats, terms: Sequence[tuple[int, ...]]
) -> tuple[Floats, Floats, Floats]:
    """Coefficients (N, T) in units of each particle's reach, the reaches, and nearest distances."""
    K = min(_NEIGHBORS_A_TERM * len(terms), len(z) - 1)
    distance, neighbors = tree.query(z, K + 1)
    reach = distance[:, -1]
    basis = _monomials((z[neighbors] - z[:, None]) / reach[:, None, None], terms)
    weighted = basis * _weight(distance / (1.05 * reach[:, None]))[..., None]
    normal = np.swapaxes(weighted, 1, 2) @ basis
    normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(len(terms))
    right = np.einsum("ikp,ik->ip", weighted, log_p[neighbors])
    return np.linalg.solve(normal, right[..., None])[..., 0], reach, distance[:, 1]


def _tail(c: Floats, reach: Floats, terms: Sequence[tuple[int, ...]], n: int) -> tuple[Floats, Floats]:
    """Gradient (N, n) and concave part of the second derivatives (N, n, n) at each particle."""
    gradient, H = np.zeros((len(c), n)), np.zeros((len(c), n, n))
    for k, axes in enumerate(terms):
        if len(axes) == 1:
            gradient[:, axes[0]] = c[:, k] / reach
        if len(axes) == 2:
            second = c[:, k] / reach**2 * (2.0 if axes[0] == axes[1] else 1.0)
            H[:, axes[0], axes[1]] = H[:, axes[1], axes[0]] = second
    w, V = np.linalg.eigh(H)
    return gradient, np.einsum("iab,ib,icb->iac", V, np.minimum(w, 0.0), V)


def normalised(density: "ParticleDensity") -> OfStates:
    """Return log p of a density that carries `log_density`, as `interpolant` does, with an integral of one.

    The integral is taken by importance sampling from the mixture of kernels in whitened coordinates: 2n
    points of equal weight stand for each kernel and have its covariance.
    """
    known: Any = density.log_density
    factor: Any = np.linalg.cholesky(density.cov("points"))
    n, log_p = density.dim, interpolant(density.x, known, factor)
    scale = np.prod(np.diag(factor)) ** (1.0 / n)
    z = np.ascontiguousarray(np.linalg.solve(factor, (density.x - density.mean()).T).T)
    h, kernel = density.h / scale, density.sph_kernel
    offsets = math.sqrt(n * kernel.variance) * np.concatenate([np.eye(n), -np.eye(n)])
    y = (z[:, None] + h[:, None, None] * offsets).reshape(-1, n)
    p = np.empty(len(y))
    index = build_index(z, kernel.radius * np.median(h), choose_method(len(z), n))
    sample_density(y, z, density.mass, h, index, kernel.pair, p)
    ratio = np.exp(log_p(density.mean() + y @ factor.T)) * scale**n / p
    log_total = math.log(np.repeat(density.mass, 2 * n) @ ratio / (2 * n))
    return lambda X: log_p(X) - log_total
