"""Initial densities: a Gaussian, a uniform box, or any pdf with a box, put on particles."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from .config import PaperScheme, SolverConfig
from .density import ParticleDensity
from .domain import Domain
from .errors import ModelError, PropagationError
from .exact import gaussian_log_pdf
from .lattice import Lattice, heaviest, particles_on, place_gaussian
from .level_set import fewest_particles, lay, reach
from .validate import array, count, covariance

__all__ = ["Gaussian", "Uniform", "initialize", "spread"]

_FAR = 6.0  # standard deviations within which a Gaussian is put on a domain with ends
_MOST_TRIED = 300  # nodes of a box, over the number of particles wanted
_COARSE = 2000  # particles a callable pdf is first looked at with


@dataclass(frozen=True)
class Gaussian:
    """Normal distribution with mean (n,) and covariance (n, n), positive definite."""

    mean: np.ndarray
    cov: np.ndarray

    def __post_init__(self):
        mean = array("mean", self.mean, (None,))
        object.__setattr__(self, "mean", mean)
        object.__setattr__(self, "cov", covariance("cov", self.cov, dim=len(mean)))

    def pdf(self, X):
        """Density at the states X (M, n)."""
        return np.atleast_1d(stats.multivariate_normal(self.mean, self.cov).pdf(X))


@dataclass(frozen=True)
class Uniform:
    """Uniform distribution on a box (n, 2) of lower and upper bounds."""

    box: np.ndarray

    def __post_init__(self):
        object.__setattr__(self, "box", checked_box(self.box))

    def pdf(self, X):
        """Density at the states X (M, n)."""
        inside = np.all((self.box[:, 0] <= X) & (self.box[:, 1] >= X), axis=1)
        return inside / np.prod(self.box[:, 1] - self.box[:, 0])


def checked_box(box):
    """Return `box` as an array (n, 2) whose bounds rise, or raise `ModelError`."""
    box = array("box", box, (None, 2))
    if np.any(box[:, 1] <= box[:, 0]):
        raise ModelError(f"box must hold (low, high) with low < high for every state, got {box.tolist()}")
    return box


def initialize(distribution, n_particles, config=None, *, box=None, t=0.0, domain=None):
    """Put a distribution on particles (002 sections 4.1, 4.2 and 4.6).

    Parameters
    ----------
    distribution : Gaussian, Uniform, or callable pdf(X (M, n)) -> (M,)
        A callable need not be normalised, and needs `box`.
    n_particles : int
        Upper bound of the number of particles: a lattice cannot hit a number.
    config : SolverConfig or FilterConfig, optional
    box : array_like, shape (n, 2), optional
        Where a callable pdf is not negligible.
    t : float
        Time of the density, seconds.
    domain : Domain, or sequence of its axes, optional
        That of the model, if it has periodic axes or walls. The density is cut off at walls, and summed over
        the turns of an angle.

    Returns
    -------
    ParticleDensity
    """
    scheme = (config or SolverConfig()).scheme
    n_particles = count("n_particles", n_particles)
    gaussian, box = isinstance(distribution, Gaussian), _box_of(distribution, box)
    domain = None if domain is None else Domain.of(domain, len(box))
    domain = None if domain is None or domain.unbounded else domain
    smooth = not isinstance(distribution, Uniform) and (
        domain is None or (gaussian and not domain.walled.any())
    )
    if not isinstance(scheme, PaperScheme):
        if smooth:
            return _on_level_set(distribution, box, n_particles, scheme, t, domain)
        if domain is None:
            return _for_corrected(distribution, box, n_particles, t)  # edges have no smooth logarithm
        scheme = PaperScheme(kernel="wendland_c2")
    if gaussian and domain is None:
        return _from_gaussian(distribution, n_particles, scheme, t)
    pdf = distribution.pdf if isinstance(distribution, Gaussian | Uniform) else distribution
    if domain is not None:
        if gaussian:
            pdf = _all_turns(pdf, domain, box)
        box = np.transpose(domain.within(*box.T, 0.0))
    return _from_pdf(pdf, checked_box(box), n_particles, scheme, t, domain)


def _for_corrected(distribution, box, n_particles, t):
    """Particles of a uniform density with its variance, which cell centres alone have too little of."""
    # moment-corrected SPH finds lengths of its own
    scheme = PaperScheme(kernel="wendland_c2", support_steps=1)
    density = _from_pdf(distribution.pdf, box, n_particles, scheme, t)
    centre, actual = box.mean(axis=1), np.diag(density.cov("points"))
    stretch = np.sqrt((box[:, 1] - box[:, 0]) ** 2 / 12.0 / actual)
    return replace(density, x=centre + stretch * (density.x - centre))


def spread(density, n_particles, scheme):
    """Put a density that knows its pdf anywhere on a lattice of equal spacings, for sums over kernels."""
    low, high = density.x.min(axis=0) - density.h[0], density.x.max(axis=0) + density.h[0]
    domain = density.domain
    if domain is not None:
        low, high = domain.within(low, high, 0.0)
    return _from_pdf(density.pdf, np.transpose([low, high]), n_particles, scheme, density.t, domain)


def _box_of(distribution, box):
    """Where a distribution is not negligible, shape (n, 2)."""
    if isinstance(distribution, Gaussian):
        half = _FAR * np.sqrt(np.diag(distribution.cov))
        return np.transpose([distribution.mean - half, distribution.mean + half])
    if isinstance(distribution, Uniform):
        return distribution.box
    if box is None or not callable(distribution):
        raise ModelError("initialize takes a Gaussian, a Uniform, or a callable pdf with box=, shape (n, 2)")
    return checked_box(box)


def _all_turns(pdf, domain, box):
    """A pdf summed over the turns of periodic axes that its box reaches."""
    shifts = np.zeros((1, domain.dim))
    for d in np.flatnonzero(domain.periodic):
        turns = 1 + int(np.ceil((box[d, 1] - box[d, 0]) / domain.period[d]))
        steps = np.arange(-turns, turns + 1)[:, None] * domain.period[d] * np.eye(domain.dim)[d]
        shifts = (shifts[:, None] + steps).reshape(-1, domain.dim)
    return lambda X: np.sum([pdf(X + shift) for shift in shifts], axis=0)


def _on_level_set(distribution, box, n_particles, scheme, t, domain):
    """A smooth density on a lattice that follows its level set."""
    depth = 0.5 * reach(scheme, len(box)) ** 2
    if isinstance(distribution, Gaussian):
        mean, cov = distribution.mean, distribution.cov
        log_p = gaussian_log_pdf(mean, cov)
        laid = _laid(log_p, mean, np.linalg.cholesky(cov), mean[None], n_particles, depth)
        return ParticleDensity.on_lattice(laid, t, n_particles, gaussian=True, domain=domain)
    coarse = _from_pdf(distribution, box, max(n_particles, _COARSE), PaperScheme(), t)

    def log_p(X):
        with np.errstate(divide="ignore"):
            return np.maximum(np.log(np.asarray(distribution(X), dtype=float)), -1e250)

    factor = np.linalg.cholesky(coarse.cov("points"))
    seeds = coarse.x[coarse.mass > coarse.mass.max() * np.exp(-depth)]
    laid = _laid(log_p, coarse.mean(), factor, seeds, n_particles, depth)
    return ParticleDensity.on_lattice(laid, t, n_particles)


def _laid(log_p, mean, factor, seeds, n_particles, depth):
    n = len(mean)
    try:
        return lay(log_p, mean, factor, seeds, n_particles, depth)
    except PropagationError as problem:
        if n_particles >= fewest_particles(n):
            raise
        raise ModelError(f"n_particles = {n_particles} is too small for {n} states: {problem}") from None


def _from_gaussian(gaussian, n_particles, scheme, t):
    place = place_gaussian(gaussian.mean, gaussian.cov, n_particles, scheme)
    lattice = place.lattice
    values, between = gaussian.pdf(lattice.nodes) * place.kept, gaussian.pdf(lattice.half_shifted().nodes)
    represented = min(float(values.sum() * lattice.cell_volume), 1.0)
    about = {"t": t, "represented_mass": represented, "capacity": n_particles}
    return particles_on(lattice, values, between, place.core, scheme, about)


def _from_pdf(pdf, box, n_particles, scheme, t, domain=None):
    """Cells of equal width over the box, particles at their centres, lowest masses dropped."""
    span = box[:, 1] - box[:, 0]
    for shrink in np.geomspace(0.25, 4.0, 80):
        dx = shrink * (np.prod(span) / n_particles) ** (1.0 / len(span))
        dims = np.maximum(np.ceil(span / dx).astype(int), 2)
        if np.prod(dims.astype(float)) > _MOST_TRIED * n_particles:
            continue
        lattice = Lattice(box[:, 0] + 0.5 * span / dims, span / dims, dims, domain)
        values = np.asarray(pdf(lattice.nodes), dtype=float)
        if values.shape != (len(lattice.nodes),) or not np.all(np.isfinite(values)) or values.min() < 0:
            raise ModelError("pdf must return one finite density >= 0 for each row of its argument")
        if values.sum() <= 0:
            raise ModelError("pdf is zero everywhere in its box")
        kept = heaviest(values, scheme.represented_mass)
        if kept.sum() <= n_particles:
            scale = values.sum() * lattice.cell_volume
            between = np.asarray(pdf(lattice.half_shifted().nodes), dtype=float) / scale
            represented = float(values[kept].sum() / values.sum())
            about = {"t": t, "represented_mass": represented, "capacity": n_particles, "domain": domain}
            return particles_on(lattice, values * kept / scale, between, kept, scheme, about)
    raise ModelError(f"n_particles = {n_particles} is too small for {len(span)} states; use more")
