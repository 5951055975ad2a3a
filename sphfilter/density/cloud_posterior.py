"""Bayes' rule on clouds: points weighted by the likelihood, or drawn anew where it is sharp."""

import math
from typing import Any, NamedTuple

import numpy as np

from .._types import Bools, Floats, OfStates
from ..core.sph.kernels import Kernel
from ..errors import PropagationError
from ..info import DOUBTFUL
from ..model.domain import Domain
from . import mixture
from .as_cloud import cloud_density
from .cloud import (
    KERNEL,
    key_of,
    moments,
    moments_of,
    points_of,
    systematic,
)
from .distributions import gaussian_log_pdf
from .particle_density import ParticleDensity
from .quasi_random import quasi_random, standard_normal
from .resample import logarithm
from .shapes import Folded

__all__ = ["CloudPosterior", "cloud_posterior", "passed_on"]

_ENOUGH = 800  # effective points that are drawn anew, where too few of the prior's are in the posterior
_MOST_DRAWN = 4096  # points whose densities are compared
_KERNELS = 2048  # of what they are drawn from
_WIDE, _WIDENED = 0.1, 4.0  # share of points from a Gaussian that is wider than what they are drawn from
_ROUNDS, _CORRECTED = 60, 6  # powers of a likelihood, and draws that are weighted by the prior
_ASKED = 64  # points of a posterior that are asked for the kernels that they see
_FEW_A_TERM = 20  # effective points for a state, below which kernels are not fitted to them


class CloudPosterior(NamedTuple):
    """A cloud, the log-evidence that led to it, and the error of that, nats."""

    density: ParticleDensity
    log_evidence: float
    evidence_error: float


def cloud_posterior(prior: ParticleDensity, log_weight: OfStates, n_points: int) -> CloudPosterior:
    """Density times exp(log_weight(X)) as a cloud of at most `n_points` points.

    Parameters
    ----------
    prior : ParticleDensity
        Of any kind.
    log_weight : callable
        States (M, n) to logarithms (M,); the likelihood may be zero.
    n_points : int

    Returns
    -------
    CloudPosterior

    Raises
    ------
    PropagationError
        The likelihood is zero at all points.
    """
    key, x, mass = key_of(prior), prior.x, prior.mass
    if prior.read_out != "cloud":
        x, mass = points_of(prior, n_points, key)
    weight = log_weight(x)
    if not np.any(weight > -np.inf):
        raise PropagationError(
            "prior times likelihood is zero wherever the prior has particles: check the measurement, its "
            "unit and its noise"
        )
    w, log_evidence = _normalised(np.log(mass) + weight)
    before = _effective(mass)
    if _effective(w) >= min(1.0 / DOUBTFUL**2, 0.5 * before):
        inflow = float(np.sum(w**2)) - 1.0 / before
        return CloudPosterior(_cloud(prior, x, w, -1.0 / before), log_evidence, math.sqrt(max(inflow, 0.0)))
    return _closed_in(prior, x, mass, weight, log_weight, key)


def _closed_in(
    prior: ParticleDensity, x: Floats, mass: Floats, weight: Floats, log_weight: OfStates, key: int
) -> CloudPosterior:
    """Follow the likelihood to powers that rise to one, each with points of its own; then weigh by the prior.

    The points of the last power are drawn from a density that is known, so that prior times likelihood over
    it is right whatever the way there was.
    """
    least = _spacing(x, mass)
    count, log_mass, power = min(len(x), _MOST_DRAWN), np.log(mass), 0.0
    log_prior = logarithm(prior)
    best: tuple[float, Floats, Floats, float] | None = None
    for k in range(_ROUNDS + _CORRECTED):
        step = _power(log_mass, weight, 1.0 - power)
        power, closed = power + step, power + step >= 1.0
        w, _ = _normalised(log_mass + (step * weight if step > 0.0 else 0.0))
        middle = None if prior.domain is None else prior.domain.mean(x, w)
        x, log_q = _proposed(_unrolled(prior, x, w), w, least, count, key + k)
        log_mass = np.zeros(count)
        if prior.domain is not None and middle is not None:
            log_mass[~_inside(prior.domain, x, middle)] = -np.inf
            x = prior.domain.fold(x)
        weight = log_weight(x)
        if not closed:
            continue
        log_w = log_mass + log_prior(x) + weight - log_q
        if not np.any(log_w > -np.inf):
            continue
        w, total = _normalised(log_w)
        if best is None or _effective(w) > best[0]:
            best = _effective(w), x, w, total - math.log(count)
        if best[0] >= _ENOUGH or k >= _ROUNDS:
            break
        log_mass, weight = log_w, np.zeros(count)
    if best is None:
        raise PropagationError("the likelihood is too sharp to close in on; check the measurement's noise")
    effective, x, w, log_evidence = best
    local = _local_error(prior, x, w)
    inflow = local**2 * min(1.0, _narrower(prior, x, w))
    error = math.sqrt(max(1.0 / effective - 1.0 / count, 0.0) + local**2)
    return CloudPosterior(_cloud(prior, x, w, inflow, whole=False), log_evidence, error)


