"""Paths of models: states moved from one time to another, each with noise of its own, and their readings."""

import math
from functools import lru_cache
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from .. import validate
from .._types import Floats, Ints
from ..core.domain import bounce
from ..core.limits import LOOK, ROUNDING
from ..core.sde_steps import normals_per_step, steps
from ..errors import ModelError, PropagationError
from .compile import surfacing
from .derived import scales
from .discrete import DiscreteModel
from .discretization import linear_transition
from .domain import Domain
from .dynamics import Dynamics
from .jump_markov import JumpMarkovModel
from .sde import SDE
from .timing import spans

#: dt times the fastest rate of the model; that for additive noise has the higher order. Measured: half and
#: twice change moments of 50,000 paths by chance alone, 1.1 standard errors at most.
_COURANT_ADDITIVE, _COURANT_GENERAL = 0.05, 0.01
_STEPS_PER_LOOK = 16  # before the rate is looked at again; measured: half takes 1.3 times the time, twice 1.0
_NORMALS_AT_ONCE = 1_000_000  # normals drawn at a time: 8 bytes each = 8 MB
_MAX_STEPS = 10_000_000


class Sampled(Protocol):
    """A sensor of which readings can be drawn."""

    def sample(self, x: ArrayLike, t: float, rng: np.random.Generator, /) -> Floats:
        """Draw readings of many states (N, n), shape (N, k)."""


def starting_states(x0: ArrayLike, n_paths: int | None, n: int) -> tuple[Floats, bool]:
    """Return the states (R, n) at which paths start, and whether one path is asked for."""
    x = validate.state_rows("x0", x0, n)
    if n_paths is None:
        return x, np.ndim(x0) == 1
    if len(x) != 1:
        raise ModelError(f"x0 has {len(x)} rows; with n_paths= give one state of shape ({n},).")
    return np.repeat(x, validate.count("n_paths", n_paths), axis=0), False


def advance(
    model: Dynamics,
    x: ArrayLike,
    t0: float,
    t1: float,
    rng: np.random.Generator,
    max_step: float | None = None,
) -> Floats:
    """Return the states x (N, n) of time t0 moved to t1, each with noise of its own, shape (N, n).

    A linear model takes one exact step, one in discrete time those it has. Otherwise the step is `max_step`
    or less, in equal parts; without it, 0.05 (additive noise) or 0.01 (any other) of the model's fastest time
    scale, which is looked at every 16 steps: norm of the drift's Jacobian, at the states and where the noise
    may carry them meanwhile, squared norm of the noise's derivative, and the rate of change with time. With
    steps of that size the second moments of a double well and of a geometric model were right to 1e-5,
    relative. Raises `PropagationError` for a state that is not finite, or more than ten million steps.
    """
    x = np.array(x, dtype=float, order="C", ndmin=2)
    if model.linear:
        Phi, offset, root = change_of(model, t1 - t0)
        return x @ Phi.T + offset + rng.standard_normal(x.shape) @ root.T
    if isinstance(model, DiscreteModel):
        return model.drawn(x, t0, t1, noise_root(model.covariance), rng)
    assert isinstance(model, SDE)
    for begin, end in spans(model.breaks(t0, t1), t0, t1):
        x = _advance(model, x, begin, end, rng, max_step)
    return x


