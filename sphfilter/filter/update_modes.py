"""Bayes' rule on all modes of a model that switches: each by its own evidence."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import reduce
from operator import or_
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import logsumexp

from .._types import Floats
from ..config import FilterConfig
from ..core.limits import LARGEST_EXPONENT, SAID
from ..density.modes import ModeDensities
from ..density.moments import moments_of_sum
from ..errors import PropagationError
from ..info import NOTHING_CAME, Code, UpdateInfo
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
    """

    modes: dict[str, UpdateInfo] = field(default_factory=dict)


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
    splitting, unsure = modes.splitting.copy(), modes.unsure
    infos: dict[int, UpdateInfo] = {}
    problem: PropagationError | None = None
    for i, own, density in modes.some:
        try:
            new, infos[i] = update(density, sensors[names[i]], z, config, n_particles=n_particles)
        except PropagationError as found:
            problem = problem or found
            continue
        log_w[i], densities[i] = own + infos[i].log_evidence, new
        fresh, brought_out = _off(modes, i, sensors[names[i]], z, infos[i].log_evidence)
        before = math.sqrt(max(splitting[i] ** 2 - fresh**2, 0.0))
        left = shift_left_by_update(density.cov(), new.cov(), new.gaussian)
        splitting[i] = math.hypot(left * before, brought_out)
        if unsure is not None:
            unsure = unsure + infos[i].evidence_error ** 2 * (np.arange(len(names)) == i)
    if problem is not None and not infos:
        raise problem
    log_evidence = float(logsumexp(log_w))
    posterior = ModeDensities(log_w, densities, np.minimum(splitting, 1.0), None, unsure)
    told = {names[i]: info for i, info in infos.items()}
    flagged = [(names[i], info) for i, info in infos.items() if info.flagged and posterior.w[i] > SAID]
    w = [float(posterior.w[i]) for i in infos]
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
        evidence_error=math.hypot(
            np.dot(w, [info.evidence_error for info in infos.values()]), posterior.error
        ),
        status="; ".join(f"{name}: {info.status}" for name, info in flagged if info.status != "ok") or "ok",
        code=reduce(or_, (info.code for _, info in flagged), Code.OK),
        scheme=", ".join(dict.fromkeys(info.scheme for info in infos.values())),
        modes=told,
    )


def _off(
    modes: ModeDensities, i: int, sensor: Sensor, z: ArrayLike | None, log_evidence: float
) -> tuple[float, float]:
    """Part of a mode's probability that its last prediction got wrong, and of its posterior."""
    if modes.ripples is None or not len(modes.ripples[i].X):
        return 0.0, 0.0
    X, off = modes.ripples[i]
    density = modes.densities[i]
    assert density is not None
    X = X if density.domain is None else density.domain.fold(X)
    weight = sensor.log_likelihood(z, X, density.t)
    return modes.ripples[i].mass, float(off @ np.exp(np.minimum(weight - log_evidence, LARGEST_EXPONENT)))


def _innovation(infos: list[tuple[float, UpdateInfo]]) -> tuple[Floats | None, Floats | None]:
    """Innovation and its covariance over all modes, by their probabilities before."""
    known = [(w, info.innovation, info.innovation_cov) for w, info in infos if info.innovation is not None]
    if not known:
        return None, None
    weights, y, S = (np.array(part) for part in zip(*known, strict=True))
    return moments_of_sum(weights / weights.sum(), y, S)
