"""A cloud of weighted points on paths of the model: carries any density, and tells its own error."""

import math
from typing import Any, NamedTuple

import numpy as np

from .._types import Floats
from ..config import CloudScheme
from ..core.cloud.control import (
    SHADOW,
    STEPS_ORDER,
    apart_by,
    bias_allowed,
    error_ahead,
    error_by,
    may_be_wrong,
    over_allowed,
    step_after,
    steps_of_shadow,
)
from ..core.cloud.inherited import Inherited, after_prediction
from ..core.cloud.lineages import outermost
from ..core.cloud.pace import FIRST_TRIED, MOST_LOST, Bias, Steps
from ..core.cloud.weights import any_beyond, compared, near_others
from ..core.limits import LOOK, SAID
from ..density.as_cloud import cloud_of
from ..density.as_family import moments_on_line
from ..density.defect import read_out
from ..density.left_out import LeftOut
from ..density.memory import flagged_from
from ..density.moments import columns, moments
from ..density.particle_density import ParticleDensity
from ..density.passage import (
    Transitions,
    Use,
    age_of,
    chosen_steps,
    moved_points,
    points_of_gaussian,
    points_of_sample,
    stored_key,
)
from ..density.points import FRESH, CloudState, Pace, Points
from ..density.quasi_random import even
from ..errors import PropagationError, StoppedError
from ..info import DOUBTFUL, Code, PredictInfo
from ..model.domain import Domain
from ..model.dynamics import Dynamics
from ..model.sde import SDE
from ._shared import Predicted, blow_up, carried_off, kept, skip_notes
from .time_slices import slices_at


def propagate(
    density: ParticleDensity,
    model: Dynamics,
    t1: float,
    scheme: CloudScheme,
    n_particles: int | None = None,
    target: float = 0.0,
) -> Predicted:
    """Carry a density to time t1, seconds, as weighted points, and a smaller cloud beside it that tells the
    error.

    Steps are of weak order three where the noise does not depend on the state, else two; none are needed for
    a linear model. Their length follows from how far steps of half the length lead apart, and need not be
    better than the target, an error of the mean in standard deviations, asks. `n_particles` bounds the next
    lattice's nodes, and is kept as the density's capacity. Raises `PropagationError` if the model carries a
    tenth of the probability to infinity, or needs more steps than allowed.
    """
    state, span = as_points(density, scheme.n_points), (density.t, t1)
    moved = carried_cloud(state, model, span, scheme, target, density.domain)
    capacity = density.capacity if n_particles is None else n_particles
    new = cloud_of(density, moved.state, moved.moments, t=float(t1), capacity=capacity, error=moved.error)
    before = 0.0 if moved.state.points.path is None else density.error
    if before > moved.error:  # a cloud and its shadow know nothing of what readings have left to both
        before *= _kept(state.points.x, moved.state.points, moved.moments[1])
    error = max(moved.error, before)
    wider = max(moved.variance_error, math.sqrt(2.0) * error)
    info = info_of(model, scheme.n_points, moved.steps, moved.lost, error, wider)
    if target > 0.0:
        wider = moved.state.inherited.wider  # of a reading that was flagged for it
        status, code = or_doubtful(info.status, info.code, wider, flagged_from(target))
        info = info.noted(status=status, code=code)
    return new, info


def _kept(x: Floats, points: Points, cov: Floats) -> float:
    """Part of an error of a cloud of states x (N, n) that a prediction leaves, in standard deviations."""
    if points.path is not None and len(points.path.passages) == 2:  # what parts copies, and this prediction
        x = points.path.x
    return kept(x, points.x, points.w, cov) if len(x) == len(points.x) else 1.0


class Carried(NamedTuple):
    """A cloud after a prediction; mean and covariance of its points, its errors, and what was given up."""

    state: CloudState
    moments: tuple[Floats, Floats]
    error: float
    variance_error: float
    lost: float  # probability
    steps: int


