"""The shell of all filters around their density: settings, names, what they show, calls and files."""

import math
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from os import PathLike
from typing import TYPE_CHECKING, Any, ClassVar, Final, Generic, Literal, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from .. import drawing
from .._types import Floats, Interval, Reported
from ..config import FilterConfig, checked_filter_config
from ..density.distributions import Gaussian
from ..density.initialize import initialize
from ..density.particle_density import ParticleDensity
from ..errors import ModelError
from ..model.dynamics import Dynamics
from ..model.jump_markov import JumpMarkovModel
from ..model.measurements import Sensor
from ..model.named import InputRecord
from ..model.sensors import Sensors
from ..validate import array, choice, column, count, covariance, positive, real, row, seconds
from .budget import Budget, rehearse
from .checkpoint import Restored, write
from .forecast import Event, Forecast, forecast
from .late import StepHistory
from .names import check_assigned, check_read
from .state import Carried, FilterState

RANKED = 2**14  # points of a cloud that a truth is ranked among: ranks are off by 1 / (2 √RANKED) = .004

#: What a filter's densities obey, and the sensors that it is made with.
Model = TypeVar("Model", Dynamics, JumpMarkovModel)
Given = TypeVar("Given")


def _shown(name: str, what: str) -> Any:
    """A property that shows a part of a filter's state."""

    def part(self: Any) -> Any:
        return getattr(self._state, name)

    return property(part, doc=what)


