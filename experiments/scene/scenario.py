"""Scenarios: read from TOML, changed key by key, and drawn from as simulated runs."""

import json
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import numpy as np

import sphfilter as sf
from sphfilter.campaign.campaign import Case
from sphfilter.errors import SphfilterError
from sphfilter.files.read_model import check_inputs, check_start, model_of, sensor_of, tables_of
from sphfilter.files.text import ModelText, Reads, Sensor, TableText
from sphfilter.settings import settings

from . import start
from .inputs import sampled
from .reading import read_settings, scenario_names
from .settings import ScenarioSettings

__all__ = ["Scenario", "Scene", "check_parts", "load_scenario", "read_settings", "scenario_names"]

#: Times in an interval between measurements at which the truth is drawn.
_PARTS = 20


@settings
class _Read(Reads):
    """Sensors alone."""

    sensor: Sensor | None
    sensors: dict[str, Sensor]


class Scene:
    """What a scenario and a transient problem share, both of `settings` with a `ModelText`."""

    @property
    def model(self):
        """The `SDE`."""
        return _model(_text_of(self.settings.model))

    @property
    def tables(self):
        """What the model's texts call, each a `Table`, by name."""
        return tables_of(self.settings.model.tables)

    @property
    def labels(self):
        """Names of the states for people, length n."""
        return self.settings.model.labels or self.settings.model.states

    @property
    def units(self):
        """Units of the states, length n; empty where a state is a plain number."""
        return self.settings.model.units or ("",) * len(self.settings.model.states)


@dataclass(frozen=True)
class Scenario(Scene):
    """A model, a sensor, measurement times and a start: what a campaign draws its runs from.

    Only the settings travel to worker processes; each compiles the model once.
    """

    name: str
    settings: ScenarioSettings
    # cases hold times between the measurements too, without measurement: the same runs, for pictures
    between: bool = False

    @property
    def measurement(self):
        """The `GaussianMeasurement`, or `Sensors` of several."""
        found = self.settings
        sensor = found.sensor and asdict(found.sensor)
        sensors = [(name, asdict(sensor)) for name, sensor in found.sensors.items()]
        return _measurement(json.dumps([found.model.states, sensor, sensors]))

    @property
    def inputs(self):
        """What the model's inputs are between measurements, shape (T, m); None if the file does not say."""
        times, given = self.settings.times, self.settings.inputs
        given = {k: asdict(v) if isinstance(v, TableText) else v for k, v in given.items()}
        begins = [times.start, *times.grid()[:-1].tolist()]
        return _inputs(_text_of(self.settings.model), json.dumps([given, begins]))

    def draw(self, rng):
        """Simulate one run, as a `Case`."""
        begin, t0, interval = self.settings.start, self.settings.times.start, self.settings.times.interval
        draw = {"gaussian": start.gaussian, "benes": start.benes, "tpd": start.two_point}[begin.kind]
        n = len(self.settings.times.grid())
        times = t0 + interval * np.arange(1, n * _PARTS + 1) / _PARTS
        inputs = self.inputs
        held = None if inputs is None else np.repeat(inputs, _PARTS, axis=0)
        truth, z, x0, P0 = draw(self.model, self.measurement, begin, t0, times, rng, held)
        at_measurement = slice(_PARTS - 1, None, _PARTS)
        if not self.between:
            times, truth, z = self.settings.times.grid(), truth[at_measurement], z[at_measurement]
        else:
            measured, z = z[at_measurement], np.full_like(z, np.nan)
            z[at_measurement], inputs = measured, held
        return Case(times=times, truth=truth, z=z, x0=x0, P0=P0, t0=t0, inputs=inputs)


def _text_of(model):
    return json.dumps(asdict(model), sort_keys=True)


@cache
def _model(text):
    """The model of a `ModelText` as JSON."""
    return model_of(ModelText(**json.loads(text)))


@cache
def _measurement(text):
    """The sensor of states and a `Sensor`, or a list of (name, `Sensor`), as JSON."""
    states, alone, several = json.loads(text)
    return sensor_of(states, _Read(sensor=alone, sensors=dict(several)))


@cache
def _inputs(model, text):
    """Inputs of a model, and where intervals begin, as JSON; what holds there."""
    given, begins = json.loads(text)
    given = {k: sf.Table(**v) if isinstance(v, dict) else v for k, v in given.items()}
    return sampled(_model(model), given, np.array(begins))


def load_scenario(name, **changes):
    """Read a `Scenario` and build its model and sensor; see `read_settings` for name, changes and errors."""
    scenario = Scenario(Path(name).stem, read_settings(name, changes))
    check_parts(scenario, name)
    return scenario


def check_parts(scenario, source):
    """Build model and sensor, and check that they and the start fit each other.

    Raises `ExpressionError` or `ModelError`, which start with the `source`, name or file of the scenario.
    """
    try:
        begin = scenario.settings.start
        check_start(scenario.model, scenario.measurement, begin.mean, begin.cov)
        inputs = getattr(scenario.settings, "inputs", {})
        check_inputs(scenario.model, scenario.measurement, inputs)
        _ = scenario.inputs if inputs else None  # which may be refused
    except SphfilterError as problem:
        raise type(problem)(f"{source}: {problem}") from problem