def _normalised(log_w: Floats) -> tuple[Floats, float]:
    """Weights whose sum is one, and the logarithm of what it was."""
    top = log_w.max()
    w = np.exp(log_w - top)
    total = w.sum()
    return w / total, float(top + math.log(total))


def _effective(w: Floats) -> float:
    return 1.0 / float(np.sum(w**2))


def _power(log_mass: Floats, weight: Floats, most: float) -> float:
    """Largest power, at most `most`, under which enough points count; a small one if there is none."""

    def enough(power: float) -> bool:
        return _effective(_normalised(log_mass + power * np.maximum(weight, -1e300))[0]) >= need

    need = min(_ENOUGH, 0.5 * _effective(_normalised(log_mass)[0]))
    if most <= 0.0 or enough(most):
        return most
    low, high = 1e-12 * most, most
    if not enough(low):  # the likelihood is zero at almost all points
        return most
    while high > 1.02 * low:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if enough(middle) else (low, middle)
    return low


def _spacing(x: Floats, mass: Floats) -> Floats:
    """Distance of points along each axis, shape (n,)."""
    std = np.sqrt(np.diag(moments(x, mass)[1]))
    return std * _effective(mass) ** (-1.0 / x.shape[1])


def _proposed(x: Floats, w: Floats, least: Floats, count: int, key: int) -> tuple[Floats, Floats]:
    """Draw points (count, n) near weighted ones, with the logarithms of the density that they are drawn from.

    Kernels around them, and a wider Gaussian so that no point of what is sought is ever unlikely.
    """
    n = x.shape[1]
    mean, cov = moments(x, w)
    kernel, fits = Kernel.of(KERNEL, n), _effective(w) >= _FEW_A_TERM * n
    few = x[systematic(w, _KERNELS)]
    mix = mixture.shrunk(few, np.full(_KERNELS, 1.0 / _KERNELS), None, kernel) if fits else None
    if mix is None:
        cov = cov + np.diag(least**2)
        factor = np.diag(np.sqrt(np.diag(cov) * mixture.silverman(w, n) ** 2 + least**2))
        own = np.full(_KERNELS, 1.0 / _KERNELS), np.full(_KERNELS, 1.0 / math.sqrt(kernel.variance))
        mix = mixture.mixture(np.linalg.solve(factor, few.T).T, *own, kernel, factor=factor)
    wide = math.ceil(_WIDE * count)
    uniform = quasi_random(count - wide, n + 1, key)
    near = mixture.points(mix, mixture.drawn(kernel.kind, uniform), systematic(mix.mass, count - wide))
    far = _normal(mean, _WIDENED * cov, wide, key)
    X = np.concatenate([near, far])
    with np.errstate(divide="ignore"):
        log_near = np.log(mixture.pdf(mix, X)) + math.log(1.0 - wide / count)
    log_far = gaussian_log_pdf(mean, _WIDENED * cov)(X) + math.log(wide / count)
    return X, np.logaddexp(log_near, log_far)


def _normal(mean: Floats, cov: Floats, count: int, key: int) -> Floats:
    return mean + np.einsum("ij,kj->ik", standard_normal(count, len(mean), key), np.linalg.cholesky(cov))