def advance_modes(
    model: JumpMarkovModel,
    x: Floats,
    now: Ints,
    span: tuple[float, float],
    rng: np.random.Generator,
    max_step: float | None = None,
) -> tuple[Floats, Ints]:
    """States (R, n) and modes (R,) after an interval: those that do not jump go together."""
    x, now, (t0, t1) = x.copy(), now.copy(), span
    if model.transitions is not None:
        return _stepped(model, x, now, span, rng)
    leaving = -model.rates.diagonal()
    with np.errstate(divide="ignore"):
        waits = rng.standard_exponential(len(x)) / leaving[now]
    stays, sdes = t0 + waits >= t1, list(model.modes.values())
    for k in np.unique(now[stays]):
        which = stays & (now == k)
        x[which] = sdes[k].domain.wrap(advance(sdes[k], x[which], t0, t1, rng, max_step))
    for r in np.flatnonzero(~stays):
        t, wait = t0, waits[r]
        while True:
            end = min(t + wait, t1)
            sde = sdes[now[r]]
            x[r] = sde.domain.wrap(advance(sde, x[r : r + 1], t, end, rng, max_step))[0]
            if end >= t1:
                break
            to = np.maximum(model.rates[now[r]], 0.0)
            t, now[r] = end, rng.choice(len(to), p=to / to.sum())
            wait = rng.standard_exponential() / leaving[now[r]] if leaving[now[r]] > 0.0 else np.inf
    return x, now


def _stepped(
    model: JumpMarkovModel, x: Floats, now: Ints, span: tuple[float, float], rng: np.random.Generator
) -> tuple[Floats, Ints]:
    """States (R, n) and modes (R,) after steps of maps, each of which begins with a jump."""
    ends = np.cumsum(np.asarray(model.transitions), axis=1)
    for begin, end in pairwise([*model.starts(*span), span[1]]):
        now = np.minimum((rng.random(len(now))[:, None] > ends[now]).sum(axis=1), len(ends) - 1)
        for k, mode in enumerate(model.modes.values()):
            own = now == k
            x[own] = mode.domain.wrap(advance(mode, x[own], begin, end, rng))
    return x, now


def _advance(
    model: SDE, x: Floats, t0: float, t1: float, rng: np.random.Generator, max_step: float | None
) -> Floats:
    """`advance` over an interval in which the model does not jump."""
    L = noise_root(model.spectral_density)
    t, taken = float(t0), 0
    while t < t1:
        end, n_steps = (t1, 1) if max_step else _next_block(model, x, t, t1)
        n_steps = max(n_steps, _parts(end - t, min(max_step or math.inf, model.max_step)))
        taken += n_steps
        if taken > _MAX_STEPS:
            raise PropagationError(
                f"The model needs over {_MAX_STEPS} steps between t={t0:g} and t={t1:g}: it is too stiff "
                "or is blowing up. Check its units and parameters, or give max_step=."
            )
        _take(model, x, t, (end - t) / n_steps, n_steps, L, rng)
        _check_finite(x, t, end)
        t = end
    return x


@lru_cache(maxsize=256)
def change_of(model: Dynamics, dt: float) -> tuple[Floats, Floats, Floats]:
    """Φ, offset and root of the noise of a linear model over a time, as compiled code takes them."""
    flow, offset, Q = linear_transition(model, dt)
    return flow.copy(), offset.copy(), noise_root(Q)


