"""Whitened coordinates of a cloud, with the smoothing lengths and pair lists that belong to them.

Kernels, neighbours and distances live in z = L^-1 (x - mean), so that results do not depend on the units or
axes of the state. L and the lists are kept until the lists can no longer be trusted: a rotation or shear of
the whole cloud costs no search.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import types

from .._addresses import Entry
from .._jit import MATRIX, VECTOR, jit
from .._records import type_of
from ..small_matrices import cholesky, invert_lower, moments
from ..sph.kernels import RADIUS
from .number_density import solve_lengths, transform
from .pairs import pair_lists, pairs_expected

__all__ = [
    "FRAME",
    "OPTIONS",
    "SEARCH",
    "Cloud",
    "Frame",
    "Options",
    "crosses",
    "follow_spacing",
    "keep_lengths",
    "make_frame",
    "settle",
    "still_valid",
    "whiten_frame",
]

_SKIN = 1.25  # radius of the lists in units of the support
_LIGHT = 1e-6  # particles of less mass may cross their neighbours
_FLAT = 1e-14  # of a variance: what others do not explain of it, below which that is rounding
_CLOSE = 0.1  # of h: spacing below which a pair of particles counts as one


class Cloud(NamedTuple):
    """Particles, updated in place; h is in the units of x: (det L)^(1/n) times that in whitened ones."""

    x: np.ndarray  # (N, n)
    m: np.ndarray  # (N,)
    h: np.ndarray  # (N,)


class Options(NamedTuple):
    """Numbers of the scheme; passed as a record."""

    kernel: int
    normalisation: float
    eta: float  # smoothing lengths over the spacing of the particles
    degree: int  # of the polynomials of the correction
    variance: float  # of the kernel of length one, along an axis
    tol: float  # of a step, in standard deviations
    dt_max: float
    pause_after: int  # steps


class Frame(NamedTuple):
    """The coordinates that whiten a cloud, and what is kept from one search to the next."""

    cloud: Cloud
    L: np.ndarray  # (n, n)
    inverse: np.ndarray
    z: np.ndarray  # (N, n) whitened positions at the time of the search
    h: np.ndarray  # (N,) smoothing lengths in whitened coordinates
    reach: np.ndarray  # (N,) radius of the neighbour lists
    nearest: np.ndarray  # (N,) nearest neighbour


#: Numba's types of a record of `Options`, and of `Frame`.
OPTIONS = type_of(Options)
_CLOUD = types.NamedTuple([MATRIX, VECTOR, VECTOR], Cloud)
FRAME = types.NamedTuple([_CLOUD, MATRIX, MATRIX, MATRIX, VECTOR, VECTOR, types.int64[::1]], Frame)


@jit
def make_frame(cloud):
    """Room for the frame of a cloud."""
    N, n = cloud.x.shape
    matrices = (np.empty((n, n)), np.empty((n, n)), np.empty((N, n)))
    return Frame(cloud, *matrices, np.empty(N), np.empty(N), np.empty(N, np.int64))


@jit
def whiten_frame(frame):
    """L of the covariance now, whitened positions and lengths; False where x has no spread somewhere."""
    cloud, n, total = frame.cloud, frame.z.shape[1], 0.0
    mean, C = np.empty(n), np.empty((n, n))
    for i in range(cloud.m.size):
        total += cloud.m[i]
    moments(cloud.x, cloud.m, mean, C, total)
    if not cholesky(C, frame.L):
        return False
    for a in range(n):
        if not frame.L[a, a] ** 2 > _FLAT * C[a, a]:
            return False
    inverse = invert_lower(frame.L)
    for a in range(n):
        for b in range(n):
            frame.inverse[a, b] = inverse[a, b]
    transform(cloud.x, mean, inverse, frame.z)
    scale = _scale(frame.L)
    for i in range(frame.h.size):
        frame.h[i] = cloud.h[i] / scale
    return True


@jit
def keep_lengths(frame):
    """Smoothing lengths of the cloud, in the units of x, from those of its frame."""
    scale = _scale(frame.L)
    for i in range(frame.h.size):
        frame.cloud.h[i] = frame.h[i] * scale


@jit
def search(frame, options):
    """New pair lists."""
    for i in range(frame.h.size):
        frame.reach[i] = _SKIN * RADIUS[options.kernel] * frame.h[i]
    expected = pairs_expected(_SKIN * RADIUS[options.kernel] * options.eta, frame.z.shape[1])
    pairs, nearest = pair_lists(frame.z, frame.reach, expected)
    for i in range(nearest.size):
        frame.nearest[i] = nearest[i]
    return pairs


#: `search` by its address: it is compiled once, not at every level that calls it.
SEARCH = Entry(search, (FRAME, OPTIONS))
search_at = SEARCH.at


@jit
def _scale(L):
    """(det L)^(1/n)."""
    total = 0.0
    for a in range(L.shape[0]):
        total += math.log(L[a, a])
    return math.exp(total / L.shape[0])


@jit
def still_valid(z, frame, K):
    """Do the lists hold every pair within its support?

    An unlisted pair was farther apart than its reach. Under z -> F z + rest it is still beyond
    sigma reach - 2 |rest|, with sigma^2 >= 1 - |F'F - 1| for the smallest singular value of F. F is the
    regression on the old positions, whose covariance is the identity.
    """
    N, n = z.shape
    m, F, total = frame.cloud.m, np.zeros((n, n)), 0.0
    for i in range(N):
        total += m[i]
        for a in range(n):
            for b in range(n):
                F[a, b] += m[i] * z[i, a] * frame.z[i, b]
    for a in range(n):
        for b in range(n):
            F[a, b] /= total
    stretch2 = 0.0
    for a in range(n):
        for b in range(n):
            s = -1.0 if a == b else 0.0
            for c in range(n):
                s += F[c, a] * F[c, b]
            stretch2 += s * s
    sigma = math.sqrt(max(1.0 - math.sqrt(stretch2), 0.0))
    rest2, slack = 0.0, np.inf
    for i in range(N):
        r2 = 0.0
        for a in range(n):
            s = z[i, a]
            for b in range(n):
                s -= F[a, b] * frame.z[i, b]
            r2 += s * s
        rest2 = max(rest2, r2)
        slack = min(slack, sigma * frame.reach[i] - K * frame.h[i])
    return slack > 2.0 * math.sqrt(rest2)


@jit
def crosses(x0, frame):
    """Part of the way to its nearest neighbour, relative to it, that a particle goes; (worst, particle).

    Not-a-number counts as infinitely far.
    """
    x, m = frame.cloud.x, frame.cloud.m
    N, n = x.shape
    worst, culprit = 0.0, 0
    gap, way = np.empty(n), np.empty(n)
    for i in range(N):
        j = frame.nearest[i]
        for d in range(n):
            gap[d] = x0[i, d] - x0[j, d]
            way[d] = x[i, d] - x[j, d] - gap[d]
        gap2, way2 = 0.0, 0.0
        for d in range(n):
            a, b = 0.0, 0.0
            for c in range(d + 1):
                a += frame.inverse[d, c] * gap[c]
                b += frame.inverse[d, c] * way[c]
            gap2 += a * a
            way2 += b * b
        part = math.sqrt(way2 / max(gap2, (_CLOSE * frame.h[i]) ** 2))
        if not math.isfinite(part):
            return np.inf, i
        if part > worst and m[i] > _LIGHT:
            worst, culprit = part, i
    return worst, culprit


@jit
def follow_spacing(frame, number, options):
    """One step of the fixed-point iteration h = eta n^(-1/n); lists decide whether they still suffice."""
    n = frame.z.shape[1]
    for i in range(number.size):
        frame.h[i] = math.sqrt(frame.h[i] * options.eta * number[i] ** (-1.0 / n))


@jit
def _guess_lengths(frame, eta):
    """Lengths of a ball filled evenly, where those at hand are far off: particles of a new lattice.

    The variance of a ball of radius Z along an axis is Z^2 / (n + 2).
    """
    N, n = frame.z.shape
    total, mean = 0.0, 0.0
    for i in range(N):
        mean += frame.h[i] / N
        for d in range(n):
            total += frame.z[i, d] ** 2
    radius = math.sqrt((n + 2) * total / (n * N))
    guess = eta * radius * (math.pi ** (0.5 * n) / math.gamma(0.5 * n + 1.0) / N) ** (1.0 / n)
    if not 0.8 * guess < mean < 1.25 * guess:
        frame.h[:] = guess


@jit
def settle(search, cloud, options, tolerance):
    """Solve for h at the present positions; False where the cloud has no spread in some direction.

    Parameters
    ----------
    search : ADDRESS
        Of `SEARCH`.
    cloud : Cloud
    options : record
        `Options`, packed.
    tolerance : float
        Of the lengths, relative.
    """
    frame = make_frame(cloud)
    kernel = (options.kernel, options.normalisation)
    if not whiten_frame(frame):
        return False
    _guess_lengths(frame, options.eta)
    for _ in range(30):
        pairs = search_at(search)(frame, options)
        if solve_lengths(frame.z, frame.h, options.eta, pairs, frame.reach, kernel, tolerance) == 0:
            break
    keep_lengths(frame)
    return True
