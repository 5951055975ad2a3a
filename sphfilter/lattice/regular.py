"""Regular lattices of particles: where they lie, how far their kernels reach, what mass they carry."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .._types import Bools, Floats, Ints
from ..config import PaperScheme
from ..core.sph.kernels import Kernel, shape
from ..core.sph.neighbors import build_index, choose_method, neighbor_lists
from ..core.sph.summation import deposit
from ..errors import ModelError
from ..model.domain import Domain
from ..validate import row

MOST_NODES = 2e6  # of one lattice: ten arrays of 8 bytes each = 160 MB


@dataclass(frozen=True)
class Lattice:
    """Nodes origin + k * spacing, k = 0 .. dims - 1 along each axis; the last axis runs fastest."""

    origin: Floats
    spacing: Floats
    dims: Ints
    domain: Domain | None = None

    @classmethod
    def spanning(
        cls, low: ArrayLike, high: ArrayLike, dims: ArrayLike, domain: Domain | None = None
    ) -> "Lattice":
        """Lattice with nodes at both ends of [low, high] (002 (49) prints N = span/d: it is span/d + 1).

        Where both ends are those of the domain, or one is a wall, nodes lie in the middle of equal cells.
        """
        low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
        nodes = np.maximum(np.asarray(dims, dtype=int), 2)
        if domain is None:
            return cls(low, (high - low) / (nodes - 1), nodes)
        centred = domain.whole(low, high) | (domain.walled & ((low <= domain.low) | (high >= domain.high)))
        spacing = (high - low) / np.where(centred, nodes, nodes - 1)
        return cls(low + np.where(centred, 0.5 * spacing, 0.0), spacing, nodes, domain)

    @classmethod
    def spaced(cls, low: Floats, high: Floats, spacing: Floats, domain: Domain | None = None) -> "Lattice":
        """Lattice as `spanning` lays it, with the given spacing (n,), or the next smaller one that fits."""
        cells = np.ceil(np.minimum((high - low) / spacing * (1.0 - 1e-12), MOST_NODES)).astype(int)
        ends = cls.spanning(low, high, cells + 1, domain)
        lattice = ends if domain is None else cls.spanning(low, high, cells + (ends.origin == low), domain)
        if np.prod(lattice.dims.astype(float)) > MOST_NODES:
            raise ModelError(
                f"spacing = {row(spacing)} makes {np.prod(lattice.dims.astype(float)):.2g} nodes, more than "
                f"{MOST_NODES:g}: take a wider one or a smaller box"
            )
        return lattice

    @property
    def nodes(self) -> Floats:
        """All nodes, shape (M, n)."""
        indices = np.indices(tuple(self.dims)).reshape(len(self.dims), -1).T
        return self.origin + indices * self.spacing

    @property
    def cell_volume(self) -> float:
        return float(np.prod(self.spacing))

    def half_shifted(self) -> "Lattice":
        """The interstitial lattice: half a cell off along every axis, inscribed (002 4.6.1)."""
        return replace(self, origin=self.origin + 0.5 * self.spacing, dims=self.dims - 1)

    def density_of(self, x: Floats, mass: Floats, h: Floats, kernel: Kernel) -> Floats:
        """Mixture density of particles at every node, shape (M,)."""
        out = np.empty(int(np.prod(self.dims)))
        if self.domain is not None:
            x, mass, h = self.domain.seen(x, mass, h, kernel.radius * h.max())
        deposit(self.origin, self.spacing, self.dims, x, mass, h, kernel.pair, out)
        return out


@dataclass(frozen=True)
class GaussianPlacement:
    """Trimmed lattice for a Gaussian: 002 (39)-(42)."""

    lattice: Lattice
    kept: Bools  # nodes of the lattice that carry a particle: core and buffer
    core: Bools  # nodes inside the core ellipsoid


def place_gaussian(mean: Floats, cov: Floats, n_particles: int, scheme: PaperScheme) -> GaussianPlacement:
    """Finest lattice whose ellipsoid (39), grown by N_B buffer layers (42), holds at most n_particles nodes.

    The spacing is the same along every axis, or wider along longer axes up to `scheme.anisotropy`. The
    ellipsoid's semi-axes grow by the width of the layers: for equal variances this is (42). They grow by one
    standard deviation at most: every lattice published in 002 stays within that, but on a few hundred
    particles (42) would reach out to seven, where densities differ so much from node to node that smoothing
    lengths collapse within a step. Raises `ModelError` if n_particles is too small for so many states.
    """
    from scipy import stats  # on use: import time

    n = len(mean)
    z_core = math.sqrt(stats.chi2.ppf(scheme.represented_mass, n))
    layers = round(float(np.mean(scheme.support_range)) * scheme.buffer_ratio)
    widths = np.sqrt(np.diag(cov))
    aspect = np.minimum(widths / widths.min(), scheme.anisotropy)
    variances, vectors = np.linalg.eigh(cov)
    ellipsoid = _Ellipsoid(z_core, np.sqrt(variances), vectors, layers)
    guess = _spacing_for(n_particles, ellipsoid, aspect)
    best = None
    if guess is not None:
        # The count of nodes falls with the spacing only on the whole: try from fine to coarse, both parities.
        spacings = guess * np.geomspace(0.9, 1.5, 60)
        tried = (_trimmed(mean, ellipsoid, dx * aspect, shift) for dx in spacings for shift in (0.0, 0.5))
        best = next((place for place in tried if place.kept.sum() <= n_particles), None)
    if best is None or best.kept.sum() < 3**n or best.core.sum() < 2**n:
        if widths.max() > 10.0 * widths.min():
            raise ModelError(
                f"the standard deviations of the states, {widths.min():.3g} to {widths.max():.3g}, are too "
                f"far apart for equal spacings: rescale the states, or raise anisotropy "
                f"(now {scheme.anisotropy:g})"
            )
        raise ModelError(
            f"n_particles = {n_particles} is too small for {n} states: needed are {3**n} nodes or more, "
            f"{2**n} of them within the core; use more particles or a smaller buffer_ratio (now "
            f"{scheme.buffer_ratio:g})"
        )
    return best


class _Ellipsoid(NamedTuple):
    z_core: float
    deviations: Floats
    vectors: Floats
    layers: int

    def radii(self, dx: float) -> tuple[Floats, Floats]:
        """Semi-axes of the core, and of core and buffer for a spacing dx."""
        core = self.z_core * self.deviations
        return core, core + np.minimum(self.layers * dx, self.deviations)


def _spacing_for(n_particles: int, ellipsoid: _Ellipsoid, aspect: Floats) -> float | None:
    """Spacing at which the grown ellipsoid's volume is n_particles cells, or None if there is none."""
    from scipy import optimize  # on use: import time

    n = len(ellipsoid.deviations)
    ball = math.pi ** (n / 2) / math.gamma(n / 2 + 1)
    stretch = float(np.prod(aspect)) ** (1.0 / n)

    def surplus(log_dx: float) -> float:
        dx = stretch * math.exp(log_dx)
        return math.log(ball) + np.log(ellipsoid.radii(dx)[1] / dx).sum() - math.log(n_particles)

    low, high = (math.log(ellipsoid.deviations.max()) + off for off in (-20.0, 5.0))
    if surplus(high) > 0.0:
        return None
    return math.exp(optimize.brentq(surplus, low, high))


