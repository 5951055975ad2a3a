"""The ladder: a prediction takes the cheapest representation that keeps its error within a target.

A Gaussian in closed form, one exponential family and its higher degrees, then a lattice or a cloud of points.
What the last steps needed is in the density, `density.needs`: there the next one begins.
"""

import math
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from ..config import CloudScheme, FamilyScheme
from ..core.cloud.control import MOST_POINTS
from ..core.family.march import MISSED
from ..core.family.rules import degrees
from ..core.limits import HIGHEST, LITTLE
from ..density.as_family import as_polynomials, family_density, moments_on_line
from ..density.family import ON_LATTICE, gaussian_family
from ..density.memory import Memory, error_budget, flagged_if_missed, tolerated_excess, usual_points
from ..density.particle_density import ParticleDensity
from ..density.resample import on_lattice
from ..errors import PropagationError, UnresolvedError
from ..info import PredictInfo
from ..lattice.level_set import min_nodes
from ..lattice.resolved import TIMES
from ..model.discrete import DiscreteModel
from ..model.discretization import linear_transition
from ..model.dynamics import Dynamics
from ..model.sde import SDE
from . import automatic, chapman_kolmogorov, cloud, family, pieces
from ._shared import Predicted
from .again import MOST_WORK, Time, carried_to_target

Found = TypeVar("Found")

#: Points that a target asks for, up to which a cloud comes before one family, by states: it takes .1 to .9
#: times as long. Error² times time in four states, over that of families first: cart, sharp range, bearings,
#: tracking .13, .13, .6, 1.4 asked .1, and .4, .5, 2.3, 1.5 asked .03 (`experiments benchmark`).
_AS_FAMILIES = {1: 2**9, 2: 2**9, 3: 2**9, 4: 2**8, 5: 2**12}  # and of more as of five
#: As long as a lattice that makes the same error, by states: of one it pays sooner, and knows its tails; of
#: three and more never. And as families of five and six, of thousands of nodes (`experiments benchmark`).
_AS_LATTICES = {1: 2**11, 2: 2**13}
#: Evaluations of the drift that a lattice may take for each point of a usual cloud: 15 to 45 ns each, beside
#: .6 µs of a point, or 5 to 15 times as long, for what it knows of tails. With five times as many three of
#: eleven scenes took 1.5 to 2.5 times as long; with half a tail was lost, unsaid (`experiments benchmark`).
_WORK = 200.0


def first_degree(dim: int, needs: Memory) -> int:
    """Degree that is tried first."""
    known = degrees(dim)
    lowest = min((d for d in known if d >= (4 if dim <= 3 else 3)), default=0)
    return max(needs.degree, lowest) if lowest else 0


def prefers_cloud(dim: int, needs: Memory, target: float) -> bool:
    """Whether a cloud comes after one family, and not a lattice."""
    return dim > ON_LATTICE or (not needs.smooth and needs.cloud(target, dim) <= _AS_LATTICES[dim])


def becomes_cloud(dim: int, needs: Memory, target: float) -> bool:
    """Whether a cloud costs less than one family, and is all that is asked for."""
    return not needs.smooth and (needs.points or usual_points(target)) <= _AS_FAMILIES[min(dim, 5)]


def best_family(
    dim: int, allowed: float, first: int, attempt: Callable[[int, float], tuple[Found, float]]
) -> tuple[Found, int, float] | None:
    """The first degree of a family whose added error is allowed, else the best; None where none will do.

    One that is somewhat off is taken where what comes next would not be better. Of a step, `attempt` makes
    what comes of a degree, and the error that it adds, standard deviations, of the most that it may; it may
    raise `PropagationError`. The degree `first` is tried first. Returns what came of the step, its degree,
    and the error over what is allowed.
    """
    best, most = None, tolerated_excess(dim) * allowed
    for degree in (d for d in degrees(dim) if 0 < first <= d <= HIGHEST):
        try:
            found, added = attempt(degree, most)
        except PropagationError:
            continue
        if added <= most:
            best, most = (found, degree, added / allowed), added
        if added <= allowed:
            break
    return best


def propagate(density: ParticleDensity, model: Dynamics, t1: float, target: float, time: Time) -> Predicted:
    """Carry a density to time t1, seconds, as cheaply as the target error allows.

    The info's scheme names the rung. The target is the error of the mean, in standard deviations, that the
    record may have. Raises `PropagationError` if the model carries the density to infinity.
    """
    needs = (density.needs or Memory()).gone_on()
    if density.gaussian and model.linear and model.domain.unbounded:
        return _closed_form(density, model, t1, needs)
    if density.form.closed and model.linear and model.domain.unbounded:
        return _by_pieces(density, model, t1, target, needs)
    if density.form.own_points:
        return _by_cloud(density, model, t1, target, needs)
    if isinstance(model, DiscreteModel):
        return _by_sums(density, model, t1, target, needs, time)
    assert isinstance(model, SDE)
    by_cloud = not model.domain.walled.any() and prefers_cloud(density.dim, needs, target)
    if by_cloud and becomes_cloud(density.dim, needs, target):
        return _by_cloud(density, model, t1, target, needs)
    if needs.waits > 0:
        needs = needs._replace(waits=needs.waits - 1)
    elif not family.why_not(model, density):
        found = _by_family(density, model, t1, target, needs)
        if found is not None:
            return found
        needs = needs.refused()
    if by_cloud:
        return _by_cloud(density, model, t1, target, needs)
    return _by_lattice(density, model, t1, target, needs, time)