def _local_error(prior: ParticleDensity, x: Floats, w: Floats) -> float:
    """Relative error of a cloud's density, averaged over a posterior: as few of its kernels are seen there.

    Responsibilities of the kernels for some of the posterior's points say how many.
    """
    if prior.read_out != "cloud":
        return 0.0
    shape: Any = prior.form.shape if isinstance(prior.form, Folded) else prior.form
    mix, seen = shape.mixture, np.zeros(prior.n_particles)
    for z in np.linalg.solve(mix.factor, (x[systematic(w, _ASKED)] - mix.centre).T).T:
        q = np.minimum(np.sqrt(np.sum((mix.z - z) ** 2, axis=1)) / (mix.kernel.radius * mix.h), 1.0)
        near = mix.mass * (1.0 - q) ** 4 * (1.0 + 4.0 * q)
        seen += near / max(near.sum(), 1e-300)
    return math.sqrt(min(1.0, float(np.sum(seen**2)) / max(seen.sum() ** 2, 1e-300)))


def _narrower(prior: ParticleDensity, x: Floats, w: Floats) -> float:
    """Variance of a posterior over that of the prior's kernels, on average over the axes."""
    std = [np.diag(moments(_unrolled(prior, X, m), m)[1]) for X, m in ((x, w), (prior.x, prior.mass))]
    return float(np.mean(std[0] / std[1])) / mixture.silverman(prior.mass, prior.dim) ** 2


def _unrolled(prior: ParticleDensity, x: Floats, w: Floats) -> Floats:
    """Points on the line around their mean direction, where an axis is periodic."""
    if prior.domain is None:
        return x
    mean = prior.domain.mean(x, w)
    return mean + prior.domain.nearest(x - mean)


def _inside(domain: Domain, x: Floats, middle: Floats) -> Bools:
    """Which points lie between walls, and within half a turn of a middle (n,)."""
    d = x - middle
    return domain.contains(x) & np.all(domain.nearest(d) == d, axis=1)


def _cloud(
    prior: ParticleDensity, x: Floats, w: Floats, inflow: float, whole: bool = True
) -> ParticleDensity:
    """The posterior of points and weights, with its error.

    Its square is the sampling error of the weights, and what the prior's error leaves: as much less as the
    reading narrows the density, and more where its points are copies of few. `inflow` is added; with `whole`
    weights it is that share of the prior's.
    """
    new = cloud_density(prior, x, w)
    unit = np.sqrt(np.maximum(np.diag(prior.cov()), 1e-300))
    mean, cov = moments_of(new) if prior.domain is None else moments(_unrolled(prior, x, w), w)
    squares = float(np.sum(w**2))
    middle, second = moments(_unrolled(prior, x, w), w**2 / squares)
    second = squares * (second + np.outer(middle - mean, middle - mean))
    before, cov, second = (C / np.outer(unit, unit) for C in (prior.cov(), cov, second))
    keeps = min(float(np.trace(np.linalg.lstsq(before, cov, rcond=None)[0])) / prior.dim, 1.0)
    sampled = float(np.sum(np.linalg.pinv(cov, hermitian=True) * second)) / prior.dim
    left = keeps * prior.error**2 + (keeps * inflow if whole else inflow)
    if whole and prior.read_out == "cloud":
        left = passed_on(prior, squares, keeps)
    square = sampled + left
    return new.noted(error=math.sqrt(max(square, 0.0)))


def passed_on(prior: ParticleDensity, squares: float, keeps: float) -> float:
    """Square of the error that a cloud's posterior has from what is wrong with its prior beyond the weights.

    Points may be copies of fewer, and fill a part of the density's volume, as far as noise has moved them
    apart. A reading that leaves less than that of it leaves fewer of the points that they come from.

    Parameters
    ----------
    prior : ParticleDensity
        A cloud.
    squares : float
        Sum of the squares of the posterior's weights.
    keeps : float
        Variance of the posterior over that of the prior.
    """
    before = float(np.sum(prior.mass**2))
    n, apart = prior.dim, 1.0 - prior.inherited
    seen = min(1.0, (min(1.0, before / squares) ** (2.0 / n) + apart) ** (0.5 * n))
    return max(keeps, min(1.0, keeps / max(apart, 1e-9)) / seen) * max(prior.error**2 - before, 0.0)
