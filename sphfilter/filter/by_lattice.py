"""Prior times likelihood on a lattice that follows its level set."""

import math
from typing import Any

import numpy as np

from ..config import FilterConfig
from ..core.cloud.inherited import ROUGH
from ..core.limits import ALIKE, LARGEST_EXPONENT, OUTLYING
from ..density.left_out import LeftOut
from ..density.particle_density import ParticleDensity
from ..density.resample import times_likelihood
from ..errors import PropagationError
from ..info import DOUBTFUL, Code, may_be_off
from ..lattice.check import Remote, beside, nodes_and_beside, remote
from ..lattice.field import extrapolated_mass, inside_lattice
from ..lattice.resolved import TOLERATED, Resolved
from ..lattice.walls import moved_in
from .by_cloud import by_cloud
from .inherited import evidence_error_of, of_shape, shift_left_by_update
from .reading_at_prior import Posterior, ReadingAtPrior

#: Deviations beyond particles to which a Gaussian's tail is trusted; measured: half changes no run.
_TRUSTED_GAUSSIAN = 20.0


def by_lattice(
    density: ParticleDensity, asked: ReadingAtPrior, n_particles: int, config: FilterConfig
) -> Posterior:
    """Prior times likelihood on a lattice that follows its level set; the prior where that is a guess."""
    gaussian, flag = density.gaussian and asked.linear, asked.outlying
    found, evidence_error, error, left, unsure = None, 0.0, 0.0, 1.0, 0.0
    try:
        search = None if gaussian else asked.search(density, config)
        about = asked.log_weight, n_particles, config.scheme, gaussian, search
        new, log_evidence, found = times_likelihood(density, *about)
        if found.off.edge > config.most_left_out and config.scheme == "auto":
            raise PropagationError("it ends where the likelihood becomes zero, and polynomials do not")
        if found.between > 0.5 and config.scheme == "auto":
            raise PropagationError("most of it lies between its nodes")
        evidence_error = found.off.log_mass
        if gaussian:  # a closed form knows better than a sum over nodes
            summed, log_evidence = log_evidence, asked.gaussian_evidence
            evidence_error = abs(summed - log_evidence)
        unsure = 0.0 if density.gaussian else _extrapolated(density, new)
        moments = (density.mean(), density.cov()), (new.mean(), new.cov())
        left = shift_left_by_update(moments[0][1], moments[1][1], new.gaussian)
        # what its mean is off by may be of any shape: next to nothing at a usual reading, ten times in a tail
        shape = of_shape(math.hypot(density.rough, density.error), moments)
        error = math.hypot(left * density.error, found.off.mean, unsure, shape)
        unknown = _beyond(density, new)
    except PropagationError as problem:
        if not flag and config.scheme == "auto":
            why = f"no lattice holds the posterior: {problem}"
            return by_cloud(density, asked, n_particles, config, why)
        if not flag:
            raise
        new, unknown = density, f"not used: {flag}, where no lattice holds a posterior"
        log_evidence = asked.gaussian_evidence
    far = Remote()
    if unknown:
        new = density
    else:
        far, unheld = (far, None) if gaussian else _beyond_lattice(density, new, asked, log_evidence)
        known = {"lost": left * density.lost, "rough": left**ROUGH * density.rough, "left_out": unheld}
        new = new.noted(error=math.hypot(error, far.mean), **known)
    cut = beside(new.field, new.mean(), new.cov(), new.walls)
    left_out = cut.mass if found is None else max(cut.mass, found.left_out)
    inherited = math.nan if unknown else evidence_error_of(density, new)  # unknown, it is a guess
    return new, {
        "residual": new.residual or 0.0,
        "error": math.hypot(new.error, cut.mean),
        "variance_error": math.hypot(math.sqrt(2.0) * math.hypot(new.error, cut.mean), far.variance),
        "evidence_error": math.hypot(evidence_error, 0.0 if gaussian else left_out, inherited, unsure),
        "mass_left_out": left_out,
        "accepted": not unknown,
        "log_evidence": log_evidence,
        "reason": unknown or flag,
        "extrapolated": _extrapolated(density, new),
        "scheme": "log_density",
        "code": Code.OK,
    } | ({} if unknown or found is None else _told(found, new.error, config.most_left_out, far.variance))


def _beyond_lattice(
    prior: ParticleDensity, posterior: ParticleDensity, asked: ReadingAtPrior, log_evidence: float
) -> tuple[Remote, LeftOut | None]:
    """Moments that the prior's nodes beyond a posterior's lattice, and cells around those, would add to it.

    And those of them of which its polynomials know nothing either: what follows it knows nothing of them.
    """
    field: Any = posterior.field
    X, mass = nodes_and_beside(prior.x, prior.mass, prior.field, prior.walls)
    beyond = ~inside_lattice(field, moved_in(posterior.walls, field.A, X))
    if not beyond.any():
        return Remote(), None
    X, log_l = X[beyond], asked.log_weight(X[beyond]) - log_evidence
    mass = mass[beyond] * np.exp(np.minimum(log_l, LARGEST_EXPONENT))
    far = remote(posterior.mean(), posterior.cov(), X, mass)
    return far, LeftOut.of(posterior, X, mass, prior.logpdf(X) + log_l)


def _told(found: Resolved, error: float, most_left_out: float, wider: float) -> dict[str, Any]:
    """Code and status of an update whose lattice is finer than usual, or not fine or wide enough."""
    said = []
    wrong = max(found.off.residual, found.off.log_mass)
    if wrong > TOLERATED:
        said.append(f"the lattice does not resolve the posterior: its density is off by {wrong:.2g}")
    if found.left_out > most_left_out:
        said.append(f"the lattice leaves out a probability of {found.left_out:.2g} that was found elsewhere")
    if wider > 1.0 - ALIKE:
        said.append(would_widen(wider))
    if error > DOUBTFUL:
        said.append(may_be_off(error))
    code = Code.UNRESOLVED if said else Code.OK
    if found.times > 1:
        code |= Code.FINER
        said.insert(0, f"the posterior is on {found.times} times the particles")
    return {"code": code, "status": "; ".join(said) or "ok"}


def would_widen(wider: float) -> str:
    """Sentence on what lies far away and is left out, which a variance lacks as a part of itself."""
    return f"what little is left out far away would widen the density: its variance by {wider:.0%}"


def _extrapolated(prior: ParticleDensity, posterior: ParticleDensity) -> float:
    """Probability of a posterior where its prior has no particles."""
    return extrapolated_mass(prior.field, posterior.x, posterior.mass, prior.walls)


def _beyond(prior: ParticleDensity, posterior: ParticleDensity) -> str:
    """Say so where the posterior lies so far outside of the prior's particles that its shape is a guess."""
    L = np.linalg.cholesky(prior.cov())
    away = np.linalg.norm(np.linalg.solve(L, posterior.mean() - prior.mean()))
    if away < OUTLYING:
        return ""
    edge = np.linalg.norm(np.linalg.solve(L, (prior.x - prior.mean()).T), axis=0).max()
    if away - edge < (_TRUSTED_GAUSSIAN if prior.gaussian else OUTLYING):
        return ""
    return (
        f"not used: the posterior would lie {away - edge:.0f} standard deviations outside of the prior's "
        f"particles, where its density is a guess"
    )
