"""A model as the compiled marches take it: functions by address, and what needs no asking."""

from typing import NamedTuple

import numpy as np


class Equations(NamedTuple):
    """dx = f(x, t) dt + g dW with diffusion matrix D = g Q g^T / 2, as far as D is constant.

    `drift`, `diffusion` and `divergence` (of D) are addresses of functions of signature `BATCH`, which
    `function_at` makes functions again.
    """

    drift: int
    diffusion: int
    divergence: int
    p: np.ndarray  # parameters of the model
    D: np.ndarray  # (n, n), used where neither time nor state changes it
    rows: np.ndarray  # numbers of the rows of D that are not zero
    time_dependent: bool
    state_dependent: bool
