"""`SPHFilter`: predict and update with state, in the shape filterpy users know."""

from collections.abc import Mapping
from copy import copy, deepcopy
from functools import partial
from typing import Any, Literal, Self

from numpy.typing import ArrayLike

from .._types import Floats, Interval, Readings, Reported
from ..config import FilterConfig
from ..consistency.ranks import Ranker
from ..core.cloud.control import MOST_POINTS
from ..density.as_cloud import thinned
from ..density.memory import max_particles
from ..density.particle_density import ParticleDensity
from ..density.resample import max_particles_of
from ..density.weighted import WeightedStates
from ..errors import ModelError
from ..info import NOTHING_CAME, PredictInfo, UpdateInfo
from ..lattice.level_set import min_nodes
from ..lattice.resolved import MOST
from ..model.compile import StateFunction
from ..model.dynamics import Dynamics
from ..model.measurements import Sensor
from ..model.named import InputRecord, InputValues, check_parameters, driven, parametrised
from ..prediction.again import Outcome, Time, or_as_cloud, predict_from_finer
from ..prediction.predict import Prediction, predict
from ..validate import count, real, seconds, short
from .budget import Budget
from .checkpoint import restored
from .glide import Glide
from .names import suggest_keyword
from .readings import checked_sensor, interval_of, numbers_of, parted, sensor_of
from .results import FilterResult, run_filter
from .shell import RANKED, DensityFilter
from .state import FilterState
from .update_again import Update, prediction_of, update_or_predict_again