def carried_cloud(
    state: CloudState,
    model: Dynamics,
    span: tuple[float, float],
    scheme: CloudScheme,
    target: float,
    domain: Domain | None,
) -> Carried:
    """Carry a cloud and its shadow over a span of time: what `propagate` does with densities."""
    (t0, t1), count = span, scheme.n_points
    steps, few, pace = _steps(state, model, span, scheme.max_steps, target)
    clouds = (state.points, count, steps), (state.shadow, shadow_size(count), few)
    ends: list[Points] = []
    sums, lost = [], 0.0
    for k, (points, many, own) in enumerate(clouds):
        begun, key = unrolled_about_mean(points, domain), stored_key(state.age, k)
        moved = moved_points(begun, model, t0, t1, own, many, key)
        if own.number < steps.number and any_beyond(columns(moved.x), columns(ends[0].x)):
            moved = moved_points(begun, model, t0, t1, steps, many, key)
        moved, gone = without_runaways(moved, domain)
        lost = gone if k == 0 else lost
        if gone > MOST_LOST:
            raise PropagationError(_blow_up(model, moved, t0, t1))
        ends.append(moved)
        sums.append(moments(moved.x, moved.w))
    told = state.told.of(count / state.size)
    off = squared_differences(ends[0], ends[1], domain, sums)
    seen = told.after(*off)
    inherited, beyond = state.inherited, outermost(columns(ends[0].x), ends[0].w, *sums[0])
    if max(inherited.missed, inherited.wider) > 0.0:
        inherited = after_prediction(inherited, _kept(state.points.x, ends[0], sums[0][1]))
    error = error_ahead(seen.mean, inherited, pace.bias)
    wider = max(math.sqrt(2.0) * error, error_by(seen.variance), beyond, inherited.wider)
    state = CloudState(ends[0], ends[1], count, told, pace, inherited, state.age + 1)
    return Carried(state, sums[0], error, math.hypot(wider, pace.bias.variance), lost, steps.number)


def as_points(density: ParticleDensity, count: int) -> CloudState:
    """A density as points and a smaller cloud of points; those that it has, if it is a cloud."""
    if density.cloud is not None:
        return density.cloud
    age, own = age_of(density), density.form.own_points
    if own is not None:
        x, w = own
        few = np.linspace(0.0, len(w) - 1, min(shadow_size(count), len(w))).astype(int)
        shadow = Points(x[few], w[few] / w[few].sum())
        return CloudState(Points(x, w), shadow, len(w), age=age)
    clouds = [(n, stored_key(age, k)) for k, n in enumerate((count, shadow_size(count)))]
    if density.form.degree == 2:
        mean, cov = moments_on_line(density)
        points, shadow = (points_of_gaussian(mean, cov, n, key, k) for k, (n, key) in enumerate(clouds))
    else:
        points, shadow = (points_of_sample(Points(*density.form.drawn(n, key)), n, key) for n, key in clouds)
    inherited, path = FRESH._replace(error=density.error), points.path
    family, defect = density.family, density.defect
    if family is not None and defect is not None and path is not None:
        unsigned, missed = read_out(family, defect).unsigned, defect.missed_at(family, path.x, points.w)
        inherited = Inherited(density.error, 0.0, 0.0, unsigned, *missed)
    return CloudState(points, shadow, count, inherited=inherited, age=age)


def left_out_later(density: ParticleDensity, model: Dynamics, t1: float) -> LeftOut | None:
    """What a density has left out, at time t1, of each state several: noise parts them. None in a domain."""
    left, span = density.left_out, (density.t, t1)
    if left is None or not model.domain.unbounded:
        return None
    copies, key = math.ceil(8 * LOOK / len(left.x)), stored_key(age_of(density), Use.LEFT_OUT)
    steps, points = Steps(model.own_steps(*span) or 1), Points(left.x, left.mass / left.mass.sum())
    if not (model.linear or model.own_steps(*span)):
        bounds = least_steps(model, left.x, span), CloudScheme().max_steps
        steps, *_ = chosen_steps(points, model, span, Steps(FIRST_TRIED), bounds, DOUBTFUL, key)
    each = np.repeat(np.arange(len(left.x)), copies)
    moved = Transitions.of(model, left.x, span, steps).moved(even(len(each), model.dim, key, 0), key, each)
    finite = np.isfinite(moved).all(axis=1)
    return LeftOut(moved[finite], left.mass[each[finite]] / copies) if finite.any() else None


