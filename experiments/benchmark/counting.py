"""How often a competitor evaluates the drift: what counts where a model is expensive."""

from dataclasses import dataclass, replace

import numpy as np

import sphfilter as sf
from experiments.scene.scenario import Scenario
from sphfilter.campaign.one_run import put_through

from .watch import Watched

#: Particle filters do the same work in every step of every particle: so many are counted, and scaled.
_COUNTED = 1000


@dataclass(frozen=True)
class OtherModel(Scenario):
    """A scenario whose filters are given another model than the one that its truth follows."""

    other: object = None

    @property
    def model(self):
        """The other model."""
        return self.other


def drift_evaluations(method, scenario, case, n_steps, limit=np.inf):
    """Number of states at which a run evaluates the drift of a model that offers nothing else.

    Jacobian and divergence are differences of the drift, as for any black box: 2 n evaluations each. The
    exact filters use no drift. `n_steps` are the time steps that the run took, as measured; counting is given
    up after `limit` seconds. NaN if the filter raised something.
    """
    count = np.zeros(1, dtype=np.int64)
    counted = OtherModel(scenario.name, scenario.settings, scenario.between, _counting(scenario.model, count))
    settings, sampled = method.factory.settings, method.family in ("pf", "pf4")
    size = min(method.size, _COUNTED)
    if sampled:
        settings = replace(settings, n_particles=size, n_threads=1)
    filt = replace(method.factory, scenario=counted, settings=settings)(case, np.random.default_rng(0))
    watched = Watched(filt, limit=limit)
    count[:] = 0
    try:
        put_through(watched, case)
    except Exception:  # its own row tells
        return np.nan
    steps = sum(info.n_steps for info in watched.predictions)
    more = method.size / size if sampled else 1.0
    if sampled and not scenario.model.linear:  # whose steps are exact, but not those of a black box
        more *= n_steps / steps
    return float(count[0] * more)


def _counting(model, count):
    """The same equation as a black box that counts its states."""

    def drift(X, t):
        count[0] += len(X)
        return model.drift(X, t)

    def autonomous_drift(X):
        return drift(X, 0.0)

    noise = model.noise(np.zeros((1, model.dim)), 0.0)[0]
    if model.state_dependent_noise:
        noise = model.noise
    chosen = autonomous_drift if model.autonomous else drift
    return sf.SDE(chosen, model.dim, noise, model.spectral_density, vectorized=True)
