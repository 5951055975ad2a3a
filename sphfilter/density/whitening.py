"""Whitened coordinates of weighted points, and the slope of the log-density that they stand for."""

import math

import numpy as np

from .._types import Floats
from ..core.limits import TINY
from ..core.monomials import up_to

_POINTS_A_TERM = 2  # of the polynomial of slopes
_TRUSTED = 2.0, 3.0  # standard deviations from the mean to which it is, and from which it no longer is
_CLIP = 5.0  # standard deviations, beyond which polynomials keep the values that they have there
_RIDGE = 1e-10  # of the mean diagonal of the normal matrix: rounding, 1e-16, over a hundred terms squared
_BLOCK = 4096  # points at a time: of 35 terms, as four states have, 8 · 35 _BLOCK = 1.1 MB


def framed(x: Floats, mass: Floats) -> tuple[Floats, ...] | None:
    """Whitened coordinates z (N, n) of points x = centre + root z; None where their covariance is singular.

    Centre, root, z, and the lower root (n, n) of the covariance within pieces that lie apart.
    """
    centre = mass @ x
    try:
        root = np.linalg.cholesky(((x - centre) * mass[:, None]).T @ (x - centre))
    except np.linalg.LinAlgError:
        return None
    z = np.ascontiguousarray(np.linalg.solve(root, (x - centre).T).T)
    slope = _slope(z, mass)
    # Inverse of the slopes' second moments: covariance within the pieces, in no direction above the whole's.
    values, axes = np.linalg.eigh((slope * mass[:, None]).T @ slope)
    within = np.linalg.cholesky((axes / np.maximum(values, 1.0)) @ axes.T)
    return centre, *(np.asarray(part, dtype=float) for part in (root, z, within))


def least_change(have: Floats, wanted: Floats) -> Floats:
    """The symmetric matrix that makes one covariance (n, n) another: the least change of the states."""
    root = _root(have)
    inverse = np.linalg.inv(root)
    return inverse @ _root(root @ wanted @ root) @ inverse


def _root(matrix: Floats) -> Floats:
    """Symmetric root of a positive matrix (n, n)."""
    values, axes = np.linalg.eigh(matrix)
    return (axes * np.sqrt(values)) @ axes.T


def _slope(z: Floats, mass: Floats) -> Floats:
    """Gradient of the log-density (N, n) at whitened points, a polynomial of degree three.

    It is the one for which E[q . grad log p] = -E[div q] holds for polynomials q of that degree: that of a
    Gaussian, or of exp of any polynomial of degree four, exactly. Far from the middle, where a few light
    points would decide, it points inwards at least as steeply as a Gaussian's.
    """
    N, n = z.shape
    points = min(N, 1.0 / np.sum(mass**2))
    degree = max((p for p in (1, 2, 3) if _POINTS_A_TERM * math.comb(n + p, p) <= points), default=1)
    powers = np.array(up_to(degree, n))
    normal, pull = np.zeros((len(powers), len(powers))), np.zeros((len(powers), n))
    for k in range(0, N, _BLOCK):
        phi, gradients = _hermite(z[k : k + _BLOCK], powers, mass[k : k + _BLOCK])
        normal += (phi * mass[k : k + _BLOCK]) @ phi.T
        pull += gradients
    normal += _RIDGE * np.trace(normal) / len(powers) * np.eye(len(powers))
    c = np.linalg.solve(normal, pull)
    u = np.concatenate([_hermite(z[k : k + _BLOCK], powers)[0].T @ c for k in range(0, N, _BLOCK)])
    r2 = (z**2).sum(axis=1)
    near, far = _TRUSTED
    doubt = np.clip((np.sqrt(r2) - near) / (far - near), 0.0, 1.0)
    short = np.maximum(r2 - (u * z).sum(axis=1), 0.0) / np.maximum(r2, near**2)
    return -u - (doubt * short)[:, None] * z


def _hermite(z: Floats, powers: Floats, mass: Floats | None = None) -> tuple[Floats, Floats]:
    """Products (q, N) of normalised Hermite polynomials at z (N, n), and the sums (q, n) of their gradients.

    Gradients are summed with masses (N,), where there are any. Beyond `_CLIP` products are what they are on
    that sphere, which looks the same from all whitened coordinates.
    """
    r = np.maximum(np.linalg.norm(z, axis=1, keepdims=True), TINY)
    scale = np.minimum(1.0, _CLIP / r)
    y = scale * z
    He = [np.ones_like(y), y]
    for k in range(2, powers.max() + 1):
        He.append((y * He[-1] - math.sqrt(k - 1) * He[-2]) / math.sqrt(k))
    values = np.array(He)  # (degree + 1, N, n)
    axes = range(z.shape[1])
    own = [values[powers[:, d], :, d] for d in axes]
    phi, sums = np.prod(own, axis=0), np.zeros(powers.shape)
    if mass is None:
        return phi, sums
    slopes = [np.sqrt(powers[:, d, None]) * values[np.maximum(powers[:, d] - 1, 0), :, d] for d in axes]
    g = np.stack([np.prod([*own[:d], slopes[d], *own[d + 1 :]], axis=0) for d in axes], axis=-1)
    way = np.where(scale < 1.0, z / r, 0.0)  # outwards, along which nothing changes beyond the sphere
    g = scale * (g - np.einsum("kia,ia->ki", g, way)[..., None] * way)
    return phi, np.einsum("kia,i->ka", g, mass)
