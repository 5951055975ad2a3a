"""Prior times likelihood as cheaply as a target error allows: a family, a lattice or a cloud."""

import math
from dataclasses import replace
from functools import partial
from typing import Any

from scipy.special import logsumexp

from ..config import FilterConfig
from ..core.cloud.inherited import ROUGH
from ..core.kalman import conditioned
from ..core.step_control import TRIES
from ..density.as_family import as_polynomials, may_miss, pieces_density
from ..density.memory import Memory, error_budget, tolerated_excess
from ..density.particle_density import ParticleDensity
from ..density.pieces import OF_CHANGE, Pieces, merged
from ..density.resample import on_lattice
from ..info import DOUBTFUL, Code, may_be_off
from ..lattice.level_set import min_nodes, root_of
from ..lattice.resolved import MOST
from ..model.measurements import block, is_gaussian
from ..prediction.again import ORDER
from ..prediction.ladder import becomes_cloud, best_family, first_degree, prefers_cloud
from .by_cloud import by_cloud
from .by_family import by_family, by_kalman
from .by_lattice import by_lattice
from .inherited import left_by_update, shift_left_by_update
from .reading_at_prior import Posterior, ReadingAtPrior, info_fields

_LIGHT = 1e-5  # what the lightest, dropped, carry together; measured: half, twice move means by 7e-4 at most


def by_ladder(
    density: ParticleDensity, asked: ReadingAtPrior, target: float, config: FilterConfig
) -> Posterior:
    """Prior times likelihood on the cheapest rung whose own error leaves the target.

    Where a lattice had to be taken, the posterior comes down to one family again if that holds it.
    """
    needs = (density.needs or Memory())._replace(legs=0)
    if density.form.closed and asked.linear:
        return _on_pieces(density, asked, target, needs)
    exact = _in_closed_form(density, asked, needs)
    if exact is not None:
        return exact
    walled = density.walls[0].size > 0
    by_cloud = density.form.cell is None and not walled and prefers_cloud(density.dim, needs, target)
    if density.form.own_points or (by_cloud and becomes_cloud(density.dim, needs, target)):
        return _on_cloud(density, asked, target, config, needs)
    found = _on_family(density, asked, target, needs)
    if found is not None and by_cloud and found[1]["error"] > tolerated_excess(density.dim) * target:
        found = None  # what the reading made of the prior's error, no family tells
    if found is not None:
        return found
    if by_cloud:
        return _on_cloud(density, asked, target, config, needs)
    (new, said), needs = _on_lattice(density, asked, target, config, needs)
    new = new.noted(needs=needs)
    if needs.waits == 0 and said["accepted"] and not said["code"] & Code.UNRESOLVED:
        one = as_polynomials(new, first_degree(new.dim, needs), error_budget(new.error, target))
        new, needs = (new, needs.refused()) if one is None else (one, needs)
    return new.noted(needs=needs), said | {"error": new.error}


def _in_closed_form(density: ParticleDensity, asked: ReadingAtPrior, needs: Memory) -> Posterior | None:
    """The posterior by Kalman's rule, of however many states; None where that does not hold."""
    if not density.gaussian or density.form.degree == 0:
        return None
    degree = first_degree(density.dim, needs) or 2
    found = by_kalman(density, asked, degree, density.capacity or 0)
    if found is None:
        return None
    return found[0].noted(needs=needs.followed(degree)), found[1]


def _on_family(
    density: ParticleDensity, asked: ReadingAtPrior, target: float, needs: Memory
) -> Posterior | None:
    """The posterior as one family, of as high a degree as the error asks; None where none will do."""
    own = density.form.degree
    if own == 0 or density.walls[0].size:
        return None

    first = max(first_degree(density.dim, needs), 0 if density.gaussian else own)
    updated = partial(by_family, density, asked, density.capacity or 0)
    best = best_family(density.dim, error_budget(density.error, target), first, updated)
    if best is None:
        return None
    (new, said), degree, _ = best
    return new.noted(needs=needs.followed(degree)), said


