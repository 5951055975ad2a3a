"""Simulated truths and measurements, with an error in distribution far below that of any filter."""

from itertools import pairwise
from typing import overload

import numpy as np
from numpy.typing import ArrayLike

from .. import validate
from .._types import Floats, Seed
from .dynamics import Dynamics
from .jump_markov import JumpMarkovModel
from .named import InputRecord, each_driven
from .paths import Sampled, advance, drawn_readings, starting_states
from .simulate_modes import simulate_modes


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
    if isinstance(model, JumpMarkovModel):
        return simulate_modes(model, measurement, x0, times, rng, n_paths, max_step, inputs)[:2]
    rng, times = validate.generator(rng), validate.times("times", times)
    max_step = None if max_step is None else validate.positive("max_step", max_step)
    x, single = starting_states(x0, n_paths, model.dim)
    truth = np.empty((len(times), *x.shape))
    truth[0] = x
    each = each_driven(model, inputs, len(times))
    for i, (before, t) in enumerate(pairwise(times), start=1):
        x = model.domain.wrap(advance(each[i], x, before, t, rng, max_step)) if t > before else x
        truth[i] = x
    z = drawn_readings(measurement, truth, times, each, rng)
    truth = truth.transpose(1, 0, 2).copy()
    return (truth[0], None if z is None else z[0]) if single else (truth, z)
