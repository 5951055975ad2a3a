"""The filters an experiment can run, by name, as factories for `run_campaign`."""

from dataclasses import dataclass, fields, replace
from functools import partial

import numpy as np

import sphfilter as sf
from reference_filters.closed_forms import BenesFilter
from reference_filters.grid import GridFilter
from reference_filters.grid_density import GridDensity, fitted_box
from reference_filters.kalman import ExtendedKalmanFilter, KalmanFilter, UnscentedKalmanFilter
from reference_filters.particle import ParticleFilter
from sphfilter.errors import ConfigError

from .names import FILTERS, check_filters, name_of
from .scenario import Scenario

__all__ = ["FILTERS", "Factory", "factories", "name_of", "takes_grid"]


@dataclass(frozen=True)
class Factory:
    """Make one filter of a scenario for a case; picklable, and its text says all its settings."""

    name: str
    scenario: Scenario
    settings: object = None

    def __call__(self, case, rng):
        """Return the filter at the start of `case`."""
        build = _BUILDERS[self.name]
        return build(self.scenario, self.settings, case, rng)

    def of_scheme(self, scheme):
        """The same filter of another scheme; of SPH filters."""
        config = replace(self.settings.config, scheme=scheme)
        return replace(self, settings=replace(self.settings, config=config))


def _reference(kind, scenario, settings, case, rng):
    """A filter that starts from the case's mean and covariance, and takes its settings by name, if any."""
    own = {} if kind is KalmanFilter else {f.name: getattr(settings, f.name) for f in fields(settings)}
    own |= {"rng": rng} if kind is ParticleFilter else {}
    return kind(scenario.model, scenario.measurement, case.x0, case.P0, case.t0, **own)


def _sph(scenario, settings, case, rng):
    shape = {"n_particles": settings.n_particles, "config": settings.config}
    if scenario.settings.start.kind != "benes":
        return sf.SPHFilter(scenario.model, scenario.measurement, case.x0, case.P0, t0=case.t0, **shape)
    exact = _benes(scenario, None, case, rng)
    reach = 6 * np.sqrt(exact.P[0, 0])
    box = [[exact.x[0] - reach, exact.x[0] + reach]]
    density = sf.initialize(lambda X: exact.pdf(X[:, 0]), box=box, t=case.t0, **shape)
    return sf.SPHFilter(scenario.model, scenario.measurement, density=density, **shape)


def _grid(scenario, settings, case, rng):
    if scenario.settings.start.kind != "benes":
        return _reference(GridFilter, scenario, settings, case, rng)
    exact = _benes(scenario, None, case, rng)
    box = fitted_box(exact.x[None], np.ones(1), exact.P, settings.size)
    density = GridDensity.sampled(lambda X: exact.pdf(X[:, 0]), box)
    shape = {"size": settings.size, "tol": settings.tol}
    return GridFilter(scenario.model, scenario.measurement, t0=case.t0, density=density, **shape)


def _benes(scenario, settings, case, rng):
    start = scenario.settings.start
    if start.kind != "benes":
        raise ConfigError('the Beneš filter needs a scenario with start.kind = "benes"')
    return BenesFilter(scenario.measurement, start.mean[0], start.cov[0][0], case.t0)


_BUILDERS = {
    "kf": partial(_reference, KalmanFilter),
    "ekf": partial(_reference, ExtendedKalmanFilter),
    "ukf": partial(_reference, UnscentedKalmanFilter),
    "pf": partial(_reference, ParticleFilter),
    "sph": _sph,
    "sph_paper": _sph,
    "grid": _grid,
    "benes": _benes,
}


def factories(names, scenario):
    """A `Factory` for each name, by name and in that order; the scenario's own choice for None.

    Raises `ConfigError` for an unknown name, or a filter that does not fit the scenario.
    """
    settings = scenario.settings.filters
    made = {}
    check_filters(names)
    for name in settings.default if names is None else names:
        _check_fit(name, scenario)
        made[name] = Factory(name, scenario, getattr(settings, name, None))
    return made


def takes_grid(model):
    """Whether a grid can carry the density of a model."""
    return model.dim <= 2 and not model.state_dependent_noise


def _check_fit(name, scenario):
    model, start = scenario.model, scenario.settings.start
    if name == "kf" and not model.linear:
        raise ConfigError(f"kf needs a linear model, {scenario.name} is not: take ekf or ukf")
    if name == "grid" and not takes_grid(model):
        raise ConfigError(f"grid takes 1 or 2 states with additive noise, not {scenario.name}: take pf")
    if name == "benes" and start.kind != "benes":
        raise ConfigError(f"benes is the closed form of one problem, not of {scenario.name}")
