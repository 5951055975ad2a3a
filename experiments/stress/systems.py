"""The models and sensors of the stress grid; levels are data, so that each compiles once."""

from functools import cache

import numpy as np

import sphfilter as sf

from .cell import drawn

__all__ = ["LINE", "OSCILLATORS", "START", "chain", "drift_1d", "linear_chain", "multiplicative",
           "oscillator", "position", "relaxation", "square", "usual"]  # fmt: skip

_ON_VELOCITY = [[0.0], [1.0]]


def oscillator(q=0.8, unit=1.0, damping=0.4):
    """Linear oscillator, natural period 2π `unit` seconds; `q` is the velocity's noise at unit 1."""
    A = [[0.0, 1.0 / unit], [-1.0 / unit, -damping / unit]]
    return sf.LinearSDE(A=A, noise=_ON_VELOCITY, spectral_density=[[q / unit]])


def linear_chain(n, q=0.5):
    """Ornstein-Uhlenbeck processes, each driven by the one before, with noise on all."""
    A = -np.eye(n) + np.diag(np.full(n - 1, 0.8), -1)
    return sf.LinearSDE(A=A, noise=np.eye(n), spectral_density=q * np.eye(n))


@cache
def _nonlinear_chain(n):
    states = [f"x{i}" for i in range(n)]
    drift = [f"{x} - {x}**3" + (f" + 0.5*sin({states[i - 1]})" if i else "") for i, x in enumerate(states)]
    return sf.SDE.from_expressions(states, drift, np.eye(n).tolist(), 0.5 * np.eye(n))


def nonlinear_chain(n):
    """Double wells, each pushed by the one before."""
    return _nonlinear_chain(n)


def chain(n, linear):
    """Return one of the two chains."""
    return linear_chain(n) if linear else nonlinear_chain(n)


def _van_der_pol(x, t, p):
    return x[1] * p[1], (p[0] * (1.0 - x[0] * x[0]) * x[1] - x[0]) * p[1]


def _duffing(x, t, p):
    return x[1], -0.4 * x[1] + x[0] - p[0] * x[0] ** 3


def van_der_pol(q=0.8, mu=1.0, unit=1.0):
    """Van der Pol oscillator; time in units of `unit` seconds."""
    return sf.SDE(
        _van_der_pol, 2, _ON_VELOCITY, [[q / unit]], parameters={"mu": mu, "rate": 1.0 / unit}
    )  # fmt: skip


def duffing(q=1.6, e=0.1):
    """Duffing oscillator with two wells (002 Table 8)."""
    return sf.SDE(_duffing, 2, _ON_VELOCITY, [[q]], parameters={"e": e})


def _forced(x, t, p):
    return (-p[0] * (x[0] - np.sin(t)),)


def _relaxation(x, t, p):
    return p[0] * (x[0] - x[0] ** 3 / 3.0 - x[1]), x[0] / p[0]


def relaxation(mu):
    """Van der Pol oscillator in Liénard's form, fast jumps between slow branches; noise on both states."""
    return sf.SDE(_relaxation, 2, np.eye(2), 0.1 * np.eye(2), parameters={"mu": mu})


_DRIFTS = {
    "forced": _forced,
    "double well": lambda x, t, p: (p[0] * (x[0] - x[0] ** 3),),
    "tanh": lambda x, t, p: (np.tanh(x[0]),),
    "root inwards": lambda x, t, p: (-np.sign(x[0]) * np.sqrt(np.abs(x[0])),),
    "root outwards": lambda x, t, p: (np.sign(x[0]) * np.sqrt(np.abs(x[0])),),
    "cube root": lambda x, t, p: (-np.cbrt(x[0]),),
    "absolute": lambda x, t, p: (-np.abs(x[0]),),
    "bang-bang": lambda x, t, p: (-np.sign(x[0]),),
    "cubic inwards": lambda x, t, p: (-(x[0] ** 3),),
    "cubic outwards": lambda x, t, p: (x[0] ** 3,),
    "square": lambda x, t, p: (x[0] ** 2,),
}


def drift_1d(name, q=0.5, k=1.0):
    """Return a model of one state; `k` is the rate where the drift has one."""
    return sf.SDE(_DRIFTS[name], 1, [[1.0]], [[q]], parameters={"k": k})


def _growing(x, t, p):
    return (-0.1 * x[0],)


def _noise_proportional(x, t, p):
    return ((p[0] * x[0],),)


def _noise_root(x, t, p):
    return ((p[0] * np.sqrt(np.abs(x[0])),),)


def _noise_wavy(x, t, p):
    return ((p[0] * (1.0 + 0.5 * np.sin(x[0])),),)


_NOISES = {"proportional": _noise_proportional, "root": _noise_root, "wavy": _noise_wavy}


def multiplicative(name, strength):
    """Return a model of one state whose noise depends on it."""
    return sf.SDE(
        _growing, 1, noise=_NOISES[name], spectral_density=[[1.0]], parameters={"strength": strength}
    )


def position(dim, R, states=(0,)):
    """Sensor of some states, equal and independent errors of variance R."""
    return sf.GaussianMeasurement(h=np.eye(dim)[list(states)], noise_cov=R * np.eye(len(states)))


def _square(x, t):
    return (x[0] ** 2,)


def square(R):
    """Sensor z = x₀² + error: cannot tell x₀ from −x₀."""
    return sf.GaussianMeasurement(h=_square, noise_cov=[[R]])


OSCILLATORS = {"linear": oscillator, "Van der Pol": van_der_pol, "Duffing": duffing}
#: Starts of the models of two states, and of those of one.
START, LINE = {"x0": [1.0, 0.0], "P0": np.diag([0.2, 0.4])}, {"x0": [0.3], "P0": [[0.5]]}


def usual(rng, model, **changes):
    """A problem as most families have it: `START`, its first state read every half second; see `drawn`."""
    return drawn(rng, model, **{"sensor": position(2, 0.2), "interval": 0.5} | START | changes)
