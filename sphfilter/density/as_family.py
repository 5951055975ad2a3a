"""Densities as one exponential family, and back on lattices."""

import math
from functools import cache
from typing import Any

import numpy as np

from .._types import Floats, Ints
from ..core.family.basis import averages
from ..core.limits import LEAP, ROUNDS, TINY
from ..core.monomials import up_to
from .defect import Defect, defect_of
from .family import OF_MISFIT, Family, fitted, gaussian_family, moments_apart, node_moments
from .left_out import LeftOut
from .moments import moments
from .particle_density import ParticleDensity
from .pieces import Pieces, particles_of_pieces, pieces_of
from .resample import logarithm

_FOUND = 1e-9  # of moments: Newton's next step would leave (1e-9)² = 1e-18, less than rounding


def family_of(density: ParticleDensity, degree: int) -> tuple[Family, float]:
    """The family of a density, and its misfit: the rms of log p less its polynomial.

    That is where the family is. Of what lies elsewhere, a part far away, moments tell: what they are apart by
    is a misfit, too. The density has a logarithm everywhere: on a lattice, or a family itself.
    """
    if density.form.degree == degree:
        own: Any = density.family
        return own, 0.0
    mean, cov = moments_on_line(density)
    if density.gaussian:
        return gaussian_family(mean, cov, degree), 0.0
    family, misfit = fitted(logarithm(density), mean, cov, degree)
    shift, own = node_moments(family.basis.xi, family.weighted()[0])  # 0 and I where moments agree
    return family, max(moments_apart(shift, own - np.eye(len(mean))) / OF_MISFIT, misfit)


def defect_in(density: ParticleDensity, family: Family, misfit: float = 0.0) -> Defect:
    """The defect of the family, of a misfit, that stands for a density: see `family_of`."""
    old, told = density.family, density.defect
    if old is not None and told is not None:
        return told if old is family else defect_of(family, lambda X: old.log_p(X) + told.at(old, X), told)
    known = Defect.none(family, math.hypot(density.error, OF_MISFIT * misfit))
    if density.form.cell is None or density.gaussian:
        return known
    return defect_of(family, logarithm(density), known)


def moments_on_line(density: ParticleDensity) -> tuple[Floats, Floats]:
    """Mean (n,) and covariance (n, n) on the line: of a periodic axis it is not turned back."""
    return density.moments or (density.mass @ density.x, density.cov())


def gaussians_of(density: ParticleDensity) -> Pieces | None:
    """Gaussians that a density is known to be the sum of, one or more; None of others, or in a domain."""
    one = density.form.degree > 0 and density.gaussian and density.domain is None
    return pieces_of(*moments_on_line(density)) if one else density.pieces


def may_miss(density: ParticleDensity) -> bool:
    """Whether a density is one family whose polynomial may miss something of log p: that is its defect."""
    return density.form.degree > 0 and not density.gaussian


def as_polynomials(density: ParticleDensity, degree: int, most: float) -> ParticleDensity | None:
    """A density on a lattice or a cloud as one family; None where that adds an error above `most`."""
    try:
        found = _fitted(density, degree)
    except np.linalg.LinAlgError:  # flat along some combination of the states
        return None
    if found is None or not OF_MISFIT * found[1] <= most:
        return None
    error = math.hypot(density.error, OF_MISFIT * found[1])
    new = family_density(density, found[0], error=error, defect=defect_in(density, *found))
    if not _agree(density, new, most):
        return None
    x, mass = density.x, density.mass
    beyond = None if density.form.cell is None else LeftOut.of(new, x, mass, density.logpdf(x))
    return new.noted(left_out=density.left_out if beyond is None else beyond.beside(density.left_out, new))


def _fitted(density: ParticleDensity, degree: int) -> tuple[Family, float] | None:
    """The family next to a density, and its misfit; None where there is none."""
    if density.walls[0].size:
        return None
    own = density.form.own_points
    if own is None:
        return family_of(density, degree)
    if density.domain is not None:  # moments do not go round a circle
        return None
    return max_entropy(*own, degree)


def _agree(density: ParticleDensity, family: ParticleDensity, most: float) -> bool:
    """Are mean and covariance the same, as far as an error of `most` lets them differ?"""
    (mean, cov), (own_mean, own_cov) = moments_on_line(density), moments_on_line(family)
    root = np.linalg.inv(np.linalg.cholesky(cov))
    return moments_apart(root @ (own_mean - mean), root @ own_cov @ root.T - np.eye(len(mean))) <= most


