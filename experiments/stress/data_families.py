"""Families of cells whose data, start or units are hard."""

import numpy as np

import sphfilter as sf

from . import systems
from .cell import drawn
from .exact import benes_posterior

__all__ = ["FAMILIES"]

_START = {"x0": [1.0, 0.0], "P0": np.diag([0.2, 0.4])}
_OSCILLATORS = {
    "linear": systems.oscillator,
    "Van der Pol": systems.van_der_pol,
    "Duffing": systems.duffing,
}
_BENES = {"exact": benes_posterior, "exact_name": "closed form", "n_particles": 100}
_CHAIN = {"x0": np.zeros(4), "P0": 0.5 * np.eye(4)}


def _sensor_noise(name):
    def build(rng, R):
        return drawn(rng, _OSCILLATORS[name](), systems.position(2, R), **_START, interval=0.5)

    return build


def _interval(name):
    def build(rng, dt):
        step, sensor = min(0.05, dt), systems.position(2, 0.2)
        return drawn(rng, _OSCILLATORS[name](), sensor, **_START, interval=dt, step=step)

    return build


def _particles(name):
    def build(rng, n):
        sensor, n_updates = systems.position(2, 0.2), 6 if n <= 1000 else 2
        model = _OSCILLATORS[name]()
        return drawn(rng, model, sensor, **_START, interval=0.5, n_updates=n_updates, n_particles=n)

    return build


def _singular(rng, gap):
    """Start whose two states are correlated by 1 - gap: condition about 2 / gap."""
    P0 = 0.4 * np.array([[1.0, 1.0 - gap], [1.0 - gap, 1.0]])
    return drawn(rng, systems.oscillator(), systems.position(2, 0.2), [1.0, 0.0], P0, interval=0.5)


def _singular_nonlinear(rng, gap):
    P0 = 0.4 * np.array([[1.0, 1.0 - gap], [1.0 - gap, 1.0]])
    return drawn(rng, systems.van_der_pol(), systems.position(2, 0.2), [1.0, 0.0], P0, interval=0.5)


def _condition(rng, cond):
    """Start of widely different standard deviations, the sensor reading the wide state."""
    P0 = np.diag([1.0, 1.0 / cond])
    return drawn(rng, systems.oscillator(), systems.position(2, 0.2), [1.0, 0.0], P0, interval=0.5)


def _start_size(rng, size):
    """Start whose standard deviations are `size` times those of the measurements."""
    P0 = size**2 * np.diag([0.2, 0.4])
    return drawn(rng, systems.oscillator(), systems.position(2, 0.2), [1.0, 0.0], P0, interval=0.5)


def _state_units(rng, unit):
    """Linear oscillator, position in units 1 / unit and velocity in units `unit`."""
    base, S = systems.oscillator(), np.diag([unit, 1.0 / unit])
    A, noise = S @ base.A @ np.linalg.inv(S), S @ np.array([[0.0], [1.0]])
    model = sf.LinearSDE(A=A, noise=noise, spectral_density=[[0.8]])
    sensor = systems.position(2, 0.2 * unit**2)
    return drawn(rng, model, sensor, S @ [1.0, 0.0], S @ np.diag([0.2, 0.4]) @ S, interval=0.5)


def _time_units(name):
    def build(rng, unit):
        model, sensor = _OSCILLATORS[name](unit=unit), systems.position(2, 0.2)
        return drawn(rng, model, sensor, **_START, interval=0.5 * unit, step=0.05 * unit)

    return build


def _late_start(rng, t0):
    """Clock that is far from zero when the filter starts."""
    sensor = systems.position(2, 0.2)
    return drawn(rng, systems.oscillator(), sensor, **_START, interval=0.5, t0=t0)


def _far_origin(rng, distance):
    """States of size one about a point that is far from zero."""
    centre, base = np.array([distance, 0.0]), systems.oscillator()
    model = sf.LinearSDE(A=base.A, b=-base.A @ centre, noise=[[0.0], [1.0]], spectral_density=[[0.8]])
    sensor, x0 = systems.position(2, 0.2), [distance + 1.0, 0.0]
    return drawn(rng, model, sensor, x0, _START["P0"], interval=0.5)


def _outlier(name):
    """The third of six measurements lies `sigma` standard deviations of its prediction off the truth."""

    def build(rng, sigma):
        if name == "tanh drift":
            model, sensor, start, more = (
                systems.drift_1d("tanh", q=1.0),
                systems.position(1, 0.5),
                _LINE,
                _BENES,
            )
        elif name == "linear chain":
            model, sensor, start = systems.linear_chain(4), systems.position(4, 0.3, (0, 3)), _CHAIN
            more = {"n_particles": 1000}
        else:
            model, sensor, start, more = _OSCILLATORS[name](), systems.position(2, 0.2), _START, {}
        made = drawn(rng, model, sensor, **start, interval=0.5, **more)
        spread = 1.0 if name == "tanh drift" else 0.75  # about the standard deviation of the innovations
        made.z[2] += sigma * spread
        return made.__class__(**{**vars(made), "truth": None})

    return build


