"""A record put through a cloud without a density, and what a step says, for every reading.

What a filter finds so has the bits that it finds step by step: where a step would be anything but usual, the
filter takes that one itself.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from .._types import Floats
from ..config import CloudScheme
from ..core.cloud.cycle import JUDGE, REFUSED, WRONG, Bounds
from ..core.cloud.reading import Reader
from ..density.as_cloud import cloud_of
from ..density.needs import FLAGGED, MISSED, Needs
from ..density.particle_density import ParticleDensity
from ..density.passage import Through, put_through
from ..density.points import CloudState
from ..density.resample import target_of
from ..errors import ModelError, PropagationError
from ..info import DOUBTFUL
from ..model.measurements import GaussianMeasurement
from ..model.sde import SDE
from ..prediction.cloud import carried, fewer, least_steps
from .asked import OUTLYING, Asked, left_of, reading_of
from .by_cloud import fresh, read
from .found import found as as_found
from .stacked import Stacked
from .state import FilterState

__all__ = ["Glide"]

_LONGEST = 8  # readings at most that a filter takes itself, before the next are tried
_AT_ONCE = 64  # readings at most of one call of compiled code, which nothing interrupts


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
        filt = self._filt
        density, model, sensor = filt.density, filt.model, filt.measurement
        Z, ends = _plain(model, sensor, filt.t, times, readings)
        rows: list[dict[str, Any]] = []
        if not len(Z):
            return rows
        stacked = Stacked.of((_asked(sensor, Z[0], ends[1]),), None)
        run = _Run(density.cloud, density.needs, target_of(density, filt.config, "auto"), model, stacked)
        try:
            while len(rows) < len(Z) and not run.ended:
                rows += run.on(ends[len(rows) :], Z[len(rows) :])
        finally:  # what is done stays done, whatever raises
            if rows:
                moments, error, t = (rows[-1]["x"], rows[-1]["P"]), rows[-1]["error"], float(ends[len(rows)])
                cloud = cloud_of(density, run.state, moments, t=t, capacity=0, error=error)
                last = _asked(sensor, Z[len(rows) - 1], t)
                filt._state = _after(filt._state, cloud.noted(needs=run.needs), rows, last)
        return rows


class _Run:
    """A cloud on its way through a record, and what its next step needs."""

    def __init__(self, state: CloudState, needs: Needs, target: Any, model: SDE, stacked: Stacked) -> None:
        self.state, self.needs, self.ended = state, needs, False
        self._target, self._model, self._stacked = target, model, stacked
        self._sensor: Any = stacked.asked[0].measurement
        self._reader = stacked.reader
        self._most = _AT_ONCE if model.autonomous or model.linear else 1  # steps follow how a model changes

    def on(self, times: Floats, Z: Floats) -> list[dict[str, Any]]:
        """What a result keeps of the next readings put through; `ended` where a filter would do more."""
        rows: list[dict[str, Any]] = []
        if self._reader is not None and self.state.points.path is None and self.state.inherited == 0.0:
            try:
                rows = self._at_once(self._reader, times[: self._most + 1], Z[: self._most])
            except Exception:
                if self._most == 1:
                    raise
                self._most = 1  # up to the reading at which a function raises
        if rows or self.ended:
            return rows
        rows = self._in_turn(times[:2].tolist(), Z[0])
        self.ended = not rows
        return rows

    def _at_once(self, reader: Reader, times: Floats, Z: Floats) -> list[dict[str, Any]]:
        """The next readings by one call of compiled code, as far as each is usual."""
        state, model, target = self.state, self._model, self._target
        count = self.needs.cloud(target)
        spans = zip(times[:-1].tolist(), times[1:].tolist(), strict=True)
        least = np.array([1 if model.linear else least_steps(model, state.points.x, span) for span in spans])
        bounds = target, MISSED * target, FLAGGED * target, DOUBTFUL, OUTLYING, CloudScheme().max_steps
        about = least, (count, fewer(count)), self.needs.calm, Bounds(*bounds)
        found = put_through(state, model, times, (reader, Z), *about)
        self.ended = found.end == REFUSED
        if found.end == JUDGE and not self._added(found, times, Z) <= MISSED * target:
            found, self.ended = found.before, True  # more points help where this cycle has added its error
        if found.done:
            self.state = found.state
            self.needs = self.needs._replace(points=found.points, calm=found.calm, legs=0)
        return _rows(self._sensor, Z[: found.done], found.rows)

    def _added(self, found: Through, times: Floats, Z: Floats) -> float:
        """Error of the mean that the last reading put through has added."""
        k = found.done - 1
        (t0, t1), (_, _, x, P, *_) = times[k : k + 2].tolist(), found.rows
        seen = self._stacked.again(_asked(self._sensor, Z[k], t1))
        return fresh(found.before.state, found.state, self._model, (t0, t1), seen, (x[k], P[k]))

    def _in_turn(self, span: Sequence[float], z: Floats) -> list[dict[str, Any]]:
        """The next reading step by step."""
        target, model, sensor = self._target, self._model, self._sensor
        stacked = self._stacked.again(_asked(sensor, z, span[1]))
        scheme = CloudScheme(n_points=self.needs.gone_on().cloud(target))
        try:
            moved = carried(self.state, model, (span[0], span[1]), scheme, target)
        except PropagationError:
            return []
        done = read(moved.state, stacked, span[1]) if moved.lost == 0.0 and moved.error < DOUBTFUL else None
        if done is None:
            return []
        if done.state.inherited > 0.0:
            done = done.left(left_of(moved.moments[1], done.moments[1]))
        if not done.error <= FLAGGED * target or not done.error < DOUBTFUL or done.doubt > WRONG:
            return []
        if done.error > MISSED * target:
            added = fresh(self.state, done.state, model, (span[0], span[1]), stacked, done.moments)
            if not added <= MISSED * target:
                return []
        points = moved.state.points
        expected, S, _ = reading_of(sensor, done.t, points.x, points.w, moved.moments)
        y, S = sensor.residual(z, expected), S + sensor.noise_cov
        if stacked.asked[0]._replace(innovation=y, S=S).outlying:
            return []
        self.needs = self.needs._replace(legs=0).told(done.state.told.errors.mean, target, done.state.size)
        self.state = done.state
        return [_row(*moved.moments, *done.moments, done.log_evidence, done.error, y, S)]


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


def _plain(
    model: SDE, sensor: GaussianMeasurement, t: float, times: Floats, readings: Sequence[Any]
) -> tuple[Floats, Floats]:
    """The first readings (K, k) of which all numbers came, but for the last; t and their times (K + 1,)."""
    Z, ends = [], [t]
    for t1, then, z in zip(times[:-1].tolist(), times[1:].tolist(), readings[:-1], strict=True):
        numbers = _all_of(sensor, z)
        if (
            numbers is None
            or not ends[-1] < t1 < then
            or next(iter(model.breaks(ends[-1], t1)), None) is not None
        ):
            break
        Z.append(numbers)
        ends.append(t1)
    return np.array(Z, dtype=float), np.array(ends)


def _asked(sensor: GaussianMeasurement, z: Floats, t: float) -> Asked:
    """A reading of which all numbers came."""
    return Asked(sensor, z, np.ones(len(z), dtype=bool), t, None, None, None)


def _all_of(sensor: GaussianMeasurement, z: Any) -> Floats | None:
    """The numbers of a reading, if all of them came; a filter says what is wrong with others."""
    try:
        numbers, seen = sensor.reading(z)
    except ModelError:
        return None
    return numbers if seen.all() else None


def _rows(sensor: GaussianMeasurement, Z: Floats, columns: tuple[Floats, ...]) -> list[dict[str, Any]]:
    """What a result keeps of readings (K, k), of columns that compiled code made."""
    rows = [_row(*parts) for parts in zip(*(column[: len(Z)] for column in columns), strict=True)]
    if sensor.H is not None and not sensor.angles:  # to the last bit as the sensor itself predicts
        for row, z in zip(rows, Z, strict=True):
            row["innovation"] = sensor.residual(z, sensor.predict(row["x_prior"])[0])
    return rows


def _row(
    m: Floats, P: Floats, x: Floats, C: Floats, log_evidence: float, error: float, y: Floats, S: Floats
) -> Any:
    """What a result keeps of a reading that is usual."""
    row = {
        "x_prior": m,
        "P_prior": P,
        "x": x,
        "P": C,
        "log_evidence": float(log_evidence),
        "error": float(error),
    }
    return row | {"flagged": False, "accepted": True, "innovation": y, "innovation_cov": S}
