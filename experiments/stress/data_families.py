"""Families of cells whose data, start or units are hard."""

from dataclasses import replace
from functools import partial

import numpy as np

import sphfilter as sf

from . import systems
from .cell import drawn
from .exact import benes_posterior
from .systems import LINE, OSCILLATORS, START, usual

__all__ = ["FAMILIES"]

_BENES = {"exact": benes_posterior, "exact_name": "closed form", "n_particles": 100}
_CHAIN = {"x0": np.zeros(4), "P0": 0.5 * np.eye(4)}


def _sensor_noise(name, rng, R):
    return usual(rng, OSCILLATORS[name](), sensor=systems.position(2, R))


def _interval(name, rng, dt):
    return usual(rng, OSCILLATORS[name](), interval=dt, step=min(0.05, dt))


def _particles(name, rng, n):
    return usual(rng, OSCILLATORS[name](), n_updates=6 if n <= 1000 else 2, n_particles=n)


def _singular(name, rng, gap):
    """Start whose two states are correlated by 1 - gap: condition about 2 / gap."""
    return usual(rng, OSCILLATORS[name](), P0=0.4 * np.array([[1.0, 1.0 - gap], [1.0 - gap, 1.0]]))


def _condition(rng, cond):
    """Start of widely different standard deviations, the sensor reading the wide state."""
    return usual(rng, systems.oscillator(), P0=np.diag([1.0, 1.0 / cond]))


def _start_size(rng, size):
    """Start whose standard deviations are `size` times those of the measurements."""
    return usual(rng, systems.oscillator(), P0=size**2 * START["P0"])


def _state_units(rng, unit):
    """Linear oscillator, position in units 1 / unit and velocity in units `unit`."""
    base, S = systems.oscillator(), np.diag([unit, 1.0 / unit])
    A, noise = S @ base.A @ np.linalg.inv(S), S @ np.array([[0.0], [1.0]])
    model = sf.LinearSDE(A=A, noise=noise, spectral_density=[[0.8]])
    start = {"x0": S @ START["x0"], "P0": S @ START["P0"] @ S}
    return usual(rng, model, sensor=systems.position(2, 0.2 * unit**2), **start)


def _time_units(name, rng, unit):
    return usual(rng, OSCILLATORS[name](unit=unit), interval=0.5 * unit, step=0.05 * unit)


def _late_start(rng, t0):
    """Clock that is far from zero when the filter starts."""
    return usual(rng, systems.oscillator(), t0=t0)


def _far_origin(rng, distance):
    """States of size one about a point that is far from zero."""
    centre, base = np.array([distance, 0.0]), systems.oscillator()
    model = sf.LinearSDE(A=base.A, b=-base.A @ centre, noise=[[0.0], [1.0]], spectral_density=[[0.8]])
    return usual(rng, model, x0=[distance + 1.0, 0.0])


def _outlier(name, rng, sigma):
    """The third of six measurements lies `sigma` standard deviations of its prediction off the truth."""
    if name == "tanh drift":
        model, given = systems.drift_1d("tanh", q=1.0), _BENES | LINE | {"sensor": systems.position(1, 0.5)}
    elif name == "linear chain":
        model, sensor = systems.linear_chain(4), systems.position(4, 0.3, (0, 3))
        given = _CHAIN | {"sensor": sensor, "n_particles": 1000}
    else:
        model, given = OSCILLATORS[name](), {}
    made = usual(rng, model, **given)
    spread = 1.0 if name == "tanh drift" else 0.75  # about the standard deviation of the innovations
    made.z[2] += sigma * spread
    return replace(made, truth=None)


def _missing(name, rng, part):
    made = usual(rng, OSCILLATORS[name](), sensor=systems.position(2, 0.2, (0, 1)), n_updates=10)
    made.z[rng.random(made.z.shape) < part] = np.nan
    return made


