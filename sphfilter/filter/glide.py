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
from ..density.needs import MISSED, Needs
from ..density.resample import target_of
from ..errors import PropagationError
from ..info import DOUBTFUL
from ..model.measurements import GaussianMeasurement
from ..model.sde import SDE
from ..prediction.cloud import DOUBTED, carried
from .asked import Asked, reading_of
from .by_cloud import WRONG, read
from .found import found
from .stacked import Stacked

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
        density, sensor, t = filt.density, filt.measurement, filt.t
        state, needs, log_evidence = density.cloud, density.needs, filt.log_evidence
        target: Any = target_of(density, filt.config, "auto")
        stacked, done = None, None
        for t1, z in zip(times[:-1].tolist(), readings[:-1], strict=True):
            numbers = _all_of(sensor, z)
            if numbers is None or not t1 > t or next(iter(filt.model.breaks(t, t1)), None) is not None:
                break
            asked = Asked(sensor, numbers, np.ones(len(numbers), dtype=bool), t1, None, None, None)
            stacked = Stacked.of((asked,), None) if stacked is None else stacked.again(asked)
            if stacked.reader is None:
                break
            made = _step(state, filt.model, (t, t1), stacked, needs.gone_on(), target)
            if made is None:
                break
            moved, done, needs = made
            rows.append(_row(sensor, numbers, moved, done))
            state, t, log_evidence = done.state, t1, log_evidence + done.log_evidence
        if done is not None:
            new = cloud_of(density, state, done.moments, t=t, capacity=0, error=done.error)
            x, P = map(found, done.moments)
            known = {"x": x, "P": P, "x_post": x, "P_post": P, "origin": None, "log_evidence": log_evidence}
            filt._state = filt._state.noted(density=new.noted(needs=needs), **known)
        return rows


def _usual(filt: Any) -> bool:
    """Whether a filter is such that steps of its cloud are all there is to do."""
    config, density, sensor = filt.config, filt.density, filt.measurement
    plain = config.scheme == "auto" and config.time_budget is None and not config.acceptance.enabled
    known = density.cloud is not None and density.needs is not None and density.cloud.inherited == 0.0
    own = type(sensor) is GaussianMeasurement and not sensor.inputs and not filt.model.inputs
    return bool(plain and filt.adapts and known and own and filt.model.domain.unbounded and not filt._steps)


def _all_of(sensor: GaussianMeasurement, z: Any) -> Floats | None:
    """The numbers of a reading, if all of them came."""
    if z is None:
        return None
    numbers, seen = sensor.reading(z)
    return numbers if seen.all() else None


def _step(
    state: Any, model: SDE, span: tuple[float, float], stacked: Stacked, needs: Needs, target: float
) -> tuple[Any, Any, Needs] | None:
    """A prediction and a reading of a cloud, and what the next needs; None where a filter would do more."""
    try:
        moved = carried(state, model, span, CloudScheme(n_points=needs.cloud(target)), target)
    except PropagationError:
        return None
    if moved.lost > DOUBTED or not moved.error < DOUBTFUL:
        return None
    done = read(moved.state, stacked, span[1])
    if done is None or not done.error <= MISSED * target or done.doubt > WRONG:
        return None
    told = done.state.told.errors.mean
    return moved, done, needs._replace(legs=0).told(told, target, done.state.size)


def _row(sensor: Any, z: Floats, moved: Any, done: Any) -> dict[str, Any]:
    """What a result keeps of a reading."""
    points, (mean, cov), (x, P) = moved.state.points, moved.moments, done.moments
    expected, S, _ = reading_of(sensor, done.t, points.x, points.w, (mean, cov))
    row = {"x_prior": mean, "P_prior": cov, "x": x, "P": P, "log_evidence": done.log_evidence}
    row |= {"error": done.error, "flagged": False, "accepted": True}
    y = sensor.residual(z, expected)
    return row | {"innovation": y, "innovation_cov": S + sensor.noise_cov}
