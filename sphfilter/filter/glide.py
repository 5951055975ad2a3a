"""A record put through a cloud without a density, and what a step says, for every reading.

What a filter finds so has the bits that it finds step by step: where a step would be anything but usual, the
filter takes that one itself.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from .._types import Floats
from ..config import CloudScheme
from ..density.as_cloud import cloud_of
from ..density.carriers import Carried
from ..density.needs import FLAGGED, MISSED, Needs
from ..density.particle_density import ParticleDensity
from ..density.passage import cycled
from ..density.points import CloudState
from ..density.resample import target_of
from ..errors import ModelError, PropagationError
from ..info import DOUBTFUL
from ..model.measurements import GaussianMeasurement
from ..model.sde import SDE
from ..prediction.cloud import ahead, carried, fewer, pooled, steps_of
from .asked import Asked, left_of, reading_of
from .by_cloud import WRONG, Read, fresh, read, read_of, told_after
from .found import found as as_found
from .guided import Weighed
from .stacked import Stacked
from .state import FilterState

__all__ = ["Glide"]

_LONGEST = 8  # readings at most that a filter takes itself, before the next are tried


class Glide:
    """Puts the readings of a record through a filter's cloud, as far as each is usual.

    Parameters
    ----------
    filt : SPHFilter
        Its density and log-evidence are those after the last reading that was put through.
    """

    def __init__(self, filt: Any) -> None:
        self._filt, self._wait, self._next = filt, 0, 0

    def through(self, times: Floats, readings: Sequence[Any]) -> list[dict[str, Any]]:
        """What a result keeps of each of the first readings; the last is always left to the filter."""
        if self._next > 0 or not _usual(self._filt):
            self._next -= 1
            return []
        rows = self._through(times, readings)
        self._wait = min(2 * self._wait + 1, _LONGEST) if not rows else 0
        self._next = self._wait
        return rows

    def _through(self, times: Floats, readings: Sequence[Any]) -> list[dict[str, Any]]:
        filt, rows = self._filt, []
        density, model, sensor, t = filt.density, filt.model, filt.measurement, filt.t
        state, needs, target = density.cloud, density.needs, target_of(density, filt.config, "auto")
        stacked, done, last = None, None, None
        try:
            for t1, then, z in zip(times[:-1].tolist(), times[1:].tolist(), readings[:-1], strict=True):
                numbers = _all_of(sensor, z)
                if numbers is None or not t < t1 < then or next(iter(model.breaks(t, t1)), None) is not None:
                    break
                asked = Asked(sensor, numbers, np.ones(len(numbers), dtype=bool), t1, None, None, None)
                stacked = Stacked.of((asked,), None) if stacked is None else stacked.again(asked)
                made = None
                if stacked.reader is not None:
                    made = _step(state, model, (t, t1), stacked, needs.gone_on(), target)
                if made is None:
                    break
                row, done, needs = made
                rows.append(row)
                state, t, last = done.state, t1, asked
        finally:  # what is done stays done, whatever raises
            if done is not None:
                new = cloud_of(density, state, done.moments, t=t, capacity=0, error=done.error)
                filt._state = _after(filt._state, new.noted(needs=needs), rows, last)
        return rows


def _after(
    state: FilterState[ParticleDensity], density: ParticleDensity, rows: Any, asked: Any
) -> FilterState[ParticleDensity]:
    """The state of a filter that has put these rows through."""
    last, told = rows[-1], {name: as_found(rows[-1][name]) for name in ("x", "P", "x_prior", "P_prior")}
    log_evidence = sum((row["log_evidence"] for row in rows), start=state.log_evidence)
    said = {"z": asked.z, "y": last["innovation"], "S": last["innovation_cov"]}
    said |= {"log_likelihood": last["log_evidence"], "log_evidence": log_evidence, "origin": None}
    return state.noted(density=density, **told, x_post=told["x"], P_post=told["P"], **said)


def _usual(filt: Any) -> bool:
    """Whether a filter is such that steps of its cloud are all there is to do."""
    config, density, sensor = filt.config, filt.density, filt.measurement
    plain = config.scheme == "auto" and config.time_budget is None and not config.acceptance.enabled
    known = density.cloud is not None and density.needs is not None
    own = type(sensor) is GaussianMeasurement and not sensor.inputs and not filt.model.inputs
    if own:
        sensor.check_dim(filt.model.dim)
    return bool(plain and filt.adapts and known and own and filt.model.domain.unbounded and not filt._steps)


def _all_of(sensor: GaussianMeasurement, z: Any) -> Floats | None:
    """The numbers of a reading, if all of them came; a filter says what is wrong with others."""
    try:
        numbers, seen = sensor.reading(z)
    except ModelError:
        return None
    return numbers if seen.all() else None


def _step(
    state: CloudState, model: SDE, span: tuple[float, float], stacked: Stacked, needs: Needs, target: Any
) -> tuple[Any, Any, Needs] | None:
    """A prediction and a reading of a cloud, and what the next needs; None where a filter would do more."""
    about = state, model, span, stacked, needs.cloud(target), target
    try:
        made = _at_once(*about) or _in_turn(*about)
    except PropagationError:
        return None
    if made is None:
        return None
    prior, done = made
    if done.state.inherited > 0.0:
        done = done.left(left_of(prior[2][1], done.moments[1]))
    if not done.error <= FLAGGED * target or not done.error < DOUBTFUL or done.doubt > WRONG:
        return None
    if done.error > MISSED * target:  # more points help where this cycle has added it
        added = fresh(state, done.state, model, span, stacked, done.moments)
        if not added <= MISSED * target:
            return None
    row, told = _row(stacked.asked[0].measurement, stacked.z, prior, done), done.state.told.errors.mean
    asked = stacked.asked[0]._replace(innovation=row["innovation"], S=row["innovation_cov"])
    return None if asked.outlying else (row, done, needs._replace(legs=0).told(told, target, done.state.size))


def _at_once(
    state: CloudState, model: SDE, span: tuple[float, float], stacked: Stacked, count: int, target: float
) -> tuple[Any, Read] | None:
    """The prior's points and moments, and what was read, by one call of compiled code; None if unusual."""
    if stacked.reader is None or state.points.path is not None:
        return None
    steps, pace = steps_of(state, model, span, CloudScheme().max_steps, target)
    about = model, span, steps, stacked.reader, (count, fewer(count))
    cloud, beside, before, after = cycled((state.points, state.shadow), *about)
    if not cloud.usual or not beside.usual:
        return None
    found, few, n = Carried(*cloud.found), Carried(*beside.found), model.dim
    error, told = ahead(state, pace, count, *pooled(*before, n))
    told = told_after(told, found, few, pooled(*after, n))
    state = CloudState(state.points, state.shadow, count, told, pace, state.inherited)
    done = read_of(state, Weighed.of(found, found.points), few.points, told, span[1])
    return ((cloud.y, cloud.w, (cloud.mean, cloud.cov)), done) if error < DOUBTFUL else None


def _in_turn(
    state: CloudState, model: SDE, span: tuple[float, float], stacked: Stacked, count: int, target: float
) -> tuple[Any, Read] | None:
    """The same step by step."""
    moved = carried(state, model, span, CloudScheme(n_points=count), target)
    if moved.lost > 0.0 or not moved.error < DOUBTFUL:
        return None
    done = read(moved.state, stacked, span[1])
    return done and ((moved.state.points.x, moved.state.points.w, moved.moments), done)


def _row(sensor: Any, z: Floats, prior: tuple[Floats, Floats, tuple[Floats, Floats]], done: Read) -> Any:
    """What a result keeps of a reading of points x (N, n), w (N,) with a mean and covariance."""
    x, w, summed = prior
    expected, S, _ = reading_of(sensor, done.t, x, w, summed)
    row: dict[str, Any] = dict(zip(("x_prior", "P_prior", "x", "P"), (*summed, *done.moments), strict=True))
    row |= {"log_evidence": done.log_evidence, "error": done.error, "flagged": False, "accepted": True}
    y = sensor.residual(z, expected)
    return row | {"innovation": y, "innovation_cov": S + sensor.noise_cov}
