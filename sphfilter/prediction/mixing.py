"""Sums of densities as one density: what the modes of a model become where states switch between them.

A sum is kept as one where Gaussians are added, which are merged as far as an error allows. Others become one
family, where one holds them, or lie on a new lattice by the logarithm of the sum, or go on as points.
"""

import math
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from scipy.special import logsumexp

from .._types import Floats, OfStates
from ..core.cloud.control import MOST_POINTS, power_of_two
from ..core.family.rules import degrees
from ..core.limits import FAR, HIGHEST, LITTLE
from ..core.step_control import HELPED
from ..density.as_cloud import cloud_density
from ..density.as_family import as_polynomials, family_density, gaussians_of, moments_on_line, pieces_density
from ..density.defect import Defect, defect_of
from ..density.family import OF_MISFIT, fitted, moments_apart, node_moments
from ..density.memory import Memory
from ..density.moments import moments_of_sum
from ..density.particle_density import ParticleDensity
from ..density.passage import Use, age_of, stored_key
from ..density.pieces import OF_CHANGE, Pieces, light, merged
from ..density.resample import folded_logarithm
from ..errors import PropagationError
from ..lattice.check import misfit, remote
from ..lattice.field import inside_lattice
from ..lattice.level_set import lattice_depth, lay, min_nodes, root_of
from ..lattice.resolved import MOST
from .ladder import first_degree, prefers_cloud

#: Gaussians of a sum, and tries of letting it change four times more until it has no more: 4⁵ = 1,024.
_MOST_PIECES, _COARSER = 200, 5
_TRIES = 6  # lattices, each of twice the nodes of the one before: up to 2⁵ = 32 times the first
_SEEDS = 1e-4  # of the heaviest node of a part: those by which a lattice finds all of its pieces


class Part(NamedTuple):
    """A density of a sum."""

    log_w: float
    density: ParticleDensity


class Allowed(NamedTuple):
    """Errors of the mean, in standard deviations, that merging Gaussians, and laying a lattice, may add."""

    by_mergers: float
    by_lattice: float
    reach: float = 1.0  # times as far out as usual, that mergers are to change little


def mixed(parts: Sequence[Part], target: float, errors: Allowed) -> ParticleDensity:
    """The sum of densities of one time, as one density, whose `error` has what its parts were wrong by, and
    what has been added.

    The logarithms of the parts' weights need not be normalised; one at least is finite. The target is the
    error of the mean, in standard deviations, that a record may have, and `errors` are those that may be
    added. Raises `PropagationError` if nothing holds the sum.
    """
    allowed = errors.by_mergers
    parts, lost = _heavy(_joined(parts), allowed)
    w = np.exp([part.log_w for part in parts])
    error = math.hypot(math.sqrt(float(w @ [part.density.error**2 for part in parts])), FAR * lost)
    first = parts[0].density
    if len(parts) == 1:
        return first.noted(error=error)
    first = first.noted(error=error, defect=None, needs=_needs(parts))
    found = _as_pieces(parts, first, errors) or _as_family(parts, first, allowed)
    if found is not None:
        return found
    needs = first.needs
    as_points = needs is not None and first.domain is None and prefers_cloud(first.dim, needs, target)
    if not (as_points or any(part.density.form.own_points for part in parts)):
        with suppress(PropagationError, np.linalg.LinAlgError):
            return _on_lattice(parts, first, errors.by_lattice)
    return _as_cloud(parts, first, target)


def _joined(parts: Sequence[Part]) -> list[Part]:
    """The parts, heaviest first, those of the same density together, with weights of sum one."""
    found: list[Part] = []
    for part in parts:
        same = next((i for i, other in enumerate(found) if _same(other.density, part.density)), None)
        if same is None:
            found.append(part)
        else:
            found[same] = found[same]._replace(log_w=float(np.logaddexp(found[same].log_w, part.log_w)))
    total = float(logsumexp([part.log_w for part in found]))
    found = [part._replace(log_w=part.log_w - total) for part in found if part.log_w > -math.inf]
    return sorted(found, key=lambda part: -part.log_w)


