"""Models and sensors of the hard cases, as text; what levels change is data, so that each compiles once."""

import numpy as np

import sphfilter as sf

from .equations import Equation
from .problem import Problem
from .sensors import GaussianReader

#: Force on the velocity of an oscillator, and the spectral density of its noise.
OSCILLATORS = {
    "linear": ("-x0 - 0.4*x1", 0.8),
    "Van der Pol": ("(1 - x0**2)*x1 - x0", 0.8),
    "Duffing": ("x0 - 0.1*x0**3 - 0.4*x1", 1.6),
}
_LINES = {
    "forced": "-k*(x0 - sin(t))",
    "double well": "k*(x0 - x0**3)",
    "decay": "-0.5*x0",
    "slow decay": "-0.1*x0",
    "growth": "k*x0",
    "tanh drift": "tanh(x0)",
    "root inwards": "-sign(x0)*sqrt(abs(x0))",
    "root outwards": "sign(x0)*sqrt(abs(x0))",
    "cube root": "-sign(x0)*abs(x0)**(1/3)",
    "absolute": "-abs(x0)",
    "bang-bang": "-sign(x0)",
    "inward cube": "-x0**3",
    "cubic outwards": "x0**3",
    "square": "x0**2",
}
#: Starts of the models of two states, and of those of one.
START = {"x0": np.array([1.0, 0.0]), "P0": np.diag([0.2, 0.4])}
LINE = {"x0": np.array([0.3]), "P0": np.array([[0.5]])}


def equation(drift, G, factor="", **parameters):
    """dX = f dt + g dW with E[dW dWᵀ] = dt and g the numbers G (n, m), each with the text `factor` behind."""
    G = np.asarray(G, dtype=float)
    G = G[:, np.any(G != 0.0, axis=0)]
    given = parameters | {f"g{i}{k}": G[i, k] for i, k in np.argwhere(G)}
    noise = [[f"g{i}{k}{factor}" if g else "0" for k, g in enumerate(row)] for i, row in enumerate(G)]
    return Equation(
        states=_names(len(drift)), drift=tuple(drift), noise=tuple(map(tuple, noise)), matrix=True,
        parameters=tuple((name, float(value)) for name, value in given.items()),
    )  # fmt: skip


def _names(n):
    return tuple(f"x{i}" for i in range(n))


def linear(A, G, b=None):
    """dX = (A X + b) dt + G dW."""
    n = len(A)
    b = np.zeros(n) if b is None else b
    drift = [" + ".join([f"b{i}", *(f"a{i}{j}*x{j}" for j in range(n))]) for i in range(n)]
    rows = {f"a{i}{j}": A[i][j] for i in range(n) for j in range(n)}
    return equation(drift, G, **rows, **{f"b{i}": b[i] for i in range(n)})


def oscillator(name, factor=1.0, unit=1.0):
    """An oscillator with `factor` times its usual noise; its unit of time has so many seconds."""
    force, q = OSCILLATORS[name]
    noise = np.diag([0.0, np.sqrt(q * factor / unit)])
    return equation(("rate*x1", f"rate*({force})"), noise, rate=1.0 / unit)


def line(name, q=0.5, k=1.0, factor=""):
    """A model of one state, of rate k if its drift has one; its noise has density q times a text squared."""
    rate = {"k": k} if "k*" in _LINES[name] else {}
    return equation((_LINES[name],), [[np.sqrt(q)]], factor, **rate)


def chain(n, is_linear):
    """Processes of which each is driven by the one before, with noise on all: decays, or double wells."""
    noise = np.sqrt(0.5) * np.eye(n)
    if is_linear:
        return linear(np.diag(np.full(n - 1, 0.8), -1) - np.eye(n), noise)
    pushes = ["", *(f" + 0.5*sin(x{i})" for i in range(n - 1))]
    return equation([f"x{i} - x{i}**3{push}" for i, push in enumerate(pushes)], noise)


def position(dim, R, states=(0,)):
    """Sensor of some states, equal and independent errors of variance R."""
    seen = list(states)
    return GaussianReader(kind="linear", states=_names(dim), R=R * np.eye(len(seen)), H=np.eye(dim)[seen])


def square(dim, R):
    """Sensor z = x₀² + error: cannot tell x₀ from -x₀."""
    return GaussianReader(kind="square", states=_names(dim), R=np.array([[R]]), h=("x0**2",))


def drawn(rng, model, reader, x0, P0, *, interval, n_updates=6, t0=0.0, step=0.05, **more):
    """A problem whose truth and readings are drawn from its own start, model and sensor.

    A reading after every `interval` seconds, of a truth in steps of at most `step`; `more` are further
    attributes of the `Problem`.
    """
    x0, P0 = np.asarray(x0, dtype=float), np.asarray(P0, dtype=float)
    times = t0 + interval * np.arange(n_updates + 1)
    start = x0 + np.linalg.cholesky(P0) @ rng.standard_normal(len(x0))
    truth, z = sf.simulate(model.model, reader.sensor, start, times, rng, max_step=step)
    given = {"equation": model, "readers": (reader,), "z": (z[1:],), "times": times[1:], "truth": truth[1:]}
    return Problem(**given, x0=x0, P0=P0, t0=t0, **more)


def usual(rng, model, **changes):
    """A problem as most families have it: `START`, its first state read every half second; see `drawn`."""
    return drawn(rng, model, **{"reader": position(2, 0.2), "interval": 0.5} | START | changes)
