"""A cloud of weighted points on random paths: carries any density, with the error of as many samples."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from .._types import Bools, Floats, Ints
from ..config import CloudScheme
from ..core._addresses import address_of
from ..core.paths.blocks import move_blocks, standard_normals
from ..core.paths.curve import along_curve
from ..core.paths.normals import LANES
from ..core.paths.step_length import BIAS_PER_ERROR, PLATEN, SHIFTED_PATH
from ..core.paths.weights import group_moments
from ..density.as_cloud import cloud_density
from ..density.cloud import (
    KERNEL,
    drawn,
    key_of,
    moments,
    moments_of,
    points_of,
    systematic,
)
from ..density.particle_density import ParticleDensity
from ..density.quasi_random import standard_normal
from ..density.resample import times_likelihood
from ..errors import PropagationError, StoppedError
from ..info import Code, PredictInfo
from ..model.compile import surfacing
from ..model.discretization import linear_transition, transition
from ..model.sde import SDE
from ..model.simulate import noise_root, rate_of_time
from ._shared import blow_up, carried_off, skip_notes

__all__ = ["on_lattice", "parts", "propagate"]

_BIAS = 0.6  # of the steps, over the sampling error
_SEEN = 2048  # points of a cloud by which it is told how far it reaches, and how far it forgets
_PLANE = 2  # states up to which normals are not evenly spread
_ASIDE = 1  # of a key, for normals that are not those of paths
_LOOKED_AT = 64  # states at which the rate of change with time is looked at
_PART_OF_WALLS = 0.25  # of a standard deviation: the largest noise of a step beside walls
_PATIENT = 2000  # steps of points that have no noise
_NARROW = 0.1  # of the spread of all points, that of the narrowest part of a density without noise
_GROUP, _HALVINGS = 8, 5  # blocks of which one has steps of half the length, and how often all have
_CHANCE = 5.0  # standard deviations by which two samples may differ
_HELPED = 0.7  # of a difference that is left by steps of half the length, if it comes from them
_FEW = 0.5  # effective points over all, below which points are drawn anew
_SPREAD = 0.01  # least variance that noise adds for copies of a point to part, over the cloud's
#: States, and kernels of a cloud, from which a lattice is tried again.
_MOST_STATES, _KERNELS = 4, 4096
_FORGOTTEN = 0.01  # probability lost by lattices, above which none is tried again
_AGREES, _LEAST_ERROR, _RESIDUAL = 3.0, 0.005, 0.1  # for a lattice to stand for a cloud
_AWAY = 1e6  # extents of a cloud, from which a point has run away
_DOUBTFUL, _MOST_LOST, _CERTAIN = 0.01, 0.1, 0.25  # probability of the paths that were given up


def propagate(
    density: ParticleDensity, model: SDE, t1: float, scheme: CloudScheme, n_particles: int | None = None
) -> tuple[ParticleDensity, PredictInfo]:
    """Carry a density to time t1 as weighted points, each on a path with noise of its own.

    Steps are of weak order three where the noise does not depend on the state, else two, and exact for a
    linear model. What comes is drawn from a density of another kind by quasi-random numbers.

    Parameters
    ----------
    density : ParticleDensity
    model : SDE
    t1 : float
        Seconds.
    scheme : CloudScheme
    n_particles : int, optional
        Bound of the next lattice's nodes, which the density keeps as its capacity.

    Returns
    -------
    ParticleDensity, PredictInfo

    Raises
    ------
    PropagationError
        The model carries a tenth of the probability to infinity, or needs more steps than allowed.
    """
    key = key_of(density)
    dealt = _dealt(scheme.n_points)
    before, mass = _points(density, model, t1, key, dealt)
    x, alive, steps, bias = before.copy(), np.ones(len(before), dtype=bool), 1, 0.0
    if model.linear:
        x = _exactly(x, model, t1 - density.t, key, dealt)
    else:
        few = before[systematic(mass, LANES)]  # tell a model that blows up at once
        pilot, kept = few.copy(), np.ones(LANES, dtype=bool)
        paths = _Paths(model, (density.t, t1), scheme, key, np.diag(density.cov()).copy())
        _, first = _walked(pilot, kept, paths)
        if kept.mean() < 1.0 - _CERTAIN:
            raise PropagationError(_blow_up(model, few[~kept], density.t, t1))
        ends = _normals(dealt, model.dim, len(model.spectral_density), key)
        longest, drifted = _longest(few, paths, len(x))
        paths = paths._replace(first=first, longest=longest, ends=np.ascontiguousarray(ends.T))
        steps, bias = _moved(before, x, mass, alive, paths)
        bias = math.hypot(bias, drifted)
    alive &= _near(before, x)
    lost = 0.0
    if not alive.all():
        lost = float(mass[~alive].sum())
        if lost > _MOST_LOST:
            raise PropagationError(_blow_up(model, before[~alive], density.t, t1))
        before, x, mass = before[alive], x[alive], mass[alive] / (1.0 - lost)
    error, left = _error(density, before, x, mass)
    error = math.hypot(error, bias)
    moved = cloud_density(
        density,
        x if density.domain is None else density.domain.wrap(x),
        mass,
        t=float(t1),
        capacity=density.capacity if n_particles is None else n_particles,
        error=error,
        lost=left * density.lost,
        inherited=left**2 if density.read_out == "cloud" else 0.0,
    )
    return moved, _info(model, len(x), steps, lost, error)


def on_lattice(density: ParticleDensity, n_particles: int) -> ParticleDensity | None:
    """A cloud on a lattice that has its mean and covariance and its density, or None where none has."""
    if density.dim > _MOST_STATES or abs(density.lost) > _FORGOTTEN:
        return None
    few = ParticleDensity(
        x=density.x[systematic(density.mass, _KERNELS)],
        mass=np.full(_KERNELS, 1.0 / _KERNELS),
        h=density.h[:1].repeat(_KERNELS),
        kernel=KERNEL,
        read_out="cloud",
        t=density.t,
        domain=density.domain,
    )
    try:
        laid, *_ = times_likelihood(few, lambda X: np.zeros(len(X)), n_particles, "auto")
    except PropagationError:
        return None
    root = np.linalg.inv(np.linalg.cholesky(density.cov()))
    off = np.sqrt(np.mean((root @ (laid.mean() - density.mean())) ** 2))
    wider = np.abs(root @ laid.cov() @ root.T - np.eye(density.dim)).max()
    X, _ = few.form.states(16, True)
    residual = np.mean(np.abs(np.expm1(np.clip(laid.logpdf(X) - few.logpdf(X), -1.0, 1.0))))
    if max(off, 0.5 * wider) > _AGREES * max(density.error, _LEAST_ERROR) or residual > _RESIDUAL:
        return None
    error = math.hypot(density.error, float(off))
    return laid.noted(error=error, lost=density.lost, capacity=density.capacity)


def _points(density: ParticleDensity, model: SDE, t1: float, key: int, dealt: Ints) -> tuple[Floats, Floats]:
    """Points (N, n) that are to be moved, dealt to blocks, and their weights.

    Copies of heavy points part by themselves where the noise is enough for that; else the points are drawn
    from the density that is read between them.
    """
    count = len(dealt)
    evenly = np.full(count, 1.0 / count)
    if density.read_out != "cloud":
        x, mass = points_of(density, count, key)
        dealt = _along(x, *moments(x, mass))[dealt]
        return x[dealt], mass[dealt]
    order = _along(density.x, *moments_of(density))
    mass = density.mass
    if len(mass) == count and 1.0 / np.sum(mass**2) >= _FEW * count:
        return density.x[order[dealt]], mass[order[dealt]]
    drift_apart = parts(model, density, t1)
    if density.domain is not None and not drift_apart:
        return drawn(density, count, key)[dealt], evenly
    x = density.x[order[systematic(mass[order], count)[dealt]]]
    return (x if drift_apart else _beside(x, density, key)), evenly


def _along(x: Floats, mean: Floats, cov: Floats) -> Ints:
    """Numbers of points (N, n) in an order in which neighbours follow each other."""
    try:
        white = np.linalg.inv(np.linalg.cholesky(cov))
    except np.linalg.LinAlgError:  # flat along some combination of the states
        white = np.diag(1.0 / np.sqrt(np.maximum(np.diag(cov), 1e-300)))
    place = along_curve(np.ascontiguousarray(x), mean, np.ascontiguousarray(white))
    return np.argsort(place, kind="stable")


def _dealt(count: int) -> Ints:
    """Numbers of points that lie in order, as they are dealt to blocks: to each a few from everywhere."""
    blocks = -(-count // LANES)
    dealt = np.arange(blocks * LANES).reshape(LANES, blocks).T.ravel()
    return dealt[dealt < count]


def _normals(dealt: Ints, dim: int, k: int, key: int) -> Floats:
    """Standard normals (N, k) for points as they were dealt, evenly spread among those that lie close by.

    Not in one or two dimensions, where the error would be a fifth of what is told of it, or less.
    """
    if dim <= _PLANE:
        return standard_normals(key ^ _ASIDE, len(dealt), k)
    return standard_normal(len(dealt), k, key, dealt)


def _beside(x: Floats, density: ParticleDensity, key: int) -> Floats:
    """Copies of heavy points, each moved by about the distance of points, with mean and covariance of all."""
    count = len(x)
    mean, cov = moments_of(density)
    width = float(np.sum(density.mass**2)) ** (1.0 / density.dim)
    values, axes = np.linalg.eigh(cov)
    x = x - mean
    z = standard_normals(key ^ _ASIDE, count, density.dim) * np.sqrt(np.maximum(values, 0.0))
    return mean + math.sqrt(1.0 - width**2) * x + width * np.einsum("ij,kj->ik", z, axes)


def parts(model: SDE, density: ParticleDensity, t1: float) -> bool:
    """Does the noise of an interval move copies of a point apart, in all directions?"""
    mean, cov = moments_of(density)
    with np.errstate(all="ignore"):
        D = model.diffusion(mean, density.t)[0]
        if not np.isfinite(D).all():
            return False
        slope = np.nan_to_num(model.jacobian(mean, density.t))
        flow, _, added = transition(slope, np.zeros(len(mean)), 2.0 * D, t1 - density.t)
        total = flow @ cov @ flow.T + added
    if not np.isfinite(total).all():
        return False
    scale = np.sqrt(np.maximum(np.diag(total), 1e-300))
    values, axes = np.linalg.eigh(total / np.outer(scale, scale))
    white = axes / np.sqrt(np.maximum(values, 1e-12)) / scale[:, None]
    return bool(np.linalg.eigvalsh(white.T @ added @ white)[0] > _SPREAD)


def _exactly(x: Floats, model: SDE, dt: float, key: int, dealt: Ints) -> Floats:
    """Points moved by the exact transition of a linear model."""
    flow, offset, Q = linear_transition(model, dt)
    noise = _normals(dealt, model.dim, model.dim, key)
    # not matrix products: their last bits depend on the threads
    return np.einsum("ij,kj->ik", x, flow) + offset + np.einsum("ij,kj->ik", noise, noise_root(Q))


class _Paths(NamedTuple):
    """What paths are drawn for."""

    model: SDE
    span: tuple[float, float]  # times, from and to
    scheme: CloudScheme
    key: int
    variance: Floats  # (n,) of all points: the unit of what steps may be off by
    first: float = math.inf  # step that is tried first, seconds
    longest: float = math.inf  # step
    still: bool = False  # without noise
    ends: Floats | None = None  # (m, N) where noise ends, or anywhere


def _longest(few: Floats, paths: _Paths, count: int) -> tuple[float, float]:
    """Longest step by which the drift alone leads points where half of it does; and how far the two part.

    That is in units of the noise, and of a tenth of the spread: no part of a density is narrower, and a
    reading may leave one of them alone. By how far the means of all points part is not enough to tell. Of a
    drift that jumps nothing can be told without noise.
    """
    model, span = paths.model, paths.span[1] - paths.span[0]
    patient = min(paths.scheme.max_steps, _PATIENT)
    paths = paths._replace(still=True, scheme=replace(paths.scheme, max_steps=patient))
    allowed, off, ends = _BIAS / math.sqrt(count), 0.0, few.copy()
    alive = np.ones(len(few), dtype=bool)
    try:
        steps, _ = _walked(ends, alive, paths)
        D = np.diagonal(model.diffusion(few, paths.span[0]), axis1=1, axis2=2).mean(axis=0)
        unit = np.sqrt(np.maximum(2.0 * D * span + _NARROW**2 * np.var(ends, axis=0), 1e-300))
        for _ in range(_HALVINGS):
            finer = few.copy()
            twice, _ = _walked(finer, alive, paths, most=0.5 * span / steps)
            off = float(np.nanmean(np.abs(ends - finer) / unit, axis=0).max())
            if not off > allowed:
                break
            ends, steps = finer, twice
    except StoppedError:
        return math.inf, 0.0
    return span / steps, off


def _moved(start: Floats, x: Floats, mass: Floats, alive: Bools, paths: _Paths) -> tuple[int, float]:
    """Move points x from their start, an eighth by steps of half the length; those given up are not alive.

    Where the two part beyond chance, steps are too long, as they may be for jumps: all is done again.

    Returns
    -------
    int, float
        The steps of a block, and in standard deviations by how much the two have parted nevertheless.
    """
    fine = np.arange(len(x)) // LANES % _GROUP == _GROUP - 1
    some, others, longest, taken = np.flatnonzero(fine[::LANES]), np.flatnonzero(~fine[::LANES]), math.inf, 0
    parted, (before, chance) = math.inf, _apart(x, mass, fine)
    for halvings in range(_HALVINGS + 1):
        steps, _ = _walked(x, alive, paths, others, longest)
        if not len(some):
            return steps, 0.0
        longest, taken = 0.5 * (paths.span[1] - paths.span[0]) / steps, taken + steps
        _walked(x, alive, paths, some, longest)
        own = (slice(None),) if alive.all() else (alive,)
        after, chance = _apart(x[own], mass[own], fine[own])
        earlier, parted = parted, float(np.max(after - before - _CHANCE * chance))
        helped = parted < _HELPED * earlier  # else it is chance that the two are apart, and not their steps
        if parted <= 0.0 or not helped or halvings == _HALVINGS or 4 * steps > paths.scheme.max_steps:
            break
        x[:], alive[:] = start, True
    return taken, max(parted, 0.0)


def _apart(x: Floats, mass: Floats, some: Bools) -> tuple[Floats, Floats]:
    """How far apart means, and half the variances, of two samples are, and may be by chance; (2, n) each.

    In standard deviations. The samples are some of the points, and the others.
    """
    n = x.shape[1]
    if some.all() or not some.any():
        return np.zeros((2, n)), np.zeros((2, n))
    own, (mean, second, fourth) = mass * some, np.empty((3, 2, n))
    part = group_moments(np.ascontiguousarray(x), mass, own, mean, second, fourth)
    variance = np.maximum(second[1], 1e-300)
    off = np.abs(mean[0] - mean[1]) / np.sqrt(variance)
    apart = np.array([off, 0.5 * np.abs(second[0] / variance - 1.0)])
    by_chance = np.array([np.ones(n), 0.5 * np.sqrt(np.maximum(fourth[1] / variance**2 - 1.0, 0.0))])
    squares = float(np.sum(own**2)) / part**2 + float(np.sum((mass - own) ** 2)) / (1.0 - part) ** 2
    return apart, math.sqrt(squares) * by_chance


def _walked(
    x: Floats, alive: Bools, paths: _Paths, which: Ints | None = None, most: float = math.inf
) -> tuple[int, float]:
    """Move some blocks of points, or all, by steps of at most a length.

    Returns
    -------
    int, float
        Mean number of steps of a block, and the shortest first one.
    """
    model, span, scheme, key, variance, first, bound, still, ends = paths
    ends = np.empty((0, len(x))) if ends is None else ends
    steps = PLATEN if model.state_dependent_noise else SHIFTED_PATH
    blocks = -(-len(x) // LANES)
    which = np.arange(blocks) if which is None else which
    report, tolerance = np.zeros((blocks, 2)), _BIAS / math.sqrt(len(x))
    rate = rate_of_time(model, x[:_LOOKED_AT], *span)
    rough = tolerance / BIAS_PER_ERROR[steps]
    part = (4.0 * rough) ** (1 / 3) if steps == SHIFTED_PATH else math.sqrt(rough)
    longest = min(part / rate if rate > 0.0 else math.inf, model.max_step)
    if model.domain.walled.any():
        longest = min(longest, _beside_walls(model, x, variance, span[0]))
    limits = min(longest, most, bound), first, tolerance, float(scheme.max_steps)
    entries = address_of(model.drift_batch), address_of(model.noise_batch)
    root = noise_root(model.spectral_density)
    constants = model.p, variance, np.zeros_like(root) if still else root
    with surfacing():
        codes, stream = model.domain.codes, (steps, key)
        move_blocks()(x, alive, ends, report, which, span, limits, entries, constants, codes, stream)
    report = report[which]
    if not report[:, 0].all():
        stopped = report[report[:, 0] == 0, 1][0]
        raise StoppedError(
            f"prediction from {span[0]:g} to {span[1]:g} stopped at t = {stopped:.6g}: "
            f"{scheme.max_steps} steps were not enough for a cloud; the drift is stiff. Allow more with "
            f"scheme=CloudScheme(max_steps=...), or predict over a shorter interval"
        )
    return math.ceil(report[:, 0].mean()), float(report[:, 1].min())


def _near(before: Floats, after: Floats) -> Bools:
    """Which points have not run away, out of all proportion to where they and others were and are."""
    with np.errstate(invalid="ignore", over="ignore"):
        extent = np.ptp(before[:: max(len(before) // LANES, 1)], axis=0)
        off = after - before
        off /= extent
        if max(off.max(), -off.min()) <= 0.1 * _AWAY:  # as ever: none can be
            return np.ones(len(after), dtype=bool)
        few = slice(None, None, max(len(after) // _SEEN, 1))
        low, middle, high = np.percentile(after[few], [25.0, 50.0, 75.0], axis=0)
        extent = np.maximum(np.ptp(before[few], axis=0), high - low)
        return np.asarray(np.all(np.abs(after - middle) <= _AWAY * extent, axis=1))


def _beside_walls(model: SDE, x: Floats, variance: Floats, t: float) -> float:
    """Longest step whose noise sees walls: a small part of the spread along each axis that ends."""
    D = np.diagonal(model.diffusion(x[:_LOOKED_AT], t), axis1=1, axis2=2).max(axis=0)
    noisy = model.domain.walled & (D > 0.0)
    return float(np.min(_PART_OF_WALLS**2 * variance[noisy] / (2.0 * D[noisy]), initial=math.inf))


def _blow_up(model: SDE, x: Floats, t0: float, t1: float) -> str:
    """Sentence for states (K, n) from which paths left the finite numbers."""
    x = x[np.argsort(np.abs(model.drift(x, t0)).sum(axis=1))[-_LOOKED_AT:]]
    return carried_off(model, x, t0, t1) or blow_up(model, x[-1], t0, t0, t1)


def _error(density: ParticleDensity, before: Floats, after: Floats, mass: Floats) -> tuple[float, float]:
    """Error of the mean in standard deviations: what is left of the error before, and that of new noise; and
    the part that is left.

    The part of the variance that the points had before is how far the error before goes on.
    """
    few = slice(None, None, max(len(after) // _SEEN, 1))
    before, after, even = before[few], after[few], mass[few] / mass[few].sum()
    both = np.hstack([before, after])
    if density.domain is not None:
        d = density.domain
        both = np.hstack([d.nearest(X - d.mean(X, even)) for X in (before, after)])
    n, cov = density.dim, moments(both, even)[1]
    scale = np.sqrt(np.maximum(np.diag(cov), 1e-300))
    cov = cov / np.outer(scale, scale)
    old, new, cross = (cov[rows, columns] for rows, columns in _quarters(n))
    inverse = np.linalg.pinv(old, hermitian=True), np.linalg.pinv(new, hermitian=True)
    kept = min(max(float(np.trace(inverse[1] @ cross.T @ inverse[0] @ cross)) / n, 0.0), 1.0)
    return math.sqrt(kept * density.error**2 + (1.0 - kept) * float(np.sum(mass**2))), math.sqrt(kept)


def _quarters(n: int) -> tuple[tuple[slice, slice], ...]:
    first, last = slice(0, n), slice(n, 2 * n)
    return (first, first), (last, last), (first, last)


def _info(model: SDE, count: int, steps: int, lost: float, error: float) -> PredictInfo:
    status = f"on a cloud of {count} points: the mean is good to {error:.2g} standard deviations"
    code = Code.CLOUD
    if lost > _DOUBTFUL:
        status += f", but the model carried {100 * lost:.2g} % of the probability to infinity"
        code |= Code.UNRESOLVED
    return PredictInfo(
        n_steps=steps,
        n_evaluations=4 * steps,
        mass_error=lost,
        error=error,
        skipped=tuple(note for note in skip_notes(model, 0) if "evaluation of D" in note),
        scheme="cloud",
        status=status,
        code=code,
    )
