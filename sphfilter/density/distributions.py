"""Distributions a density may start from: a Gaussian, or a uniform box."""

import math
import sys
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .._types import Floats, OfStates, in_a_line
from ..core.field.walls import Walls
from ..errors import ModelError
from ..validate import array, covariance


@dataclass(frozen=True)
class Gaussian:
    """Normal distribution with mean (n,) and covariance (n, n), positive definite.

    Examples
    --------
    >>> import sphfilter as sf
    >>> print(sf.Gaussian([0.0], [[4.0]]).pdf([[0.0], [2.0]]).round(4))
    [0.1995 0.121 ]
    """

    mean: Floats
    cov: Floats

    __repr__ = in_a_line

    def __init__(self, mean: ArrayLike, cov: ArrayLike) -> None:
        centre = array("mean", mean, (None,))
        object.__setattr__(self, "mean", centre)
        object.__setattr__(self, "cov", covariance("cov", cov, dim=len(centre)))

    def pdf(self, X: ArrayLike) -> Floats:
        """Density at the states X (M, n)."""
        from scipy import stats  # on use: import time

        return np.atleast_1d(stats.multivariate_normal(self.mean, self.cov).pdf(X))


def check_within(gaussian: Gaussian, walls: Walls) -> None:
    """Refuse a Gaussian that has no probability within some walls, low and high (n,), up to rounding."""
    states = zip(gaussian.mean, np.sqrt(np.diag(gaussian.cov)), *walls, strict=False)  # without walls none
    for a, (mean, deviation, low, high) in enumerate(states):
        off = max(low - mean, mean - high) / deviation
        if math.erfc(off / math.sqrt(2.0)) < 2.0 * sys.float_info.epsilon:
            raise ModelError(
                f"the start lies {off:.3g} standard deviations beyond a wall: state {a} is {mean:g} ± "
                f"{deviation:.3g}, between {low:g} and {high:g}; check its mean, and its units"
            )


@dataclass(frozen=True)
class Uniform:
    """Uniform distribution on a box (n, 2) of lower and upper bounds.

    Examples
    --------
    >>> import sphfilter as sf
    >>> print(sf.Uniform([[0.0, 2.0]]).pdf([[1.0], [3.0]]))
    [0.5 0. ]
    """

    box: Floats

    __repr__ = in_a_line

    def __init__(self, box: ArrayLike) -> None:
        object.__setattr__(self, "box", checked_box(box))

    def pdf(self, X: ArrayLike) -> Floats:
        """Density at the states X (M, n)."""
        states = np.asarray(X, dtype=float)
        inside = np.all((self.box[:, 0] <= states) & (self.box[:, 1] >= states), axis=1)
        return inside / np.prod(self.box[:, 1] - self.box[:, 0])


def checked_box(box: ArrayLike) -> Floats:
    """Return `box` as an array (n, 2) whose bounds rise, or raise `ModelError`."""
    box = array("box", box, (None, 2))
    if np.any(box[:, 1] <= box[:, 0]):
        raise ModelError(f"box must hold (low, high) with low < high for every state, got {box.tolist()}")
    return box


def gaussian_log_pdf(mean: Floats, cov: Floats) -> OfStates:
    """Return log N(X; mean, cov) as a function of states X (M, n)."""
    factor = np.linalg.cholesky(cov)
    whiten = np.linalg.inv(factor).T
    constant = -np.log(np.diag(factor)).sum() - 0.5 * len(mean) * np.log(2 * np.pi)

    def log_p(X: Floats) -> Floats:
        z = (X - mean) @ whiten
        return constant - 0.5 * np.einsum("ia,ia->i", z, z)

    return log_p
