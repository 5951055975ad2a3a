"""Families of cells whose model is hard: noise levels, stiffness, instability, roughness, dimension."""

from functools import partial

import numpy as np
from scipy.integrate import solve_ivp

import sphfilter as sf

from . import systems
from .cell import Problem, drawn
from .exact import forced_posterior
from .systems import LINE, OSCILLATORS, START, usual

__all__ = ["FAMILIES"]

#: Intensities of the noise that levels are factors of.
_NOISE = {"linear": 0.8, "Van der Pol": 0.8, "Duffing": 1.6}


def _noise(name, rng, factor):
    # the fastest rate grows with the square of the states that the noise reaches
    step = 0.05 if name == "linear" else 0.05 / (1.0 + 0.3 * factor**0.5)
    return usual(rng, OSCILLATORS[name](_NOISE[name] * factor), step=step)


def _no_noise(name, rng, n_updates):
    if name in OSCILLATORS:
        model, sensor, start = OSCILLATORS[name](0.0), systems.position(2, 0.2), START
    elif name == "decay":
        model, sensor, start = sf.LinearSDE(A=[[-0.5]]), systems.position(1, 0.2), LINE
    else:
        model, sensor, start = systems.drift_1d("double well", q=0.0), systems.position(1, 0.2), LINE
    return drawn(rng, model, sensor, **start, interval=0.5, n_updates=n_updates)


def _silent_rows(rng, n):
    """Chain of n integrators, noise on the last; n = 0: a constant unknown beside a process."""
    if n == 0:
        model = sf.LinearSDE(A=[[-1.0, 1.0], [0.0, 0.0]], noise=[[1.0], [0.0]], spectral_density=[[0.5]])
    else:
        model = sf.LinearSDE(A=np.eye(n, k=1), noise=np.eye(n)[:, -1:], spectral_density=[[0.5]])
    dim = model.dim
    start = {"x0": np.zeros(dim), "P0": 0.5 * np.eye(dim)}
    size = {"n_particles": _SIZES[dim], "interval": 0.5}
    return drawn(rng, model, systems.position(dim, 0.2), **start, **size)


def _forced(rng, k):
    model = systems.drift_1d("forced", q=0.1 * k, k=k)
    about = {"exact": forced_posterior, "exact_name": "closed form", "n_particles": 100}
    sensor, step = systems.position(1, 0.02), min(0.05, 0.2 / k)
    return drawn(rng, model, sensor, [0.5], [[0.2]], interval=0.5, step=step, **about)


def _two_rates(rng, k):
    model = sf.LinearSDE(
        A=[[-1.0, 1.0], [0.0, -k]], noise=np.eye(2), spectral_density=np.diag([0.5, 0.5 * k])
    )
    return drawn(rng, model, systems.position(2, 0.1), [1.0, 1.0], 0.5 * np.eye(2), interval=0.5)


def _relaxation(rng, mu):
    model, sensor = systems.relaxation(mu), systems.position(2, 0.1)
    step = min(0.05, 0.2 / mu)
    return drawn(rng, model, sensor, [1.5, 0.0], np.diag([0.1, 0.1]), interval=0.5, step=step)


def _steep_well(rng, k):
    model, step = systems.drift_1d("double well", q=0.5 * k, k=k), min(0.05, 0.1 / k)
    sensor = systems.position(1, 0.5)
    return drawn(rng, model, sensor, [0.2], [[0.3]], interval=0.5, step=step, n_particles=100)


def _growing(q, rng, rate):
    model = sf.LinearSDE(A=[[rate]], noise=[[1.0]], spectral_density=[[q]])
    return drawn(rng, model, systems.position(1, 0.2), **LINE, interval=1.0, n_particles=100)


def _saddle(rng, rate):
    model = sf.LinearSDE(A=[[0.0, 1.0], [rate**2, 0.0]], noise=[[0.0], [1.0]], spectral_density=[[0.5]])
    return drawn(rng, model, systems.position(2, 0.2), [0.3, 0.0], 0.3 * np.eye(2), interval=1.0)


def _rough(name, rng, q):
    x0 = 2.0 if name == "absolute" else 0.3
    model, start = systems.drift_1d(name, q=q), {"x0": [x0], "P0": [[0.3]]}
    step = 0.005  # drifts with a kink or a corner cost a weak scheme its order
    return drawn(rng, model, systems.position(1, 0.1), **start, interval=0.5, step=step, n_particles=100)


