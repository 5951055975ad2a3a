"""Simulated truths of a model that switches between modes."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .. import validate
from .._types import Floats, Ints, Seed
from ..errors import ModelError
from .jump_markov import JumpMarkovModel
from .named import InputRecord, each_driven
from .paths import Sampled, advance, drawn_readings, starting_states


class ModePaths(NamedTuple):
    """Paths of a model that switches.

    Attributes
    ----------
    truth : ndarray, shape (T, n) or (R, T, n)
    z : ndarray, shape (T, k) or (R, T, k); None without a measurement
    modes : ndarray of int, shape (T,) or (R, T)
        Numbers of the modes, in the order of ``model.names``.
    """

    truth: Floats
    z: Floats | None
    modes: Ints


def simulate_modes(
    model: JumpMarkovModel,
    measurement: Sampled | None,
    x0: ArrayLike,
    times: ArrayLike,
    rng: Seed = None,
    n_paths: int | None = None,
    max_step: float | None = None,
    inputs: InputRecord | None = None,
    *,
    mode: str | None = None,
) -> ModePaths:
    """Draw paths of a model that switches between modes, the modes, and readings of the paths.

    Jumps come at the times at which they are drawn, not at those of the readings.

    Parameters
    ----------
    model : JumpMarkovModel
    measurement, x0, times, rng, n_paths, max_step, inputs
        As of `simulate`.
    mode : str, optional
        Mode at ``times[0]``; drawn from ``model.stationary`` if not given.

    Returns
    -------
    ModePaths

    Raises
    ------
    ModelError, PropagationError
        As `simulate`.

    Examples
    --------
    >>> import sphfilter as sf
    >>> drift = lambda v: sf.LinearSDE([[0.0]], [v], noise=[[0.1]])
    >>> model = sf.JumpMarkovModel({"left": drift(-1.0), "right": drift(1.0)}, [[-0.5, 0.5], [0.5, -0.5]])
    >>> truth, z, modes = sf.simulate_modes(model, None, [0.0], range(100), rng=1, mode="left")
    >>> print(truth.shape, z, modes[0], 0 < modes.mean() < 1)
    (100, 1) None 0 True
    """
    if not isinstance(model, JumpMarkovModel):
        raise ModelError(
            f"simulate_modes takes a JumpMarkovModel, got {validate.short(model)}; simulate takes an SDE"
        )
    rng, times = validate.generator(rng), validate.times("times", times)
    max_step = None if max_step is None else validate.positive("max_step", max_step)
    x, single = starting_states(x0, n_paths, model.dim)
    each = each_driven(model, inputs, len(times))
    if mode is None:
        now = rng.choice(len(model.names), size=len(x), p=model.stationary)
    else:
        now = np.full(len(x), model.names.index(validate.choice("mode", mode, model.names)))
    truth, modes = np.empty((len(times), *x.shape)), np.empty((len(times), len(x)), np.int64)
    truth[0], modes[0] = x, now
    for i, (before, t) in enumerate(pairwise(times), start=1):
        if t > before:
            x, now = advance_modes(each[i], x, now, (before, t), rng, max_step)
        truth[i], modes[i] = x, now
    z = drawn_readings(measurement, truth, times, each, rng)
    truth, modes = truth.transpose(1, 0, 2).copy(), modes.T.copy()
    return (
        ModePaths(truth[0], None if z is None else z[0], modes[0]) if single else ModePaths(truth, z, modes)
    )


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
