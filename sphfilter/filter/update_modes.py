"""Bayes' rule on all modes of a model that switches: each by its own evidence."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import logsumexp

from .._types import Floats
from ..config import FilterConfig
from ..core.limits import SAID
from ..density.modes import ModeDensities
from ..density.moments import moments_of_sum
from ..errors import PropagationError
from ..info import NOTHING_CAME, UpdateInfo, codes_of, schemes_of
from ..model.measurements import Sensor
from .inherited import shift_left_by_update
from .update import update


@dataclass(frozen=True, kw_only=True)
class ModesUpdateInfo(UpdateInfo):
    """One measurement update of all modes of a model that switches.

    Attributes
    ----------
    modes : dict of str to UpdateInfo
        What was said of each mode; of one that has no probability, or whose density knows nothing of such a
        reading, nothing.
    splitting_error : float
        Estimated part of the posterior that the last prediction's steps have put at wrong states or modes.
    """

    modes: dict[str, UpdateInfo] = field(default_factory=dict)
    splitting_error: float = 0.0


def update_modes(
    modes: ModeDensities,
    sensors: Mapping[str, Sensor],
    z: ArrayLike | None,
    config: FilterConfig,
    n_particles: Any,
) -> tuple[ModeDensities, ModesUpdateInfo]:
    """Multiply the density of every mode by the likelihood of z (k,), and its probability by its evidence.

    The sensors are those of all modes, in their order; `n_particles`, a number or "auto", is as of `update`.
    A mode in which the reading cannot have come about has no probability left; `PropagationError` is raised
    if it cannot have in any.
    """
    names = list(sensors)
    if not any(sensor.observed(z).any() for sensor in sensors.values()):
        said: dict[str, Any] = {"accepted": True, "log_evidence": 0.0, "reason": NOTHING_CAME}
        return modes, ModesUpdateInfo(n_particles=modes.n_particles, error=modes.error, **said)
    log_w, densities = np.full(len(names), -math.inf), list(modes.densities)
    splitting, of_evidence = np.zeros(len(names)), np.zeros(len(names))
    infos: dict[int, UpdateInfo] = {}
    problem: PropagationError | None = None
    for i, own, density in modes.some:
        try:
            new, infos[i] = update(density, sensors[names[i]], z, config, n_particles=n_particles)
        except PropagationError as found:
            problem = problem or found
            continue
        log_w[i], densities[i] = own + infos[i].log_evidence, new
        fresh = 0.0 if modes.ripples is None else modes.ripples[i].mass
        before = math.sqrt(max(modes.splitting[i] ** 2 - fresh**2, 0.0))
        splitting[i] = shift_left_by_update(density.cov(), new.cov()) * before
        of_evidence[i] = infos[i].evidence_error
    if problem is not None and not infos:
        raise problem
    log_evidence = float(logsumexp(log_w))
    log_off = np.array([_log_off(modes, i, sensors[name], z, log_w[i]) for i, name in enumerate(names)])
    brought_out = np.subtract(log_off, log_w, out=np.full(len(names), -math.inf), where=log_w > -math.inf)
    splitting = np.hypot(splitting, np.exp(np.minimum(brought_out, 0.0)))
    of_evidence[np.isnan(of_evidence) & (log_w - log_evidence < math.log(SAID))] = 0.0  # of next to nothing
    unsure = modes.unsure + of_evidence**2 + np.logaddexp(0.0, brought_out) ** 2
    posterior = ModeDensities(log_w, densities, np.minimum(splitting, 1.0), None, unsure)
    off = float(np.exp(min(logsumexp(log_off) - log_evidence, 0.0)))
    told = {names[i]: info for i, info in infos.items()}
    flagged = [(names[i], info) for i, info in infos.items() if info.flagged and posterior.w[i] > SAID]
    y, S = _innovation([(modes.w[i], info) for i, info in infos.items()])
    return posterior, ModesUpdateInfo(
        accepted=any(info.accepted for i, info in infos.items() if posterior.w[i] > SAID),
        log_evidence=log_evidence,
        innovation=y,
        innovation_cov=S,
        reason=told[names[int(np.argmax(log_w))]].reason,
        n_particles=posterior.n_particles,
        error=posterior.error,
        # a density that is wrong by so many standard deviations of its mean is so by about as many nats
        evidence_error=math.hypot(float(posterior.w @ of_evidence), posterior.error, math.log1p(off)),
        status="; ".join(f"{name}: {info.status}" for name, info in flagged if info.status != "ok") or "ok",
        code=codes_of(info for _, info in flagged),
        scheme=schemes_of(infos.values()),
        modes=told,
        splitting_error=off,
    )


def _log_off(modes: ModeDensities, i: int, sensor: Sensor, z: ArrayLike | None, log_w: float) -> float:
    """Logarithm of what the last prediction got wrong of a mode's part of the evidence, which is log_w."""
    if modes.ripples is None or not len(modes.ripples[i].X):
        return -math.inf
    X, off, mass, exact = modes.ripples[i]
    about = modes.heaviest
    X = X if about.domain is None else about.domain.fold(X)
    found = float(modes.log_w[i] + logsumexp(sensor.log_likelihood(z, X, about.t), b=off))
    return found if exact or mass == 0.0 else max(found, log_w + math.log(mass))


def _innovation(infos: list[tuple[float, UpdateInfo]]) -> tuple[Floats | None, Floats | None]:
    """Innovation and its covariance over all modes, by their probabilities before."""
    known = [(w, info.innovation, info.innovation_cov) for w, info in infos if info.innovation is not None]
    if not known:
        return None, None
    weights, y, S = (np.array(part) for part in zip(*known, strict=True))
    return moments_of_sum(weights / weights.sum(), y, S)
