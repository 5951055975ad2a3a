"""How far an answer of a density may be off, whatever was asked."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from .._types import Floats
from ..core.cloud.control import SHADOW, error_by
from .cloud import KERNEL, points_of, smoothing_length
from .points import moments

if TYPE_CHECKING:
    from .particle_density import ParticleDensity

__all__ = ["error_of"]

#: That stand for a density. The same ones are moved, so that a change is known to 1 / √4096 = .016 of itself.
_POINTS = 4096

Answer = Callable[["ParticleDensity"], Floats]


def error_of(density: "ParticleDensity", question: Answer) -> Floats:
    """Standard error of what a question is answered with, of its shape."""

    def answer(p: "ParticleDensity") -> Floats:
        return np.asarray(question(p), dtype=float)

    if density.cloud is not None and density.read_out == "cloud":
        return _by_parts(density, answer)
    return _by_moving(density, answer)


def _by_parts(density: "ParticleDensity", answer: Answer) -> Floats:
    """Of a cloud: by how much parts of it differ, none of which has an ancestor in common with another.

    Parts are SHADOW in number, and errors fall with the number of points as those of a shadow do. What they
    have in common from readings before is taken for as large a part of the answer's as of the mean's. Kernels
    of a part are wider, and what that changes falls as N^(-4/(n + 8)).
    """
    assert density.cloud is not None
    points = density.cloud.points
    part = (np.arange(len(points.w)) if points.lineage is None else points.lineage[0]) % SHADOW
    some = [_cloud(density, points.x[part == k], points.w[part == k]) for k in range(SHADOW)]
    means, answers = np.array([p.mean() for p in some]), np.array([answer(p) for p in some])
    if density.domain is not None:
        means = density.domain.nearest(means - density.mean())
    variances = np.maximum(np.diag(density.cov()), np.finfo(float).tiny)
    own = error_by(float(np.mean(np.var(means, axis=0, ddof=1) / variances)))
    scale = error_by(1.0) * max(density.error / own if own > 0.0 else 1.0, 1.0)
    smoothed = (answers.mean(axis=0) - answer(density)) / (SHADOW ** (4.0 / (density.dim + 8.0)) - 1.0)
    return np.hypot(scale * np.std(answers, axis=0, ddof=1), smoothed)


def _by_moving(density: "ParticleDensity", answer: Answer) -> Floats:
    """Of a density without points of its own: by how much it changes as mean and variances are off.

    Along each of its principal axes the mean by the error told, and the variance by √2 of it: a change of the
    logarithm by a Hermite polynomial of the second degree does that which shifts a mean by as much.
    """
    x, w = points_of(density, _POINTS, 0)
    mean, cov = (density.mean(), density.cov()) if density.domain is not None else moments(x, w)
    values, axes = np.linalg.eigh(cov)
    off = x - mean if density.domain is None else density.domain.nearest(x - mean)
    here = answer(_cloud(density, x, w))
    square = np.zeros_like(here)
    if math.isnan(density.error):
        return np.full_like(here, math.nan)
    for value, axis in zip(np.maximum(values, 0.0), axes.T, strict=True):
        along = np.outer(off @ axis, axis)
        for change in (density.error * math.sqrt(value) * axis, density.error * math.sqrt(0.5) * along):
            square = square + (answer(_cloud(density, x + change, w)) - here) ** 2
    return np.asarray(np.sqrt(square))


def _cloud(density: "ParticleDensity", x: Floats, w: Floats) -> "ParticleDensity":
    """Weighted points as a density of the same time and domain."""
    from .particle_density import ParticleDensity  # on use: it asks this module

    x = x if density.domain is None else density.domain.wrap(x)
    about: dict[str, Any] = {"t": density.t, "domain": density.domain, "error": density.error}
    h = smoothing_length(w / w.sum(), moments(x, w)[1])
    return ParticleDensity(x=x, mass=w / w.sum(), h=h, kernel=KERNEL, read_out="cloud", **about)
