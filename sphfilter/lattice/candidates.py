"""The published re-gridding: where the next regular lattice lies, and which of its nodes have particles.

Numbers in, numbers out: what is to be laid comes as particles and a function of a lattice.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .._types import Bools, Floats, Ints
from ..config import PaperScheme
from ..core.limits import ROUNDS
from ..errors import PropagationError
from ..model.domain import Domain
from .regular import MOST_NODES, Lattice, heaviest, mean_and_cov

_ZOOM_ENDS = 0.8  # part of its extent that the posterior fills along every axis when zooming in has ended
NO_OVERLAP = (
    "prior times likelihood is zero wherever the prior has particles: the measurement lies outside them; "
    "check it, use more particles, or, in the paper's scheme, a larger represented_mass and domain_mass"
)


class Product(NamedTuple):
    """prior(x) * weight(x) on a lattice, with the largest log-weight taken out."""

    lattice: Lattice
    values: Floats  # (M,)
    log_scale: float


class Sought(NamedTuple):
    """Demands on a lattice.

    `x` (N, n) are the prior's particles, `mass` (N,) their masses, `raw` (N,) a first estimate of the
    posterior's, `support` the mean reach of their kernels; `product` lays prior times weight on a lattice.
    """

    x: Floats
    mass: Floats
    raw: Floats
    support: float
    domain: Domain | None
    product: Callable[[Lattice], Product]


class Candidate(NamedTuple):
    """A lattice with the product on it: nodes kept, nodes of the core, and how badly it fits."""

    product: Product
    kept: Bools  # bool, (M,)
    core: Bools  # bool, (M,)
    fitness: float


def best_candidate(sought: Sought, n_particles: int, scheme: PaperScheme) -> tuple[Candidate, int, float]:
    """The best of the central discretisation and its neighbours (002 4.7.3), on `n_particles` nodes at most.

    With it the number tried, and the part of the lattice's box that the posterior fills. Raises
    `PropagationError` if no lattice of so few particles has three nodes along every axis.
    """
    low, high, volume_fraction = _extents(sought, n_particles, scheme)
    candidates = _candidates(sought, (low, high), volume_fraction, n_particles, scheme)
    return min(candidates, key=lambda c: c.fitness), len(candidates), volume_fraction


def _least_nodes(n_particles: int, n: int) -> int:
    """Fewest nodes along an axis: six resolve a Gaussian to rounding, fewer where particles are few."""
    return int(np.clip(0.6 * n_particles ** (1.0 / n), 3, 6))


def _dims(span: Floats, n_nodes: int, volume_fraction: float, anisotropy: float, least: int) -> Ints:
    """Nodes per axis for spacings that differ at most by `anisotropy` (002 (50)-(56))."""
    # a posterior thinner than that across the axes is resolved less
    volume_fraction = max(volume_fraction, n_nodes / MOST_NODES)
    aspect = span / span.min()
    nodes_aspect = aspect / np.minimum(aspect, anisotropy)
    fewest = (n_nodes / (volume_fraction * np.prod(nodes_aspect))) ** (1.0 / len(span))
    dims = np.maximum(np.round(nodes_aspect * fewest), least)
    # An axis held at the least number of nodes leaves fewer to the others than the formula gave them.
    free = dims > least
    surplus = np.prod(dims) * volume_fraction / n_nodes
    if surplus > 1.5 and free.any():
        dims[free] = np.maximum(np.round(dims[free] / surplus ** (1.0 / free.sum())), least)
    return dims.astype(int)


def _extents(sought: Sought, n_particles: int, scheme: PaperScheme) -> tuple[Floats, Floats, float]:
    """Extents of the new lattice, and the part of it that the posterior fills (002 (53)-(55)).

    They begin with the particles that hold the mass, as in 002, and close in on the test-grid nodes that do
    where the weight is narrower than the particles' spacing.
    """
    least = _least_nodes(n_particles, sought.x.shape[1])
    kept = sought.x[heaviest(sought.raw, scheme.domain_mass)]
    low, high = kept.min(axis=0), kept.max(axis=0)
    # a single row of particles still has width
    widen = np.maximum(0.5 * (sought.support - (high - low)), 0.0)
    low, high = low - widen, high + widen
    if sought.domain is not None:
        low, high = sought.domain.within(low, high, sought.support)
    for _ in range(ROUNDS):
        dims = _dims(high - low, n_particles, 1.0, scheme.anisotropy, least)
        lattice = Lattice.spanning(low, high, dims, sought.domain)
        filled = heaviest(sought.product(lattice).values, scheme.domain_mass)
        nodes = lattice.nodes[filled]
        inner_low = np.maximum(low, nodes.min(axis=0) - lattice.spacing)
        inner_high = np.minimum(high, nodes.max(axis=0) + lattice.spacing)
        if np.all(inner_high - inner_low > _ZOOM_ENDS * (high - low)):
            break
        low, high = inner_low, inner_high
    return low, high, filled.mean()


def _candidates(
    sought: Sought,
    extents: tuple[Floats, Floats],
    volume_fraction: float,
    n_particles: int,
    scheme: PaperScheme,
) -> list[Candidate]:
    """The central discretisation and its neighbours, one node more or less along each axis (002 4.7.3)."""
    (low, high), n = extents, sought.x.shape[1]
    core = heaviest(sought.mass, scheme.represented_mass).sum()  # particles that hold P_T, and all mass:
    wanted = mean_and_cov(sought.x, sought.raw)[1], core / heaviest(sought.mass, scheme.domain_mass).sum()
    least = _least_nodes(n_particles, n)
    dims = _dims(high - low, n_particles, volume_fraction, scheme.anisotropy, least)
    steps = [np.zeros(n, int), *np.eye(n, dtype=int), *-np.eye(n, dtype=int)]
    while True:
        tried = [
            _candidate(sought, Lattice.spanning(low, high, dims + step, sought.domain), wanted, scheme)
            for step in steps
            if np.all(dims + step >= least)
        ]
        viable = [c for c in tried if c.kept.sum() <= n_particles and _spans(c)]
        if viable:
            return viable
        if np.all(dims <= least):
            raise PropagationError(
                f"n_particles = {n_particles} is too small for {n} states: no such lattice has three nodes "
                f"in the posterior along every axis; use more particles"
            )
        dims = np.maximum(dims - 1, least)


def _candidate(
    sought: Sought, lattice: Lattice, wanted: tuple[Floats, float], scheme: PaperScheme
) -> Candidate:
    """A candidate's fitness: error of its raw covariance times error of its core-to-domain ratio."""
    product, (cov, core_ratio) = sought.product(lattice), wanted
    kept = heaviest(product.values, scheme.domain_mass)
    core = heaviest(product.values, scheme.represented_mass)
    mass = product.values[kept] / product.values[kept].sum()
    off = mean_and_cov(lattice.nodes[kept], mass)[1] - cov
    cov_error = np.sqrt(np.mean(off**2)) / np.trace(cov) if np.trace(cov) > 0 else 0.0
    ratio_error = abs(core.sum() / kept.sum() - core_ratio)
    return Candidate(product, kept, core & kept, cov_error * ratio_error)


def _spans(candidate: Candidate) -> bool:
    """Do the kept nodes stand at three places at least along every axis?"""
    axes = range(len(candidate.product.lattice.dims))
    kept = candidate.kept.reshape(candidate.product.lattice.dims)
    return all(kept.any(axis=tuple(a for a in axes if a != axis)).sum() >= 3 for axis in axes)
