"""Initial densities: a Gaussian, a uniform box, or any pdf with a box, put on particles."""

import logging
import math
from dataclasses import replace
from functools import cache
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from .._types import Floats, OfStates
from ..config import AnyConfig, CloudScheme, FilterConfig, LogDensityScheme, PaperScheme, Scheme, SolverConfig
from ..core.family.rules import MOST, degrees
from ..core.field.walls import NO_WALLS
from ..core.limits import EDGE
from ..core.sph.kernels import Kernel
from ..errors import ModelError, PropagationError
from ..lattice.check import deep_enough, misfit, remote
from ..lattice.field import inside_lattice
from ..lattice.level_set import enough_particles, fewest_particles, lattice_depth, lay, min_nodes
from ..lattice.regular import Lattice, heaviest, place_gaussian
from ..model.domain import Domain, DomainLike
from ..validate import array, choice, count, real, row
from .distributions import Gaussian, Uniform, check_within, checked_box, gaussian_log_pdf
from .family import gaussian_family, particles_of
from .memory import Memory, max_particles
from .particle_density import ParticleDensity
from .particles import particles_on, particles_with

__all__ = ["Gaussian", "Uniform", "initialize", "on_equal_lattice"]

#: What a density may start from; a callable is a pdf of states (M, n).
Distribution: TypeAlias = Gaussian | Uniform | OfStates

_LOGGER = logging.getLogger("sphfilter")
_MISSING = 0.05  # of the variance of a Gaussian, from which it is said: √.95 = .975 of its deviation is left
_TRIES = 5  # numbers of nodes, each twice the one before, for a target error: up to 2⁴ = 16 times the first
_MOST_TRIED = 300  # nodes of a box, over the particles wanted: √300 = 17 times as wide in two states
_COARSE = 5000  # particles that a callable pdf is first looked at with: √5000 = 71 along each of two axes
#: Probability that is left out: 10,000 standard deviations off it moves a mean by 1e4 · 1e-6 = .01 of one.
NEGLIGIBLE = 1e-6
#: Kernels of a density that no scheme asks kernels of: smooth, and not fitted.
_PLAIN = PaperScheme(kernel="wendland_c2", support_steps=1)


def initialize(
    distribution: Distribution,
    n_particles: int | Literal["auto"] | None = None,
    config: AnyConfig | None = None,
    *,
    box: ArrayLike | None = None,
    spacing: ArrayLike | None = None,
    t: float = 0.0,
    domain: DomainLike = None,
) -> ParticleDensity:
    """Put a distribution on particles (002 sections 4.1, 4.2 and 4.6).

    Parameters
    ----------
    distribution : Gaussian, Uniform, or callable pdf(X (M, n)) -> (M,)
        A callable need not be normalised, and needs `box`.
    n_particles : int or "auto", optional
        Upper bound of the number of particles: a lattice cannot hit a number. With "auto", the default but
        for a `spacing`, the steps that follow choose how the density is represented, by a target error.
    config : SolverConfig or FilterConfig, optional
    box : array_like, shape (n, 2), optional
        Where a callable pdf is not negligible; with a `spacing`, where a Gaussian is put on particles.
    spacing : float or array_like, shape (n,), optional
        Spacing of a lattice with nodes at both ends of the box, or the next smaller one that fits: all nodes
        where the pdf is not zero carry a particle, of the density times the volume of a cell (000 5.2.3). For
        schemes that take particles as they lie: "paper", "cloud" and "auto".
    t : float
        Time of the density, seconds.
    domain : Domain, or sequence of its axes, optional
        Domain of the model, if it has periodic axes or walls. The density is cut off at walls, and summed
        over the turns of an angle.

    Returns
    -------
    ParticleDensity

    Raises
    ------
    ModelError
        Neither or too small a number of particles, a box or spacing that cannot be one, a pdf that is
        negative, not finite or zero everywhere.

    Examples
    --------
    >>> import numpy as np
    >>> import sphfilter as sf
    >>> normal = sf.initialize(sf.Gaussian([1.0, 0.0], np.eye(2)), n_particles=200)
    >>> print(normal.n_particles <= 200, normal.cov().round(3).tolist())
    True [[1.0, 0.0], [0.0, 1.0]]
    >>> two = sf.initialize(lambda X: np.exp(-((X[:, 0] ** 2 - 4) ** 2)), n_particles=100, box=[[-4, 4]])
    >>> print(two.cov().round(2))
    [[3.93]]
    """
    scheme = (config or SolverConfig()).scheme
    if isinstance(distribution, Gaussian):
        check_within(distribution, Domain.of(domain, len(distribution.mean)).walls)
    if isinstance(n_particles, str):
        choice("n_particles", n_particles, ["auto"])
    bound = max_particles("auto" if n_particles is None else n_particles, config)
    if isinstance(scheme, CloudScheme) and spacing is None and (start := _as_family(distribution, t, domain)):
        return start.noted(capacity=bound)
    if spacing is not None and not isinstance(n_particles, str):
        return _spaced(distribution, n_particles, scheme, box, spacing, t, domain)
    if isinstance(bound, str):
        return _to_target(distribution, box, config, t, domain)
    n_particles, box = count("n_particles", bound), _box_of(distribution, box)
    domain = _bounds(domain, box)
    if not isinstance(scheme, PaperScheme):
        if not isinstance(distribution, Uniform) and (domain is None or isinstance(distribution, Gaussian)):
            try:
                return _on_level_set(distribution, box, n_particles, scheme, t, domain)
            except PropagationError as problem:
                if n_particles >= fewest_particles(n := len(box)):
                    raise
                raise ModelError(
                    f"n_particles = {n_particles} is too small for {n} states: {problem}"
                ) from None
        if domain is None and isinstance(distribution, Uniform):
            return _uniform(distribution, box, n_particles, t)  # edges have no smooth logarithm
        scheme = PaperScheme(kernel="wendland_c2")
    if isinstance(distribution, Gaussian) and domain is None:
        return _from_gaussian(distribution, n_particles, scheme, t)
    pdf, box = _seen_from(distribution, box, domain)
    return _from_pdf(pdf, box, n_particles, scheme, t, domain)


