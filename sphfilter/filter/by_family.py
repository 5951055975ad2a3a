"""Prior times likelihood as one exponential family, in a frame of its own."""

import math
from typing import NamedTuple

import numpy as np

from .._types import Floats, OfStates
from ..core.cloud.inherited import OF_UNSIGNED
from ..core.family.frame import moved, root_between
from ..core.kalman import conditioned
from ..core.limits import ALIKE, FAR, LARGEST_EXPONENT, LOOK, ROUNDING, TINY
from ..density.as_family import defect_in, family_density, family_of, moments_on_line
from ..density.defect import after_reading, read_out
from ..density.family import (
    ASTRAY,
    Family,
    gaussian_family,
    moments_apart,
    node_moments,
    node_weights,
    turned,
)
from ..density.particle_density import ParticleDensity
from ..density.passage import Use, age_of, stored_key
from ..errors import PropagationError
from ..lattice.level_set import root_of
from ..model.measurements import block, is_gaussian
from .inherited import evidence_error_by, evidence_error_of, shift_left_by_update
from .reading_at_prior import Posterior, ReadingAtPrior, info_fields

#: Points of a prior that a posterior is looked for at, and of those it may have: its mean to 1 / √8 = .35.
_LOOKED_AT, _FEW = 512, 8.0
#: Standard deviations that each point from which states explaining a reading are looked for stands for: one
#: d deviations off widens a variance, s² of the prior's, by exp(-d² / 2) (d / s)², by .1 at d = 3.5, s = .5.
_APART = 2.5
#: In logarithms: of a posterior over its family, exp(2) = 7.4 times, and below its peak, exp(-9) = 1.2e-4.
_MORE, _NEGLIGIBLE = 2.0, 9.0
_SETTLED = 1e-3  # of the moments in the frame; measured: half, twice move means of six scenes by 2e-6, .015
_ROUNDS, _LEAST, _MOST = 8, 0.05, 4.0  # rounds, and their variances; measured: half and twice change no run
#: Times and part of the frame, in which nodes are looked at once more: both rules miss two modes alike.
#: Measured on 208 such posteriors: the rules alone told .1 of what is made, with these .7. A Gaussian is off
#: by 5e-5 then (of up to three states), by 5e-4 one that cubics hold.
_WIDER, _WIDER_OF_CUBICS = 1.1, 1.05


def by_family(
    density: ParticleDensity, asked: ReadingAtPrior, n_particles: int, degree: int, most: float = math.inf
) -> tuple[Posterior, float]:
    """Posterior and what is said of it, and the error in standard deviations that it adds to the prior's.

    Raises `PropagationError` if no family holds it, or the error of that would be above `most`.
    """
    if density.form.own_points or density.walls[0].size:
        raise PropagationError(
            "one family does not hold this density, which has no smooth logarithm; use another scheme"
        )
    closed = by_kalman(density, asked, degree, n_particles)
    if closed is not None:
        return closed, 0.0
    prior, misfit = family_of(density, degree)
    found = family_posterior(prior, asked.weight_on(density.domain), _linearised(density, asked))
    missed, of_evidence = 0.0, found.evidence_apart
    if not asked.linear:
        missed, nats = _errors_beyond_nodes(density, asked, prior, found.family, found.log_evidence)
        of_evidence = math.hypot(of_evidence, nats)
    new = family_density(density, found.family, capacity=n_particles, gaussian=False)
    moments, before = (moments_on_line(density), moments_on_line(new)), defect_in(density, prior, misfit)
    spread = np.sqrt(np.maximum(np.abs(moments[1][1].diagonal()), TINY))
    if not np.linalg.eigvalsh(moments[1][1] / np.outer(spread, spread))[0] > ROUNDING**2:
        raise PropagationError(
            f"what a reading leaves is too narrow for the nodes of a family of degree {degree}"
        )
    left = after_reading(prior, before, found.family, found.products, moments)
    told = read_out(found.family, left.defect, left.rest)
    unseen = math.hypot(found.apart, OF_UNSIGNED * missed)
    error, of_variance = math.hypot(told.error, unseen), math.hypot(told.variance, math.sqrt(2.0) * unseen)
    added = math.sqrt(max(error**2 - density.error**2, 0.0))
    if not added <= most:
        raise PropagationError(f"one family of degree {degree} is off by {added:.2g} after the reading")
    of_evidence = math.hypot(
        of_evidence, evidence_error_by(read_out(prior, before), left.log_mass, density, new)
    )
    said = info_fields(asked, "family", found.log_evidence, error, of_evidence)
    defect = left.defect._replace(U=left.defect.U + missed**2 * moments[1][1])
    said |= {"residual": left.rest, "variance_error": of_variance}
    return (new.noted(error=error, defect=defect, rough=defect.rough(found.family)), said), added


