"""Prior times likelihood as a cloud of weighted points, which any likelihood leaves."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from .._types import Floats
from ..config import CloudScheme, FilterConfig
from ..core._views import as_compiled
from ..core.cloud.control import both, errors_told, evidence_error, shown
from ..core.cloud.inherited import (
    Inherited,
    error_with,
    left_by_reading,
    spread_with,
    variance_error_with,
    with_missed,
)
from ..core.cloud.pace import Steps
from ..density.as_cloud import cloud_of
from ..density.memory import flagged_from
from ..density.moments import columns, moments
from ..density.particle_density import ParticleDensity
from ..density.passage import Use, moved_points, stored_key
from ..density.points import CloudState, Pace, Points, Told
from ..density.quasi_random import systematic
from ..errors import PropagationError
from ..info import Code
from ..prediction.cloud import as_points, or_doubtful, shadow_size, squared_differences
from .guided import weighed
from .reading_at_prior import Posterior, ReadingAtPrior, info_fields
from .stacked import Stacked


def by_cloud(
    density: ParticleDensity,
    asked: ReadingAtPrior,
    n_particles: int,
    config: FilterConfig,
    why: str = "",
    n_points: int | None = None,
) -> Posterior:
    """Prior times likelihood as a cloud of weighted points, and what the update says.

    What is none yet becomes one of as many points as are given, or the configuration's scheme has.
    """
    if n_points is None:
        n_points = (config.scheme if isinstance(config.scheme, CloudScheme) else CloudScheme()).n_points
    state = as_points(density, n_points)
    found = cloud_times_likelihood(state, Stacked.of((asked,), density.domain))
    if found is None:
        raise PropagationError(
            "prior times likelihood is zero wherever the prior has particles: check the measurement, its "
            "unit and its noise"
        )
    found = found.inheriting(state)
    error, code, told = found.error, Code.CLOUD, flagged_from(config.target_error)
    known = {"capacity": n_particles, "error": error, "rough": 0.0}  # of which `inherited` knows
    new = cloud_of(density, found.left(told), found.moments, **known)
    status = f"on a cloud of {new.n_particles} points: the mean is good to {error:.2g} standard deviations"
    if error < told:  # else it is said of the mean
        status, code = or_doubtful(status, code, found.spread, told)
    said = info_fields(asked, "cloud", found.log_evidence, error, found.evidence_error)
    said |= {"variance_error": found.variance_error, "code": code}
    return new, said | {"status": f"{status}; {why}" if why else status}


class CloudReading(NamedTuple):
    """A cloud after a reading; mean and covariance of its points, the evidence, and errors."""

    state: CloudState
    moments: tuple[Floats, Floats]
    log_evidence: float
    evidence_error: float
    own: float  # error of the mean that is its own
    of_variance: float  # error of the variances that is
    shown: tuple[float, float]  # parts of both that a shadow shows, and steps: the rest it has, too

    @property
    def error(self) -> float:
        """Error of the mean, in standard deviations, with what was wrong before there were points."""
        return error_with(self.own, self.shown[0], self.state.inherited)

    @property
    def variance_error(self) -> float:
        """Error of the variances as a part of each, where it is most."""
        return variance_error_with(self.of_variance, self.shown[1], self.state.inherited)

    @property
    def spread(self) -> float:
        """Error of the variances by which they are flagged."""
        return spread_with(self.of_variance, self.shown[1], self.state.inherited)

    def left(self, flagged: float) -> CloudState:
        """What goes on: of an error that is flagged, the next readings inherit what no shadow shows later."""
        own = self.own, self.of_variance
        return self.state._replace(inherited=with_missed(self.state.inherited, own, self.shown, flagged))

    def inheriting(self, before: CloudState) -> "CloudReading":
        """With what the reading leaves of an error that there was before there were points, or so many.

        It is counted as long as the cloud's own does not hide it.
        """
        old, points = before.inherited, self.state.points
        if not max(old.error, old.missed, old.wider) > 0.0:
            return self
        about, own = (columns(points.x), as_compiled(points.w), points.older), (self.own, self.of_variance)
        left, nats = left_by_reading(old, moments(*before.points[:2]), *about, self.moments, own)
        state = self.state._replace(inherited=Inherited(*left))
        return self._replace(state=state, evidence_error=both(self.evidence_error, nats))


def cloud_times_likelihood(state: CloudState, sensor: Stacked) -> CloudReading | None:
    """A cloud and its shadow times a likelihood; None where that is zero at all points."""
    found, points = weighed(state.points, sensor, stored_key(state.age, Use.READING))
    if not math.isfinite(found.log_evidence):
        return None
    beside, few = weighed(state.shadow, sensor, stored_key(state.age, Use.READING + 1))
    lineage = None if few.lineage is None else few.lineage[:1]  # it goes back no further
    shadow, told = few._replace(lineage=lineage), state.told
    moments = found.mean, found.cov
    if math.isfinite(beside.log_evidence):
        off = squared_differences(points, shadow, sensor.domain, (moments, (beside.mean, beside.cov)))
        told = told.or_expected(beside.effective, few.x.shape[1])
        told = told.after(*off, (found.log_evidence - beside.log_evidence) ** 2)
    else:  # none of the few sees the reading: a part of the many goes on beside them
        shadow = _part_of(points, len(state.shadow.w))
        told = told.after(1.0, 1.0, 1.0)
    error, wider = errors_told(told.mean, told.variance, found, state.size, state.pace.bias)
    bias = state.pace.bias
    seen = shown(told.mean, bias.mean), shown(told.variance, bias.variance)
    pace = Pace(state.pace.step, state.pace.stiff)
    state = state._replace(points=points, shadow=shadow, told=told, pace=pace)
    unsure = evidence_error(told.log_evidence, found, state.size, len(found.mean))
    return CloudReading(state, moments, found.log_evidence, unsure, error, wider, seen)


def error_added(
    before: CloudState,
    after: CloudState,
    legs: Sequence[tuple[Any, float]],
    t: float,
    sensor: Stacked,
    moments: tuple[Floats, Floats],
    target: float,
) -> float:
    """The deciding error that predictions from time t and a reading have added, of a cloud of these moments.

    The predictions are models, and where each ends, seconds.

    A part of the points of before goes beside the cloud: unlike its shadow it has what was wrong then, too.
    NaN where it cannot be told.
    """
    points, (step, stiff, *_), many = before.points, after.pace, shadow_size(after.size)
    if points.path is not None:
        return math.nan
    moved, age = _part_of(points, many), before.age
    for model, end in legs:
        own = model.own_steps(t, end)
        if not own and not step > 0.0:
            return math.nan
        steps = Steps(own) if own else Steps(max(math.ceil((end - t) / step), 1), stiff)
        moved, t, age = moved_points(moved, model, t, end, steps, many, stored_key(age, 1)), end, age + 1
    if not np.isfinite(moved.x).all():
        return math.nan
    beside, few = weighed(moved, sensor, stored_key(age, Use.READING + 1))
    if not math.isfinite(beside.log_evidence):
        return math.nan
    off = squared_differences(after.points, few, sensor.domain, (moments, (beside.mean, beside.cov)))
    return Told(*off).decisive(target, len(moments[0]))


def _part_of(points: Points, count: int) -> Points:
    """Some of a posterior's points, each as heavy as the others."""
    return Points(points.x[systematic(points.w, count)], np.full(count, 1.0 / count))