def _to_target(
    distribution: Distribution, box: ArrayLike | None, config: AnyConfig | None, t: float, domain: DomainLike
) -> ParticleDensity:
    """A Gaussian as one family, another distribution on as many nodes as a target error asks for."""
    n = len(_box_of(distribution, box))
    known = Domain.of(domain, n)
    ladder = config is None or config.scheme == "auto"
    if ladder and not degrees(n):
        raise ModelError(
            f'n_particles="auto" carries densities of up to {MOST} states, and {n} are more: leave some out '
            f"of the model"
        )
    smooth = isinstance(config, FilterConfig) and config.density_error is not None
    if ladder and (start := _as_family(distribution, t, known)):
        return start.noted(needs=Memory(smooth=smooth))
    target = config.target_error if isinstance(config, FilterConfig) else FilterConfig().target_error
    nodes = min_nodes(n)
    for _ in range(_TRIES):
        density = initialize(distribution, nodes, config, box=box, t=t, domain=domain)
        if not density.error > 0.5 * target:
            break
        nodes *= 2
    return replace(density, needs=Memory(nodes=nodes, smooth=smooth), capacity=nodes)


def _as_family(distribution: Distribution, t: float, domain: DomainLike) -> ParticleDensity | None:
    """A Gaussian that no wall cuts, as one family."""
    if not isinstance(distribution, Gaussian):
        return None
    known = Domain.of(domain, len(distribution.mean))
    if known.walled.any():
        return None
    start = gaussian_family(distribution.mean, distribution.cov, 2)
    about: dict[str, Any] = {"t": t, "gaussian": known.unbounded, "domain": known}
    return ParticleDensity(**particles_of(start), **about)


def _bounds(domain: DomainLike, box: Floats) -> Domain | None:
    """The domain of a density whose states are those of a box; None if it has no bounds."""
    domain = Domain.of(domain, len(box))
    return None if domain.unbounded else domain


def _seen_from(distribution: Distribution, box: Floats, domain: Domain | None) -> tuple[OfStates, Floats]:
    """The pdf of a distribution inside a domain, and the part of its box there."""
    pdf = distribution.pdf if isinstance(distribution, Gaussian | Uniform) else distribution
    if domain is not None:
        if isinstance(distribution, Gaussian):
            pdf = _all_turns(pdf, domain, box)
        low, high = box.T
        box = np.transpose(domain.within(low, high, 0.0))
    return pdf, checked_box(box)


