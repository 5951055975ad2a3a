"""Makers of hard problems, make(rng, level) or make(system, rng, level): each is hard in one respect."""

from dataclasses import replace

import numpy as np
from scipy.integrate import solve_ivp

from reference_filters.exact import BenesFromGaussian, ForcedFilter

from .hard_systems import (
    LINE,
    OSCILLATORS,
    chain,
    drawn,
    equation,
    line,
    linear,
    oscillator,
    position,
    square,
    usual,
)
from .problem import Problem
from .relations import in_other_coordinates

#: What the strength of a noise is multiplied by.
NOISES = {"proportional": "x0", "root": "sqrt(abs(x0))", "wavy": "(1 + 0.5*sin(x0))"}
_FEW = {"n_particles": 100}
_SIZES = {1: 50, 2: 200, 3: 500, 4: 1000, 5: 2000, 6: 3000}


def noise(name, rng, factor):
    # the fastest rate grows with the square of the states that the noise reaches
    step = 0.05 if name == "linear" else 0.05 / (1.0 + 0.3 * factor**0.5)
    return usual(rng, oscillator(name, factor), step=step)


def no_noise(name, rng, n_updates):
    if name in OSCILLATORS:
        return usual(rng, oscillator(name, 0.0), n_updates=n_updates)
    return drawn(rng, line(name, 0.0), position(1, 0.2), **LINE, interval=0.5, n_updates=n_updates)


def silent_rows(rng, n):
    """Chain of n integrators, noise on the last; n = 0: a constant unknown beside a process."""
    dim = max(n, 2)
    G = np.sqrt(0.5) * np.eye(dim)
    model = linear(np.eye(n, k=1), G[:, -1:]) if n else linear([[-1.0, 1.0], [0.0, 0.0]], G[:, :1])
    start = {"x0": np.zeros(dim), "P0": 0.5 * np.eye(dim)}
    return drawn(rng, model, position(dim, 0.2), **start, n_particles=_SIZES[dim], interval=0.5)


def forced(rng, k):
    model, step, reader = line("forced", 0.1 * k, k=k), min(0.05, 0.2 / k), position(1, 0.02)

    def exact(problem):
        return ForcedFilter(k, 0.1 * k, reader.sensor, problem.x0, problem.P0, problem.t0)

    return drawn(rng, model, reader, [0.5], [[0.2]], interval=0.5, step=step, exact=exact, **_FEW)


def two_rates(rng, k):
    model = linear([[-1.0, 1.0], [0.0, -k]], np.diag(np.sqrt([0.5, 0.5 * k])))
    return drawn(rng, model, position(2, 0.1), [1.0, 1.0], 0.5 * np.eye(2), interval=0.5)


def relaxation(rng, mu):
    """Van der Pol oscillator in Liénard's form, fast jumps between slow branches; noise on both states."""
    model = equation(("mu*(x0 - x0**3/3 - x1)", "x0/mu"), np.sqrt(0.1) * np.eye(2), mu=mu)
    start = {"x0": [1.5, 0.0], "P0": 0.1 * np.eye(2)}
    return drawn(rng, model, position(2, 0.1), **start, interval=0.5, step=min(0.05, 0.2 / mu))


def steep_well(rng, k):
    model, step = line("double well", 0.5 * k, k=k), min(0.05, 0.1 / k)
    return drawn(rng, model, position(1, 0.5), [0.2], [[0.3]], interval=0.5, step=step, **_FEW)


def growing(q, rng, rate):
    return drawn(rng, line("growth", q, k=rate), position(1, 0.2), **LINE, interval=1.0, **_FEW)


def saddle(rng, rate):
    model = linear([[0.0, 1.0], [rate**2, 0.0]], [[0.0], [np.sqrt(0.5)]])
    return drawn(rng, model, position(2, 0.2), [0.3, 0.0], 0.3 * np.eye(2), interval=1.0)


def rough(name, rng, q):
    start = {"x0": [2.0 if name == "absolute" else 0.3], "P0": [[0.3]]}
    step = 0.005  # drifts with a kink or a corner cost a weak scheme its order
    return drawn(rng, line(name, q), position(1, 0.1), **start, interval=0.5, step=step, **_FEW)