def shadow_size(count: int) -> int:
    """Points of a shadow."""
    return max(count // SHADOW, 32)


def squared_differences(
    points: Points, shadow: Points, domain: Domain | None, sums: Any
) -> tuple[float, float]:
    """Squared errors that two clouds show of a mean, on average over the states, and of a covariance at most.

    In standard deviations of the first; the sums are mean (n,) and covariance (n, n) of each.
    """
    (mean, cov), (other, own) = sums
    if domain is not None and domain.periodic.any():
        off = domain.mean(shadow.x, shadow.w) - domain.mean(points.x, points.w)
        other = mean + domain.nearest(off[None])[0]
    first, second, most = compared(mean, cov, other, own)
    return apart_by(first, second), most


def unrolled_about_mean(points: Points, domain: Domain | None) -> Points:
    """Points unrolled about their mean direction, where an axis is periodic, if their path begins here."""
    if domain is None or points.path is not None or not domain.periodic.any():
        return points
    mean = domain.mean(points.x, points.w)
    return points._replace(x=mean + domain.nearest(points.x - mean))


def _steps(
    state: CloudState, model: Dynamics, span: tuple[float, float], most: int, target: float
) -> tuple[Steps, Steps, Pace]:
    """Steps whose bias is small beside the points' error, those of the shadow, and the pace of the next."""
    pace = state.pace._replace(legs=state.pace.legs + 1)
    own = model.own_steps(*span)
    if own:
        return Steps(own), Steps(own), pace
    assert isinstance(model, SDE)
    dt, (step, stiff, legs, had), points = span[1] - span[0], pace, state.points
    shorter = legs ** (1.0 / STEPS_ORDER)  # biases of predictions without a reading between add up
    least = least_steps(model, points.x, span)
    number = math.ceil(dt * shorter / step - 1e-9) if step > 0.0 else FIRST_TRIED
    told = state.told.errors.mean
    allowed = bias_allowed(told, len(points.w), state.inherited.error, DOUBTFUL, target, legs)
    about = Steps(number, stiff), (least, most), allowed, stored_key(state.age, 0)
    steps, bias, lost = chosen_steps(points, model, span, *about)
    if lost > 2.0 * MOST_LOST:  # of a few: all need not be asked, each of which takes long
        raise PropagationError(_blow_up(model, points, *span))
    if steps.number > most:
        raise StoppedError(
            f"prediction from {span[0]:g} to {span[1]:g} stopped: {most} steps were not enough for a cloud; "
            f"the drift is stiff. Allow more with scheme=CloudScheme(max_steps=...), or predict over a "
            f"shorter interval"
        )
    next_step = step_after(dt * shorter, steps.number, over_allowed(bias, allowed, model.dim))
    few = steps._replace(number=steps_of_shadow(steps.number, steps.stiff, least))
    return steps, few, Pace(next_step, steps.stiff, legs, Bias(*np.add(had, bias).tolist()))


def least_steps(model: Dynamics, x: Floats, span: tuple[float, float]) -> int:
    """Least steps of a span: a model's own, or by its bound and how it changes in time at points x (N, n)."""
    own, dt = model.own_steps(*span), span[1] - span[0]
    if own:
        return own
    assert isinstance(model, SDE)
    least = math.ceil(dt / model.max_step) if model.max_step < math.inf else 1
    return max(least, slices_at(model, x, *span))


def without_runaways(points: Points, domain: Domain | None) -> tuple[Points, float]:
    """The points without weight where they ran away or left a bounded axis; and what that was."""
    alive, every = near_others(columns(points.x))
    if every and domain is None:
        return points, 0.0
    if domain is not None:
        alive &= domain.contains(np.where(alive[:, None], points.x, np.inf))
    if alive.all() or not alive.any():
        return points, 0.0 if alive.all() else 1.0
    lost = float(points.w[~alive].sum())
    x, w = np.where(alive[:, None], points.x, points.x[np.argmax(alive)]), np.where(alive, points.w, 0.0)
    return points._replace(x=x, w=w / w.sum()), lost


def _blow_up(model: Dynamics, points: Points, t0: float, t1: float) -> str:
    """Sentence for points of which many left the finite numbers."""
    if not isinstance(model, SDE):
        return f"the model blew up: from t = {t0:g} to {t1:g} its steps lead to no finite numbers"
    x = points.x if points.path is None else points.path.x
    x = x[np.argsort(np.abs(model.drift(x, t0)).sum(axis=1))[-LOOK:]]
    return carried_off(model, x, t0, t1) or blow_up(model, x[-1], t0, t0, t1)


def or_doubtful(status: str, code: Code, variance: float, flagged: float) -> tuple[str, Code]:
    """Status and code of a cloud, which say so where its variances may be wrong by what is told of them."""
    if not may_be_wrong(variance, flagged):
        return status, code
    return f"{status}, but the variance may be off by {2.0 * variance:.0%}", code | Code.UNRESOLVED


def info_of(
    model: Dynamics, count: int, steps: int, lost: float, error: float, variance_error: float = math.nan
) -> PredictInfo:
    """Info of a prediction of a cloud."""
    status = f"on a cloud of {count} points: the mean is good to {error:.2g} standard deviations"
    code = Code.CLOUD
    if lost > SAID:
        status += f", but the model carried {100 * lost:.2g} % of the probability to infinity"
        code |= Code.UNRESOLVED
    return PredictInfo(
        n_steps=steps,
        n_evaluations=(4 if isinstance(model, SDE) else 1) * steps,
        mass_error=lost,
        error=error,
        variance_error=variance_error,
        skipped=tuple(note for note in skip_notes(model, 0) if "evaluation of D" in note),
        scheme="cloud",
        status=status,
        code=code,
    )