def _trimmed(mean: Floats, ellipsoid: _Ellipsoid, spacing: Floats, shift: float) -> GaussianPlacement:
    vectors, n = ellipsoid.vectors, len(mean)
    radii, grown = ellipsoid.radii(float(np.prod(spacing)) ** (1.0 / n))
    extent = np.sqrt((vectors**2) @ grown**2)
    half = np.maximum(np.floor(extent / spacing - shift), 0)
    if np.prod(2.0 * half + 1.0) > MOST_NODES:
        raise ModelError(
            "the initial covariance is so narrow in a direction oblique to the axes that a lattice would "
            "need millions of nodes: rotate or rescale the states, or widen the covariance there"
        )
    half = half.astype(int)
    lattice = Lattice(mean - (half + shift) * spacing, spacing, 2 * half + (2 if shift else 1))
    along = (lattice.nodes - mean) @ vectors
    kept = ((along / grown) ** 2).sum(axis=1) < 1.0
    core = ((along / radii) ** 2).sum(axis=1) < 1.0
    return GaussianPlacement(lattice, kept, core & kept)


@dataclass(frozen=True)
class SupportFit:
    """Sweep of the support Lambda = K h / dx (002 4.6.1): errors on particle and interstitial nodes."""

    h: float
    support: Floats  # swept values
    error_particles: Floats  # eps_RMS (002 (32)) on interior particle nodes
    error_interstitial: Floats  # and on interior interstitial nodes
    error: Floats  # both together