def by_kalman(
    density: ParticleDensity, asked: ReadingAtPrior, degree: int, n_particles: int
) -> Posterior | None:
    """A Gaussian times the likelihood of a linear sensor, which adds no error; None where there is none."""
    if not (density.gaussian and density.domain is None and asked.linear and is_gaussian(asked.measurement)):
        return None
    assert asked.measurement.H is not None and asked.innovation is not None
    H, R = asked.measurement.H[asked.seen], block(asked.measurement.noise_cov, asked.seen)
    mean, cov = moments_on_line(density)
    (x,), (P,), (log_evidence,) = conditioned(mean[None], cov[None], asked.innovation[None], H, R)
    if not math.isfinite(log_evidence):
        return None
    try:
        found = gaussian_family(x, P, degree)
    except np.linalg.LinAlgError:
        return None
    new = family_density(density, found, capacity=n_particles, gaussian=True)
    left = shift_left_by_update(cov, P, True) if density.error else 0.0  # of nothing
    error = left * density.error
    said = info_fields(asked, "family", float(log_evidence), error, evidence_error_of(density, new))
    return new.noted(error=error), said | {"residual": 0.0}


def _errors_beyond_nodes(
    density: ParticleDensity, asked: ReadingAtPrior, prior: Family, posterior: Family, log_evidence: float
) -> tuple[float, float]:
    """Errors of the posterior's family, standard deviations, and of the log-evidence, as points of the prior
    see it.

    At these the posterior and its family weigh the prior, and the difference of the weights tells by how much
    mean, covariance and integral differ: in tails, too, which lie beyond all nodes. Raises `PropagationError`
    if a state explains the reading as well and is nowhere near, or too few points lie where the posterior is
    to tell.
    """
    key = stored_key(age_of(density), Use.ELSEWHERE)
    X, mass = density.form.bare.drawn(_LOOKED_AT, key)
    weight = asked.weight_on(density.domain)
    (_, cov), (own_mean, own_cov) = _moments(prior), _moments(posterior)
    root = np.linalg.inv(np.linalg.cholesky(own_cov))
    elsewhere = 0.0  # by how much what no node sees widens a variance
    states = asked.explained(X[:: _LOOKED_AT // LOOK], _APART * np.linalg.cholesky(cov))
    share = math.exp(0.5 * (np.linalg.slogdet(own_cov)[1] - np.linalg.slogdet(cov)[1]))
    if states is None and not is_gaussian(asked.measurement) and share * _LOOKED_AT < _FEW:
        raise PropagationError("one family may not be all that is left of so sharp a likelihood")

    if states is not None and len(states):
        true = prior.log_p(states) + weight(states) - log_evidence
        below = posterior.log_p(own_mean[None]) - true
        far = (((states - own_mean) @ root.T) ** 2).sum(axis=1)  # a peak that far off widens a variance so
        log_wider = np.log(np.maximum(far, 1.0)) - below
        other = true - posterior.log_p(states) > _MORE
        if np.any(other & ((below < _NEGLIGIBLE) | (log_wider > math.log(1.0 - ALIKE)))):
            raise PropagationError(
                "one family does not hold the posterior: other states explain the reading too"
            )
        elsewhere = math.exp(np.max(log_wider[other], initial=-math.inf))
    likely, own = weight(X) - log_evidence, posterior.log_p(X) - prior.log_p(X)
    off = mass * (np.exp(np.minimum(likely, LARGEST_EXPONENT)) - np.exp(np.minimum(own, LARGEST_EXPONENT)))
    y = (X - own_mean) @ root.T
    with np.errstate(over="ignore", invalid="ignore"):  # of a family that is nowhere near
        apart = moments_apart(off @ y, (y * off[:, None]).T @ y - off.sum() * np.eye(len(cov)))
    worst = 1e3  # an error that is as bad as any
    return min(math.hypot(apart, elsewhere), worst), min(abs(float(off.sum())), worst)


def _moments(family: Family) -> tuple[Floats, Floats]:
    mean, cov = node_moments(family.nodes, family.weighted()[0])
    root_of(cov, "one family does not hold the density: few of its nodes have any weight")
    return mean, cov


def _linearised(density: ParticleDensity, asked: ReadingAtPrior) -> tuple[Floats, Floats] | None:
    """Mean and a factor of the covariance by statistical linearisation; None without a Gaussian sensor."""
    if asked.innovation is None or asked.S is None or asked.cross is None:
        return None
    mean, cov = moments_on_line(density)
    try:
        gain = np.linalg.solve(asked.S, asked.cross.T).T
        cov = cov - gain @ asked.cross.T
        return mean + gain @ asked.innovation, np.asarray(np.linalg.cholesky(0.5 * (cov + cov.T)), np.float64)
    except np.linalg.LinAlgError:  # a sensor as sharp as rounding
        return None


class FamilyPosterior(NamedTuple):
    """A posterior, the log of its integral before it was normalised, and how far other rules are from it."""

    family: Family
    log_evidence: float
    products: Floats  # (N,) logarithms of prior times likelihood, normalised, at the nodes of both rules
    apart: float  # at most, of mean and covariance, standard deviations
    evidence_apart: float  # nats


def family_posterior(
    prior: Family, log_weight: OfStates, first: tuple[Floats, Floats] | None = None
) -> FamilyPosterior:
    """A family times exp(log_weight(X)), of states X (M, n), in a frame of its own.

    That begins with the prior's, or with a mean (n,) and a factor (n, n) of a covariance. Raises
    `PropagationError` if no frame fits the posterior, or the likelihood is zero where it has nodes.
    """
    rule = prior.basis
    mu, A = (prior.mu, prior.A) if first is None else first
    for left in range(_ROUNDS, 0, -1):
        log_p = _product(prior, log_weight, mu + rule.xi @ A.T)
        w, log_evidence = node_weights(rule, A, log_p)
        b, C = node_moments(rule.xi, w)
        off = moved(b, C)
        if off < _SETTLED or left == 1:
            break
        root = np.empty(C.shape)
        root_between(C, _LEAST, _MOST, root)
        mu, A = mu + A @ (b * min(1.0, FAR / max(float(np.linalg.norm(b)), TINY))), A @ root
    if not off < ASTRAY:
        raise PropagationError(
            f"one family of degree {prior.degree} does not hold the posterior: its frame does not settle"
        )
    found, more = Family(mu, np.ascontiguousarray(A), log_p @ rule.F), turned(len(mu), prior.degree)
    apart, of_evidence, looks = 0.0, 0.0, [log_p]
    wider = _WIDER if prior.degree > 3 else _WIDER_OF_CUBICS
    for times in (1.0, wider, 1.0 / wider):
        looks.append(_product(prior, log_weight, mu + times * (more.xi @ A.T)))
        w, own_evidence = node_weights(more, times * A, looks[-1])
        own_b, own_C = node_moments(more.xi, w)
        apart = max(apart, moments_apart(b - times * own_b, C - times**2 * own_C))
        of_evidence = max(of_evidence, abs(log_evidence - own_evidence))
    products = np.concatenate(looks[:2]) - log_evidence
    return FamilyPosterior(found.normalised(), log_evidence, products, apart, of_evidence)


def _product(prior: Family, log_weight: OfStates, X: Floats) -> Floats:
    """Log of prior times likelihood at states."""
    log_p = prior.log_p(X) + log_weight(X)
    if np.count_nonzero(np.isfinite(log_p)) < len(log_p):
        raise PropagationError("one family does not hold the posterior: the likelihood is zero at its nodes")
    return log_p