_LINE = {"x0": [0.3], "P0": [[0.5]]}


def _missing(name):
    def build(rng, part):
        sensor = systems.position(2, 0.2, (0, 1))
        made = drawn(rng, _OSCILLATORS[name](), sensor, **_START, interval=0.5, n_updates=10)
        made.z[rng.random(made.z.shape) < part] = np.nan
        return made

    return build


def _disconnected(name):
    """Sensor z = x² + error, that leaves two places to be in."""

    def build(rng, R):
        if name in _OSCILLATORS:
            model, start, more = _OSCILLATORS[name](), {"x0": [0.0, 0.0], "P0": np.diag([4.0, 1.0])}, {}
        else:
            kind = {"double well": "double well", "tanh drift": "tanh"}[name]
            model, start, more = systems.drift_1d(kind), {"x0": [0.0], "P0": [[1.0]]}, {"n_particles": 100}
        return drawn(rng, model, systems.square(R), **start, interval=0.5, **more)

    return build


def _long(linear):
    def build(rng, n_updates):
        model = systems.chain(1, linear) if linear else systems.drift_1d("double well")
        size = {"n_updates": int(n_updates), "n_particles": 40, "interval": 0.1}
        return drawn(rng, model, systems.position(1, 0.3), [0.0], [[0.5]], **size)

    return build


def _repeated(rng, times_each):
    """Every reading comes several times over, the first of them at the start; each with its own error."""
    model, sensor = systems.oscillator(), systems.position(2, 0.2)
    made = drawn(rng, model, sensor, **_START, interval=0.5, n_updates=3)
    index = np.repeat(np.arange(3), int(times_each))
    z = made.truth[index][:, :1] + np.sqrt(0.2) * rng.standard_normal((len(index), 1))
    about = {"t0": made.times[0], "times": made.times[index], "z": z, "truth": None}
    return made.__class__(**{**vars(made), **about})


_R = (1e-6, 1e-4, 1e-2, 1.0, 1e2)
_DT = (1e-3, 1e-2, 0.1, 1.0, 10.0)
_N = (20, 50, 200, 1000, 5000, 20000)
_GAPS = (1e-1, 1e-3, 1e-6, 1e-9, 1e-12)
_SIGMAS = (0, 3, 5, 10, 20, 50)
_UNITS = (1e-6, 1e-3, 1.0, 1e3, 1e6)
#: (family, system, unit of the level, build, levels, levels of the reduced grid)
FAMILIES = [
    *(("sensor noise", name, "R", _sensor_noise(name), _R, (1e-6, 1e2)) for name in _OSCILLATORS),
    *(("interval", name, "s", _interval(name), _DT, (1e-3, 10.0) if name == "linear" else (1.0,))
      for name in _OSCILLATORS),
    *(("particles", name, "N", _particles(name), _N, (20, 50)) for name in ("linear", "Van der Pol")),
    ("near-singular start", "linear", "1 - corr.", _singular, _GAPS, (1e-9,)),
    ("near-singular start", "Van der Pol", "1 - corr.", _singular_nonlinear, _GAPS, (1e-3,)),
    ("near-singular start", "linear along axes", "cond.", _condition, (1e2, 1e4, 1e8, 1e12), (1e12,)),
    ("badly scaled start", "linear", "× std", _start_size, _UNITS, (1e-6, 1e6)),
    ("units", "states", "×", _state_units, _UNITS, (1e-6, 1e6)),
    ("units", "time linear", "s", _time_units("linear"), _UNITS, (1e-6, 1e6)),
    ("units", "time Van der Pol", "s", _time_units("Van der Pol"), _UNITS, (1e6,)),
    ("units", "start of the clock", "s", _late_start, (-1e3, 1e3, 1e6, 1e9), (1e9,)),
    ("units", "distance of the origin", "std", _far_origin, (1e2, 1e4, 1e6, 1e9), (1e6,)),
    *(("outlier", name, "σ", _outlier(name), _SIGMAS, (3, 20, 50) if name != "Duffing" else (5,)) for name in
      ("tanh drift", "linear", "linear chain", "Van der Pol", "Duffing")),
    *(("missing data", name, "part", _missing(name), (0.0, 0.5, 0.9, 1.0), (0.5, 1.0)) for name in
      ("linear", "Duffing")),
    *(("two places", name, "R", _disconnected(name), (1e-3, 1e-2, 0.1, 1.0), (0.1,)) for name in
      ("double well", "tanh drift", "linear", "Duffing")),
    ("long run", "linear", "updates", _long(True), (100, 1000, 10000), (100,)),
    ("long run", "double well", "updates", _long(False), (100, 1000, 10000), ()),
    ("repeated times", "linear", "each", _repeated, (1, 2, 5), (5,)),
]  # fmt: skip
