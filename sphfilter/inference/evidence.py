"""The log-evidence of measurements as a function of parameters."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from copy import copy, deepcopy
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from .. import validate
from .._types import Bools, Floats, Readings, Rows
from ..config import FamilyScheme
from ..density.memory import USUAL
from ..errors import EstimationError, ModelError, SphfilterError, nearest
from ..filter.readings import rows_of
from ..filter.results import AnyFilter, FilterResult
from ..filter.sph_filter import SPHFilter
from ..model.discrete import DiscreteModel
from ..model.measurements import Reading
from ..model.named import InputRecord, check_parameters, each_input, parametrised

#: Makes a filter, at the start of the measurements, of parameters by name.
Builder: TypeAlias = Callable[[dict[str, float]], AnyFilter]
#: Lowest and highest value of a parameter.
Bound: TypeAlias = tuple[float | None, float | None]
_TOLERANCE = 1e-4  # of a family's steps, for slopes of the evidence; measured: half, twice move fits by 4e-5
#: Called with the number of runs so far, the parameters of the last and its log-evidence.
Progress: TypeAlias = Callable[[int, dict[str, float], float], object]


def check_name(whose: str, name: str, known: Sequence[str]) -> None:
    """Raise `ModelError` for a parameter that a fit or its posterior has not; the nearest is named."""
    if name not in known:
        has = ", ".join(known)
        raise ModelError(f"{whose} has no parameter {name!r}{nearest(name, known)}; it has {has}")


def checked_guess(
    guess: Mapping[str, float], bounds: Mapping[str, Bound] | None
) -> tuple[list[str], Floats, Floats, Floats]:
    """Names, guess, lowest and highest values (n,)."""
    if not isinstance(guess, Mapping) or not guess:
        what = validate.short(guess) if guess else "empty"
        raise ModelError(
            f"guess is {what}; give the parameters to fit with a first value, as in {{'c': 0.3}}"
        )
    names = [str(name) for name in guess]
    theta = np.array([validate.real(f"guess of {name}", value) for name, value in dict(guess).items()])
    low, high = np.full(len(names), -np.inf), np.full(len(names), np.inf)
    for name, pair in dict(bounds or {}).items():
        if name not in names:
            raise ModelError(f"bounds name {name!r}{nearest(name, names)}; guess has {', '.join(names)}")
        k = names.index(name)
        for limits, bound in zip((low, high), pair, strict=True):
            limits[k] = limits[k] if bound is None else validate.real(f"bound of {name}", bound)
        if not low[k] < high[k] or not low[k] <= theta[k] <= high[k]:
            raise ModelError(f"the guess {theta[k]:g} of {name} is not within its bounds {tuple(pair)}")
    return names, theta, low, high


class Pickled:
    """What holds read-only mappings, which Python does not pickle as they are; and is told on one line."""

    def __repr__(self) -> str:
        return f"{type(self).__name__}({'; '.join(str(self).splitlines())})"

    def __getstate__(self) -> dict[str, Any]:
        return {k: dict(v) if isinstance(v, MappingProxyType) else v for k, v in vars(self).items()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update({k: MappingProxyType(v) if type(v) is dict else v for k, v in state.items()})


class Evidence:
    """The log-evidence as a function of parameters (n,): minus infinity where the filter refuses."""

    def __init__(
        self,
        filt: SPHFilter | Builder,
        times: ArrayLike,
        measurements: Readings,
        names: Sequence[str],
        report: Progress | None,
        inputs: InputRecord | None,
    ) -> None:
        if not isinstance(filt, SPHFilter) and not callable(filt):
            raise ModelError(
                f"parameters of an SPHFilter are fitted, or of what a function makes of them; got "
                f"{validate.short(filt)}: give a function of them by name that returns a new filter"
            )
        self.times, self.names, self.inputs = validate.array("times", times, (None,)), names, deepcopy(inputs)
        self.measurements = deepcopy(rows_of(getattr(filt, "measurement", None), measurements))
        if len(self.times) != len(self.measurements):
            raise ModelError(
                f"as many measurements as times are needed; got times of shape {np.shape(self.times)} and "
                f"{len(self.measurements)} measurements"
            )
        self.given: Any = copy(filt) if isinstance(filt, SPHFilter) else filt  # which stays where it is
        self.build = _builder(self.given, self) if isinstance(self.given, SPHFilter) else self.given
        self.bounds = np.full(len(names), -np.inf), np.full(len(names), np.inf)
        self.report, self.n_evaluations = report, 0
        self.n_readings = n_readings(self.measurements)

    def __reduce__(self) -> tuple[Any, ...]:
        made = self.given, self.times, self.measurements, self.names, None, self.inputs
        return Evidence, made, {"bounds": self.bounds, "n_evaluations": self.n_evaluations}

    def first(self, theta: Floats) -> None:
        """Raise `EstimationError` where it is not finite at the guess."""
        try:
            value = self._run(theta)
        except SphfilterError as problem:
            raise EstimationError(
                f"the filter refuses the guess {self.named(theta)}: {problem}; begin elsewhere"
            ) from problem
        if not np.isfinite(value):
            raise EstimationError(f"the log-evidence of the guess {self.named(theta)} is {value}")

    def __call__(self, theta: Floats) -> float:
        try:
            value = self._run(theta)
        except SphfilterError:
            return -np.inf
        return value if np.isfinite(value) else -np.inf

    def result(self, theta: Floats) -> FilterResult:
        """Result that the filter leaves behind."""
        given: dict[str, Any] = {} if self.inputs is None else {"inputs": self.inputs}
        return self.build(self.named(theta)).run(self.times, self.measurements, **given)

    def _run(self, theta: Floats) -> float:
        self.n_evaluations += 1
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # wild parameters are tried, too
            value = float(np.sum(self.result(theta).log_evidence))
        if self.report is not None:
            self.report(self.n_evaluations, self.named(theta), value)
        return value

    @property
    def data(self) -> str:
        """Fingerprint of times, measurements and inputs."""
        return fingerprint(self.times, self.measurements, self.inputs)

    def named(self, theta: Floats) -> dict[str, float]:
        """Parameters by name."""
        return dict(zip(self.names, map(float, theta), strict=True))

    def names_of(self, which: Bools) -> list[str]:
        """Names of some parameters, bool (n,)."""
        return [name for name, one in zip(self.names, which, strict=True) if one]

    def within(self, theta: Floats, free: Bools) -> Callable[[Floats], float]:
        """As a function of the free parameters, the others held."""

        def function(values: Floats) -> float:
            point = theta.copy()
            point[free] = values
            return self(point)

        return function


def _builder(filt: SPHFilter, evidence: Evidence) -> Builder:
    """Make filters like one at its start, with other parameters of its model and sensor, all of one shape.

    Steps that chose anew how the density is represented would make the log-evidence jump.
    """
    each_input(filt.model.inputs, evidence.inputs, len(evidence.times))  # wrong ones are refused now
    owners = filt.model, filt.measurement
    check_parameters(evidence.names, *owners)
    shape: dict[str, Any] = {}

    def build(parameters: dict[str, float]) -> SPHFilter:
        start = partial(SPHFilter, *(parametrised(own, parameters) for own in owners), density=filt.density)
        if not shape:
            shape.update(_shape(filt, start, evidence))
        return start(**shape)

    return build


def _shape(filt: SPHFilter, start: Callable[..., SPHFilter], evidence: Evidence) -> dict[str, Any]:
    """How a filter carries its density: as it does; if a target error chooses, one family if that does."""
    if not filt.adapts:
        return {"n_particles": filt.n_particles, "config": filt.config}
    on_particles = {"n_particles": USUAL, "config": filt.config}
    trial, degree, exact = start(config=filt.config), 0, filt.model.linear
    driving = each_input(filt.model.inputs, evidence.inputs, len(evidence.times))
    for t, z, u in zip(evidence.times, evidence.measurements, driving, strict=True):
        for step in (partial(trial.predict, t=t, u=u), partial(trial.update, z)):
            step()
            own, exact = trial.density.form.degree, exact and trial.density.gaussian
            if own == 0:
                return on_particles
            degree = max(degree, own)
    if exact or isinstance(filt.model, DiscreteModel):
        return {"config": filt.config}  # in closed form, every step
    scheme = FamilyScheme(degree=degree, tolerance=_TOLERANCE)
    return {"config": replace(filt.config, scheme=scheme)}


def error_of_run(result: Any) -> float:
    """Error of a run's log-evidence, nats; NaN where the result, of a filter of one's own, tells none."""
    return float(getattr(result, "total_evidence_error", np.nan))


def n_readings(measurements: Rows) -> int:
    """How many numbers were measured, NaN not counted."""
    known = (np.asarray(validate.unmasked(z), dtype=float) for z in measurements if z is not None)
    return sum(int(np.isfinite(z).sum()) for z in known)


def fingerprint(times: ArrayLike, measurements: Rows, inputs: InputRecord | None = None) -> str:
    """Short hash of times, measurements and inputs; None is what NaN is."""
    known = hashlib.sha256(np.asarray(times, dtype=float).tobytes())
    for z in measurements:
        z = Reading.of(z).z
        known.update(b"missing" if np.isnan(z).all() else z.tobytes())
    if inputs is not None:
        named = sorted(inputs.items()) if isinstance(inputs, Mapping) else [("", inputs)]
        for name, values in named:
            known.update(name.encode() + np.asarray(values, dtype=float).tobytes())
    return known.hexdigest()[:12]