def _same(one: ParticleDensity, other: ParticleDensity) -> bool:
    """Are two densities the same to the last bit, as those of equal modes are?"""
    names = ("x", "mass", "h")
    return one is other or all(np.array_equal(getattr(one, name), getattr(other, name)) for name in names)


def _heavy(parts: list[Part], allowed: float) -> tuple[list[Part], float]:
    """The parts but for the lightest, and the probability of those."""
    w = np.exp([part.log_w for part in parts])
    means, covs = (
        np.array([f(p.density) for p in parts]) for f in (ParticleDensity.mean, ParticleDensity.cov)
    )
    heavy = ~light(w, means, covs, LITTLE * allowed, FAR)
    scale = math.log(w[heavy].sum())
    left = [part._replace(log_w=part.log_w - scale) for part, kept in zip(parts, heavy, strict=True) if kept]
    return left, float(w[~heavy].sum())


def _needs(parts: Sequence[Part]) -> Memory | None:
    """The most that any of the parts needs, for a sum is no simpler; of points, as their shares say.

    What so many of all points are wrong by counts as often in the error of the sum.
    """
    own = [part.density.needs for part in parts]
    share = np.exp([part.log_w for part in parts])
    known = [needs for needs in own if needs is not None]
    if len(known) < len(own):
        return None
    return known[0]._replace(
        degree=max(needs.degree for needs in known),
        nodes=max(needs.nodes for needs in known),
        points=int(power_of_two(share @ [needs.points for needs in known])),
    )


def _as_pieces(parts: Sequence[Part], about: ParticleDensity, errors: Allowed) -> ParticleDensity | None:
    """Gaussians, all of them, merged; None where a part is no sum of Gaussians."""
    several = []
    for part in parts:
        pieces = gaussians_of(part.density)
        if pieces is None:
            return None
        several.append(pieces._replace(log_w=pieces.log_w + part.log_w))
    union = Pieces(*(np.concatenate(part) for part in zip(*several, strict=True))).normalised()
    kept = union.heavy(LITTLE * errors.by_mergers, FAR)
    lost = float(union.w[~kept].sum())
    pieces, change = _few(union.some(kept).normalised(), errors.by_mergers / OF_CHANGE, errors.reach)
    error = math.hypot(about.error, OF_CHANGE * change, FAR * lost)
    return pieces_density(about, pieces, error=error).noted(needs=about.needs)


def _few(pieces: Pieces, most: float, reach: float) -> tuple[Pieces, float]:
    """Pieces merged until they can be carried, and the change of log p: more than asked for, if need be."""
    pieces, change = merged(pieces, most, reach)
    for _ in range(_COARSER):
        if len(pieces.log_w) <= _MOST_PIECES:
            break
        most *= 4.0
        pieces, added = merged(pieces, most, reach)
        change += added
    return pieces, change


def _as_family(parts: Sequence[Part], about: ParticleDensity, allowed: float) -> ParticleDensity | None:
    """One family, of as low a degree as the error lets it be; None where none holds the sum."""
    smooth = all(part.density.form.smooth for part in parts)
    if about.needs is None or not smooth or about.walls[0].size:
        return None
    mean, cov = _moments(parts)
    log_p, first = _log_sum(parts), first_degree(about.dim, about.needs)
    for degree in (d for d in degrees(about.dim) if 0 < first <= d <= HIGHEST):
        found, off = fitted(log_p, mean, cov, degree)
        b, C = node_moments(found.basis.xi, found.weighted()[0])
        added = max(OF_MISFIT * off, moments_apart(b, C - np.eye(len(mean))))
        if added <= allowed:
            error = math.hypot(about.error, added)
            defect = defect_of(found, log_p, Defect.none(found, error))
            new = family_density(about, found, error=error, gaussian=False, defect=defect)
            return new.noted(needs=about.needs)
    return None


