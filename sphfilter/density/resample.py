"""Re-gridding: a density, or its product with a likelihood, on a new regular lattice (002 4.7 and 6.1)."""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from ..config import PaperScheme, SolverConfig
from ..errors import PropagationError
from ..info import ResampleInfo
from ..lattice import field
from ..lattice.level_set import lattice_reach
from ..lattice.posterior import posterior
from ..lattice.regular import Lattice, heaviest
from ..model.domain import Domain
from ..validate import count
from .distributions import gaussian_log_pdf
from .interpolant import normalised
from .particle_density import ParticleDensity
from .particles import particles_on

__all__ = ["logarithm", "particle_bound", "regrid", "resample", "times_likelihood"]

_FAINT = -12.0  # logarithm of a Gaussian's weight beside a mixture of kernels

_MOST_NODES = 2e6  # of one lattice; a posterior thinner than that across the axes is resolved less
_ZOOMS = 12
_ZOOM_ENDS = 0.8  # part of its extent that the posterior fills along every axis when zooming in has ended
_NO_OVERLAP = (
    "prior times likelihood is zero wherever the prior has particles: the measurement lies outside them; "
    "check it, use more particles, or, in the paper's scheme, a larger represented_mass and domain_mass"
)


class _Field(NamedTuple):
    """prior(x) * weight(x) on a lattice, with the largest log-weight taken out."""

    lattice: Lattice
    values: np.ndarray
    log_scale: float


class _Candidate(NamedTuple):
    field: _Field
    kept: np.ndarray
    core: np.ndarray
    fitness: float


def resample(density, n_particles=None, config=None):
    """Put a density on a new lattice without a measurement (002 4.7).

    Each time widens the density by the variance c_K h^2 of the kernels it is read through: resample to mend
    a disordered cloud, not as a habit (002 5.3).

    Parameters
    ----------
    density : ParticleDensity
    n_particles : int, optional
        Upper bound of the number of particles; that of the density if not given.
    config : SolverConfig or FilterConfig, optional

    Returns
    -------
    ParticleDensity, ResampleInfo

    Examples
    --------
    >>> import sphfilter as sf
    >>> coarse = sf.initialize(sf.Gaussian([0.0], [[1.0]]), n_particles=50)
    >>> fine, info = sf.resample(coarse, n_particles=200)
    >>> print(coarse.n_particles <= 50 < fine.n_particles == info.n_particles <= 200)
    True
    """
    scheme = (config or SolverConfig()).scheme
    return regrid(density, particle_bound(density, n_particles), scheme)


def logarithm(density):
    """Return log p as a function of states (M, n), defined far outside of the particles too."""
    if density.field is not None:
        return partial(field.at, density.field)
    if density.log_density is not None:
        return normalised(density)
    factor = np.linalg.cholesky(density.cov("points"))
    # A mixture of kernels ends somewhere: a faint Gaussian of the same moments goes on.
    faint = gaussian_log_pdf(density.mean(), factor @ factor.T)
    return lambda X: np.logaddexp(density.logpdf(X), _FAINT + faint(X))


def times_likelihood(density, log_weight, n_particles, scheme, gaussian=False):
    """Density times exp(log_weight(X)) on a lattice that follows its level set, and the log of
    its integral; `gaussian` if it is known to be one.
    """
    depth = 0.5 * lattice_reach(scheme, density.dim) ** 2
    cell = None if density.field is None else density.field.A
    domain = density.domain
    weight = log_weight if domain is None else lambda X: log_weight(domain.wrap(X))
    laid = posterior(density.x, density.mass, logarithm(density), weight, n_particles, depth, cell)
    return ParticleDensity.on_lattice(laid, density.t, n_particles, gaussian, domain), laid.log_mass


def particle_bound(density, n_particles=None):
    """Upper bound of the number of particles at the next re-gridding: as given, else the density's own."""
    if n_particles is not None:
        return count("n_particles", n_particles)
    return density.capacity or density.n_particles


