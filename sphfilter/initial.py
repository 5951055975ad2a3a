"""Initial densities: a Gaussian, a uniform box, or any pdf with a box, put on particles."""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from .config import PaperScheme, SolverConfig
from .density import ParticleDensity
from .errors import ModelError, PropagationError
from .exact import gaussian_log_pdf
from .lattice import Lattice, heaviest, particles_on, place_gaussian
from .level_set import fewest_particles, lay, reach
from .validate import array, count, covariance

__all__ = ["Gaussian", "Uniform", "initialize"]

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


def initialize(distribution, n_particles, config=None, *, box=None, t=0.0):
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

    Returns
    -------
    ParticleDensity
    """
    scheme = (config or SolverConfig()).scheme
    n_particles = count("n_particles", n_particles)
    if not isinstance(scheme, PaperScheme) and not isinstance(distribution, Uniform):
        return _on_level_set(distribution, box, n_particles, scheme, t)
    if not isinstance(scheme, PaperScheme):
        scheme = PaperScheme(kernel="wendland_c2")  # a density with edges has no smooth logarithm
    if isinstance(distribution, Gaussian):
        return _from_gaussian(distribution, n_particles, scheme, t)
    if isinstance(distribution, Uniform):
        distribution, box = distribution.pdf, distribution.box
    elif box is None or not callable(distribution):
        raise ModelError("initialize takes a Gaussian, a Uniform, or a callable pdf with box=, shape (n, 2)")
    return _from_pdf(distribution, checked_box(box), n_particles, scheme, t)


def _on_level_set(distribution, box, n_particles, scheme, t):
    """A smooth density on a lattice that follows its level set."""
    gaussian = isinstance(distribution, Gaussian)
    n = len(distribution.mean) if gaussian else np.shape(box)[0] if np.ndim(box) else 0
    depth = 0.5 * reach(scheme, n) ** 2
    if gaussian:
        mean, cov = distribution.mean, distribution.cov
        log_p = gaussian_log_pdf(mean, cov)
        laid = _laid(log_p, mean, np.linalg.cholesky(cov), mean[None], n_particles, depth)
        return ParticleDensity.on_lattice(laid, t, n_particles, gaussian=True)
    if box is None or not callable(distribution):
        raise ModelError("initialize takes a Gaussian, a Uniform, or a callable pdf with box=, shape (n, 2)")
    coarse = _from_pdf(distribution, checked_box(box), max(n_particles, _COARSE), PaperScheme(), t)

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


def _from_pdf(pdf, box, n_particles, scheme, t):
    """Cells of equal width over the box, particles at their centres, lowest masses dropped."""
    span = box[:, 1] - box[:, 0]
    for shrink in np.geomspace(0.25, 4.0, 80):
        dx = shrink * (np.prod(span) / n_particles) ** (1.0 / len(span))
        dims = np.maximum(np.ceil(span / dx).astype(int), 2)
        lattice = Lattice(box[:, 0] + 0.5 * span / dims, span / dims, dims)
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
            about = {"t": t, "represented_mass": represented, "capacity": n_particles}
            return particles_on(lattice, values * kept / scale, between, kept, scheme, about)
    raise ModelError(f"n_particles = {n_particles} is too small for {len(span)} states; use more")
