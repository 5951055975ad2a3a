"""`JumpMarkovFilter`: a Bayes filter of a model that switches between modes, with a density for each."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from .._types import Floats, Interval, Readings, Reported
from ..config import FilterConfig
from ..consistency.ranks import Ranker
from ..density.as_cloud import thinned
from ..density.memory import Memory, flagged_from, usual_error, usual_points
from ..density.modes import ModeDensities
from ..density.particle_density import ParticleDensity
from ..density.weighted import WeightedStates
from ..errors import ModelError
from ..info import DOUBTFUL, NOTHING_CAME, Code, target_missed
from ..lattice.level_set import min_nodes
from ..model.compile import StateFunction
from ..model.dynamics import Dynamics
from ..model.jump_markov import JumpMarkovModel
from ..model.jump_markov import mode_probabilities as checked_probabilities
from ..model.measurements import Sensor
from ..model.named import InputRecord, InputValues, driven
from ..model.sensors import Sensors
from ..prediction.jumping import suits
from ..prediction.mixing_modes import whatever_the_mode
from ..prediction.switching import ModesInfo, ModesPrediction, points_of_modes, predict_modes
from ..validate import end_of, short
from .checkpoint import restored_modes
from .names import suggest_keyword
from .readings import checked_sensor, numbers_of, rows_of, sensor_of
from .results import FilterResult, run_filter
from .shell import RANKED, DensityFilter
from .state import FilterState
from .update_modes import ModesUpdateInfo
from .update_modes_again import update_or_predict_modes_again

__all__ = ["JumpMarkovFilter", "JumpMarkovResult", "ModesUpdateInfo"]

#: One for all modes, or one for each.
_Sensors = Sensor | Mapping[str, Sensor] | None


@dataclass(frozen=True, repr=False)
class JumpMarkovResult(FilterResult):
    """A `FilterResult` with the probabilities of the modes.

    Attributes
    ----------
    mode_probabilities : ndarray, shape (T, M)
        After each update.
    names : tuple of str, length M
        Of the modes.

    Examples
    --------
    >>> import sphfilter as sf
    >>> drift = lambda v: sf.LinearSDE([[0.0]], [v], noise=[[0.2]])
    >>> model = sf.JumpMarkovModel({"left": drift(-1.0), "right": drift(1.0)}, [[-0.1, 0.1], [0.1, -0.1]])
    >>> flt = sf.JumpMarkovFilter(model, sf.GaussianMeasurement([[1.0]], [[0.04]]), [0.0], [[0.1]])
    >>> result = flt.run([1.0, 2.0], [0.9, 2.1])
    >>> print(result.names, result.mode_probabilities.round(2).tolist())
    ('left', 'right') [[0.03, 0.97], [0.01, 0.99]]
    """

    mode_probabilities: Floats = None  # type: ignore[assignment]
    names: tuple[str, ...] = ()


class JumpMarkovFilter(DensityFilter[ModeDensities, JumpMarkovModel, _Sensors]):
    """A Bayes filter of a `JumpMarkovModel`: it carries a density for every mode, and their probabilities.

    The densities of modes mix as what they are, sums, and not as Gaussians with their moments.

    Parameters
    ----------
    model : JumpMarkovModel
    measurement : GaussianMeasurement, LikelihoodMeasurement, Sensors, a mapping of these by mode, or None
        The sensor `update` uses unless another is given; a mapping where it depends on the mode.
    x0, P0 : array_like, shapes (n,), (n, n)
        Initial mean and covariance, in every mode.
    mode_probabilities : array_like, shape (M,), or mapping of str to float, optional
        Of the modes at t0; ``model.stationary`` if not given. A mode that a mapping does not name has none.
    t0 : float
        Seconds.
    n_particles : int or "auto"
        As of `SPHFilter`, of each mode.
    config : FilterConfig, optional
        With `time_budget`, a step has as many points as are expected to end in time, 256 in each mode at
        least, and sums go to the error that so many points would have; where that is more than the target,
        it is said. See `prepare`.
    dt : float or timedelta, optional
        Makes ``predict()`` advance by dt seconds when called without argument.
    window : int
        As of `SPHFilter`: how many steps are kept for readings that come late.

    Attributes
    ----------
    x, P : ndarray, shapes (n,), (n, n)
        Mean and covariance over all modes now; `x_prior`, `P_prior` before and `x_post`, `P_post` after the
        last update.
    t : float
    mode_probabilities : ndarray, shape (M,)
        In the order of ``model.names``.
    mode : str
        The most probable one.
    densities : dict of str to ParticleDensity
        Of the modes that have a probability.
    density : ParticleDensity
        Of the states, whatever the mode.
    z, y, S : ndarray or None
        Last measurement, its innovation over all modes and the covariance of that.
    log_likelihood, log_evidence : float
        Log-evidence of the last measurement, given all before, and of all.

    Notes
    -----
    A predict or update that raises leaves the filter as it was. The filter draws no random numbers: the
    same input gives the same bits, unless it has a `time_budget`: then its densities hang on the clock.

    Examples
    --------
    >>> import sphfilter as sf
    >>> drift = lambda v: sf.LinearSDE([[0.0]], [v], noise=[[0.2]])
    >>> modes = {"rest": drift(0.0), "moving": drift(1.0)}
    >>> model = sf.JumpMarkovModel(modes, rates=[[-0.1, 0.1], [0.2, -0.2]])
    >>> sensor = sf.GaussianMeasurement([[1.0]], [[0.04]])
    >>> flt = sf.JumpMarkovFilter(model, sensor, x0=[0.0], P0=[[0.1]], dt=1.0)
    >>> for z in (0.1, 0.0, 0.9, 2.1):
    ...     predicted, updated = flt.predict(), flt.update(z)
    ...     print(f"{flt.x[0]:5.2f} {flt.mode} {flt.mode_probabilities.round(2)}")
     0.10 rest [0.91 0.09]
     0.03 rest [0.97 0.03]
     0.80 moving [0.32 0.68]
     2.02 moving [0.05 0.95]
    """

    _restored = staticmethod(restored_modes)

    @suggest_keyword
    def __init__(
        self,
        model: JumpMarkovModel,
        measurement: Sensor | Mapping[str, Sensor] | None,
        x0: ArrayLike,
        P0: ArrayLike,
        *,
        mode_probabilities: ArrayLike | Mapping[str, float] | None = None,
        t0: float = 0.0,
        n_particles: int | Literal["auto"] = "auto",
        config: FilterConfig | None = None,
        dt: Interval | None = None,
        window: int = 0,
    ) -> None:
        if not isinstance(model, JumpMarkovModel):
            raise ModelError(f"model must be a JumpMarkovModel, got {short(model)}; SPHFilter takes an SDE")
        self.model = model
        self.measurement = measurement
        self.n_particles = self._configure(config, n_particles, dt)
        density = self._start(x0, P0, t0, self.n_particles)
        w = checked_probabilities(mode_probabilities, model)
        modes = ModeDensities.alike(w, density, summed=not suits(model))
        self._state = FilterState.begun(modes, model.inputs)
        self._remember_from_here(window)

    def _checked(self, measurement: Any) -> dict[str, Sensor]:
        """The sensor of every mode."""
        if isinstance(measurement, Sensors) or not isinstance(measurement, Mapping):
            sensor = checked_sensor(measurement, self.model)
            return dict.fromkeys(self.model.names, sensor)
        if set(measurement) != set(self.model.names):
            raise ModelError(
                f"a measurement by mode needs one for each of {list(self.model.names)}, "
                f"got {list(measurement)}"
            )
        sensors = {name: checked_sensor(measurement[name], self.model) for name in self.model.names}
        if len({getattr(sensor, "dim_z", 0) for sensor in sensors.values()}) > 1:
            raise ModelError(
                "the measurements of all modes must have as many components: they are of one reading"
            )
        listed = {name: [*s] if isinstance(s, Sensors) else None for name, s in sensors.items()}
        first, names = next(iter(listed.items()))
        for name, others in listed.items():
            if others != names:
                raise ModelError(
                    f"the Sensors of all modes must have the same names in the same order, for a reading is "
                    f"of all modes: those of {first!r} are {names}, those of {name!r} {others}"
                )
        return sensors

    def _asked(self, given: Any, H: ArrayLike | StateFunction | None) -> dict[str, Sensor]:
        """The sensor of every mode that a reading comes from."""
        if H is None and (hasattr(given, "log_likelihood") or isinstance(given, Mapping)):
            return self._checked(given)
        if self._sensors is None and given is None:
            raise ModelError("update needs a measurement, or a filter made with one")
        own = self._sensors or dict.fromkeys(self.model.names)
        return {name: sensor_of(own[name], given, H, self.model) for name in self.model.names}

    def _of_any_mode(self, sensors: Mapping[str, Sensor] | None) -> Sensor | None:
        """A sensor that takes readings by name, or says how many numbers they have, as those of all modes."""
        return None if sensors is None else sensors[self.model.names[0]]

    def __repr__(self) -> str:
        modes = zip(self.model.names, self.mode_probabilities, strict=True)
        told = ", ".join(f"{name}: {w:.3g}" for name, w in modes)
        return f"JumpMarkovFilter({self._told()}, modes={{{told}}})"

    @property
    def measurement(self) -> Sensor | None:
        """The filter's own sensor; None where it depends on the mode, or there is none."""
        sensors = list((self._sensors or {}).values())
        return sensors[0] if sensors and all(sensor is sensors[0] for sensor in sensors) else None

    @measurement.setter
    def measurement(self, value: Sensor | Mapping[str, Sensor] | None) -> None:
        self._sensors = None if value is None else self._checked(value)

    @property
    def dim_z(self) -> int | None:
        """Number of components of the filter's own sensors; None without one, or where any number will do."""
        return getattr(self._of_any_mode(self._sensors), "dim_z", None)

    @property
    def mode_probabilities(self) -> Floats:
        """Probabilities of the modes now, shape (M,), in the order of ``model.names``."""
        return self._state.density.w

    @property
    def mode(self) -> str:
        """The most probable mode."""
        return self.model.names[int(np.argmax(self._state.density.log_w))]

    @property
    def densities(self) -> Mapping[str, ParticleDensity]:
        """Densities by mode, of those that have a probability."""
        return MappingProxyType({self.model.names[i]: p for i, _, p in self._state.density.some})

    @property
    def density(self) -> ParticleDensity:
        """The density of the states, whatever the mode: the sum of those of the modes."""
        return whatever_the_mode(self._state.density, self.config.target_error)

    @suggest_keyword
    def predict(
        self, dt: Interval | None = None, *, t: float | None = None, u: InputValues | None = None
    ) -> ModesInfo:
        """Advance by dt seconds, or to time t; without either by the filter's own dt. Returns ModesInfo.

        The inputs of the modes' models are u over the interval, in their order or by name.
        """
        self._budget.begin(step=True)
        by = self.dt if dt is None and t is None else dt
        if by is None and t is None:
            raise ModelError("predict needs dt or t=, or a filter made with dt=")
        end = end_of(self.t, by, t)
        rehearses = self._rehearsed(end - self.t)
        state, model, what = self._afforded(), self.model if u is None else self.model.with_inputs(u), ""
        if end == self.t:
            info = ModesInfo(error=state.density.error, skipped=("everything: the interval is empty",))
            state = state.noted(inputs=dict(model.inputs))  # that sensors read
        else:
            what, before, settings = "" if rehearses else "predict", state.density, self._settings(state)
            modes, info = predict_modes(before, model, end, *settings)
            state = state.predicted(modes, ModesPrediction(before, info.n_substeps, model), model.inputs)
        info = self._budget.end(what, info, self._number(state), repeated=False)
        self._predicted(state, {"dt": dt, "t": t}, u)
        return info

    def _number(self, state: FilterState[ModeDensities]) -> int:
        """Particles of each mode that a step has; of sums, points that would be as good."""
        if not isinstance(self.n_particles, str):
            return self._budget.bound(self.n_particles, min_nodes(self.model.dim))
        return state.n_particles or points_of_modes(state.density, self.config.target_error)

    def _afforded(self) -> FilterState[ModeDensities]:
        """The state, whose densities go on as no more points than there is time for."""
        state, target = self._state, self.config.target_error
        if not isinstance(self.n_particles, str):
            return state
        asked = points_of_modes(state.density, target)
        if state.n_particles:  # the step before had fewer than it asked for
            asked = max(asked, Memory().cloud(target, state.density.heaviest.dim))
        most = self._budget.bound(asked, int(usual_points(DOUBTFUL)))
        if most == asked:
            return state.noted(n_particles=0)
        most = 2 ** int(math.log2(most))
        return state.noted(density=state.density.cut(most), n_particles=most)

    def _settings(self, state: FilterState[ModeDensities]) -> tuple[FilterConfig, int | str]:
        """Settings of a step and bound of its particles: sums go to an error that their points would have."""
        if not isinstance(self.n_particles, str):
            return self.config, self._number(state)
        target = max(self.config.target_error, usual_error(state.n_particles) if state.n_particles else 0.0)
        return replace(self.config, target_error=target), "auto"

    @property
    def _each(self) -> list[tuple[Dynamics, ParticleDensity, Sensor | None]]:
        names, own = self.model.names, self._sensors or {}
        return [(self.model.modes[names[i]], p, own.get(names[i])) for i, _, p in self._state.density.some]

    @suggest_keyword
    def update(
        self,
        z: Reported,
        measurement: Sensor | Mapping[str, Sensor] | ArrayLike | str | None = None,
        H: ArrayLike | StateFunction | None = None,
        *,
        R: ArrayLike | None = None,
    ) -> ModesUpdateInfo:
        """Use a measurement z, of another sensor if given; None or NaN is missing; a ModesUpdateInfo.

        Of several `Sensors`, z maps their names to readings, or `measurement` is the name of the one read.
        R and H change the filter's own sensor for this reading, as those of `SPHFilter.update`.
        """
        return self._updated(z, measurement, H, R)

    def _read(self, z: Reported, given: Any, H: Any) -> tuple[FilterState[ModeDensities], ModesUpdateInfo]:
        state = self._state
        sensors = {name: driven(sensor, state.inputs) for name, sensor in self._asked(given, H).items()}
        numbers = numbers_of(self._of_any_mode(sensors), z)
        self._budget.begin()
        number, settings = self._number(state), self._settings(state)
        prior, modes, info = update_or_predict_modes_again(
            *(state.origin, state.density, sensors, numbers, *settings),
            fits=lambda times: self._budget.fits(int(times * number)),
        )
        if state.n_particles and info.error > flagged_from(self.config.target_error):
            info = info.also(Code.COARSE, target_missed(info.error, self.config.target_error))
        what, repeated = "" if info.reason == NOTHING_CAME else "update", prior is not state.density
        info = self._budget.end(what, info, number, repeated)
        return state.updated((prior, modes, info), None, sensors[self.mode], numbers), info

    def spread(self) -> WeightedStates:
        """The densities of all modes as states and weights, `WeightedStates`; of large clouds, of a part."""
        modes = self._state.density
        few = [None if p is None else thinned(p, RANKED) for p in modes.densities]
        return ModeDensities(modes.log_w, few).spread()

    def run(
        self,
        times: ArrayLike,
        measurements: Readings,
        truth: ArrayLike | None = None,
        observer: Ranker | None = None,
        inputs: InputRecord | None = None,
    ) -> JumpMarkovResult:
        """Predict to each time and update with its measurement; returns a `JumpMarkovResult`.

        `truth`, `observer` and `inputs` are those of `SPHFilter.run`.
        """
        told: list[Floats] = []
        measurements = rows_of(self._of_any_mode(self._sensors), measurements)
        looked = {"each": lambda flt: told.append(flt.mode_probabilities)}
        result = run_filter(self, times, measurements, truth, observer, inputs=inputs, **looked)
        w = np.array(told).reshape(-1, len(self.model.names))
        return JumpMarkovResult(**vars(result), mode_probabilities=w, names=self.model.names)