def regrid(density, n_particles, scheme, log_weight=None):
    """Put density times exp(log_weight(X)) on a new lattice and normalise it.

    Raises
    ------
    PropagationError
        The product is zero wherever the density has particles.
    """
    if not isinstance(scheme, PaperScheme):
        return _relaid(density, n_particles, scheme, log_weight)
    measured, domain = log_weight is not None, density.domain
    log_weight = log_weight or (lambda X: np.zeros(len(X)))
    if domain is not None:
        density, log_weight = _unrolled(density), lambda X, given=log_weight: given(domain.wrap(X))
    raw = _weighted_masses(density, log_weight)
    low, high, volume_fraction = _domain(density, raw, log_weight, n_particles, scheme)
    candidates = _candidates(density, raw, log_weight, (low, high), volume_fraction, n_particles, scheme)
    best = min(candidates, key=lambda c: c.fitness)
    lattice, values, log_scale = best.field
    total = values.sum() * lattice.cell_volume
    density_values = _rescale_boundary(values / total, best.kept, best.core, lattice.cell_volume)
    between = _field(density, lattice.half_shifted(), log_weight, log_scale).values / total
    represented = float(values[best.kept].sum() / values.sum())
    represented *= 1.0 if measured else density.represented_mass
    about = {"t": density.t, "represented_mass": represented, "capacity": n_particles, "domain": domain}
    new = particles_on(lattice, density_values, between, best.core, scheme, about)
    info = ResampleInfo(
        n_particles=new.n_particles,
        lattice_dims=tuple(int(d) for d in lattice.dims),
        spacing=tuple(float(s) for s in lattice.spacing),
        n_candidates=len(candidates),
        fitness=float(best.fitness),
        volume_fraction=float(volume_fraction),
        log_evidence=float(np.log(total) + log_scale),
    )
    return new, info


def _relaid(density, n_particles, scheme, log_weight):
    """As `regrid` on a level-set lattice."""
    weight = log_weight or (lambda X: np.zeros(len(X)))
    new, log_evidence = times_likelihood(density, weight, n_particles, scheme)
    span = np.ptp(new.field.node, axis=0) + 1
    info = ResampleInfo(
        n_particles=new.n_particles,
        lattice_dims=tuple(int(d) for d in span),
        spacing=tuple(float(s) for s in np.linalg.norm(new.field.A, axis=0)),
        n_candidates=1,
        fitness=abs(log_evidence) if log_weight is None else 0.0,
        volume_fraction=new.n_particles / float(np.prod(span)),
        log_evidence=log_evidence,
    )
    return new, info


def _unrolled(density):
    """The density with its particles side by side along periodic axes, cut where there are none."""
    x, axes = density.domain.wrap(density.x), list(density.domain.axes)
    for d in np.flatnonzero(density.domain.periodic):
        period = density.domain.period[d]
        along = np.sort(x[:, d])
        gaps = np.diff(along, append=along[0] + period)
        cut = along[np.argmax(gaps)] + 0.5 * gaps.max()
        x[:, d] = cut + (x[:, d] - cut) % period
        axes[d] = "periodic", cut, cut + period
    return replace(density, x=x, domain=Domain(*axes))


def _weighted_masses(density, log_weight):
    """First estimate of the posterior masses, 002 (57) as it must read: m_i l_i / sum_j m_j l_j."""
    log_w = log_weight(density.x)
    if log_w.max() == -np.inf:
        raise PropagationError(_NO_OVERLAP)
    raw = density.mass * np.exp(log_w - log_w.max())
    return raw / raw.sum()


def _field(density, lattice, log_weight, log_scale=None):
    """Interpolated density (16) times the weight on a lattice (002 (58)-(59))."""
    values = lattice.density_of(density.x, density.mass, density.h, density.kernel_code)
    log_w = log_weight(lattice.nodes)
    if log_scale is None:
        log_scale = log_w[values > 0].max(initial=-np.inf)
        if not np.isfinite(log_scale):
            raise PropagationError(_NO_OVERLAP)
    return _Field(lattice, values * np.exp(np.minimum(log_w - log_scale, 700.0)), float(log_scale))


def _least_nodes(n_particles, n):
    """Fewest nodes along an axis: six resolve a Gaussian to rounding, fewer where particles are few."""
    return int(np.clip(0.6 * n_particles ** (1.0 / n), 3, 6))