def _spaced(
    distribution: Distribution,
    n_particles: int | None,
    scheme: Scheme,
    box: ArrayLike | None,
    spacing: ArrayLike,
    t: float,
    domain: DomainLike,
) -> ParticleDensity:
    """All nodes of a given lattice on which a distribution is not zero."""
    if isinstance(scheme, LogDensityScheme):
        raise ModelError(
            'spacing is for schemes "paper", "cloud" and "auto": "log_density" lays lattices of its own'
        )
    box = _box_of(distribution, box) if box is None else checked_box(box)
    domain = _bounds(domain, box)
    pdf, box = _seen_from(distribution, box, domain)
    low, high = box.T
    lattice = Lattice.spaced(low, high, _spacings(spacing, box), domain)
    values = _values(pdf, lattice)
    scale, kept = values.sum() * lattice.cell_volume, int(np.count_nonzero(values))
    if n_particles is not None and kept > count("n_particles", n_particles):
        raise ModelError(
            f"spacing = {spacing!s} lays {kept} particles, more than n_particles = {n_particles}: leave one "
            f"of the two out"
        )
    about = {"t": t, "capacity": kept if n_particles is None else n_particles, "domain": domain}
    if not isinstance(scheme, PaperScheme):
        scheme = _PLAIN
    first, last = scheme.support_range
    if first == last or scheme.support_steps == 1:  # nothing to choose from
        h = first * lattice.cell_volume ** (1.0 / len(box)) / Kernel.of(scheme.kernel, len(box)).radius
        return particles_with(h, lattice, values / scale, scheme, about)
    between = np.asarray(pdf(lattice.half_shifted().nodes), dtype=float) / scale
    return particles_on(lattice, values / scale, between, values > 0, scheme, about)


def _spacings(spacing: ArrayLike, box: Floats) -> Floats:
    """A spacing for each axis of a box, shape (n,)."""
    n, sides = len(box), box[:, 1] - box[:, 0]
    scalar = np.ndim(spacing) == 0
    spacing = np.full(n, real("spacing", spacing)) if scalar else array("spacing", spacing, (n,))
    if np.any(spacing <= 0.0) or np.any(spacing > sides * (1.0 + 1e-12)):
        raise ModelError(
            f"spacing must be positive and no longer than the sides of the box, {row(sides)}, "
            f"got {row(spacing)}"
        )
    return spacing


def _uniform(distribution: Uniform, box: Floats, n_particles: int, t: float) -> ParticleDensity:
    """Particles of a uniform density with its variance, which cell centres alone have too little of."""
    density = _from_pdf(distribution.pdf, box, n_particles, _PLAIN, t)
    centre, actual = box.mean(axis=1), np.diag(density.cov("points"))
    stretch = np.sqrt((box[:, 1] - box[:, 0]) ** 2 / 12.0 / actual)
    return replace(density, x=centre + stretch * (density.x - centre))


def on_equal_lattice(density: ParticleDensity, n_particles: int, scheme: PaperScheme) -> ParticleDensity:
    """Put a density that knows its pdf anywhere on a lattice of equal spacings, for sums over kernels."""
    low, high = density.x.min(axis=0) - density.h[0], density.x.max(axis=0) + density.h[0]
    domain = density.domain
    if domain is not None:
        low, high = domain.within(low, high, 0.0)
    return _from_pdf(density.pdf, np.transpose([low, high]), n_particles, scheme, density.t, domain)


def _box_of(distribution: Distribution, box: ArrayLike | None) -> Floats:
    """Where a distribution is not negligible, shape (n, 2)."""
    if isinstance(distribution, Gaussian):
        half = EDGE * np.sqrt(np.diag(distribution.cov))
        return np.transpose([distribution.mean - half, distribution.mean + half])
    if isinstance(distribution, Uniform):
        return distribution.box
    if box is None or not callable(distribution):
        raise ModelError("initialize takes a Gaussian, a Uniform, or a callable pdf with box=, shape (n, 2)")
    return checked_box(box)


def _all_turns(pdf: OfStates, domain: Domain, box: Floats) -> OfStates:
    """A pdf summed over the turns of periodic axes that its box reaches."""
    shifts = np.zeros((1, domain.dim))
    for d in np.flatnonzero(domain.periodic):
        turns = 1 + int(np.ceil((box[d, 1] - box[d, 0]) / domain.period[d]))
        steps = np.arange(-turns, turns + 1)[:, None] * domain.period[d] * np.eye(domain.dim)[d]
        shifts = (shifts[:, None] + steps).reshape(-1, domain.dim)
    return lambda X: np.sum([pdf(X + shift) for shift in shifts], axis=0)


