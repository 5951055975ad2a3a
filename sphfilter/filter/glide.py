"""A record put through a cloud without a density, and what a step says, for every reading.

What a filter finds so has the bits that it finds step by step: where a step would be anything but usual, the
filter takes that one itself. It takes the last step of a record, too, when it is asked what came of that.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from numba.core.errors import NumbaError

from .._types import Floats
from ..config import CloudScheme
from ..core.cloud import cycle
from ..density.as_cloud import cloud_of
from ..density.memory import MISSED, Memory, flagged_from
from ..density.particle_density import ParticleDensity
from ..density.passage import Through, put_through
from ..density.points import CloudState
from ..density.resample import max_particles_of, target_of
from ..errors import ModelError
from ..info import DOUBTFUL
from ..model.measurements import GaussianMeasurement
from ..model.sde import SDE
from ..prediction.cloud import as_points, least_steps, shadow_size
from ..prediction.ladder import becomes_cloud
from .by_cloud import error_added
from .reading_at_prior import ReadingAtPrior, linear_reading
from .stacked import Stacked
from .state import FilterState, read_only

_LONGEST = 8  # readings at most that a filter takes itself, before the next are tried
_AHEAD = 64  # readings that are looked at
#: Points of all readings of one call of compiled code, which nothing interrupts: some tenth of a second.
_POINTS = 2**16
_COLUMNS = (
    "x_prior", "P_prior", "x", "P", "log_evidence", "evidence_error", "error", "variance_error",
    "innovation", "innovation_cov", "flagged",
)  # fmt: skip


class Glide:
    """Puts the readings of a record through a filter's cloud, as far as each is usual.

    Density and log-evidence of the `SPHFilter` become those after the last reading that was put through.
    """

    def __init__(self, filt: Any) -> None:
        self._filt, self._wait, self._next = filt, 0, 0

    def through(self, times: Floats, readings: Sequence[Any]) -> list[dict[str, Any]]:
        """Rows of a result for the first readings."""
        if self._next > 0 or not _usual(self._filt):
            self._next -= 1
            return []
        rows = self._through(times, readings)
        self._wait = min(2 * self._wait + 1, _LONGEST) if not rows else 0
        self._next = self._wait
        return rows

    def _through(self, times: Floats, readings: Sequence[Any]) -> list[dict[str, Any]]:
        run, later, going_on = _Run(self._filt), np.append(times[1:], math.inf), True
        try:
            while going_on:
                some = slice(len(run.reached.rows), len(run.reached.rows) + _AHEAD)
                Z, ends = _plain(self._filt, run.reached.t, (times[some], later[some]), readings[some])
                going_on = run.through(ends, Z) and len(Z) == _AHEAD  # else the next is the filter's
        finally:  # what is done stays done, whatever raises
            self._leave(run, times, readings)
        return run.reached.rows

    def _leave(self, run: "_Run", times: Floats, readings: Sequence[Any]) -> None:
        """Leave the filter at what a run has reached; before the last step, if nothing comes after it."""
        whole, filt, left = len(run.reached.rows) == len(times), self._filt, None
        reached = run.before if whole else run.reached
        if reached.rows:
            log_evidence = sum((row["log_evidence"] for row in reached.rows), start=filt.log_evidence)
            z = _all_of(filt.measurement, readings[len(reached.rows) - 1])
            left = _Left(reached._replace(rows=reached.rows[-1:]), z, log_evidence)
        if whole:
            filt._pending = left, float(times[-1]), _all_of(filt.measurement, readings[-1])
        elif left is not None:
            filt._state = left.state(filt)


class _Reached(NamedTuple):
    """How far a record has been put through a cloud: one value, which nothing interrupts halfway."""

    state: CloudState
    needs: Memory
    rows: list[dict[str, Any]]
    t: float


class _Left(NamedTuple):
    """How far a filter has put readings through: the row of the last, z; and the log-evidence of all."""

    reached: _Reached
    z: Any
    log_evidence: float

    def state(self, filt: Any) -> FilterState[ParticleDensity]:
        """The state of the filter, which was where the readings began."""
        (cloud, needs, (row,), t), z, log_evidence = self
        about: dict[str, Any] = {"t": t, "capacity": 0, "error": row["error"]}
        density = cloud_of(filt.density, cloud, (row["x"], row["P"]), **about).noted(needs=needs)
        told = {name: read_only(row[name]) for name in ("x", "P", "x_prior", "P_prior")}
        said = {"z": z, "y": row["innovation"], "S": row["innovation_cov"], "origin": None}
        said |= {"log_likelihood": row["log_evidence"], "log_evidence": log_evidence}
        said |= {"n_particles": max_particles_of(density, "auto")}
        return filt._now.noted(density=density, **told, x_post=told["x"], P_post=told["P"], **said)


class _Run:
    """A cloud on its way through a record."""

    def __init__(self, filt: Any) -> None:
        density, needs, model = filt.density, filt.density.needs or Memory(), filt.model
        self._sensor, self._model = filt.measurement, model
        self._target = target = _target_of(filt)
        self.reached = _Reached(as_points(density, needs.cloud(target, density.dim)), needs, [], filt.t)
        self.before = self.reached  # one reading earlier
        self._steady = model.autonomous or model.linear or not isinstance(model, SDE)
        self._known: Stacked | None = None

    def through(self, times: Floats, Z: Floats) -> bool:
        """Put readings (K, k) at times (K + 1,) through; false where one of them is the filter's."""
        first = len(self.reached.rows)
        if not len(Z) or self._stacked(Z[0], times[1]).reader is None:
            return False
        while (k := len(self.reached.rows) - first) < len(Z):
            if not self._at_once(times[k:], Z[k:]):
                return False
        return True

    def _stacked(self, z: Floats, t: float) -> Stacked:
        """The sensor that has read numbers z (k,) at a time."""
        every = np.ones(len(z), dtype=bool)
        asked = ReadingAtPrior(self._sensor, z, every, float(t), None, None, None)
        self._known = self._known or Stacked.of((asked,), None)
        return self._known.again(asked)

    def _at_once(self, times: Floats, Z: Floats) -> bool:
        """Put readings through by one call of compiled code; false where the next is the filter's."""
        (state, needs, *_), model, target = self.reached, self._model, self._target
        count = needs.cloud(target, model.dim)
        K = min(len(Z), max(_POINTS // count, 1)) if self._steady else 1
        times, Z = times[: K + 1], Z[:K]
        most = CloudScheme().max_steps
        bounds = cycle.Bounds(target, MISSED * target, flagged_from(target), DOUBTFUL, most)
        about = (count, shadow_size(count)), needs.calm, bounds
        reader = self._stacked(Z[0], times[1]).reader
        assert reader is not None
        spans = zip(times[:-1].tolist(), times[1:].tolist(), strict=True)
        try:
            least = np.array([least_steps(model, state.points.x, span) for span in spans])
            found = put_through(state, model, times, (reader, Z), least, *about)
            refused = found.end == cycle.JUDGE and not self._added(found, times, Z) <= MISSED * target
        except (SystemError, NumbaError):  # a Ctrl-C, or a fault of the library
            raise
        except Exception:  # a user's function raises at one of them, up to which the filter goes
            return False
        if refused or found.end == cycle.MISSED:
            found, refused = found.before, True  # more points help where this cycle has added its error
        if found.done:
            rows, rest = _rows(self._sensor, Z[: found.done], times[1:], found.rows), found.before
            alone = rest is None or rest.done == 0
            self.before = self.reached if alone else self._put(rest, rows, times)
            self.reached = self._put(found, rows, times)
        return not refused and found.end != cycle.UNUSUAL

    def _put(self, found: Through, rows: list[dict[str, Any]], times: Floats) -> _Reached:
        """How far the record is, where compiled code has put it through so many readings."""
        told: dict[str, Any] = {"points": found.points, "calm": found.calm, "legs": 0, "age": found.state.age}
        needs, done = self.reached.needs._replace(**told), [*self.reached.rows, *rows[: found.done]]
        return _Reached(found.state, needs, done, float(times[found.done]))

    def _added(self, found: Through, times: Floats, Z: Floats) -> float:
        """Error of the mean that the last reading put through has added."""
        k = found.done - 1
        (t0, t1), (_, _, x, P, *_) = times[k : k + 2].tolist(), found.rows
        about = [(self._model, t1)], t0, self._stacked(Z[k], t1), (x[k], P[k]), self._target
        return error_added(found.before.state if k else self.reached.state, found.state, *about)


def _usual(filt: Any) -> bool:
    """Whether a filter is such that steps of its cloud are all there is to do."""
    config, density, sensor = filt.config, filt.density, filt.measurement
    plain = config.scheme == "auto" and config.time_budget is None and not config.acceptance.enabled
    own = type(sensor) is GaussianMeasurement and not sensor.inputs and not filt.model.inputs
    if own:
        sensor.check_dim(filt.model.dim)
        own = sensor.H is None or not sensor.angles  # else it sums in an order of its own
    usual = plain and filt.adapts and own and filt.model.domain.unbounded and not filt._steps
    usual = usual and density.left_out is None  # which steps carry
    known = density.needs is not None
    return bool(usual and (_begins(filt) if density.cloud is None else known and density.cloud.begins))


def _begins(filt: Any) -> bool:
    """Whether a filter's density is a Gaussian as given, of which its first prediction makes a cloud."""
    density = filt.density
    if not density.gaussian or density.error > 0.0 or filt.model.linear:
        return False
    return becomes_cloud(density.dim, density.needs or Memory(), _target_of(filt))


def _target_of(filt: Any) -> float:
    """Error that is asked of a filter's means, which adapts to it."""
    return cast(float, target_of(filt.density, filt.config, "auto"))


def _plain(filt: Any, t: float, times: tuple[Floats, ...], readings: Sequence[Any]) -> tuple[Floats, Floats]:
    """The first readings (K, k) of which all numbers came; t and their times (K + 1,).

    The times are those of the readings, and of the ones after them.
    """
    Z, ends = [], [t]
    for t1, then, z in zip(*(each.tolist() for each in times), readings, strict=True):
        numbers = _all_of(filt.measurement, z)
        jump = next(iter(filt.model.breaks(ends[-1], t1)), None)
        if numbers is None or not ends[-1] < t1 < then or jump is not None:
            break
        Z.append(numbers)
        ends.append(t1)
    return np.array(Z, dtype=float), np.array(ends)


def _all_of(sensor: GaussianMeasurement, z: Any) -> Floats | None:
    """The numbers of a reading, if all of them came; a filter says what is wrong with others."""
    try:
        numbers, seen = sensor.reading(z)
    except ModelError:
        return None
    return numbers if seen.all() else None


def _rows(sensor: Any, Z: Floats, times: Floats, columns: tuple[Floats, ...]) -> list[dict[str, Any]]:
    """Rows of a result for readings (K, k), of columns that compiled code made."""
    rows: list[dict[str, Any]] = []
    for told in zip(*(column[: len(Z)] for column in columns), strict=True):
        known = zip(_COLUMNS, told, strict=True)
        row = {name: float(value) if np.ndim(value) == 0 else value for name, value in known}
        rows.append(row | {"flagged": bool(row["flagged"]), "accepted": True})
    if sensor.H is not None:  # to the last bit as the sensor itself predicts
        for row, z, t in zip(rows, Z, times, strict=False):
            expected, S, _ = linear_reading(sensor, float(t), row["x_prior"], row["P_prior"])
            row |= {"innovation": sensor.residual(z, expected), "innovation_cov": S + sensor.noise_cov}
    return rows