def _dims(span, n_nodes, volume_fraction, anisotropy, least=2):
    """Nodes per axis for spacings that differ at most by `anisotropy` (002 (50)-(56))."""
    volume_fraction = max(volume_fraction, n_nodes / _MOST_NODES)
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


def _domain(density, raw, log_weight, n_particles, scheme):
    """Extents of the new lattice, and the part of it that the posterior fills (002 (53)-(55)).

    They begin with the particles that hold the mass, as in 002, and close in on the test-grid nodes that do
    where the weight is narrower than the particles' spacing.
    """
    least = _least_nodes(n_particles, density.dim)
    kept = density.x[heaviest(raw, scheme.domain_mass)]
    support = density.mean_support
    low, high = kept.min(axis=0), kept.max(axis=0)
    widen = np.maximum(0.5 * (support - (high - low)), 0.0)  # a single row of particles still has width
    low, high = low - widen, high + widen
    if density.domain is not None:
        low, high = density.domain.within(low, high, support)
    for _ in range(_ZOOMS):
        dims = _dims(high - low, n_particles, 1.0, scheme.anisotropy, least)
        lattice = Lattice.spanning(low, high, dims, density.domain)
        filled = heaviest(_field(density, lattice, log_weight).values, scheme.domain_mass)
        nodes = lattice.nodes[filled]
        inner_low = np.maximum(low, nodes.min(axis=0) - lattice.spacing)
        inner_high = np.minimum(high, nodes.max(axis=0) + lattice.spacing)
        if np.all(inner_high - inner_low > _ZOOM_ENDS * (high - low)):
            break
        low, high = inner_low, inner_high
    return low, high, filled.mean()


def _candidates(density, raw, log_weight, extents, volume_fraction, n_particles, scheme):
    """The central discretisation and its neighbours, one node more or less along each axis (002 4.7.3)."""
    low, high = extents
    n, domain = density.dim, density.domain
    cov = _covariance(density.x, raw)
    core_ratio = _core_ratio(density.mass, scheme)
    least = _least_nodes(n_particles, n)
    dims = _dims(high - low, n_particles, volume_fraction, scheme.anisotropy, least)
    steps = [np.zeros(n, int), *np.eye(n, dtype=int), *-np.eye(n, dtype=int)]
    while True:
        tried = [
            _candidate(
                density, log_weight, Lattice.spanning(low, high, dims + step, domain), cov, core_ratio, scheme
            )
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


def _candidate(density, log_weight, lattice, cov, core_ratio, scheme):
    """A candidate's fitness: error of its raw covariance times error of its core-to-domain ratio."""
    field = _field(density, lattice, log_weight)
    kept = heaviest(field.values, scheme.domain_mass)
    core = heaviest(field.values, scheme.represented_mass)
    mass = field.values[kept] / field.values[kept].sum()
    off = _covariance(lattice.nodes[kept], mass) - cov
    cov_error = np.sqrt(np.mean(off**2)) / np.trace(cov) if np.trace(cov) > 0 else 0.0
    ratio_error = abs(core.sum() / kept.sum() - core_ratio)
    return _Candidate(field, kept, core & kept, cov_error * ratio_error)


def _spans(candidate):
    """Do the kept nodes stand at three places at least along every axis?"""
    axes = range(len(candidate.field.lattice.dims))
    kept = candidate.kept.reshape(candidate.field.lattice.dims)
    return all(kept.any(axis=tuple(a for a in axes if a != axis)).sum() >= 3 for axis in axes)


def _core_ratio(mass, scheme):
    """Particles that hold P_T over particles that hold the whole simulated mass."""
    return heaviest(mass, scheme.represented_mass).sum() / heaviest(mass, scheme.domain_mass).sum()


def _covariance(x, mass):
    d = x - mass @ x
    return (d * mass[:, None]).T @ d


def _rescale_boundary(values, kept, core, cell_volume):
    """Scale the boundary particles so that the trimmed density has mass one again (002 4.7.3)."""
    boundary = kept & ~core
    values = values * kept
    in_core, at_boundary = values[core].sum() * cell_volume, values[boundary].sum() * cell_volume
    if at_boundary > 0.0 and in_core < 1.0:
        values[boundary] *= (1.0 - in_core) / at_boundary
    else:
        values /= in_core + at_boundary
    return values