def family_density(density: ParticleDensity, family: Family, **changes: Any) -> ParticleDensity:
    """A density whose place in the record is that of another, as one family."""
    return ParticleDensity.of_family(family, **_about(density) | changes)


def pieces_density(density: ParticleDensity, pieces: Pieces, **changes: Any) -> ParticleDensity:
    """A density as the sum of Gaussians; one alone is a family, which is known to be Gaussian."""
    if len(pieces.log_w) == 1:
        one = gaussian_family(pieces.mean[0], pieces.cov[0], 2)
        return family_density(density, one, **{"gaussian": True} | changes)
    return ParticleDensity(**particles_of_pieces(pieces), **_about(density) | {"gaussian": False} | changes)


def _about(density: ParticleDensity) -> dict[str, Any]:
    names = "t", "capacity", "domain", "error", "lost", "gaussian"
    return {name: getattr(density, name) for name in names}


def max_entropy(x: Floats, mass: Floats, degree: int) -> tuple[Family, float] | None:
    """Find the family of a degree that has the moments of points (N, n) with weights (N,) up to that degree.

    With it its misfit, what chance explains taken off: by how much moments of one degree more, and the
    variance of log p, differ from those of the points. None where no family has the moments.
    """
    mean, cov = moments(x, mass)
    try:
        start = gaussian_family(mean, cov, degree)
    except np.linalg.LinAlgError:
        return None
    rule, n = start.basis, x.shape[1]
    xi = np.ascontiguousarray((x - mean) @ np.linalg.inv(start.A).T)
    power, M = _powers(n, degree + 1), len(start.c)
    wanted, squares = np.empty((2, len(power)))
    averages(power, xi, mass, wanted, squares)
    c = _solved(rule.V, rule.log_w, start.c, wanted[:M])
    if c is None:
        return None
    found = start._replace(c=c).normalised()
    p = found.weighted()[0]
    own, _ = np.empty((2, len(power)))
    averages(power, rule.xi, p, own, _)
    chance = float(np.sum(mass**2))
    off = (wanted - own)[M:]
    odd = float(np.sum(off**2) - chance * np.sum(squares[M:]))
    log_p = found.log_p(x)
    spread = _variance(mass, log_p) / max(_variance(p, found.c @ rule.V), TINY) - 1.0
    by_chance = chance * _variance(mass, (log_p - mass @ log_p) ** 2) / max(_variance(mass, log_p) ** 2, TINY)
    even = (0.5 * spread) ** 2 - 0.25 * by_chance
    return found, math.sqrt(max(odd, 0.0) + max(even, 0.0))


def _solved(V: Floats, log_w: Floats, c: Floats, wanted: Floats) -> Floats | None:
    """Coefficients under which polynomials V (M, N) at nodes average to `wanted`, by Newton's method."""
    c = c.copy()
    for _ in range(ROUNDS):
        log_z, p = _partition(c @ V + log_w)
        off = (wanted - V @ p)[1:]
        if not np.isfinite(off).all():
            return None
        if np.abs(off).max() < _FOUND:
            return c
        centred = (V - (V @ p)[:, None])[1:]
        try:
            step = np.linalg.solve((centred * p) @ centred.T, off)
        except np.linalg.LinAlgError:
            return None
        long = math.sqrt(max(float(off @ step), 0.0))
        step *= min(1.0, LEAP / max(long, TINY))
        value, slope = log_z - c[1:] @ wanted[1:], float(off @ step)
        for _ in range(ROUNDS):
            trial = c.copy()
            trial[1:] += step
            if _partition(trial @ V + log_w)[0] - trial[1:] @ wanted[1:] <= value - 1e-4 * slope:
                break
            step, slope = 0.5 * step, 0.5 * slope
        else:
            return None
        c = trial
    return None


def _partition(log_p: Floats) -> tuple[float, Floats]:
    """Logarithm of the sum of exponentials, and each one's part of it."""
    top = float(log_p.max())
    w = np.exp(log_p - top)
    total = float(w.sum())
    return top + math.log(total), w / total


@cache
def _powers(n: int, degree: int) -> Ints:
    return np.array(up_to(degree, n))


def _variance(w: Floats, values: Floats) -> float:
    mean = w @ values
    return float(w @ (values - mean) ** 2)
