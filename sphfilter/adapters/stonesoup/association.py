"""Several detections, one at most the target's: what each says alone, and all of them together."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.special import logsumexp
from stonesoup.types.hypothesis import Hypothesis
from stonesoup.types.state import State

from ..._types import Bools, Floats
from ...config import FilterConfig, LogDensityScheme
from ...core.limits import LITTLE
from ...density.initialize import NEGLIGIBLE
from ...density.particle_density import ParticleDensity
from ...density.resample import logarithm, max_particles_of
from ...errors import ModelError, PropagationError
from ...filter.update import update
from ...filter.update_again import Update
from ...info import Code, PredictInfo, UpdateInfo
from ...lattice.level_set import enough_particles, lattice_reach
from ...model.measurements import PlainSensor, Sensor
from ...prediction.again import Ladder, Outcome
from .states import DensityState

_LADDER = Ladder(times=(1, 3, 9), deeper=0.7, most=math.inf)  # for products of density and likelihood
#: Standard deviations that a mean may be off, and part of the mass, and is not tried again: a filter's aim.
_RESOLVED = FilterConfig.target_error
#: Times the nodes of the finest lattice that is tried, beyond which none is: a bound of work, 3 · 9 = 27
#: times the particles. Some of what lies beyond could be held, as tried with no bound: two wells on 60
#: particles up to 21, their mean within .02 standard deviations.
_HOPELESS = 3.0


class Part(NamedTuple):
    """A detection: what it says alone, and the probability that it is the target's.

    `used` is what an association takes of it, None where it would not be used alone: of one density mean (n,)
    and covariance (n, n) of the posterior, of modes the whole `Step`.
    """

    sensor: Sensor
    z: Floats
    log_evidence: float
    used: Any
    weight: float = 1.0


class _Likelihood(PlainSensor):
    """A sensor with a likelihood only."""

    def observed(self, z: Any) -> Bools:
        """Something was."""
        return np.ones(1, dtype=bool)


class Association(_Likelihood):
    """The likelihood of detections of which one at most is the target's, whose probabilities are given.

    p(x | all) = p(x) (b_0 + sum_i b_i p(z_i | x) / p(z_i)): each detection's posterior, and the prior for a
    miss, of probability b_0, weighted as data association has weighted them. No mixture is merged.
    """

    def __init__(self, missed: float, parts: Sequence[Part]) -> None:
        total = missed + sum(part.weight for part in parts)
        self._missed = missed / total
        self._parts = [(p.sensor, p.z, np.log(p.weight / total) - p.log_evidence) for p in parts]

    def log_likelihood(self, z: object, X: Floats, t: float = 0.0) -> Floats:
        """Logarithm of the sum above for each state X (N, n), shape (N,)."""
        with np.errstate(divide="ignore"):
            terms = [np.full(len(X), np.log(self._missed))]
        terms += [scale + sensor.log_likelihood(z, X, t) for sensor, z, scale in self._parts]
        return logsumexp(terms, axis=0)

    def posteriors(
        self, prior: ParticleDensity, config: FilterConfig, n_particles: int
    ) -> list[tuple[float, ParticleDensity]]:
        """What the sum is of: weights, and the prior or each detection's posterior."""
        found = [(self._missed, prior)]
        for sensor, z, scale in self._parts:
            posterior, info = update(prior, sensor, z, config, n_particles=n_particles)
            found.append((np.exp(scale + info.log_evidence), posterior))
        return [(weight, density) for weight, density in found if weight > NEGLIGIBLE]


class Total(_Likelihood):
    """The likelihood that makes a weighted sum of densities of one of them."""

    def __init__(self, first: ParticleDensity, parts: Sequence[tuple[float, ParticleDensity]]) -> None:
        self._first, self._parts = logarithm(first), [(np.log(w), logarithm(p)) for w, p in parts]

    def log_likelihood(self, z: object, X: Floats, t: float = 0.0) -> Floats:
        """Logarithm of the sum over the first density, for each state X (N, n), shape (N,)."""
        return logsumexp([scale + log_p(X) for scale, log_p in self._parts], axis=0) - self._first(X)


def alone(
    state: DensityState, sensor: Sensor, z: Floats, config: FilterConfig, n_particles: int | None
) -> Part:
    """What a detection says alone of a state known by one density."""
    density = state.density
    try:
        _, (posterior, info) = _LADDER.climbed(
            max_particles_of(density, n_particles),
            lambda rung: update(density, sensor, z, config, n_particles=rung.n_particles),
        )
    except PropagationError:
        return Part(sensor, z, evidence_of_points(state, sensor, z), None)
    moments = (posterior.mean(), posterior.cov()) if info.accepted else None
    return Part(sensor, z, info.log_evidence, moments)


def evidence_of_points(state: DensityState, sensor: Sensor, z: Floats) -> float:
    """Log-evidence where no posterior can be made: a sum over the points of all densities of a state."""
    each = [(log_w, p.mass, sensor.log_likelihood(z, p.x, p.t)) for log_w, p in state._some]
    return float(logsumexp([log_w + logsumexp(log_l, b=mass) for log_w, mass, log_l in each]))


