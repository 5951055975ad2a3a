"""Scenarios whose model switches between modes, to be drawn from."""

from functools import cached_property

import numpy as np

import sphfilter as sf
from reference_filters.jump_grid import JumpGridFilter
from reference_filters.jump_particle import JumpParticleFilter


class SwitchingScene:
    """A model that switches, a sensor, times and a start, of `SwitchingSettings`."""

    def __init__(self, settings):
        self.settings = settings

    @cached_property
    def jump_model(self):
        """The `JumpMarkovModel`."""
        modes = {
            name: sf.SDE.from_expressions(**self.settings.model | own)
            for name, own in self.settings.modes.items()
        }
        return sf.JumpMarkovModel(modes, self.settings.rates)

    @property
    def measurement(self):
        """The sensor."""
        return sf.GaussianMeasurement(**self.settings.sensor)

    @property
    def start(self):
        """Model, measurement, mean and covariance, as all filters take them."""
        return self.jump_model, self.measurement, self.settings.x0, self.settings.P0

    def draw(self, seed):
        """Times (T,) and the `ModePaths` of a run, the start left out."""
        rng = np.random.default_rng(seed)
        x0 = rng.multivariate_normal(self.settings.x0, self.settings.P0)
        times = self.settings.interval * np.arange(self.settings.epochs + 1)
        paths = sf.simulate_modes(
            self.jump_model, self.measurement, x0, times, rng, mode=self.settings.begins
        )
        return times[1:], type(paths)(*(part[1:] for part in paths))

    def referees(self, truth):
        """Two referees of a run, the finer one last; of the first the other tells how good it is."""
        given = self.settings.referee
        if "n_particles" in given:
            n = int(given["n_particles"])
            return [JumpParticleFilter(*self.start, n_particles=n, rng=seed) for seed in (1, 2)]
        beyond, size, step = given["beyond"], int(given["size"]), given["step"]
        box = np.transpose([truth.min(axis=0) - beyond, truth.max(axis=0) + beyond])
        finenesses = ((3 * size // 4, 2.0 * step), (size, step))
        return [JumpGridFilter(*self.start, box=box, size=n, step=h) for n, h in finenesses]
