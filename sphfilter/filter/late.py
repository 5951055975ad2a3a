"""Readings that come late: the last steps of a filter are kept, and taken again with the reading in place."""

from collections.abc import Mapping
from copy import copy, deepcopy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .._types import Reported
from ..errors import ModelError
from ..info import UpdateInfo, codes_of
from ..model.measurements import Sensor
from ..validate import count, onwards, real


@dataclass(frozen=True)
class Step:
    """A prediction of a filter and the updates after it, as they were asked for."""

    before: Any  # the FilterState that the prediction began with
    start: float  # seconds
    end: float
    interval: Mapping[str, Any]  # ``dt`` or ``t`` of the prediction; empty where the filter began
    inputs: Mapping[str, float] | None = None  # as they were given
    actions: tuple[tuple[str, Mapping[str, Any]], ...] = ()  # methods by name, and their arguments


class StepHistory:
    """A filter that keeps its last steps; states never change, so that keeping them is all it takes.

    Steps are taken again by the filter's own predict and update: the densities have the bits that they would
    have, had all readings come in order.
    """

    _state: Any
    _steps: tuple[Step, ...] = ()
    _window: int = 0

    def _remember_from_here(self, window: int) -> None:
        """Begin to keep so many steps."""
        self._window, self._steps = count("window", window, least=0), ()
        if self._window:
            self._steps = (Step(self._state, self._state.t, self._state.t, {}),)

    def _predicted(self, state: Any, interval: dict[str, Any], u: Any) -> None:
        """Go on from the state after a prediction; one over no time belongs to the step before."""
        before, self._state = self._state, state
        inputs = None if u is None else dict(state.inputs)
        if self._window and state.t > before.t:
            step = Step(before, before.t, state.t, interval, inputs)
            self._steps = (*self._steps, step)[-self._window :]
        elif inputs is not None:
            self._did("predict", **interval, u=inputs)

    def _did(self, method: str, **arguments: Any) -> None:
        """Keep what was asked for since the last prediction; its caller may change arrays later."""
        if self._window:
            arguments = {
                name: value if hasattr(value, "log_likelihood") else deepcopy(value)
                for name, value in arguments.items()
            }
            *others, last = self._steps
            self._steps = (*others, replace(last, actions=(*last.actions, (method, arguments))))

    def update_late(self, z: Reported, t: float, measurement: Sensor | str | None = None) -> UpdateInfo:
        """Use a reading of an earlier time: steps since then are taken again, to the same bits as in order.

        Parameters
        ----------
        z : array_like, shape (k,), mapping of sensors' names to theirs, or None
        t : float
            Seconds, when it was taken; within the last steps that the filter keeps, ``window=``.
        measurement : sensor, optional
            As of `update`.

        Returns
        -------
        UpdateInfo
            Of the reading. What was unusual about the steps taken again is in its `status` and `code` too.

        Raises
        ------
        ModelError
            The filter keeps no steps, or none that reaches back so far, or has not come to this time yet; it
            stays as it was then, as it does if a step raises.

        Notes
        -----
        Steps are taken again with the model, the sensor and the configuration that the filter has now.
        Readings of one time are taken in the order in which they came.
        """
        at, now = self._time_of(real("t", t)), self._state.t
        if at > now:
            raise ModelError(f"the filter is at t = {now:g} and has not come to {at:g} yet: predict first")
        if not self._window:
            raise ModelError(
                "the filter keeps no steps to put a late reading into; make it with window=, the number of "
                "steps that a reading may be late by"
            )
        first = self._steps[0]
        if at < first.start:
            raise ModelError(
                f"the reading is of t = {at:g}, but the {self._window} steps that the filter keeps begin at "
                f"{first.start:g}: make it with a larger window="
            )
        k = max(k for k, step in enumerate(self._steps) if step.start <= at and (step.start < at or k == 0))
        twin = copy(self)
        info = twin._put(k, at, {"z": z, "measurement": measurement})
        self._state, self._steps = twin._state, twin._steps
        return info

    def _time_of(self, t: float) -> float:
        """A time, or that of a step from which it differs by rounding alone."""
        ends = [*(step.end for step in self._steps), self._state.t]
        return next((end for end in ends if onwards(np.array([t]), end)[0] == end), t)

    def _put(self, k: int, t: float, late: dict[str, Any]) -> UpdateInfo:
        """Take step k and those after it again, with a reading at a time in that step."""
        step, later = self._steps[k], self._steps[k + 1 :]
        self._state, self._steps = step.before, self._steps[:k]
        again = [step, *later]
        if t < step.end:  # the step is cut in two
            until = replace(step, end=t, interval={"t": t}, actions=())
            again = [until, replace(step, start=t, interval={"t": step.end}), *later]
        flagged, own = [], None
        for number, part in enumerate(again):
            infos = self._take(part)
            if number == 0:
                own = self.update(**late)  # type: ignore[attr-defined]
            flagged += [info for info in infos if info.flagged]
        assert own is not None
        words = dict.fromkeys(info.status if info.status != "ok" else info.reason for info in flagged)
        if words:
            own = own.also(codes_of(flagged), f"of steps taken again: {', '.join(words)}")
        return own

    def _take(self, step: Step) -> list[Any]:
        """Take a step again; what its prediction and its updates say."""
        infos = []
        if step.end > step.start:
            given = {} if step.inputs is None else {"u": step.inputs}
            infos.append(self.predict(**step.interval, **given))  # type: ignore[attr-defined]
        else:
            self._steps = (*self._steps, Step(self._state, step.start, step.start, {}))
        said = [getattr(self, method)(**arguments) for method, arguments in step.actions]
        return infos + [info for info in said if info is not None]
