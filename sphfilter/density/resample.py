"""Re-gridding: a density, or its product with a likelihood, on a new regular lattice (002 4.7 and 6.1)."""

import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from .._types import Bools, Floats, OfStates
from ..config import AnyConfig, FilterConfig, LogDensityScheme, PaperScheme, Scheme, SolverConfig
from ..core.limits import LARGEST_EXPONENT
from ..errors import ModelError, PropagationError
from ..info import ResampleInfo
from ..lattice.candidates import NO_OVERLAP, Product, Sought, best_candidate
from ..lattice.check import Misfit, misfit
from ..lattice.level_set import lattice_depth, min_nodes
from ..lattice.posterior import posterior
from ..lattice.regular import Lattice
from ..lattice.resolved import Resolved, Search, resolved
from ..lattice.walls import continued
from ..model.domain import Domain
from ..validate import count
from .distributions import gaussian_log_pdf
from .particle_density import ParticleDensity
from .particles import particles_on

_FAINT = -12.0  # logarithm of a Gaussian's weight beside a mixture of kernels: exp(-12) = 6e-6


def resample(
    density: ParticleDensity, n_particles: int | None = None, config: AnyConfig | None = None
) -> tuple[ParticleDensity, ResampleInfo]:
    """Put a density on a new lattice without a measurement (002 4.7).

    Every re-gridding widens the density by the variance c_K h^2 of the kernels it is read through: resample
    to mend a disordered cloud, not as a habit (002 5.3).

    Parameters
    ----------
    density : ParticleDensity
    n_particles : int, optional
        Upper bound of the number of particles; the density's own if not given.
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
    bound = max_particles_of(density, n_particles)
    return regrid(on_lattice(density, bound), bound, scheme)


def logarithm(density: ParticleDensity) -> OfStates:
    """Return log p as a function of states (M, n), defined far outside of the particles too."""
    if density.form.smooth:
        return density.form.bare.logpdf
    factor = np.linalg.cholesky(density.cov("points"))
    # A mixture of kernels ends somewhere: a faint Gaussian of the same moments goes on.
    faint = gaussian_log_pdf(density.mean(), factor @ factor.T)
    return lambda X: np.logaddexp(density.logpdf(X), _FAINT + faint(X))


def no_weight(X: Floats) -> Floats:
    """Log-likelihood (M,) of states X (M, n) where nothing was read."""
    return np.zeros(len(X))


def times_likelihood(
    density: ParticleDensity,
    log_weight: OfStates,
    n_particles: int,
    scheme: Scheme,
    gaussian: bool = False,
    search: Search | None = None,
) -> tuple[ParticleDensity, float, Resolved]:
    """Density times exp(log_weight(X)) on a lattice that follows its level set, the log of its integral, and
    what the lattice gets wrong; `gaussian` if it is known to be one, `search` if it is to be laid again where
    it overlooks something.
    """
    depth = lattice_depth(scheme, density.dim)
    cell, domain = density.form.cell, density.domain
    walls, weight, log_p = density.walls, log_weight, folded_logarithm(density)
    if domain is not None:
        weight = continued(lambda X: log_weight(domain.wrap(X)), walls)

    def product(X: Floats) -> Floats:
        return log_p(X) + np.maximum(weight(X), -1e250)

    try:
        laid: Any = posterior(density.x, density.mass, log_p, weight, n_particles, depth, cell, walls)
    except PropagationError as problem:
        if search is None:
            raise
        laid = problem
    if gaussian:
        found = Resolved(laid, Misfit(0.0, 0.0, 0.0))
    elif search is None:
        found = Resolved(laid, misfit(laid, product))
    else:
        prior = density.x, density.mass, density.field
        search = search._replace(walls=walls)
        found = resolved(laid, prior, product, weight, (n_particles, depth), search)
    known = {"residual": found.off.residual}
    new = ParticleDensity.on_lattice(found.laid, density.t, n_particles, gaussian, domain, **known)
    return new, found.laid.log_mass - math.log1p(-found.left_out), found


def folded_logarithm(density: ParticleDensity) -> OfStates:
    """As `logarithm`, of states inside of the walls of a domain where kernels have images beyond these."""
    log_p, domain = logarithm(density), density.domain
    if domain is None or density.form.smooth or not density.walls[0].size:
        return log_p
    return lambda X: log_p(domain.fold(X))


def max_particles_of(density: ParticleDensity, n_particles: int | str | None = None) -> int:
    """Upper bound of the number of particles at the next re-gridding: as given, else the density's own."""
    if isinstance(n_particles, str):
        if n_particles != "auto":
            raise ModelError(f'n_particles must be a whole number or "auto", got {n_particles!r}')
        nodes = 0 if density.needs is None else density.needs.nodes
        return nodes or min_nodes(density.dim)
    if n_particles is not None:
        return count("n_particles", n_particles)
    return density.capacity or density.form.nodes(density.n_particles)


def target_of(density: ParticleDensity, config: AnyConfig, n_particles: int | str | None) -> float | None:
    """Target error of a step, rms over the states; None where a number of particles or a scheme decides."""
    asked = n_particles == "auto" or (n_particles is None and density.needs is not None)
    if not asked or not (config.scheme == "auto" or isinstance(config.scheme, LogDensityScheme)):
        return None
    whole = config if isinstance(config, FilterConfig) else FilterConfig()
    least = math.inf if whole.density_error is None else whole.density_error
    return min(whole.target_error, least)