def _blow_up(name, rng, margin):
    """The mean state reaches infinity after `margin` times the six intervals."""
    x0, horizon = 1.0, (0.5 if name == "cubic outwards" else 1.0) / margin
    model, times = systems.drift_1d(name, q=1e-3), horizon / 6 * np.arange(1, 7)
    power = 3 if name == "cubic outwards" else 2
    end = min(horizon, 0.95 * margin * horizon)
    path = solve_ivp(lambda t, x: x**power, (0.0, end), [x0], rtol=1e-9, dense_output=True).sol
    z = path(np.minimum(times, end)).T
    about = {"n_particles": 100}
    sensor, start = systems.position(1, 0.01), {"x0": np.array([x0]), "P0": np.array([[2.5e-3]])}
    return Problem(model=model, measurement=sensor, **start, times=times, z=z, **about)


def _strong_inwards(rng, spread):
    model, step = systems.drift_1d("cubic inwards"), min(0.02, 0.05 / spread**2)
    P0 = [[spread**2]]
    return drawn(rng, model, systems.position(1, 0.1), [0.0], P0, interval=0.2, step=step, n_particles=100)


def _multiplicative(name, rng, strength):
    model, sensor = systems.multiplicative(name, strength), systems.position(1, 0.2)
    return drawn(rng, model, sensor, [3.0], [[0.1]], interval=0.4, step=0.01, n_particles=100)


_SIZES = {1: 50, 2: 200, 3: 500, 4: 1000, 5: 2000, 6: 3000}


def _dimension(linear, rng, n):
    model, sensor = systems.chain(n, linear), systems.position(n, 0.3, sorted({0, n - 1}))
    start = {"x0": np.full(n, 0.5), "P0": 0.3 * np.eye(n)}
    return drawn(rng, model, sensor, **start, interval=0.4, n_updates=4, n_particles=_SIZES[n])


_FACTORS = (1e-4, 1e-2, 1.0, 1e2, 1e4)
_QUICK = (1e-4, 1e4)
#: (family, system, unit of the level, build, levels, levels of the reduced grid)
FAMILIES = [
    *(("process noise", name, "×", partial(_noise, name), _FACTORS, _QUICK) for name in OSCILLATORS),
    *(("no noise", name, "updates", partial(_no_noise, name), (1, 6, 20), (6,)) for name in
      ("decay", "linear", "double well", "Duffing")),
    ("noise on some rows", "integrators", "states", _silent_rows, (0, 2, 3, 4), (0, 3)),
    ("stiff", "forced", "k", _forced, (1e1, 1e2, 1e3, 1e4), (1e3,)),
    ("stiff", "two rates", "k", _two_rates, (1e1, 1e2, 1e3, 1e4), (1e2,)),
    ("stiff", "relaxation oscillator", "mu", _relaxation, (2, 10, 50), ()),
    ("stiff", "double well", "k", _steep_well, (1e1, 1e2, 1e3), (1e1,)),
    ("stiff", "inward cube", "start std", _strong_inwards, (1, 10, 100), (10,)),
    ("unstable", "growth", "rate", partial(_growing, 0.5), (0.5, 1, 2, 5, 10), (1, 5)),
    ("unstable", "growth without noise", "rate", partial(_growing, 0.0), (0.5, 1, 2, 5), (1,)),
    ("unstable", "saddle", "rate", _saddle, (0.5, 1, 2, 5), (2,)),
    *(("rough drift", name, "Q", partial(_rough, name), (1e-3, 1e-1, 10.0), (0.1,)) for name in
      ("root inwards", "root outwards", "cube root", "absolute", "bang-bang")),
    *(("blow-up", name, "margin", partial(_blow_up, name), (10, 3, 1.3, 0.7), (3, 0.7)) for name in
      ("cubic outwards", "square")),
    *(("noise by state", name, "strength", partial(_multiplicative, name), (0.05, 0.2, 0.6), (0.2,))
      for name in ("proportional", "root", "wavy")),
    ("dimension", "linear chain", "states", partial(_dimension, True), (1, 2, 3, 4, 5, 6), (1, 3, 4)),
    ("dimension", "chain of double wells", "states", partial(_dimension, False), (1, 2, 3, 4, 5, 6), (1, 2)),
]  # fmt: skip