def check_sharpness(weights: Sequence[float], covs: Sequence[Floats], n_particles: int) -> None:
    """Raise `PropagationError` for weights and covariances so different in width that no lattice will do.

    One that spans the widest with the spacing that the sharpest needs has as many times the nodes of a
    Gaussian as their volumes differ.
    """
    parts = zip(weights, covs, strict=True)
    log_volume = [0.5 * np.linalg.slogdet(cov)[1] for weight, cov in parts if weight > NEGLIGIBLE]
    ratio = math.exp(max(log_volume) - min(log_volume))
    if ratio * enough_particles(len(covs[0])) > _HOPELESS * max(_LADDER.times) * n_particles:
        raise PropagationError(
            f"detections much sharper than the prediction, {ratio:.2g} times, leave a density too sharp and "
            f"too broad for one lattice; use more particles"
        )


def resolved(
    multiplied: Callable[[int, FilterConfig], Outcome[UpdateInfo]],
    config: FilterConfig,
    dim: int,
    expected: Floats | None,
) -> Outcome[UpdateInfo]:
    """The `Outcome` of a product, finer and further out until it has its mass and the mean (n,) of its parts.

    A part of little weight may be wide and flat beside the others, and lie below where a lattice ends.
    `multiplied` makes an `Outcome` of times the particles and a configuration; no mean is expected where it
    is that of angles. Raises `PropagationError` where no number of particles that is tried holds it.
    """
    best = None
    for level, times in enumerate(_LADDER.times):
        try:
            found = multiplied(times, _reaching(config, dim, level * _LADDER.deeper))
        except PropagationError as problem:
            refused = problem  # more particles may hold it
            continue
        error = _error(found.density, expected, found.info.log_evidence)
        if best is None or error < best[0]:
            best = error, times, found
        if error < _RESOLVED:
            break
    if best is None:
        raise refused
    error, times, found = best
    if error > LITTLE:
        raise PropagationError(
            f"detections much sharper than the prediction leave a density too sharp and too broad for one "
            f"lattice: its mean would be {error:.2g} standard deviations off; use more particles"
        )
    times = max(times, -(-found.density.n_particles // found.bound))
    if times == 1 and error < _RESOLVED:
        return found
    told = "" if error < _RESOLVED else f", its mean within {error:.2g} standard deviations"
    told = f"association on {times} times the particles{told}"
    return found._replace(info=found.info.marked(Code.FINER, told))


def _reaching(config: FilterConfig, dim: int, deeper: float) -> FilterConfig:
    """Settings whose lattices reach `deeper` standard deviations further, where they follow a level set."""
    scheme = LogDensityScheme() if config.scheme == "auto" else config.scheme
    if not deeper or not isinstance(scheme, LogDensityScheme):
        return config
    return replace(config, scheme=replace(scheme, reach=lattice_reach(scheme, dim) + deeper))


def _error(density: ParticleDensity, expected: Floats | None, log_mass: float) -> float:
    """How far a posterior is off its mean, in standard deviations, or off the mass one."""
    if expected is None:
        return abs(log_mass)
    return max(abs(log_mass), np.abs((density.mean() - expected) / np.sqrt(np.diag(density.cov()))).max())


def predicted_apart(
    origin: Update,
    predicted: Callable[[ParticleDensity, FilterConfig], Outcome[PredictInfo]],
    config: FilterConfig,
    n_particles: int,
) -> Outcome[PredictInfo]:
    """The prediction of an association, part by part: sums of solutions solve a linear equation.

    For posteriors that are sharp and broad at once, which no lattice carries on as few particles. `predicted`
    makes an `Outcome` of a density and a configuration; that of the sum begins with the widest part.
    """
    association: Any = origin.measurement
    posteriors = association.posteriors(origin.before, config, n_particles)
    moved = [(weight, predicted(posterior, config)) for weight, posterior in posteriors]
    parts = [(weight, found.density) for weight, found in moved]
    widest = max((density for _, density in parts), key=lambda density: np.linalg.det(density.cov()))
    total = Total(widest, parts)

    def summed(times: int, config: FilterConfig) -> Outcome[UpdateInfo]:
        more = times * n_particles
        posterior, info = update(widest, total, None, config, n_particles=more)
        return Outcome(widest, posterior, info, more)

    mean = None
    if widest.domain is None:
        mean = np.average([p.mean() for _, p in parts], axis=0, weights=[w for w, _ in parts])
    _, density, sum_info, bound = resolved(summed, config, widest.dim, mean)
    info = max((found.info for _, found in moved), key=lambda info: info.mass_error)
    told = "" if sum_info.status == "ok" else f"; {sum_info.status}"
    told = f"{len(parts)} parts of the association predicted apart{told}"
    return Outcome(widest, density, info.marked(Code.REPEATED, told), bound)


def one_prediction(hypotheses: Iterable[Hypothesis]) -> State:
    """The prediction that hypotheses share."""
    predictions = [hypothesis.prediction for hypothesis in hypotheses]
    if not predictions:
        raise ModelError("there is no hypothesis: data association keeps one at least, that of a miss")
    times = {prediction.timestamp for prediction in predictions}
    if len(times) > 1:
        raise ModelError(
            f"the detections of an association have {len(times)} timestamps: give those of one time to it, "
            f"or associate each alone (NearestNeighbour)"
        )
    return predictions[0]


def probability_of(hypothesis: Hypothesis) -> float:
    """The probability of a hypothesis, as a float."""
    if not hasattr(hypothesis, "probability"):
        raise ModelError(
            "an association needs hypotheses with probabilities (PDAHypothesiser, EvidenceHypothesiser), "
            f"got a {type(hypothesis).__name__}"
        )
    return float(hypothesis.probability)
