"""A time budget: how many particles a predict and the updates after it may have, going by what they cost."""

import math
from collections import deque
from contextlib import suppress
from dataclasses import replace
from time import perf_counter
from typing import Any, TypeVar

import numpy as np

from ..config import CloudScheme
from ..density.distributions import Gaussian
from ..density.initialize import initialize
from ..errors import PropagationError
from ..info import Code
from ..lattice.level_set import min_nodes
from ..model.likelihood import LikelihoodMeasurement
from ..model.measurements import Sensor, has_gaussian_noise
from ..model.named import driven
from ..prediction.predict import load, predict
from .update import update

Info = TypeVar("Info", bound=Any)

#: What time is read from, seconds; `time.process_time` leaves out what other processes take.
clock = perf_counter
#: Steps that are remembered: the next one costs more than the dearest of so many alike with
#: probability 1 / (_MEMORY + 1) = .05.
_MEMORY = 19
_REHEARSED = 2  # steps with costs that count, after one that compiles and one on few particles
_SHORT = 1e-3  # of the interval: a prediction that compiles and does little else


class Budget:
    """Wall-clock time of a step: a predict, and the updates before the next one.

    With `seconds` it is what a step may take; with None time is measured and nothing hangs on it.
    """

    def __init__(self, seconds: float | None) -> None:
        self.seconds, self.spent = seconds, 0.0  # that a step may take, and that this one has taken so far
        self.prepared = seconds is None  # is everything compiled, so that what steps take is what they cost?
        self._began, self._most = 0.0, 0
        #: Of steps: particles, seconds for each, and whether it ended in time.
        self._costs: dict[str, deque[tuple[int, float, bool]]] = {}
        self._again = False  # was the last prediction made again on more particles?
        # particles of steps where that happened twice in a row, else zero
        self._too_few: deque[int] = deque(maxlen=_MEMORY)
        self.keep(0)

    def keep(self, n: int) -> None:
        """Forget what steps have cost but for the last n."""
        kept = {what: list(self._costs.get(what, [])) for what in ("predict", "update")}
        self._costs = {what: deque(c[max(len(c) - n, 0) :], _MEMORY) for what, c in kept.items()}

    def adopt(self, other: "Budget") -> None:
        """Take over what particles have cost in a rehearsal."""
        self._costs, self._too_few, self.prepared = other._costs, other._too_few, True

    def begin(self, step: bool = False) -> None:
        """A call begins, and with a prediction a new step."""
        self._began = clock()
        self.spent = 0.0 if step else self.spent

    def bound(self, n_particles: int, least: int) -> int:
        """Particles that a step can afford: `n_particles` at most, and `least` if those are not fewer.

        Where they were too few of late, so that two predictions in a row had to be made again on three times
        as many, twice as many from the beginning take less time: more than they save if that is rare.

        Time is taken to be in proportion to particles. Part of it is the same for any number, so that more
        of them than were measured cost less than that: steps come near the budget from below. So that they
        do, what ended in time with less than half of the particles of others is no longer asked.
        """
        if self.seconds is None:
            return n_particles
        cost = self._dearest("predict") + self._dearest("update")
        affordable = min(self.seconds / cost, n_particles) if cost > 0.0 else 0.0  # NaN where none is known
        least = max(least, 2 * max(self._too_few, default=0))
        self._most = max(int(affordable), min(least, n_particles))
        return self._most

    def fits(self, n_particles: int) -> bool:
        """Would another prediction on so many particles end in time, with an update after it?"""
        if self.seconds is None:
            return True
        left = self.seconds - self.spent - (clock() - self._began)
        return n_particles * (self._dearest("predict") + self._dearest("update")) <= left

    def end(self, what: str, info: Info, n_particles: int, repeated: bool) -> Info:
        """A call has ended: note what a particle has cost, and say what the step has taken.

        `what` is "predict" or "update", on `n_particles`, of those bounded; it is empty where a call had
        nothing to do, and so no cost. One that made other predictions or updates again
        (`repeated`) says nothing of a particle.
        """
        took = clock() - self._began
        info, self.spent = info.noted(seconds=took), self.spent + took
        if self.seconds is None:
            return info
        if what == "predict":
            before, self._again = self._again, repeated or n_particles > self._most
            self._too_few.append(self._most if before and self._again else 0)
        if what and not repeated:
            self._costs[what].append((n_particles, took / n_particles, self.spent <= self.seconds))
        elif what and len(self._costs[what]) > 1:
            self._costs[what].popleft()  # time passes: a busy spell of the machine must not last for ever
        if self.spent <= self.seconds:
            return info
        late = f"time budget exceeded: {1e3 * self.spent:.3g} of {1e3 * self.seconds:.3g} ms"
        return info.also(Code.LATE, late)

    def _dearest(self, what: str) -> float:
        costs = self._costs[what]
        most = max((n for n, _, in_time in costs if in_time), default=0)
        return max((each for n, each, in_time in costs if 2 * n >= most or not in_time), default=math.nan)


def rehearse(twin: Any, budget: Budget, dt: float) -> float:
    """Predict and update a twin of a filter until all is compiled and the cost of a step is known.

    The twin stands where the filter to be prepared stands, and lives on its own; `budget` is the twin's,
    which takes the costs. Returns the seconds that the last step took, to predict by `dt` seconds and update;
    NaN if it could not be made.
    """
    seconds = math.nan
    with suppress(PropagationError):  # the filter itself will tell when it happens there
        for step in range(2 + _REHEARSED):
            twin.predict(dt)
            twin.update(*_expected(twin, twin._each[0][2]))
            seconds = budget.spent
            budget.keep(0 if step == 0 else _REHEARSED)
    with suppress(PropagationError):
        _load_rest(twin, dt)
    return seconds


def _load_rest(filt: Any, dt: float) -> None:
    """Compile what a prediction may fall back on, and an update after that."""
    for model, density, own in filt._each:
        scheme = load(model, density, filt.config)
        if scheme is None:
            continue
        config = replace(filt.config, scheme=scheme)
        # as many particles as the filter has would take minutes, and compile nothing more
        about = {"t": filt.t, "domain": model.domain}
        begins = filt.config if isinstance(scheme, CloudScheme) else config  # points come from a lattice
        few = initialize(Gaussian(density.mean(), density.cov()), min_nodes(model.dim), begins, **about)
        moved, _ = predict(few, model, max(_SHORT * dt, getattr(model, "period", 0.0)), config)
        z, sensor = _expected(filt, own)
        update(moved, sensor or driven(own, filt.inputs), z, filt.config)


def _expected(filt: Any, sensor: Any) -> tuple[Any, Sensor | None]:
    """A reading of a filter's own sensor that changes little, and the sensor if it is another."""
    if has_gaussian_noise(sensor):
        return driven(sensor, filt.inputs).predict(filt.x, filt.t)[0], None
    return 0.0, LikelihoodMeasurement(lambda z, X, t: np.zeros(len(X)))