def blow_up(name, rng, margin):
    """The mean state reaches infinity after `margin` times the six intervals."""
    power, infinity = (3, 0.5) if name == "cubic outwards" else (2, 1.0)
    horizon = infinity / margin
    times, end = horizon / 6 * np.arange(1, 7), min(horizon, 0.95 * infinity)
    path = solve_ivp(lambda t, x: x**power, (0.0, end), [1.0], rtol=1e-9, dense_output=True).sol
    z = path(np.minimum(times, end)).T
    start = {"x0": np.array([1.0]), "P0": np.array([[2.5e-3]])}
    about = {"readers": (position(1, 0.01),), "z": (z,), "times": times}
    return Problem(equation=line(name, 1e-3), **about, **start, **_FEW)


def strong_inwards(rng, spread):
    model, step = line("inward cube"), min(0.02, 0.05 / spread**2)
    return drawn(rng, model, position(1, 0.1), [0.0], [[spread**2]], interval=0.2, step=step, **_FEW)


def multiplicative(name, rng, strength):
    model = line("slow decay", strength**2, factor=f"*{NOISES[name]}")
    return drawn(rng, model, position(1, 0.2), [3.0], [[0.1]], interval=0.4, step=0.01, **_FEW)


def dimension(is_linear, rng, n):
    reader = position(n, 0.3, sorted({0, n - 1}))
    start = {"x0": np.full(n, 0.5), "P0": 0.3 * np.eye(n)}
    size = {"n_updates": 4, "n_particles": _SIZES[n]}
    return drawn(rng, chain(n, is_linear), reader, **start, interval=0.4, **size)


def changed(changes):
    """Maker of the usual problem of an oscillator with what changes(level) says of it by name."""

    def make(name, rng, level):
        return usual(rng, oscillator(name), **changes(level))

    return make


def particles(name, rng, n):
    return usual(rng, oscillator(name), n_updates=6 if n <= 1000 else 2, n_particles=n)


def _elsewhere(rng, T, c):
    """The linear oscillator in states y with x = T y + c."""
    moved = in_other_coordinates(usual(rng, oscillator("linear")), T, c)
    return replace(moved, truth=None, T=None, c=None)


def state_units(rng, unit):
    """Position in units of 1 / unit, velocity in units of `unit`."""
    return _elsewhere(rng, np.diag([1.0 / unit, unit]), np.zeros(2))


def far_origin(rng, distance):
    """States of size one about a point that is far from zero."""
    return _elsewhere(rng, np.eye(2), np.array([-distance, 0.0]))


def time_units(name, rng, unit):
    return usual(rng, oscillator(name, unit=unit), interval=0.5 * unit, step=0.05 * unit)


def _benes(problem):
    return BenesFromGaussian(problem.sensors[0], problem.x0, problem.P0, problem.t0)


def outlier(name, rng, sigma):
    """The third of six readings lies `sigma` standard deviations of its prediction off the truth."""
    if name == "tanh drift":
        given = LINE | _FEW | {"model": line(name, 1.0), "reader": position(1, 0.5), "exact": _benes}
    elif name == "linear chain":
        start = {"x0": np.zeros(4), "P0": 0.5 * np.eye(4)}
        given = start | {"model": chain(4, True), "reader": position(4, 0.3, (0, 3)), "n_particles": 1000}
    else:
        given = {"model": oscillator(name)}
    made = usual(rng, **given)
    made.z[0][2] += sigma * (1.0 if name == "tanh drift" else 0.75)  # about an innovation's deviation
    return replace(made, truth=None)


def missing(name, rng, part):
    made = usual(rng, oscillator(name), reader=position(2, 0.2, (0, 1)), n_updates=10)
    made.z[0][rng.random(made.z[0].shape) < part] = np.nan
    return made


def two_places(name, rng, R):
    """Sensor z = x² + error, that leaves two places to be in."""
    if name in OSCILLATORS:
        return drawn(rng, oscillator(name), square(2, R), [0.0, 0.0], np.diag([4.0, 1.0]), interval=0.5)
    return drawn(rng, line(name), square(1, R), [0.0], [[1.0]], interval=0.5, **_FEW)


def long(name, rng, n_updates):
    model = chain(1, True) if name == "linear" else line(name)
    size = {"n_updates": int(n_updates), "n_particles": 40, "interval": 0.1}
    return drawn(rng, model, position(1, 0.3), [0.0], [[0.5]], **size)


def repeated(rng, times_each):
    """Every reading comes several times over, the first of them at the start; each with its own error."""
    made = usual(rng, oscillator("linear"), n_updates=3)
    index = np.repeat(np.arange(3), int(times_each))
    z = made.truth[index][:, :1] + np.sqrt(0.2) * rng.standard_normal((len(index), 1))
    return replace(made, t0=made.times[0], times=made.times[index], z=(z,), truth=None)