def _disconnected(name, rng, R):
    """Sensor z = x² + error, that leaves two places to be in."""
    if name in OSCILLATORS:
        model, start, more = OSCILLATORS[name](), {"x0": [0.0, 0.0], "P0": np.diag([4.0, 1.0])}, {}
    else:
        kind = {"double well": "double well", "tanh drift": "tanh"}[name]
        model, start, more = systems.drift_1d(kind), {"x0": [0.0], "P0": [[1.0]]}, {"n_particles": 100}
    return drawn(rng, model, systems.square(R), **start, interval=0.5, **more)


def _long(linear, rng, n_updates):
    model = systems.chain(1, linear) if linear else systems.drift_1d("double well")
    size = {"n_updates": int(n_updates), "n_particles": 40, "interval": 0.1}
    return drawn(rng, model, systems.position(1, 0.3), [0.0], [[0.5]], **size)


def _repeated(rng, times_each):
    """Every reading comes several times over, the first of them at the start; each with its own error."""
    made = usual(rng, systems.oscillator(), n_updates=3)
    index = np.repeat(np.arange(3), int(times_each))
    z = made.truth[index][:, :1] + np.sqrt(0.2) * rng.standard_normal((len(index), 1))
    return replace(made, t0=made.times[0], times=made.times[index], z=z, truth=None)


_R = (1e-6, 1e-4, 1e-2, 1.0, 1e2)
_DT = (1e-3, 1e-2, 0.1, 1.0, 10.0)
_N = (20, 50, 200, 1000, 5000, 20000)
_GAPS = (1e-1, 1e-3, 1e-6, 1e-9, 1e-12)
_SIGMAS = (0, 3, 5, 10, 20, 50)
_UNITS = (1e-6, 1e-3, 1.0, 1e3, 1e6)
#: (family, system, unit of the level, build, levels, levels of the reduced grid)
FAMILIES = [
    *(("sensor noise", name, "R", partial(_sensor_noise, name), _R, (1e-6, 1e2)) for name in OSCILLATORS),
    *(("interval", name, "s", partial(_interval, name), _DT, (1e-3, 10.0) if name == "linear" else (1.0,))
      for name in OSCILLATORS),
    *(("particles", name, "N", partial(_particles, name), _N, (20, 50)) for name in
      ("linear", "Van der Pol")),
    ("near-singular start", "linear", "1 - corr.", partial(_singular, "linear"), _GAPS, (1e-9,)),
    ("near-singular start", "Van der Pol", "1 - corr.", partial(_singular, "Van der Pol"), _GAPS, (1e-3,)),
    ("near-singular start", "linear along axes", "cond.", _condition, (1e2, 1e4, 1e8, 1e12), (1e12,)),
    ("badly scaled start", "linear", "× std", _start_size, _UNITS, (1e-6, 1e6)),
    ("units", "states", "×", _state_units, _UNITS, (1e-6, 1e6)),
    ("units", "time linear", "s", partial(_time_units, "linear"), _UNITS, (1e-6, 1e6)),
    ("units", "time Van der Pol", "s", partial(_time_units, "Van der Pol"), _UNITS, (1e6,)),
    ("units", "start of the clock", "s", _late_start, (-1e3, 1e3, 1e6, 1e9), (1e9,)),
    ("units", "distance of the origin", "std", _far_origin, (1e2, 1e4, 1e6, 1e9), (1e6,)),
    *(("outlier", name, "σ", partial(_outlier, name), _SIGMAS, (3, 20, 50) if name != "Duffing" else (5,))
      for name in ("tanh drift", "linear", "linear chain", "Van der Pol", "Duffing")),
    *(("missing data", name, "part", partial(_missing, name), (0.0, 0.5, 0.9, 1.0), (0.5, 1.0)) for name in
      ("linear", "Duffing")),
    *(("two places", name, "R", partial(_disconnected, name), (1e-3, 1e-2, 0.1, 1.0), (0.1,)) for name in
      ("double well", "tanh drift", "linear", "Duffing")),
    ("long run", "linear", "updates", partial(_long, True), (100, 1000, 10000), (100,)),
    ("long run", "double well", "updates", partial(_long, False), (100, 1000, 10000), ()),
    ("repeated times", "linear", "each", _repeated, (1, 2, 5), (5,)),
]  # fmt: skip