def _on_pieces(density: ParticleDensity, asked: ReadingAtPrior, target: float, needs: Memory) -> Posterior:
    """The posterior of a sum of Gaussians, as one family where that will do and none is to be added to."""
    new, said = by_pieces(density, asked, target)
    one = as_polynomials(new, first_degree(new.dim, needs), error_budget(new.error, target))
    new = new if one is None or (needs.smooth and not one.gaussian) else one
    return replace(new, needs=needs), said | {"error": new.error}


def by_pieces(density: ParticleDensity, asked: ReadingAtPrior, target: float) -> Posterior:
    """Each Gaussian of a sum times the reading of a linear sensor by Kalman's rule; those that it makes alike
    are merged, as far as a target error allows, standard deviations, rms over the states.
    """
    prior, sensor = density.pieces, asked.measurement
    assert prior is not None and is_gaussian(sensor) and sensor.H is not None
    off = sensor.residual(asked.numbers, sensor.predict(prior.mean, density.t))[:, asked.seen]
    H, R = sensor.H[asked.seen], block(sensor.noise_cov, asked.seen)
    mean, cov, log_p = conditioned(prior.mean, prior.cov, off, H, R)
    log_w = prior.log_w + log_p
    found = Pieces(log_w, mean, root_of(cov))
    found = found.some(found.heavy(_LIGHT)).normalised()
    pieces, change = merged(found, error_budget(density.error, target) / OF_CHANGE)
    new = pieces_density(density, pieces)
    left, evidence_error = left_by_update(density, new)
    error = math.hypot(left, OF_CHANGE * change)
    told = float(logsumexp(log_w)), error, evidence_error
    return new.noted(error=error), info_fields(asked, "pieces", *told)


def _on_cloud(
    density: ParticleDensity, asked: ReadingAtPrior, target: float, config: FilterConfig, needs: Memory
) -> Posterior:
    """The posterior as a cloud; of how many points the next one has, what its points told tells."""
    new, said = by_cloud(density, asked, 0, config, n_points=needs.cloud(target, density.dim))
    cloud: Any = new.cloud
    needs = needs.told(cloud.told.decisive(target, new.dim), target, cloud.size, new.dim)
    return new.noted(needs=needs), said


def _on_lattice(
    density: ParticleDensity, asked: ReadingAtPrior, target: float, config: FilterConfig, needs: Memory
) -> tuple[Posterior, Memory]:
    """The posterior on a lattice, of more nodes where the error asks for it."""
    nodes, before = needs.nodes or min_nodes(density.dim), math.inf
    for left in range(1 if config.time_budget else TRIES, 0, -1):
        laid, known = on_lattice(density, nodes), may_miss(density)
        if known:  # what its defect tells of, too, and better
            laid = laid.noted(error=math.sqrt(max(laid.error**2 - density.error**2, 0.0)))
        new, said = by_lattice(laid.noted(rough=0.0) if known else laid, asked, nodes, config)
        if known and said["accepted"]:
            new, said = _with_inherited(new, said, *left_by_update(density, new))
            rough = laid.rough * shift_left_by_update(density.cov(), new.cov()) ** ROUGH
            new = new.noted(rough=rough)
        over = said["error"] / target
        if left == 1 or not over > 1.0 or said["error"] > 0.8 * before or nodes >= MOST:
            break  # met, or the prior itself is coarse
        before, nodes = said["error"], min(math.ceil(nodes * min(over ** (1.0 / ORDER), 3.0)), MOST)
    return (new.noted(capacity=nodes), said), needs._replace(nodes=nodes)


def _with_inherited(new: ParticleDensity, said: dict[str, Any], left: float, of_evidence: float) -> Posterior:
    """A posterior on a lattice, and what is said of it, with the errors that a prior's family brings."""
    error = math.hypot(said["error"], left)
    said = said | {"error": error, "evidence_error": math.hypot(said["evidence_error"], of_evidence)}
    said["variance_error"] = math.hypot(said["variance_error"], math.sqrt(2.0) * left)
    if error > DOUBTFUL:
        said |= {"code": said["code"] | Code.UNRESOLVED, "status": may_be_off(error)}
    return new.noted(error=math.hypot(new.error, left)), said
