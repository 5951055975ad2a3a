"""Scenarios whose model switches between modes: read from TOML, and drawn from."""

from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

import sphfilter as sf
from reference_filters.jump_grid import JumpGridFilter
from reference_filters.jump_particle import JumpParticleFilter
from sphfilter.errors import ConfigError
from sphfilter.settings import from_table, settings

from ..scene.files import file_names, find_file, read_toml

__all__ = ["NAMES", "SwitchingScene", "load_scene"]

_FOLDER = Path(__file__).parents[1] / "scenarios" / "switching"
NAMES = tuple(file_names(_FOLDER))


@settings
class SwitchingScene:
    """A model that switches, a sensor, times and a start.

    Attributes
    ----------
    description : str
    interval : float
        Between measurements, seconds.
    epochs : int
    x0, P0 : list
        Of a Gaussian, that the truth is drawn from too.
    begins : str
        Mode at the start, of the truth; filters do not know it.
    rates : list, shape (M, M)
    model, modes, sensor : dict
        What `SDE.from_expressions` takes: of all modes, and of each; and `GaussianMeasurement`.
    referee : dict
        Of the grid: how far `beyond` the truth it goes, its `size` and `step`; or a number of particles.
    """

    description: str
    interval: float
    epochs: int
    x0: list[float]
    P0: list[list[float]]
    begins: str
    rates: list[list[float]]
    model: dict[str, Any]
    modes: dict[str, dict[str, Any]]
    sensor: dict[str, Any]
    referee: dict[str, float]

    @cached_property
    def jump_model(self):
        """The `JumpMarkovModel`."""
        modes = {name: sf.SDE.from_expressions(**self.model | own) for name, own in self.modes.items()}
        return sf.JumpMarkovModel(modes, self.rates)

    @property
    def measurement(self):
        """The sensor."""
        return sf.GaussianMeasurement(**self.sensor)

    @property
    def start(self):
        """Model, measurement, mean and covariance, as all filters take them."""
        return self.jump_model, self.measurement, self.x0, self.P0

    def draw(self, seed):
        """Times (T,) and the `ModePaths` of a run, the start left out."""
        rng = np.random.default_rng(seed)
        x0 = rng.multivariate_normal(self.x0, self.P0)
        times = self.interval * np.arange(self.epochs + 1)
        paths = sf.simulate_modes(self.jump_model, self.measurement, x0, times, rng, mode=self.begins)
        return times[1:], type(paths)(*(part[1:] for part in paths))

    def referees(self, truth):
        """Two referees of a run, the finer one last; of the first the other tells how good it is."""
        given = self.referee
        if "n_particles" in given:
            n = int(given["n_particles"])
            return [JumpParticleFilter(*self.start, n_particles=n, rng=seed) for seed in (1, 2)]
        beyond, size, step = given["beyond"], int(given["size"]), given["step"]
        box = np.transpose([truth.min(axis=0) - beyond, truth.max(axis=0) + beyond])
        finenesses = ((3 * size // 4, 2.0 * step), (size, step))
        return [JumpGridFilter(*self.start, box=box, size=n, step=h) for n, h in finenesses]


def load_scene(name):
    """Read a scenario by its name, or from a path that ends in .toml."""
    path = find_file(name, _FOLDER, "a scenario that switches")
    scene = from_table(SwitchingScene, read_toml(path), path)
    if scene.begins not in scene.modes:
        raise ConfigError(f"begins must be one of the modes {list(scene.modes)}, got {scene.begins!r}")
    return scene
