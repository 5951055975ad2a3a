"""The exact transition of a linear model."""

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import matrix_balance

from .._types import Floats
from ..errors import PropagationError

if TYPE_CHECKING:
    from .dynamics import Dynamics

_TERMS = 15  # of a Taylor series of a matrix of norm 1/2: 2⁻¹⁵ / 15! = 2e-17


@lru_cache(maxsize=256)
def linear_transition(model: "Dynamics", dt: float) -> tuple[Floats, Floats, Floats]:
    """The exact transition of a model that is linear, which never changes; read-only.

    Raises `PropagationError` if it grows beyond the finite numbers.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        found = model.discretize(dt)
    if not all(np.isfinite(part).all() for part in found):
        raise PropagationError(
            f"the model blew up: within {dt:g} s its linear drift leaves the finite numbers. Check the drift "
            f"there, or predict over a shorter interval"
        )
    for part in found:
        part.setflags(write=False)
    return found


def exponential(X: Floats) -> Floats:
    """The exponential of small matrices (..., n, n), by a Taylor series and squaring.

    Scipy's shares some matrices of four rows out to threads: 8 ms each where another program has the core.
    """
    squarings = max(0, math.frexp(float(np.abs(X).sum(axis=-2).max()))[1] + 1)
    X, one = X / 2.0**squarings, np.eye(X.shape[-1])
    E = one
    for k in range(_TERMS, 0, -1):
        E = one + X @ E / k
    for _ in range(squarings):
        E = E @ E
    return E


def transition(A: Floats, b: Floats, spread: Floats, dt: float) -> tuple[Floats, Floats, Floats]:
    """Return (Phi, offset, Qd) with X(t+dt) = Phi X(t) + offset + N(0, Qd), exactly; dt >= 0, seconds.

    The drift is A x + b; `spread` (n, n) is the covariance that noise adds in a second. Van Loan's block
    exponential over a part of dt short enough for its growing block, then doubling.
    """
    n = len(A)
    # in units in which the rows of A are like its columns: norms say nothing in those of the states
    A, (unit, _) = matrix_balance(A, permute=False, separate=True)
    doublings = max(0, int(np.ceil(np.log2(max(float(np.linalg.norm(A, 1)) * dt, 1.0)))))
    h = dt / 2**doublings
    spread = spread / np.outer(unit, unit)
    size = np.abs(spread).max() or 1.0
    b = b / unit
    length = np.abs(b).max() or 1.0
    E = exponential(np.block([[-A, spread / size], [np.zeros((n, n)), A.T]]) * h)
    affine = exponential(np.block([[A, b[:, None] / length], [np.zeros((1, n + 1))]]) * h)
    Phi, offset = affine[:n, :n], affine[:n, n]
    Qd = E[n:, n:].T @ E[:n, n:]
    for _ in range(doublings):
        offset = Phi @ offset + offset
        Qd = Phi @ Qd @ Phi.T + Qd
        Phi = Phi @ Phi
    Qd = 0.5 * size * (Qd + Qd.T) * np.outer(unit, unit)
    return Phi * unit[:, None] / unit, offset * length * unit, Qd
