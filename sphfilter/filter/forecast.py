"""Forecasts: what a filter's density becomes, at times to come, while the filter stays where it is."""

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import drawing, validate
from .._types import Bools, Floats
from ..density.particle_density import ParticleDensity
from ..errors import ModelError
from ..model.dynamics import Dynamics
from ..model.named import InputRecord, each_input
from .first_passage import Event, inside, passed

__all__ = ["Event", "Forecast", "forecast"]


@dataclass(frozen=True, repr=False)
class Forecast:
    """A forecast; the first axis is the time.

    Attributes
    ----------
    t, mean, cov : ndarray, shapes (K,), (K, n), (K, n, n)
        Times, seconds, and moments.
    levels : ndarray, shape (q,)
        Probabilities of the quantiles.
    quantiles : ndarray, shape (K, n, q)
        Values below which each state lies with these probabilities.
    probability : mapping of str to ndarray, shape (K,)
        Of each event, probabilities that the state is in its region at these times.
    error : ndarray, shape (K,)
        Estimated errors of the means, in standard deviations.
    flagged : ndarray of bool, shape (K,)
        True where the prediction said that something was unusual.
    states : tuple of str
    densities : tuple of ParticleDensity, length K
        The densities themselves, which answer any other question.

    Examples
    --------
    >>> import numpy as np
    >>> import sphfilter as sf
    >>> model, sensor = sf.LinearSDE([[0.0]], noise=[[1.0]]), sf.GaussianMeasurement([[1.0]], [[0.1]])
    >>> flt = sf.SPHFilter(model, sensor, x0=[0.0], P0=[[1e-6]])
    >>> ahead = flt.forecast([1.0, 4.0], quantiles=(0.05, 0.95), events={"high": lambda X: X[:, 0] - 2.0})
    >>> print(ahead.quantiles[:, 0].round(2).tolist())
    [[-1.64, 1.64], [-3.29, 3.29]]
    >>> print(ahead.probability["high"].round(3), ahead.first_passage["high"].round(2))
    [0.023 0.159] [0.05 0.32]
    """

    t: Floats
    mean: Floats
    cov: Floats
    levels: Floats
    quantiles: Floats
    probability: Mapping[str, Floats]
    error: Floats
    flagged: Bools
    states: tuple[str, ...]
    densities: tuple[ParticleDensity, ...]
    _events: Mapping[str, Event] = field(default_factory=dict)
    _way: tuple[ParticleDensity, tuple[Dynamics, ...]] | None = None

    def __repr__(self) -> str:
        events = f", events {', '.join(self.probability)}" if self.probability else ""
        return f"Forecast({len(self.t)} times to t = {self.t[-1]:g}, {len(self.states)} states{events})"

    @property
    def first_passage(self) -> Mapping[str, Floats]:
        """Of each event, probabilities (K,) that the state has been in its region by these times.

        Points go on their way and are taken out where they are seen inside, with looks so often that twice as
        many change little. Of an event that is numbers, positive inside, what noise does between two looks is
        known, and few are needed; of one that is booleans what is missed falls as the root of their time.
        """
        return MappingProxyType({name: found[0] for name, found in self._passages.items()})

    @property
    def first_passage_error(self) -> Mapping[str, Floats]:
        """Estimated standard errors (K,) of `first_passage`: of points, of looks, and of the density now."""
        return MappingProxyType({name: found[1] for name, found in self._passages.items()})

    @cached_property
    def _passages(self) -> dict[str, tuple[Floats, Floats]]:
        if self._way is None:
            raise ModelError("first passages are told of models without modes: SPHFilter.forecast")
        return {name: passed(*self._way, self.t, event) for name, event in self._events.items()}

    @cached_property
    def quantile_error(self) -> Floats:
        """Estimated standard errors of `quantiles`, shape (K, n, q)."""
        return self._errors(lambda p: np.array([p.quantile(a, self.levels) for a in range(p.dim)]))

    @cached_property
    def probability_error(self) -> Mapping[str, Floats]:
        """Estimated standard errors of `probability`, by the events' names, (K,) each."""
        each = {name: inside(event) for name, event in self._events.items()}
        return MappingProxyType({k: self._errors(lambda p, e=e: p.probability(e)) for k, e in each.items()})

    def _errors(self, question: Callable[..., Any]) -> Floats:
        return np.array([density.error_of(question) for density in self.densities])

    def plot(self, states: Sequence[str] | None = None, ax: Any = None) -> Any:
        """Draw mean, quantiles and probabilities of events over time; needs matplotlib.

        Parameters
        ----------
        states : sequence of str, optional
            Names of those that are drawn, all if not given.
        ax : matplotlib Axes, or an array of these, optional
            One for each state, and one for the events if there are any; a new figure if not given. Returned.
        """
        return drawing.forecast(self, drawing.chosen(self.states, states), ax)


def forecast(
    filt: Any,
    times: ArrayLike,
    quantiles: ArrayLike = (0.05, 0.5, 0.95),
    events: Mapping[str, Event] | None = None,
    inputs: InputRecord | None = None,
) -> Forecast:
    """What `SPHFilter.forecast` and `JumpMarkovFilter.forecast` return."""
    times = validate.onwards(np.atleast_1d(validate.times("times", np.atleast_1d(times))), filt.t)
    if times[0] < filt.t:
        raise ModelError(f"the first time {times[0]:g} is before the filter's own time {filt.t:g}")
    levels = validate.array("quantiles", np.atleast_1d(quantiles), (None,))
    if not ((levels > 0.0) & (levels < 1.0)).all():
        raise ModelError(f"quantiles are probabilities between 0 and 1, got {validate.short(quantiles)}")
    known = _checked_events(events, filt.density)
    models: list[Any] = []
    rows: list[Any] = []
    twin = copy(filt)
    for t, u in zip(times.tolist(), each_input(filt.model.inputs, inputs, len(times)), strict=True):
        models.append(twin.model.with_inputs(twin._state.inputs if u is None else u))
        info = twin.predict(t=t, u=u)
        density = twin.density
        own = [density.quantile(a, levels) for a in range(density.dim)]
        met = [density.probability(inside(event)) for event in known.values()]
        rows.append((density.mean(), density.cov(), own, met, info.error, info.flagged, density))
    mean, cov, quantile, within, error, flagged, each = zip(*rows, strict=True)
    columns = np.array(within, dtype=float).reshape(len(times), len(known)).T
    probability = dict(zip(known, columns, strict=True))
    way = (filt.density, tuple(models)) if isinstance(filt.model, Dynamics) else None
    told = np.array(error, dtype=float), np.array(flagged, dtype=bool), tuple(filt.model.states), each
    moments = np.array(mean), np.array(cov), levels, np.array(quantile)
    return Forecast(times, *moments, probability, *told, known, way)


def _checked_events(events: Mapping[str, Event] | None, density: ParticleDensity) -> dict[str, Event]:
    """Events by name, each of which says a truth, or a number, of every state."""
    if not isinstance(events or {}, Mapping):
        raise ModelError(f"events maps names to regions, got {validate.short(events)}")
    known = dict(events or {})
    X = density.x[:2]
    for name, event in known.items():
        if not callable(event):
            raise ModelError(f"the event {name!r} must be a function of states X (M, n), got {event!r}")
        found = np.asarray(event(X.copy()))
        if found.shape != (len(X),):
            raise ModelError(
                f"the event {name!r} gave an array {found.shape} for {len(X)} states; a truth of each is "
                f"needed, such as lambda X: X[:, 0] > 2, or a number, X[:, 0] - 2"
            )
    return known
