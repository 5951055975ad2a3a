"""Numbers and regions of a density: expectations, quantiles, entropy, where it is highest, errors of these.

All are sums over states that stand for the density as it is read: its particles, points in each of its
kernels, or points in each cell of its lattice and beyond.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from .._types import Bools, Floats, OfStates
from ..core.cloud.control import SHADOW, error_by
from ..core.cloud.inherited import OF_SHIFT
from ..core.limits import LITTLE, TINY
from ..errors import ModelError
from . import weighted
from .cloud import KERNEL, smoothing_length
from .defect import read_out
from .moments import moments
from .quasi_random import FEW_STATES
from .shapes import CELL_POINTS
from .weighted import WeightedStates

if TYPE_CHECKING:
    from .particle_density import ParticleDensity

#: Points that stand for one kernel where an integral over it has no closed form, and where the density at
#: each is wanted: of as many at random its mean were known within 1 / √128 = .09 and 1 / √16 = .25 widths.
_SUBPOINTS, FEW_SUBPOINTS = 128, 16
#: Points of a distribution function in a smoothing length or a cell: in units of it Simpson's rule misses
#: h^4 / 180 = 8e-8 of a fourth derivative, h = 1 / 16.
_FINE = 16
_MOST_OFF = 1.0  # of log p: exp(1) - 1 is 1.7 times the first order, which is all that a defect is known to

Answer = Callable[["ParticleDensity"], Any]


@dataclass(frozen=True, eq=False)
class Region:
    """The smallest region that holds a probability: where the density lies above a level.

    Attributes
    ----------
    density : ParticleDensity
    level : float
    volume : float
        Volume of the region, in the units of the state space.

    Examples
    --------
    >>> region = density.hpd_region(0.95)    # doctest: +SKIP
    >>> region([[0.0, 1.0]]), density.probability(region)    # doctest: +SKIP
    (array([ True]), 0.95)
    """

    density: "ParticleDensity"
    level: float
    volume: float

    def __call__(self, X: ArrayLike) -> Bools:
        """Which of the states X (M, n) lie in the region, shape (M,)."""
        return self.density.pdf(X) >= self.level


def expectation(density: "ParticleDensity", function: OfStates, smooth: bool = True) -> float:
    """Expectation of function(X (M, n)) -> (M,)."""
    return density.form.expected(function, *density.form.states(_SUBPOINTS, smooth))


def moment(density: "ParticleDensity", powers: Sequence[int], centre: Floats | None = None) -> float:
    """Expectation of prod_d (x_d - centre_d)^powers[d], the short way round a periodic axis."""
    orders = np.asarray(powers)
    if orders.shape != (density.dim,) or np.any(orders < 0) or np.any(orders != np.floor(orders)):
        raise ModelError(f"powers must be {density.dim} whole numbers >= 0, one a state, got {orders!r}")
    if orders.sum() <= 2 and density.domain is None:  # a lattice knows these beyond its cut too
        axes = np.repeat(np.arange(density.dim), orders.astype(int))
        off = density.mean() if centre is None else density.mean() - centre
        low = float(np.prod(off[axes]))
        return low + float(density.cov()[tuple(axes)]) if len(axes) == 2 else low
    exact = density.form.raw_moment(orders, np.zeros(density.dim) if centre is None else centre)
    if exact is not None:
        return exact

    def product(X: Floats) -> Floats:
        if centre is not None:
            X = X - centre if density.domain is None else density.domain.nearest(X - centre)
        return np.prod(X**orders, axis=1)

    return expectation(density, product)


def quantile(density: "ParticleDensity", axis: int, probability: ArrayLike) -> Any:
    """Where one state's distribution function reaches `probability` (K,), counted from a domain's low end."""
    checked_axes([axis], density.dim)
    if (atoms := density.form.atoms) is not None:
        return weighted.quantile_of(atoms[0][:, axis], atoms[1], probability)
    probability = weighted.checked_part(probability)
    y, F = _distribution(density.marginal([axis]))
    found = np.interp(probability, F, y)
    return found if probability.ndim else float(found)


def entropy(density: "ParticleDensity") -> float:
    """-E[log p], nats."""
    if (known := density.form.known_entropy) is not None:
        return known
    X, w = density.form.states(FEW_SUBPOINTS, True)
    log_p = density.logpdf(X)
    inside = log_p > -np.inf  # not what kernels spread beyond a wall
    return -float(w[inside] @ log_p[inside] / w[inside].sum())


def highest_region(density: "ParticleDensity", probability: float) -> Region:
    """The region of highest density that holds a probability."""
    share = weighted.checked_part(probability)
    X, w = density.form.states(FEW_SUBPOINTS, False)
    p = density.pdf(X)
    order = np.argsort(-p, kind="stable")
    p, w = p[order], w[order]
    level = float(np.interp(share, np.cumsum(w), p))
    inside = p >= max(level, TINY)
    return Region(density, level, float((w[inside] / p[inside]).sum()))


def spread(density: "ParticleDensity") -> WeightedStates:
    """A density as `WeightedStates`: points in its cells or kernels, and how it is read between them."""
    X, w = density.form.states(FEW_SUBPOINTS, False)
    return WeightedStates(X, w, density.logpdf)


def mode(density: "ParticleDensity") -> Floats:
    """The state of highest density, shape (n,): the best particle, then a simplex search from it."""
    from scipy import optimize  # on use: import time

    X = density.form.states(FEW_SUBPOINTS, False)[0] if density.form.own_points else density.x
    best = X[np.argmax(density.pdf(X))]
    simplex = np.vstack([best, best + 0.5 * np.median(density.h) * np.eye(density.dim)])
    found = optimize.minimize(
        lambda y: -density.pdf(y)[0], best, method="Nelder-Mead", options={"initial_simplex": simplex}
    )
    return found.x


def checked_axes(axes: Sequence[int], dim: int) -> list[int]:
    """Return axes, or one, as a list of different numbers below `dim`, or raise `ModelError`."""
    own: list[int] = np.atleast_1d(np.asarray(axes, dtype=object)).ravel().tolist()
    if not own or len(set(own)) < len(own) or not set(own) <= set(range(dim)):
        raise ModelError(f"axes must be different numbers from 0 to {dim - 1}, got {own}")
    return own


def _distribution(one: "ParticleDensity") -> tuple[Floats, Floats]:
    """Distribution function of a density of one state: places (K,) and its values there."""
    from scipy import integrate  # on use: import time

    lows, highs, width = one.form.ends()
    low, high = float(lows.min()), float(highs.max())
    count = int(min(_FINE * (high - low) / float(np.median(width)), CELL_POINTS))
    y = np.linspace(low, high, max(count, _FINE) + 1)
    p = one.pdf(y[:, None])
    if not (np.diff(y).min() > 0.0 and p.any()):  # its parts are narrower than these places are apart
        order = np.argsort(one.x[:, 0])
        return one.x[order, 0], np.cumsum(one.mass[order])
    F = integrate.cumulative_simpson(p, x=y, initial=0.0)
    F = np.maximum.accumulate(F)  # parabolas through nothing but zeros and a first value undershoot
    return y, one.form.distribution(y, F / F[-1])


def error_of(density: "ParticleDensity", question: Answer) -> Floats:
    """Standard error of what a question is answered with, of its shape."""

    def answer(p: "ParticleDensity") -> Floats:
        return np.asarray(question(p), dtype=float)

    return _ERRORS.get(density.read_out, _by_moving)(density, answer)


def _unknown(density: "ParticleDensity", answer: Answer) -> Floats:
    """Of kernels, of which nothing tells an error: NaN."""
    return np.full_like(answer(density), math.nan)


def _by_defect(density: "ParticleDensity", answer: Answer) -> Floats:
    """Of a family: by how much it changes as its points weigh what its defect says they should."""
    family, defect = density.family, density.defect
    if family is None or defect is None:
        return _by_moving(density, answer)
    x, w = density.form.drawn(FEW_STATES, 0)
    away = x - family.mu if density.domain is None else density.domain.nearest(x - family.mu)
    off = defect.at(family, family.mu + away)
    heavier = w * np.exp(np.clip(off - w @ off, -_MOST_OFF, _MOST_OFF))
    here = answer(_cloud(density, x, w))
    known = OF_SHIFT * (answer(_cloud(density, x, heavier)) - here)
    return np.hypot(known, _moved(density, answer, (x, w), here, read_out(family, defect).unsigned))


def _by_parts(density: "ParticleDensity", answer: Answer) -> Floats:
    """Of a cloud: by how much parts of it differ, none of which has an ancestor in common with another.

    Parts are SHADOW in number, and errors fall with the number of points as those of a shadow do. What they
    have in common from readings before is taken for as large a part of the answer's as of the mean's. Kernels
    of a part are wider, and what that changes falls as N^(-4/(n + 8)).
    """
    if density.cloud is None:
        return _by_moving(density, answer)
    points = density.cloud.points
    part = (np.arange(len(points.w)) if points.lineage is None else points.lineage[0]) % SHADOW
    some = [_cloud(density, points.x[part == k], points.w[part == k]) for k in range(SHADOW)]
    means, answers = np.array([p.mean() for p in some]), np.array([answer(p) for p in some])
    if density.domain is not None:
        means = density.domain.nearest(means - density.mean())
    variances = np.maximum(np.diag(density.cov()), TINY)
    own = error_by(float(np.mean(np.var(means, axis=0, ddof=1) / variances)))
    scale = error_by(1.0) * max(density.error / own if own > 0.0 else 1.0, 1.0)
    smoothed = (answers.mean(axis=0) - answer(density)) / (SHADOW ** (4.0 / (density.dim + 8.0)) - 1.0)
    return np.hypot(scale * np.std(answers, axis=0, ddof=1), smoothed)


def _by_moving(density: "ParticleDensity", answer: Answer) -> Floats:
    """Of a density without points of its own: by how much it changes as mean and variances are off."""
    points = density.form.drawn(FEW_STATES, 0)
    return _moved(density, answer, points, answer(_cloud(density, *points)), density.error)


def _moved(
    density: "ParticleDensity", answer: Answer, points: tuple[Floats, Floats], here: Floats, error: float
) -> Floats:
    """By how much an answer, `here` that of points as they are, changes as these are moved by an error.

    Along each of the principal axes the mean by the error, and the variance by √2 of it: a change of the
    logarithm by a Hermite polynomial of the second degree does that which shifts a mean by as much.
    """
    x, w = points
    mean, cov = (density.mean(), density.cov()) if density.domain is not None else moments(x, w)
    values, axes = np.linalg.eigh(cov)
    off = x - mean if density.domain is None else density.domain.nearest(x - mean)
    square, step = np.zeros_like(here), max(error, LITTLE)  # of less, few points tell the change
    if math.isnan(error):
        return np.full_like(here, math.nan)
    for value, axis in zip(np.maximum(values, 0.0), axes.T, strict=True):
        along = np.outer(off @ axis, axis)
        for change in (step * math.sqrt(value) * axis, step * math.sqrt(0.5) * along):
            square = square + (answer(_cloud(density, x + change, w)) - here) ** 2
    return np.asarray(error / step * np.sqrt(square))


_ERRORS = {"points": _unknown, "mixture": _unknown, "cloud": _by_parts, "family": _by_defect}


def pdf_error(density: "ParticleDensity") -> float:
    """Hellinger distance of a cloud's pdf from the true one, as that from its shadow's pdf tells it; or NaN.

    The distance of kernels of fourth order falls as N^(-4/(n + 8)), and squares of both clouds' add up.
    """
    if density.cloud is None or not density.form.own_points:
        return math.nan
    shadow = _cloud(density, *density.cloud.shadow[:2])
    X, w = density.form.states(FEW_SUBPOINTS, False)
    with np.errstate(invalid="ignore"):
        off = np.expm1(0.5 * (shadow.logpdf(X) - density.logpdf(X)))
    square = 0.5 * (w @ np.where(np.isnan(off), 0.0, off) ** 2)  # none of either beyond a wall
    return math.sqrt(square / (1.0 + SHADOW ** (8.0 / (density.dim + 8))))


def _cloud(density: "ParticleDensity", x: Floats, w: Floats) -> "ParticleDensity":
    """Weighted points as a density of the same time and domain."""
    x = x if density.domain is None else density.domain.wrap(x)
    about: dict[str, Any] = {"t": density.t, "domain": density.domain, "error": density.error}
    h = smoothing_length(w / w.sum(), moments(x, w)[1])
    return type(density)(x=x, mass=w / w.sum(), h=h, kernel=KERNEL, read_out="cloud", **about)
