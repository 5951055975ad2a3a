"""What `estimate` fits: measurements, a filter of given parameters, where the search begins, a rival."""

from dataclasses import dataclass, replace

import numpy as np

import sphfilter as sf
from experiments.arguments.estimate import MEASURED, SENSOR
from experiments.own_data.command import case_of
from experiments.scene.scenario import Scenario, load_scenario
from experiments.sunspots import fold, load, split
from sphfilter.campaign.campaign import Case
from sphfilter.errors import ConfigError, nearest

#: Parameters that are fitted unless others are asked for, where not all can be: a common factor of others.
_DUFFING = ("xi", "gamma", "epsilon")
_FITTED = {"duffing": _DUFFING, "duffing_square": _DUFFING, "sunspots": ("w", "mu", "b", "g", SENSOR)}
#: Measurements that are simulated at least: fewer say little about a parameter.
_MEASUREMENTS = 60
_PARTICLES = 400
_FINER = 2  # times the particles a rival gets: both signs of a linear oscillator are more, thinner pieces
_OFF = 0.75  # times its true value a parameter's guess
#: Other models of the same states and noise, by scenario: name, drift, parameters, and which of them are
#: positive.
_RIVALS = {
    "duffing": ("linear oscillator", ("v", "-c*v - k*x"), {"c": 0.4, "k": 1.0}, ("c",)),
    "sunspots": (
        "linear oscillator", ("w*u", "-w*(c*u + x)"), {"w": 0.29, "c": 0.5, "g": 5.0}, ("w", "c", "g"),
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Build:
    """The SPH filter of given parameters; picklable."""

    scenario: Scenario
    case: Case
    n_particles: int
    folded: bool = False  # the sensor does not see the sign (sunspots)

    def __call__(self, parameters):
        """Return the filter at the start of the measurements."""
        model, sensor, others = self.scenario.model, self.scenario.measurement, dict(parameters)
        reads = {name: others[name] for name in others if name in sensor.parameters}
        named = {name: others[name] for name in others if name not in reads or name in model.parameters}
        variance = None if SENSOR in {**reads, **model.parameters} else named.pop(SENSOR, None)
        if self.folded:
            sensor = fold(sensor.noise_cov[0, 0] if variance is None else _positive(variance))
        elif variance is not None:
            sensor = sensor.changed(noise_cov=variance)
        sensor = sensor.with_parameters(**reads) if reads else sensor
        case = self.case
        shape = {"n_particles": self.n_particles, "config": self.scenario.settings.filters.sph.config}
        return sf.SPHFilter(model.with_parameters(**named), sensor, case.x0, case.P0, t0=case.t0, **shape)


def _positive(variance):
    if not variance > 0.0:
        raise sf.ModelError(f"a variance must be positive, got {variance:g}")
    return variance


@dataclass(frozen=True)
class Problem:
    """Measurements and the family of filters that is fitted to them."""

    name: str
    build: Build
    names: tuple  # parameters that are fitted
    values: dict  # all values of the scenario, by which measurements were simulated
    simulated: bool
    positive: tuple  # parameters that are

    @property
    def times(self):
        """Of the measurements."""
        return self.build.case.times

    @property
    def z(self):
        """The measurements."""
        return self.build.case.z

    @property
    def inputs(self):
        """What the model's inputs are between the measurements; None if there are none."""
        return self.build.case.inputs

    @property
    def bounds(self):
        """Bounds of the fitted parameters."""
        return {name: (0.0, None) for name in self.names if name in self.positive}


def problem_of(name, names, changes, seed, n_particles=None):
    """The `Problem` of a scenario with some keys changed, or of the sunspots; `names` are parameters to fit.

    Raises `ConfigError` for an unknown scenario, key or parameter, or if there is nothing to fit.
    """
    if name == MEASURED:
        if changes:
            raise ConfigError("the sunspots' model takes no --set; change a copy of its file with `filter`")
        scenario, data = load()
        learnt, _ = split(data)
        build = Build(scenario, case_of(scenario, learnt), n_particles or _PARTICLES, folded=True)
    else:
        scenario = _longer(load_scenario(name, **changes), changes)
        if scenario.settings.start.kind == "benes":
            raise ConfigError(f"{name} starts from a density of its own: there is nothing to fit in it")
        build = Build(scenario, scenario.draw(np.random.default_rng(seed)), n_particles or _PARTICLES)
    sensor = scenario.measurement
    values = {**sensor.parameters, **scenario.model.parameters}
    if SENSOR not in values and _has_one_variance(sensor):
        values[SENSOR] = float(sensor.noise_cov[0, 0])
    positive = (SENSOR, *(() if name != "sunspots" else ("w", "b", "g")))
    chosen = _chosen(name, names, values)
    return Problem(name, build, chosen, values, name != "sunspots", positive)


def _has_one_variance(sensor):
    """Is it one sensor whose noise is as large in all readings, and uncorrelated?"""
    covariance = sensor.noise_cov
    if isinstance(sensor, sf.Sensors) or covariance is None:
        return False
    return np.array_equal(covariance, covariance[0, 0] * np.eye(len(covariance)))


def _longer(scenario, changes):
    """The scenario with enough measurements, unless their number was asked for."""
    times = scenario.settings.times
    end = times.start + _MEASUREMENTS * times.interval
    if "times.end" in changes or end <= times.end:
        return scenario
    return replace(scenario, settings=replace(scenario.settings, times=replace(times, end=end)))


def _chosen(name, names, values):
    names = names or _FITTED.get(name) or tuple(key for key in values if key != SENSOR)
    for key in names:
        if key not in values:
            raise ConfigError(
                f"{name} has no parameter {key!r}{nearest(key, values)}; it has {', '.join(values)}"
            )
    if not names:
        raise ConfigError(
            f"{name} has no parameters in its file; give --parameters {SENSOR}, or name some there"
        )
    return tuple(names)


def guess_of(problem, given):
    """First values: those given, else a part of the true ones; those of the file for measured data."""
    for key in given:
        if key not in problem.names:
            raise ConfigError(
                f"--guess names {key!r}{nearest(key, problem.names)}; fitted are {', '.join(problem.names)}"
            )
    part = _OFF if problem.simulated else 1.0
    return {key: given.get(key, part * problem.values[key]) for key in problem.names}


def rival_of(problem):
    """Another model's name and problem on the same measurements, or None."""
    if problem.name not in _RIVALS:
        return None
    name, drift, parameters, positive = _RIVALS[problem.name]
    scenario = problem.build.scenario
    model = replace(scenario.settings.model, drift=drift, parameters=parameters)
    scenario = replace(scenario, settings=replace(scenario.settings, model=model))
    names = (*parameters, *([SENSOR] if SENSOR in problem.names else []))
    values = {**parameters, SENSOR: problem.values.get(SENSOR)}
    build = replace(problem.build, scenario=scenario, n_particles=_FINER * problem.build.n_particles)
    return name, Problem(problem.name, build, names, values, False, (*positive, SENSOR))