class DensityFilter(StepHistory, Generic[Carried, Model, Given]):
    """A filter that carries a density; its subclasses have the step that carries it, and Bayes' rule.

    A call makes a new state and puts it in the place of the old one as its last act: one that raises leaves
    the filter as it was.
    """

    _base: ClassVar[type]  # the library's own class: users' subclasses may have what attributes they like
    _of_state: ClassVar[tuple[str, ...]] = ("log_evidence",)  # parts of it that may be set
    #: What makes a filter again: of a file, model and measurement.
    _restored: ClassVar[Callable[..., Restored]]
    _now: FilterState[Carried]
    #: What a record has told of, and left to be worked out: where it was before its last step, if that is not
    #: where it began, and time and reading of that step.
    _pending: tuple[Any, float, Any] | None = None

    x: Final[Floats] = _shown("x", "Mean, shape (n,).")
    P: Final[Floats] = _shown("P", "Covariance, shape (n, n).")
    x_prior: Final[Floats] = _shown("x_prior", "Mean after the last prediction, shape (n,).")
    P_prior: Final[Floats] = _shown("P_prior", "Covariance after the last prediction, shape (n, n).")
    x_post: Final[Floats] = _shown("x_post", "Mean after the last update, shape (n,).")
    P_post: Final[Floats] = _shown("P_post", "Covariance after the last update, shape (n, n).")
    z: Final[Floats | None] = _shown(
        "z", "Last measurement, shape (k,), NaN where no reading came and before the first; or None."
    )
    y: Final[Floats | None] = _shown("y", "Innovation of the last measurement, shape (k,), or None.")
    S: Final[Floats | None] = _shown("S", "Covariance of the innovation, shape (k, k), or None.")
    log_likelihood: Final[float] = _shown(
        "log_likelihood", "Log-evidence of the last measurement, zero where none came."
    )
    t: Final[float] = _shown("t", "Time of the density, seconds.")
    inputs: Final[Mapping[str, float]] = _shown(
        "inputs", "What the model's inputs were in the last prediction, by name."
    )

    def __init_subclass__(cls, **given: Any) -> None:
        super().__init_subclass__(**given)
        if DensityFilter in cls.__bases__:
            cls._base = cls

    @property
    def _state(self) -> FilterState[Carried]:
        if self._pending is not None:
            self._catch_up()
        return self._now

    @_state.setter
    def _state(self, state: FilterState[Carried]) -> None:
        self._now, self._pending = state, None

    def _catch_up(self) -> None:
        """Work out what is pending."""
        filt: Any = self
        before, pending, self._pending = self._now, filt._pending, None
        left, t, z = pending
        try:
            self._now = before if left is None else left.state(filt)
            filt.predict(t=t)
            filt.update(z)
        except BaseException:  # a Ctrl-C
            self._now, self._pending = before, pending
            raise

    def __setattr__(self, name: str, value: Any) -> None:
        check_assigned(name, type(self), self._base)
        if self._pending is not None and not name.startswith("_"):
            self._catch_up()  # with the sensor and the settings that it had
        object.__setattr__(self, name, value)
        if name in self._of_state and self._steps:
            self._did("__setattr__", name=name, value=value)

    if TYPE_CHECKING:
        model: Model
        config: FilterConfig
        dt: float | None

        @property
        def density(self) -> ParticleDensity: ...
    else:  # a checker would take every name for one that is there

        def __getattr__(self, name: str) -> Any:
            check_read(name, type(self))
            return object.__getattribute__(self, name)  # raises what Python says

    def _configure(
        self, config: FilterConfig | None, n_particles: int | Literal["auto"], dt: Interval | None
    ) -> int | Literal["auto"]:
        """Check and keep the settings that all filters have; the number of particles, as it is checked."""
        self.config = checked_filter_config(config)
        self._budget = Budget(self.config.time_budget)
        if isinstance(n_particles, str):
            choice("n_particles", n_particles, ["auto"])
        else:
            n_particles = count("n_particles", n_particles)
        self.dt = None if dt is None else positive("dt", seconds("dt", dt))
        return n_particles

    def _start(self, x0: Any, P0: Any, t0: float, n_particles: Any) -> ParticleDensity:
        """The density of a Gaussian, cut where the model's axes end."""
        n = self.model.dim
        x0 = array("x0", column(x0), (n,), f"a value for each of the model's {n} states")
        P0 = covariance("P0", P0, dim=n)
        about: dict[str, Any] = {"t": real("t0", t0), "domain": self.model.domain}
        return initialize(Gaussian(x0, P0), n_particles, self.config, **about)

    def prepare(self, dt: Interval | None = None) -> float:
        """Compile all that predictions and updates call, before a loop in real time.

        Predictions and updates are rehearsed on a twin: the filter stays where it is. Under a `time_budget`
        the filter learns from the rehearsal how long its particles take; without a call of `prepare` it
        rehearses in its first predict. What leads points to a sharp reading, `sphfilter.compile` compiles.

        Parameters
        ----------
        dt : float, optional
            Interval between measurements, seconds; the filter's own dt if it has one.

        Returns
        -------
        float
            Seconds that a predict and an update take; NaN if they could not be made.
        """
        if dt is None and self.dt is None:
            raise ModelError("prepare needs dt, the interval between measurements, or a filter made with dt=")
        twin, budget = copy(self), Budget(self.config.time_budget or math.inf)
        budget.prepared, twin._budget = True, budget
        taken = rehearse(twin, budget, positive("dt", seconds("dt", self.dt if dt is None else dt)))
        self._budget.adopt(budget)
        return taken

    def _rehearsed(self, interval: float) -> bool:
        """Whether a budget is to be kept by steps that nobody has timed; if so, time some."""
        rehearses = not self._budget.prepared
        if rehearses and interval > 0.0:
            self.prepare(interval)
        return rehearses

    @property
    def _each(self) -> list[tuple[Dynamics, ParticleDensity, Sensor | None]]:
        """Models, their densities and the filter's own sensors of them."""
        raise NotImplementedError

    def _told(self) -> str:
        """How a filter of any kind describes itself."""
        std = row(np.sqrt(np.diag(self.P)))
        return f"states={self.model.states}, t={self.t:g}, x={row(self.x)}, std={std}"

    def _updated(self, z: Reported, measurement: Any, H: Any, R: ArrayLike | None) -> Any:
        """Go on from the state after an update; what `_read` says of it."""
        given, sensors = measurement if R is None else R, getattr(self, "measurement", None)
        if R is not None and isinstance(measurement, str) and isinstance(sensors, Sensors):
            part: Any = sensors[measurement]
            given, H = part.changed(R, H), None
        elif R is not None and measurement is not None:
            raise ModelError("give R= or another sensor, not both")
        self._state, info = self._read(z, given, H)
        self._did("update", z=z, measurement=measurement, H=H, R=R)
        return info

    def _read(self, z: Reported, given: Any, H: Any) -> tuple[FilterState[Carried], Any]:
        """The state after a reading, of another sensor if one is given, or its R and H; and what it says."""
        raise NotImplementedError

    def forecast(
        self,
        times: ArrayLike,
        quantiles: ArrayLike = (0.05, 0.5, 0.95),
        events: Mapping[str, Event] | None = None,
        inputs: InputRecord | None = None,
    ) -> Forecast:
        """Return what the density becomes at times to come, a `Forecast`; the filter stays where it is.

        Parameters
        ----------
        times : array_like, shape (K,)
            Not decreasing, seconds, none before the filter's own.
        quantiles : array_like, shape (q,)
            Probabilities between 0 and 1.
        events : mapping of str to callable, optional
            Regions by name: functions of states X (M, n) that return booleans (M,), or numbers that are
            positive inside, by which first passages are known better.
        inputs : array_like (K, m), or mapping of str to array_like (K,), optional
            What the model's inputs are over the interval that ends at each time.
        """
        return forecast(self, times, quantiles, events, inputs)

    def plot(self, states: Sequence[str] | None = None, ax: Any = None) -> Any:
        """Draw the density now; needs matplotlib.

        Parameters
        ----------
        states : sequence of str, optional
            Names of the states that are drawn, all if not given: one as a line, two as a map with the
            smallest regions that hold .5, .9 and .99, more as all pairs.
        ax : matplotlib Axes, or an array (k, k) of these, optional
            A new figure if not given; returned either way.
        """
        names = self.model.states
        return drawing.density(self.density, names, drawing.chosen(names, states), ax)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the filter as it stands to an npz file; model and sensors, which are code, are not in it."""
        write(path, self._state, self)

    @classmethod
    def load(cls, path: str | PathLike[str], model: Model, measurement: Given, window: int = 0) -> Self:
        """Read a filter that `save` wrote, with the model and sensors it had: it goes on to the same bits.

        An `SPHFilter` that was saved between two readings of one time does not: it knows the first as a
        density only. The steps of a `window` are not in the file: it begins anew.

        Raises
        ------
        ModelError
            The file cannot be read, holds no such filter, or one of other modes or states.
        """
        options, about, state = cls._restored(path, model, measurement)
        filt: Any = cls(model, measurement, **options)  # type: ignore[call-arg]
        for name, value in about.items():
            setattr(filt, name, value)
        filt._state = filt._state.noted(**state)
        filt._remember_from_here(window)
        return filt

    @property
    def dim_x(self) -> int:
        """Number of states n."""
        return len(self._state.x)

    @property
    def SI(self) -> Floats | None:
        """Inverse of S, that of the components that came; NaN where none did, or None."""
        if self.S is None:
            return None
        came = np.isfinite(np.diag(self.S))
        both, inverse = np.ix_(came, came), np.full_like(self.S, np.nan)
        inverse[both] = np.linalg.inv(self.S[both])
        return inverse

    @property
    def mahalanobis(self) -> float:
        """Length of the last innovation in standard deviations of its prediction; NaN where none came."""
        y, inverse = self.y, self.SI
        if y is None or inverse is None or np.isnan(y).all():
            return math.nan
        return math.sqrt(np.nansum(y[:, None] * inverse * y))

    @property
    def log_evidence(self) -> float:
        """Log-evidence of all measurements."""
        return self._state.log_evidence

    @log_evidence.setter
    def log_evidence(self, value: float) -> None:
        self._state = self._state.noted(log_evidence=float(value))

    @property
    def likelihood(self) -> float:
        """Evidence of the last measurement."""
        return float(np.exp(self._state.log_likelihood))