def _turned(parts: Sequence[Part]) -> list[Floats]:
    """By how much (n,) each part is turned round periodic axes, to lie beside the first."""
    domain, n = parts[0].density.domain, parts[0].density.dim
    if domain is None or not domain.periodic.any():
        return [np.zeros(n) for _ in parts]
    period = domain.period
    middle = moments_on_line(parts[0].density)[0]
    off = [
        (middle - moments_on_line(part.density)[0]) / np.where(period > 0.0, period, 1.0) for part in parts
    ]
    return [np.rint(turns) * period for turns in off]


def _moments(parts: Sequence[Part]) -> tuple[Floats, Floats]:
    """Mean (n,) and covariance (n, n) of the sum, on the line."""
    w = np.exp([part.log_w for part in parts])
    own = [moments_on_line(part.density) for part in parts]
    means = np.array([mean + turn for (mean, _), turn in zip(own, _turned(parts), strict=True)])
    return moments_of_sum(w, means, [cov for _, cov in own])


def _log_sum(parts: Sequence[Part]) -> OfStates:
    """Logarithm of the sum, at states on the line."""
    logs, shifts = [folded_logarithm(part.density) for part in parts], _turned(parts)

    def log_p(X: Floats) -> Floats:
        each = [p.log_w + log(X - turn) for p, log, turn in zip(parts, logs, shifts, strict=True)]
        return np.asarray(logsumexp(each, axis=0))

    return log_p


def _on_lattice(parts: Sequence[Part], about: ParticleDensity, allowed: float) -> ParticleDensity:
    """The logarithm of the sum on a lattice, of as many nodes as the error asks for."""
    log_p, (mean, cov), n = _log_sum(parts), _moments(parts), about.dim
    x = np.concatenate([p.density.x + turn for p, turn in zip(parts, _turned(parts), strict=True)])
    mass = np.concatenate([math.exp(part.log_w) * part.density.mass for part in parts])
    seeds = x[mass > _SEEDS * mass.max()]
    if about.needs is None:
        nodes = max(part.density.capacity or part.density.n_particles for part in parts)
    else:
        nodes = about.needs.nodes or min_nodes(n)
    depth = lattice_depth(None, n)
    best: Any = math.inf, None
    for _ in range(_TRIES):
        laid = lay(log_p, mean, root_of(cov), seeds, nodes, depth, walls=about.walls)
        off, beyond = misfit(laid, log_p), ~inside_lattice(laid.field, x)
        far = remote(laid.mean, laid.cov, x[beyond], mass[beyond])
        added = math.hypot(off.mean, far.mean, 0.5 * far.variance)
        before = best[0]
        if added < before:
            best = added, off.residual, laid, nodes
        helped = added < HELPED * before
        if added <= allowed or about.needs is None or not helped or 2 * nodes > MOST:
            break
        nodes *= 2
    added, residual, laid, nodes = best
    known: Any = {"residual": residual, "error": math.hypot(about.error, added), "lost": about.lost}
    new = ParticleDensity.on_lattice(laid, about.t, nodes, False, about.domain, **known)
    if about.needs is None:
        return new
    needs = about.needs._replace(nodes=nodes)
    # as one family, if one holds it and none was refused just now
    one = None if needs.waits > 0 else as_polynomials(new, first_degree(n, needs), allowed)
    return (new if one is None else one).noted(needs=needs)


def _as_cloud(parts: Sequence[Part], about: ParticleDensity, target: float) -> ParticleDensity:
    """The points of all; of what is no cloud, as many as its share says."""
    count = min((about.needs or Memory()).cloud(target, about.dim), MOST_POINTS)
    x, mass = [], []
    for k, part in enumerate(parts):
        density, w = part.density, math.exp(part.log_w)
        many, key = max(math.ceil(w * count), 1000), stored_key(age_of(about), Use.PARTS + k)
        points, weights = density.form.own_points or density.form.drawn(many, key)
        x.append(points)
        mass.append(w * weights)
    return cloud_density(about, np.concatenate(x), np.concatenate(mass)).noted(needs=about.needs)