def _take(
    model: SDE, x: Floats, t: float, dt: float, n_steps: int, L: Floats, rng: np.random.Generator
) -> None:
    """Take equal steps, drawing the normals in parts."""
    additive = not model.state_dependent_noise
    n_normals = normals_per_step(len(L), additive)
    at_once = max(1, _NORMALS_AT_ONCE // (len(x) * n_normals))
    loop, walled = steps(additive), model.domain.walled.any()
    if walled:
        at_once = 1  # walls are looked at after every step
    for first in range(0, n_steps, at_once):
        normals = rng.standard_normal((min(at_once, n_steps - first), len(x), n_normals))
        rows = np.ascontiguousarray(normals.transpose(0, 2, 1))
        with surfacing():
            loop(x, t + first * dt, dt, model.drift_batch, model.noise_batch, model.p, L, rows)
        if walled:
            bounce(model.domain.codes, x)
            _check_walls(model.domain, x, t + first * dt)


def _next_block(model: SDE, x: Floats, t: float, t1: float) -> tuple[float, int]:
    """Return the end of the next block of steps and how many steps it takes."""
    courant = _COURANT_GENERAL if model.state_dependent_noise else _COURANT_ADDITIVE
    rates = _rates(model, x, t)
    stiffest = x[np.argsort(rates)[-LOOK:]]
    rate = max(rates.max(), rate_of_time(model, stiffest, t, t1))
    length = min(t1 - t, _STEPS_PER_LOOK * courant / rate) if rate > 0 else t1 - t
    spread = np.sqrt(2.0 * length * np.abs(np.diagonal(model.diffusion(stiffest, t), axis1=1, axis2=2)))
    axes = [sign * axis for axis in np.eye(model.dim) for sign in (-1.0, 1.0)]
    moved = np.concatenate([stiffest + spread * axis for axis in axes])
    rate = max(rate, _rates(model, moved[np.isfinite(moved).all(axis=1)], t).max(initial=0.0))
    return (t1 if length >= t1 - t else t + length), _parts(length, courant / rate if rate > 0 else length)


def _rates(model: SDE, X: Floats, t: float) -> Floats:
    """Return the rate 1/s of each state: ‖∂f/∂x‖, and ‖∂σ/∂x‖² where the noise depends on the state."""
    if not len(X):
        return np.zeros(0)
    J = np.empty((len(X), model.dim**2))
    with surfacing():
        model.jacobian_batch(np.ascontiguousarray(X), t, model.p, J)
    rates = np.linalg.norm(J, axis=1)
    if model.state_dependent_noise:
        L = noise_root(model.spectral_density)
        h = 1e-5 * np.maximum(1.0, np.abs(X))
        for j, axis in enumerate(np.eye(model.dim)):
            rise = model.noise(X + h * axis, t) - model.noise(X - h * axis, t)
            slope = (rise / (2.0 * h[:, j, None, None])) @ L
            rates += np.square(slope).sum(axis=(1, 2))
    return np.nan_to_num(rates, nan=0.0, posinf=0.0)


def rate_of_time(model: SDE, X: Floats, t: float, t1: float) -> float:
    """Return how fast drift and noise change with time, 1/s, relative to their size on (t, t1)."""
    if model.autonomous:
        return 0.0
    at = np.linspace(t, t1, 65)
    rate = 0.0
    for function in (model.drift, model.noise):
        values = np.array([function(X, s).ravel() for s in at])
        change, size = np.abs(np.diff(values, axis=0)).sum(axis=0).max(), np.abs(values).max()
        rate = max(rate, change / (size * (t1 - t)) if size > 0 else 0.0)
    return np.nan_to_num(rate)


def _parts(length: float, longest: float) -> int:
    return max(1, int(np.ceil(length / longest * (1.0 - 1e-12))))


def noise_root(Q: Floats) -> Floats:
    """Return L with L Lᵀ = Q, for semidefinite Q too.

    A column's last entry that is not rounding is above zero: else draws would hang on the last bit of Q.
    """
    d = scales(Q)
    w, V = np.linalg.eigh(Q / np.outer(d, d))
    for v in V.T:
        v *= np.sign(v[np.flatnonzero(np.abs(v) > ROUNDING)[-1]])
    return np.ascontiguousarray(d[:, None] * V * np.sqrt(np.maximum(w, 0.0)))


def _check_walls(domain: Domain, x: Floats, t: float) -> None:
    left = np.isfinite(x).all(axis=1) & ~domain.contains(x)
    if left.any():
        raise PropagationError(f"a path left the domain near t = {t:.6g}, at {x[left][0]}; it is {domain}")


def _check_finite(x: Floats, before: float, t: float) -> None:
    lost = np.flatnonzero(~np.isfinite(x).all(axis=1))
    if lost.size:
        raise PropagationError(
            f"The model blew up between t={before:g} and t={t:g}: state {lost[0]} is {x[lost[0]]}. Check the "
            "drift and its parameters for growth without bound, or give a smaller max_step=."
        )