class SPHFilter(DensityFilter[ParticleDensity, Dynamics, Sensor | None]):
    """A Bayes filter that carries the probability density on SPH particles (002).

    Parameters
    ----------
    model : SDE or DiscreteModel
    measurement : GaussianMeasurement, LikelihoodMeasurement, Sensors or None
        The sensor `update` uses unless another is given.
    x0 : array_like, shape (n,)
        Initial mean.
    P0 : array_like, shape (n, n)
        Initial covariance, positive definite. Where axes of the model end at walls, x0 and P0 are those of
        a Gaussian that is cut there: the density starts as what lies between the walls, normalised.
    t0 : float
        Time of the initial density, seconds.
    n_particles : int or "auto"
        Upper bound of the number of particles at every re-gridding. With "auto", the default, every step
        takes the cheapest representation of the density that keeps its estimated error within the
        configuration's `target_error`: a closed form, one exponential family, a lattice or a cloud. The
        number is then that of the nodes that the next lattice begins with. A scheme that estimates no error
        has 200 particles for "auto".
    config : FilterConfig, optional
        With `time_budget`, n_particles is the most that a step may have: a step has as many particles as are
        expected to end in time, 60 in two states at least, and a cloud 256. See `prepare`.
    density : ParticleDensity, optional
        Initial density instead of x0, P0 and t0.
    dt : float or timedelta, optional
        Makes ``predict()`` advance by dt seconds when called without argument, as in filterpy.
    window : int
        Number of last steps, predictions with the updates after them, that are kept for readings that come
        late (`update_late`).

    Attributes
    ----------
    x, P : ndarray, shape (n,) and (n, n)
        Mean and covariance now; `x_prior`, `P_prior` before and `x_post`, `P_post` after the last update.
    t : float
    density : ParticleDensity
    z, y, S : ndarray or None
        Last measurement, its innovation and innovation covariance, NaN where no reading came and before the
        first; y and S, and z before the first, are None for sensors that are no `GaussianMeasurement`.
    log_likelihood : float
        Log-evidence of the last measurement, given all before; zero where none came.
    log_evidence : float
        Sum of all log-likelihoods so far.

    Notes
    -----
    A predict or update that raises leaves the filter as it was. The filter draws no random numbers: the
    same input gives the same bits, unless it has a `time_budget`: then its particles hang on the clock.

    Of filterpy's filters it has ``predict()``, ``update(z)``, ``update(None)``, ``update(z, R, H)``; x, P,
    their priors and posteriors, z, y, S, SI, mahalanobis, log_likelihood, likelihood, dim_x and dim_z, to be
    read; and it works in ``Saver`` and ``MMAEFilterBank``. x0 and z may be columns, (n, 1) and (k, 1). It
    has no F, Q, K or H, no ``update(z, HJacobian, Hx)``, and no place in ``IMMEstimator``, which overwrites
    x and P; a `ModelError` says what to use instead.

    Examples
    --------
    >>> import sphfilter as sf
    >>> well = sf.SDE.from_expressions(["x"], ["x - x**3"], [["1"]], [[0.5]])
    >>> sensor = sf.GaussianMeasurement([[1.0]], [[0.1]])
    >>> flt = sf.SPHFilter(well, sensor, x0=[0.0], P0=[[0.5]], n_particles=100, dt=1.0)
    >>> for z in (0.9, None, -1.1):
    ...     predicted, updated = flt.predict(), flt.update(z)
    ...     print(f"t = {flt.t:.0f}: {flt.x[0]:6.3f} ± {flt.P[0, 0] ** 0.5:.3f}")
    t = 1:  0.873 ± 0.260
    t = 2:  0.768 ± 0.517
    t = 3: -0.951 ± 0.256
    >>> print(f"{flt.log_evidence:.3f}, {flt.density.probability(lambda X: X[:, 0] > 0):.4f}")
    -3.562, 0.0007
    """

    _of_state = "log_evidence", "n_particles"
    _restored = staticmethod(restored)

    @suggest_keyword
    def __init__(
        self,
        model: Dynamics,
        measurement: Sensor | None,
        x0: ArrayLike | None = None,
        P0: ArrayLike | None = None,
        *,
        t0: float = 0.0,
        n_particles: int | Literal["auto"] = "auto",
        config: FilterConfig | None = None,
        density: ParticleDensity | None = None,
        dt: Interval | None = None,
        window: int = 0,
    ) -> None:
        if not isinstance(model, Dynamics):
            raise ModelError(f"model must be an SDE or a DiscreteModel, got {short(model)}")
        self.model = model
        self.measurement = None if measurement is None else checked_sensor(measurement, model)
        known = max_particles(self._configure(config, n_particles, dt), self.config)
        self._adapts = isinstance(known, str)
        least = min_nodes(model.dim) if isinstance(known, str) else int(known)
        start = self._begun(density, x0, P0, t0, known)
        self._state = FilterState.begun(start, model.inputs, self.measurement, least)
        self._remember_from_here(window)

    def _begun(self, density: Any, x0: Any, P0: Any, t0: float, n_particles: Any) -> ParticleDensity:
        """The density that the filter starts with: as it is given, or by its mean and covariance."""
        if density is None:
            if x0 is None or P0 is None:
                raise ModelError("the filter needs x0 and P0, or density=")
            return self._start(x0, P0, t0, n_particles)
        if x0 is not None or P0 is not None:
            raise ModelError("give either x0 and P0, or density=, not both")
        if not isinstance(density, ParticleDensity) or density.dim != self.model.dim:
            raise ModelError(f"density must be a ParticleDensity of {self.model.dim} states")
        return density

    def __repr__(self) -> str:
        scheme = self.config.scheme
        return (
            f"SPHFilter({self._told()}, {self.density.n_particles} particles (at most {self.n_particles}), "
            f"scheme={scheme if isinstance(scheme, str) else scheme.name!r})"
        )

    @property
    def density(self) -> ParticleDensity:
        """The density now."""
        return self._state.density

    @property
    def dim_z(self) -> int | None:
        """Number of components of the filter's own sensor; None without one, or where any number will do."""
        return getattr(self.measurement, "dim_z", None)

    @property
    def adapts(self) -> bool:
        """Whether the filter was made with ``n_particles="auto"``."""
        return self._adapts

    @property
    def n_particles(self) -> int:
        """Upper bound of the number of particles at the next re-gridding; a filter given one has that."""
        return self._state.n_particles

    @n_particles.setter
    def n_particles(self, value: int) -> None:
        value = count("n_particles", value)
        if "_now" in vars(self):  # else a subclass sets it before it is made
            self._state = self._state.noted(n_particles=value)
            self._adapts = False

    def with_parameters(self, parameters: Mapping[str, float] | None = None, /, **more: float) -> Self:
        """Return a new filter of the density now, whose model and sensor have other parameters.

        Values are keywords, or a mapping such as the `estimate` of a fit; a name that both have is one
        parameter. Settings are this filter's; the new one has seen no measurement. Raises `ModelError` for a
        name that neither has (the nearest is named), or a value that is not one finite number.

        Examples
        --------
        >>> import sphfilter as sf
        >>> model = sf.SDE.from_expressions(["x"], ["-a*x"], [["1"]], parameters={"a": 0.6})
        >>> flt = sf.SPHFilter(model, sf.GaussianMeasurement([[1.0]], [[0.1]]), x0=[2.0], P0=[[0.1]])
        >>> other = flt.with_parameters(a=0.0)
        >>> info = other.predict(1.0)
        >>> print(other.model.parameters["a"], f"{other.x[0]:.3f}, {flt.x[0]:.3f} at t = {flt.t:g}")
        0.0 2.000, 2.000 at t = 0
        """
        values = {**(parameters or {}), **more}
        check_parameters(values, self.model, self.measurement)
        new = copy(self)
        new.model, new.measurement = (parametrised(own, values) for own in (self.model, self.measurement))
        new._budget = Budget(self.config.time_budget)
        given = self.density, new.model.inputs, new.measurement, self.n_particles
        new._state = FilterState.begun(*given)
        new._remember_from_here(self._window)
        return new

    @suggest_keyword
    def predict(
        self, dt: Interval | Floats | None = None, *, t: float | None = None, u: InputValues | None = None
    ) -> PredictInfo:
        """Advance by dt seconds, or to time t; without either by the filter's own dt. Returns PredictInfo.

        The model's inputs are u over the interval, in their order or by name; without u, what the model has.
        As in filterpy, ``predict(u)`` takes an array for u where the filter has a dt of its own, and
        ``predict(0)`` is without.
        """
        self._budget.begin(step=True)
        by, t, u = interval_of(dt, t, u, self.dt, self.model.inputs)
        model = self.model if u is None else self.model.with_inputs(u)
        rehearses = self._rehearsed(seconds("dt", by) if t is None else real("t", t) - self.t)
        state, points = self._state, self._most()
        most = min(points, MOST)

        def predicted(density: ParticleDensity, config: Any) -> Outcome[PredictInfo]:
            options: dict[str, Any] = {"t": t, "n_particles": most}
            if self._adapts:
                options |= {"n_particles": "auto", "time": Time(most, self._budget.fits)}
            begun, needs = density, density.needs
            if needs is not None and needs.cloud(config.target_error, density.dim) > points:
                begun = density.noted(needs=needs.cut(points))
            moved, info = predict(begun, model, by, config, goes_on=False, **options)
            return Outcome(
                density, moved, info, max_particles_of(moved) if self._adapts else state.n_particles
            )

        def attempted(config: Any) -> Outcome[PredictInfo]:
            known = state.density, state.origin, config, most
            return predict_from_finer(partial(predicted, config=config), model, *known)

        outcome = or_as_cloud(attempted, self.config)
        density, info, advanced = outcome.density, outcome.info, outcome.density.t > state.t
        repeated = outcome.before is not state.density
        origin = state.origin
        if advanced:
            known = None if repeated else origin
            origin = Prediction.after(known, outcome.before, info.mass_error, model, density)
        state = state.predicted(density, origin, model.inputs, n_particles=outcome.bound)
        what = "predict" if advanced and not rehearses else ""
        info = self._budget.end(what, info, density.n_particles, repeated)
        self._predicted(state, {"dt": by, "t": t}, u)
        return info

    def _most(self) -> int:
        """Particles that a call may have."""
        asked = MOST_POINTS if self._adapts else self.n_particles
        return self._budget.bound(asked, min_nodes(self.model.dim))

    @property
    def _each(self) -> list[tuple[Dynamics, ParticleDensity, Sensor | None]]:
        return [(self.model, self.density, self.measurement)]

    @suggest_keyword
    def update(
        self,
        z: Reported,
        measurement: Sensor | ArrayLike | str | None = None,
        H: ArrayLike | StateFunction | None = None,
        *,
        R: ArrayLike | None = None,
    ) -> UpdateInfo:
        """Use a measurement z, of another sensor if given; None or NaN is missing. Returns UpdateInfo.

        Of a filter whose measurement is `Sensors`, z maps their names to readings, or `measurement` is the
        name of the one that was read.

        As in filterpy, a number or matrix in the place of the sensor is the noise covariance R of this
        reading, also given as R=, and H its matrix or function h; the rest stays that of the filter's own
        sensor.
        """
        return self._updated(z, measurement, H, R)

    def _read(self, z: Reported, given: Any, H: Any) -> tuple[FilterState[ParticleDensity], UpdateInfo]:
        state = self._state
        sensor = driven(sensor_of(self.measurement, given, H, self.model), state.inputs)
        numbers = numbers_of(sensor, z)
        used, values = parted(sensor, deepcopy(numbers))  # they may be asked for again
        prediction = prediction_of(state.origin)
        self._budget.begin()
        most = "auto" if self._adapts else self._most()
        options: dict[str, Any] = {"n_particles": most, "fits": self._budget.fits}
        outcome = update_or_predict_again(
            prediction, state.density, prediction.model or self.model, used, values, self.config, **options
        )
        repeated = outcome.before is not state.density
        what = "" if outcome.info.reason == NOTHING_CAME else "update"
        own = H is None and (given is None or given is self.measurement)
        origin = Update.after(state.origin, outcome.before, used, values, outcome.info, own)
        state = state.updated(outcome[:3], origin, sensor, numbers)
        # of a cloud both passes come out
        count = min(outcome.before.n_particles, outcome.density.n_particles)
        return state, self._budget.end(what, outcome.info, count, repeated)

    def spread(self) -> WeightedStates:
        """The density now as states and weights, `WeightedStates`; of a large cloud, of a part of it."""
        return thinned(self._state.density, RANKED).spread()

    def _glide(self) -> Glide | None:
        """What puts a record through without coming up for each reading, where that is not the steps' own."""
        kind, changed = type(self), {"predict", "update"} & vars(self).keys()
        own = kind.predict is SPHFilter.predict and kind.update is SPHFilter.update
        return Glide(self) if own and not changed else None

    @suggest_keyword
    def run(
        self,
        times: ArrayLike,
        measurements: Readings,
        truth: ArrayLike | None = None,
        observer: Ranker | None = None,
        inputs: InputRecord | None = None,
    ) -> FilterResult:
        """Predict to each time and update with its measurement; returns a `FilterResult`.

        Row k of `inputs`, (T, m) or columns (T,) by name, has the model's inputs over the interval that ends
        at ``times[k]``. Measurements of `Sensors` are rows of all their numbers, NaN where none came
        (`Sensors.merged` makes such), or mappings of their names to readings.

        Told the true states of simulated data, `truth` (T, n), the result also holds their ranks in the
        filter's densities (the filter does not see them); `sf.report` judges by them. An `observer` that
        knows the truth, a `Ranker`, may be given instead.

        Where a record goes through a cloud in one call, the density after it is worked out when the filter
        is first asked for it.
        """
        return run_filter(self, times, measurements, truth, observer, inputs=inputs)
