"""The shortcuts, each as two functions that return mean and covariance: with it and without it."""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import partial

import numpy as np

import sphfilter as sf

_HARDLY = 1e-12  # intensity of a noise that counts and does nothing
_CONSTANT = "constant D asked for once"


@dataclass(frozen=True)
class Case:
    """A shortcut on one scene."""

    name: str
    scene: str
    # with the shortcut, and without; both return mean and covariance
    on: Callable
    off: Callable


def _gaussian(n, N, config=None):
    return sf.initialize(sf.Gaussian(np.linspace(1.0, 0.0, n), 0.3 * np.eye(n) + 0.05), N, config)


def _duffing(noise=0.5, hidden=0.0):
    drift = ["v", "-0.4*v - x*(0.1*x**2 - 1)"]
    return _driven(["x", "v"], drift, [hidden, noise])


def _lorenz(hidden=0.0):
    drift = ["10*(y - x)", "x*(28 - z) - y", "x*y - 8*z/3"]
    return _driven(["x", "y", "z"], drift, [hidden, hidden, 4.0])


def _driven(states, drift, intensities):
    """A model with a noise in every state, of intensity zero or not."""
    noise = [["1" if i == j else "0" for j in range(len(states))] for i in range(len(states))]
    return sf.SDE.from_expressions(states, drift, noise, np.diag(intensities))


def _oscillator():
    return sf.LinearSDE(A=[[0.0, 1.0], [-1.0, -0.4]], noise=[[0.0], [1.0]], spectral_density=[[0.5]])


def _with(model, **flags):
    """A copy of a model that claims another structure than it has."""
    other = copy(model)
    for name, value in flags.items():
        setattr(other, name, value)
    return other


def cases():
    """All shortcuts, as a list of `Case`."""
    return [*_log_density(), *_whole_verbs(), *_paper()]


def _log_density():
    """Shortcuts of the march from lattice to lattice."""
    p, q = _gaussian(2, 200), _gaussian(3, 400)
    found = []

    def add(name, scene, density, dt, on, off):
        runs = (partial(_predicted, density, model, dt) for model in (on, off))
        found.append(Case(name, scene, *runs))

    rank, duffing, linear = "noise paths over the rank of D alone", _duffing(), _oscillator()
    add(rank, "Duffing, rank 1 of 2", p, 1.0, duffing, _duffing(hidden=_HARDLY))
    add(rank, "Lorenz, rank 1 of 3", q, 0.05, _lorenz(), _lorenz(hidden=_HARDLY))
    add("D = 0: one path", "Duffing without noise", p, 1.0, _duffing(0.0), _duffing(_HARDLY))
    add(_CONSTANT, "Duffing", p, 1.0, duffing, _with(duffing, constant_diffusion=False))
    constant = "constant divergence of the drift"
    add(constant, "linear oscillator", p, 1.0, linear, _with(linear, linear=False))
    return found


def _moments(density_and_info):
    density = density_and_info[0]
    return density.mean(), density.cov()


def _predicted(start, model, dt, config=None):
    return _moments(sf.predict(start, model, dt, config))


def _whole_verbs():
    """Verbs that have nothing to do, or a closed form."""
    p, linear = _gaussian(2, 200), _oscillator()
    flat = sf.LikelihoodMeasurement(lambda z, X, t: np.zeros(len(X)))
    exact = sf.SolverConfig(exact_linear=True)
    still = partial(_predicted, p, linear, 0.0), lambda: _moments(sf.resample(p))
    updates = (partial(lambda z: _moments(sf.update(p, flat, z)), z) for z in (None, [0.0]))
    closed = (partial(_predicted, p, linear, 1.0, config) for config in (exact, None))
    return [
        Case("empty interval", "against a new lattice", *still),
        Case("no measurement", "against a flat likelihood", *updates),
        Case("exact_linear", "linear oscillator, one second", *closed),
    ]


def _paper():
    """Shortcuts of the paper's scheme."""
    model, found = _duffing(), []

    def add(name, scene, N, off_model=model, off=None):
        runs = []
        for settings, chosen in (({}, model), (off or {}, off_model)):
            config = sf.SolverConfig.paper(**settings)
            start = _gaussian(2, N, config)
            runs.append(partial(_predicted, start, chosen, 0.5, config))
        found.append(Case(name, scene, *runs))

    bypass = "neighbour search while lists are valid"
    for N in (200, 2000):
        add(bypass, f"paper's scheme, {N} particles", N, off={"bypass": False})
    add("search by number of particles", "brute force, not cells, 200", 200, off={"search": "cells"})
    add("search by number of particles", "cells, not brute force, 2000", 2000, off={"search": "brute"})
    every = _with(model, diffusion_rows=np.ones(2, dtype=bool))
    add("zero rows of D", "paper's scheme, 1 of 2 rows", 200, off_model=every)
    varying = _with(model, constant_diffusion=False)
    add(_CONSTANT, "paper's scheme", 200, off_model=varying)
    varying = _with(model, constant_diffusion=False, state_dependent_noise=True)
    add("divergence of D", "paper's scheme, noise as if of the state", 200, off_model=varying)
    return found