def on_lattice(density: ParticleDensity, n_particles: int) -> ParticleDensity:
    """A density that is one family, or pieces, on a lattice; another as it is."""
    laid = density.form.bare.on_lattice(n_particles)
    if laid is None:
        return density
    about = density.t, density.capacity, density.gaussian, density.domain
    error, lost, rough = density.error, density.lost, density.rough
    return ParticleDensity.on_lattice(laid, *about, error=error, lost=lost, rough=rough)


def regrid(
    density: ParticleDensity, n_particles: int, scheme: Scheme, log_weight: OfStates | None = None
) -> tuple[ParticleDensity, ResampleInfo]:
    """Put density times exp(log_weight(X)) on a new lattice and normalise it.

    Raises `PropagationError` if the product is zero wherever the density has particles.
    """
    if not isinstance(scheme, PaperScheme):
        return _relaid(density, n_particles, scheme, log_weight)
    measured, domain = log_weight is not None, density.domain
    log_weight = log_weight or no_weight
    if domain is not None:
        density, log_weight = _unrolled(density, domain), lambda X, given=log_weight: given(domain.wrap(X))
    raw, product = _weighted_masses(density, log_weight), partial(_product, density, log_weight)
    sought = Sought(density.x, density.mass, raw, density.mean_support, density.domain, product)
    best, n_candidates, volume_fraction = best_candidate(sought, n_particles, scheme)
    lattice, values, log_scale = best.product
    total = values.sum() * lattice.cell_volume
    density_values = _rescale_boundary(values / total, best.kept, best.core, lattice.cell_volume)
    between = product(lattice.half_shifted(), log_scale).values / total
    represented = float(values[best.kept].sum() / values.sum())
    represented *= 1.0 if measured else density.represented_mass
    about = {"t": density.t, "represented_mass": represented, "capacity": n_particles, "domain": domain}
    new = particles_on(lattice, density_values, between, best.core, scheme, about)
    info = ResampleInfo(
        n_particles=new.n_particles,
        lattice_dims=tuple(int(d) for d in lattice.dims),
        spacing=tuple(float(s) for s in lattice.spacing),
        n_candidates=n_candidates,
        fitness=float(best.fitness),
        volume_fraction=float(volume_fraction),
        log_evidence=float(np.log(total) + log_scale),
    )
    return new, info


def _relaid(
    density: ParticleDensity, n_particles: int, scheme: Scheme, log_weight: OfStates | None
) -> tuple[ParticleDensity, ResampleInfo]:
    """As `regrid` on a level-set lattice."""
    new, log_evidence, _ = times_likelihood(density, log_weight or no_weight, n_particles, scheme)
    laid: Any = new.field
    span = np.ptp(laid.node, axis=0) + 1
    info = ResampleInfo(
        n_particles=new.n_particles,
        lattice_dims=tuple(int(d) for d in span),
        spacing=tuple(float(s) for s in np.linalg.norm(laid.A, axis=0)),
        n_candidates=1,
        fitness=abs(log_evidence) if log_weight is None else 0.0,
        volume_fraction=new.n_particles / float(np.prod(span)),
        log_evidence=log_evidence,
    )
    return new, info


def _unrolled(density: ParticleDensity, domain: Domain) -> ParticleDensity:
    """The density with its particles side by side along periodic axes, cut where there are none."""
    x, axes = domain.wrap(density.x), list(domain.axes)
    for d in np.flatnonzero(domain.periodic):
        period = domain.period[d]
        along = np.sort(x[:, d])
        gaps = np.diff(along, append=along[0] + period)
        cut = along[np.argmax(gaps)] + 0.5 * gaps.max()
        x[:, d] = cut + (x[:, d] - cut) % period
        axes[d] = "periodic", cut, cut + period
    return replace(density, x=x, domain=Domain(*axes))


def _weighted_masses(density: ParticleDensity, log_weight: OfStates) -> Floats:
    """First estimate of the posterior masses, 002 (57) as it must read: m_i l_i / sum_j m_j l_j."""
    log_w = log_weight(density.x)
    if log_w.max() == -np.inf:
        raise PropagationError(NO_OVERLAP)
    raw = density.mass * np.exp(log_w - log_w.max())
    return raw / raw.sum()


def _product(
    density: ParticleDensity, log_weight: OfStates, lattice: Lattice, log_scale: float | None = None
) -> Product:
    """Interpolated density (16) times the weight on a lattice (002 (58)-(59))."""
    values = lattice.density_of(density.x, density.mass, density.h, density.sph_kernel)
    log_w = log_weight(lattice.nodes)
    if log_scale is None:
        log_scale = log_w[values > 0].max(initial=-np.inf)
        if not np.isfinite(log_scale):
            raise PropagationError(NO_OVERLAP)
    weight = np.exp(np.minimum(log_w - log_scale, LARGEST_EXPONENT))
    return Product(lattice, values * weight, float(log_scale))


def _rescale_boundary(values: Floats, kept: Bools, core: Bools, cell_volume: float) -> Floats:
    """Scale the boundary particles so that the trimmed density has mass one again (002 4.7.3)."""
    boundary = kept & ~core
    values = values * kept
    in_core, at_boundary = values[core].sum() * cell_volume, values[boundary].sum() * cell_volume
    if at_boundary > 0.0 and in_core < 1.0:
        values[boundary] *= (1.0 - in_core) / at_boundary
    else:
        values /= in_core + at_boundary
    return values