def _on_level_set(
    distribution: Gaussian | OfStates,
    box: Floats,
    n_particles: int,
    scheme: Scheme,
    t: float,
    domain: Domain | None,
) -> ParticleDensity:
    """A smooth density on a lattice that follows its level set."""
    depth = lattice_depth(scheme, len(box))
    if isinstance(distribution, Gaussian):
        mean, cov = distribution.mean, distribution.cov
        factor: Any = np.linalg.cholesky(cov)
        walls = NO_WALLS if domain is None else domain.walls
        log_pdf, seed = gaussian_log_pdf(mean, cov), np.clip(mean, *walls) if walls[0].size else mean
        laid = lay(log_pdf, mean, factor, seed[None], n_particles, depth, walls=walls)
        whole = not walls[0].size
        if whole:
            kept = float(np.trace(np.linalg.solve(cov, laid.cov))) / len(mean)
            _say_what_is_missing(len(mean), n_particles, round(kept, 2))  # no difference by rounding
        residual = 0.0 if whole else misfit(laid, log_pdf).residual
        return ParticleDensity.on_lattice(laid, t, n_particles, whole, domain, residual=residual)
    seen = PaperScheme(represented_mass=1.0 - NEGLIGIBLE)
    coarse = _from_pdf(distribution, box, max(n_particles, _COARSE), seen, t)

    def log_p(X: Floats) -> Floats:
        with np.errstate(divide="ignore"):
            return np.maximum(np.log(np.asarray(distribution(X), dtype=float)), -1e250)

    factor = np.linalg.cholesky(coarse.cov("points"))
    if not getattr(scheme, "reach", None):
        depth = deep_enough(log_p(coarse.x), coarse.x, coarse.mass, depth)
    seeds = coarse.x[coarse.mass > coarse.mass.max() * np.exp(-depth)]
    laid = lay(log_p, coarse.mean(), factor, seeds, n_particles, depth)
    off, beyond = misfit(laid, log_p), ~inside_lattice(laid.field, coarse.x)
    far = remote(laid.mean, laid.cov, coarse.x[beyond], coarse.mass[beyond])
    error = math.hypot(off.mean, far.mean, 0.5 * far.variance)  # a part of the variance, as one of its root
    return ParticleDensity.on_lattice(laid, t, n_particles, residual=off.residual, error=error)


@cache
def _say_what_is_missing(n: int, n_particles: int, kept: float) -> None:
    """Say it, once, where a lattice has only a part of the variance that a Gaussian came with."""
    if abs(kept - 1.0) > _MISSING:
        _LOGGER.warning(
            "%d particles hold an initial Gaussian of %d states with %.2g of its variance; use about %d%s",
            n_particles,
            n,
            kept,
            enough_particles(n),
            ', or n_particles="auto"' if degrees(n) else "",
        )


def _from_gaussian(gaussian: Gaussian, n_particles: int, scheme: PaperScheme, t: float) -> ParticleDensity:
    place = place_gaussian(gaussian.mean, gaussian.cov, n_particles, scheme)
    lattice = place.lattice
    values, between = gaussian.pdf(lattice.nodes) * place.kept, gaussian.pdf(lattice.half_shifted().nodes)
    represented = min(float(values.sum() * lattice.cell_volume), 1.0)
    about = {"t": t, "represented_mass": represented, "capacity": n_particles}
    return particles_on(lattice, values, between, place.core, scheme, about)


def _values(pdf: OfStates, lattice: Lattice) -> Floats:
    """A pdf at the nodes of a lattice, shape (M,)."""
    values = np.asarray(pdf(lattice.nodes), dtype=float)
    if values.shape != (len(lattice.nodes),) or not np.all(np.isfinite(values)) or values.min() < 0:
        raise ModelError("pdf must return one finite density >= 0 for each row of its argument")
    if values.sum() <= 0:
        raise ModelError("pdf is zero everywhere in its box")
    return values


def _from_pdf(
    pdf: OfStates, box: Floats, n_particles: int, scheme: PaperScheme, t: float, domain: Domain | None = None
) -> ParticleDensity:
    """Cells of equal width over the box, particles at their centres, lowest masses dropped."""
    span = box[:, 1] - box[:, 0]
    for shrink in np.geomspace(0.25, 4.0, 80):
        dx = shrink * (np.prod(span) / n_particles) ** (1.0 / len(span))
        dims = np.maximum(np.ceil(span / dx).astype(int), 2)
        if np.prod(dims.astype(float)) > _MOST_TRIED * n_particles:
            continue
        lattice = Lattice(box[:, 0] + 0.5 * span / dims, span / dims, dims, domain)
        values = _values(pdf, lattice)
        kept = heaviest(values, scheme.represented_mass)
        if kept.sum() <= n_particles:
            scale = values.sum() * lattice.cell_volume
            between = np.asarray(pdf(lattice.half_shifted().nodes), dtype=float) / scale
            represented = float(values[kept].sum() / values.sum())
            about = {"t": t, "represented_mass": represented, "capacity": n_particles, "domain": domain}
            return particles_on(lattice, values * kept / scale, between, kept, scheme, about)
    raise ModelError(f"n_particles = {n_particles} is too small for {len(span)} states; use more")
