"""Simulated truths and measurements, with an error in distribution far below that of any filter."""

from itertools import pairwise
from typing import Any, NamedTuple, overload

import numpy as np
from numpy.typing import ArrayLike

from .. import validate
from .._types import Floats, Ints, Seed
from ..errors import ModelError
from .dynamics import Dynamics
from .jump_markov import JumpMarkovModel
from .named import InputRecord, driven, each_input
from .paths import Sampled, advance, advance_modes, starting_states


@overload
def simulate(
    model: Dynamics | JumpMarkovModel,
    measurement: Sampled,
    x0: ArrayLike,
    times: ArrayLike,
    rng: Seed = None,
    n_paths: int | None = None,
    max_step: float | None = None,
    inputs: InputRecord | None = None,
) -> tuple[Floats, Floats]: ...


@overload
def simulate(
    model: Dynamics | JumpMarkovModel,
    measurement: None,
    x0: ArrayLike,
    times: ArrayLike,
    rng: Seed = None,
    n_paths: int | None = None,
    max_step: float | None = None,
    inputs: InputRecord | None = None,
) -> tuple[Floats, None]: ...


def simulate(
    model: Dynamics | JumpMarkovModel,
    measurement: Sampled | None,
    x0: ArrayLike,
    times: ArrayLike,
    rng: Seed = None,
    n_paths: int | None = None,
    max_step: float | None = None,
    inputs: InputRecord | None = None,
) -> tuple[Floats, Floats | None]:
    """Draw paths of a model and readings of them.

    Linear models are drawn from their exact transition density. Others are stepped (`advance`).

    Parameters
    ----------
    model : SDE, DiscreteModel or JumpMarkovModel
        Of a model that switches, `simulate_modes` also tells the modes, and begins in a given one.
    measurement : GaussianMeasurement, LikelihoodMeasurement with a sampler, Sensors, or None
    x0 : array_like, shape (n,) or (R, n)
        State at ``times[0]``, of one path or of R.
    times : array_like, shape (T,)
        Non-decreasing, seconds.
    rng : numpy Generator or seed, optional
    n_paths : int, optional
        R, to start R paths from one x0 (n,).
    max_step : float, optional
        Upper bound of the step, seconds; chosen from the model when None.
    inputs : array_like (T, m), or mapping of str to array_like (T,), optional
        What the model's inputs are over the interval that ends at each time; the first row has none.

    Returns
    -------
    truth : ndarray, shape (T, n) or (R, T, n)
    z : ndarray, shape (T, k) or (R, T, k); None without a measurement

    Raises
    ------
    ModelError
        Wrong shapes, or times that run backwards.
    PropagationError
        A path left the range of finite numbers.

    Examples
    --------
    >>> import sphfilter as sf
    >>> model = sf.LinearSDE(A=[[-1.0]], noise=[[1.0]])
    >>> sensor = sf.GaussianMeasurement([[1.0]], [[0.1]])
    >>> truth, z = sf.simulate(model, sensor, x0=[2.0], times=[0, 1, 2], rng=1)
    >>> print(truth.shape, z.shape)
    (3, 1) (3, 1)
    >>> many, _ = sf.simulate(model, None, x0=[2.0], times=[0, 1], rng=1, n_paths=20_000)
    >>> print(f"{many[:, 1].mean():.2f}")  # 2 / e = 0.736
    0.73
    """
    return _drawn(model, measurement, x0, times, (rng, n_paths, max_step, inputs))[:2]


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
    drawn = _drawn(model, measurement, x0, times, (rng, n_paths, max_step, inputs), mode)
    modes = np.stack(drawn[2], axis=1)
    return ModePaths(*drawn[:2], modes if drawn[0].ndim == 3 else modes[0])


def _drawn(
    model: Dynamics | JumpMarkovModel,
    measurement: Sampled | None,
    x0: ArrayLike,
    times: ArrayLike,
    options: tuple[Seed, int | None, float | None, InputRecord | None],
    mode: str | None = None,
) -> tuple[Floats, Any, list[Ints]]:
    """Paths of a model of either kind, readings of them, and the modes (R,) at each time."""
    rng, n_paths, max_step, inputs = options
    rng, times = validate.generator(rng), validate.times("times", times)
    max_step = None if max_step is None else validate.positive("max_step", max_step)
    x, single = starting_states(x0, n_paths, model.dim)
    driving = each_input(model.inputs, inputs, len(times))
    each: list[Any] = [model if u is None else model.with_inputs(u) for u in driving]
    modes = [_first_modes(model, mode, len(x), rng)]
    truth = np.empty((len(times), *x.shape))
    truth[0] = x
    for i, (before, t) in enumerate(pairwise(times), start=1):
        now, own = modes[-1], each[i]
        if t > before and isinstance(own, JumpMarkovModel):
            x, now = advance_modes(own, x, now, (before, t), rng, max_step)
        elif t > before:
            x = model.domain.wrap(advance(own, x, before, t, rng, max_step))
        truth[i] = x
        modes.append(now)
    z = None
    if measurement is not None:  # with the inputs that the models of each time have
        read = zip(truth, times, each, strict=True)
        z = np.stack([driven(measurement, own.inputs).sample(x, t, rng) for x, t, own in read], axis=1)
    truth = truth.transpose(1, 0, 2).copy()
    return *((truth[0], None if z is None else z[0]) if single else (truth, z)), modes


def _first_modes(model: Any, mode: str | None, count: int, rng: np.random.Generator) -> Ints:
    """Modes (R,) in which paths begin: a given one, or as they are drawn; of a model that has one, zeros."""
    if not isinstance(model, JumpMarkovModel):
        return np.zeros(count, np.int64)
    if mode is None:
        return rng.choice(len(model.names), size=count, p=model.stationary)
    return np.full(count, model.names.index(validate.choice("mode", mode, model.names)))