def fit_support(
    lattice: Lattice,
    mass: Floats,
    target: Floats,
    target_between: Floats,
    interior: Bools,
    interior_between: Bools,
    scheme: PaperScheme,
) -> SupportFit:
    """Choose the one initial h whose mixture density is nearest to the target (002 4.6.1).

    The nodes have masses (M,), zero where no particle is. The density that is wanted on them is `target`, on
    the half-shifted ones `target_between`; those that count are marked in `interior`, `interior_between`.
    """
    kernel = Kernel.of(scheme.kernel, len(lattice.dims))
    dx = lattice.cell_volume ** (1.0 / len(lattice.dims))
    x, m = lattice.nodes[mass > 0], mass[mass > 0]
    between = lattice.half_shifted()
    supports = np.linspace(*scheme.support_range, scheme.support_steps)
    squares = np.empty((2, len(supports)))
    for k, support in enumerate(supports):
        h = np.full(len(x), support * dx / kernel.radius)
        off = lattice.density_of(x, m, h, kernel) - target
        off_between = between.density_of(x, m, h, kernel) - target_between
        squares[:, k] = (off[interior] ** 2).sum(), (off_between[interior_between] ** 2).sum()
    counts = np.array([max(interior.sum(), 1), max(interior_between.sum(), 1)])
    both = np.sqrt(squares.sum(axis=0) / counts.sum())
    best = supports[np.argmin(both)]
    own, shifted = np.sqrt(squares / counts[:, None])
    return SupportFit(best * dx / kernel.radius, supports, own, shifted, both)


def heaviest(values: Floats, share: float) -> Bools:
    """Mark the largest of `values` that together make up `share` of their sum; equals stay together."""
    falling = np.sort(values)[::-1]
    reached = np.cumsum(falling)
    level = falling[min(np.searchsorted(reached, share * reached[-1]), len(values) - 1)]
    return (values >= level * (1.0 - 1e-12)) & (values > 0)


def mean_and_cov(x: Floats, w: Floats) -> tuple[Floats, Floats]:
    """Mean (n,) and covariance (n, n) of states x (N, n) of weights (N,), by products of matrices."""
    mean = w @ x
    d = x - mean
    return mean, (d * w[:, None]).T @ d


def collocation_masses(x: Floats, h: float, target: Floats, kernel_name: str) -> Floats | None:
    """Masses whose mixture takes the target values at the particles (002 (48)); None if any is negative."""
    from scipy import sparse  # on use: import time

    kernel, n = Kernel.of(kernel_name, x.shape[1]), x.shape[1]
    support = np.full(len(x), kernel.radius * h)
    index = build_index(x, support[0], choose_method(len(x), n))
    start, neighbors = neighbor_lists(x, support, support.copy(), 0, index)
    rows = np.repeat(np.arange(len(x)), np.diff(start))
    r = np.linalg.norm(x[rows] - x[neighbors], axis=1)
    weights = np.array([shape(kernel.kind, q) for q in np.append(r / h, 0.0)]) * kernel.constant / h**n
    matrix = sparse.csc_array((weights[:-1], (rows, neighbors)), shape=(len(x), len(x)))
    mass = sparse.linalg.spsolve(matrix + weights[-1] * sparse.eye_array(len(x), format="csc"), target)
    return mass if np.all(np.isfinite(mass)) and mass.min() >= 0.0 else None