def _closed_form(density: ParticleDensity, model: Dynamics, t1: float, needs: Memory) -> Predicted:
    """Move a Gaussian by a linear model."""
    mean, cov = moments_on_line(density)
    transition, offset, Q = linear_transition(model, t1 - density.t)
    try:
        moved = gaussian_family(transition @ mean + offset, transition @ cov @ transition.T + Q, 2)
    except np.linalg.LinAlgError:
        raise PropagationError("the model leaves some state without spread: give it a little noise") from None
    skipped = ("everything: a Gaussian through a linear model",)
    info = PredictInfo(scheme="exact_linear", error=density.error, skipped=skipped)
    return family_density(density, moved, t=float(t1), needs=needs), info


def _by_family(
    density: ParticleDensity, model: SDE, t1: float, target: float, needs: Memory
) -> Predicted | None:
    """Carry one family, of as high a degree as the error asks for; None where none will do."""

    def carried(degree: int, most: float) -> tuple[Predicted, float]:
        scheme = FamilyScheme(degree=degree, tolerance=LITTLE * target)
        moved, info = family.carried_family(density, model, t1, scheme, density.capacity or 0, most)
        added = math.sqrt(max(info.error**2 - density.error**2, 0.0))
        return (moved, info), math.inf if moved.defect and moved.defect.rest > MISSED else added

    allowed = error_budget(density.error, target) * needs.shared
    if family.escaped(density, model, t1) > math.sqrt(2.0) * allowed:
        return None
    best = best_family(density.dim, allowed, first_degree(density.dim, needs), carried)
    if best is None:
        return None
    (moved, info), degree, used = best
    return moved.noted(needs=needs.followed(degree - (used < LITTLE))), as_asked(info, target)


def _by_pieces(
    density: ParticleDensity, model: Dynamics, t1: float, target: float, needs: Memory
) -> Predicted:
    """Carry Gaussians each by itself; one family takes their place where it holds what they become."""
    allowed = error_budget(density.error, target)
    moved, info = pieces.carried_pieces(density, model, t1, allowed)
    one = as_polynomials(moved, first_degree(moved.dim, needs), allowed)
    return (moved if one is None else one).noted(needs=needs), info


def _by_cloud(
    density: ParticleDensity, model: Dynamics, t1: float, target: float, needs: Memory
) -> Predicted:
    """Carry as many points as the target asks for."""
    points = needs.cloud(target, density.dim)
    moved, info = cloud.propagate(density, model, t1, CloudScheme(n_points=points), target=target)
    own = as_asked(info.noted(error=moved.error), target)  # what was wrong before, a reading has said
    return moved.noted(needs=needs), own.noted(error=info.error)


def _by_sums(
    density: ParticleDensity, model: DiscreteModel, t1: float, target: float, needs: Memory, time: Time
) -> Predicted:
    """Carry a density by a model in discrete time: by sums over a lattice, or as points."""

    def predicted(nodes: int) -> Predicted:
        return chapman_kolmogorov.propagate(density, model, t1, nodes)

    by_cloud = needs.cloud(target, model.dim) <= chapman_kolmogorov.AS_SUMS.get(model.dim, MOST_POINTS)
    if by_cloud or chapman_kolmogorov.why_not(model):
        return _by_cloud(density, model, t1, target, needs)
    try:
        first = needs.nodes or min_nodes(density.dim)
        moved, info, nodes = carried_to_target(density, predicted, target, first, time)
    except PropagationError:
        return _by_cloud(density, model, t1, target, needs)
    return moved.noted(needs=needs._replace(nodes=nodes), capacity=nodes), as_asked(info, target)


def _by_lattice(
    density: ParticleDensity, model: SDE, t1: float, target: float, needs: Memory, time: Time
) -> Predicted:
    """Carry log p on as many nodes as the target asks for."""
    allowed = time.for_lattices(density, target)
    bound = MOST_WORK if needs.smooth else _WORK * needs.cloud(target, density.dim)
    work = bound if allowed else math.inf

    def predicted(nodes: int) -> Predicted:
        laid = on_lattice(density, nodes)
        return automatic.propagate(laid, model, t1, nodes, allowed=allowed, most_work=work)

    def tried(nodes: int) -> tuple[ParticleDensity, PredictInfo, int]:
        return carried_to_target(density, predicted, target, nodes, time, work)

    nodes = needs.nodes or min_nodes(density.dim)
    try:
        try:
            moved, info, nodes = tried(nodes)
        except UnresolvedError:  # a first lattice knows nothing of the density, and may be too coarse
            moved, info, nodes = tried(TIMES[1] * nodes)
    except PropagationError:
        return _by_cloud(density, model, t1, target, needs)
    if moved.form.cell is not None:
        nodes = max(moved.n_particles, min_nodes(density.dim))
    return moved.noted(needs=needs._replace(nodes=nodes), capacity=nodes), as_asked(info, target)


def as_asked(info: PredictInfo, target: float) -> PredictInfo:
    """The info of a rung that the target asked for, and not of one that took another's place."""
    return info.noted(**flagged_if_missed(info.code, info.error, target))
