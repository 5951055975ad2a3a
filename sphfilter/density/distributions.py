"""Distributions a density may start from: a Gaussian, or a uniform box."""

from dataclasses import dataclass

import numpy as np

from ..errors import ModelError
from ..validate import array, covariance

__all__ = ["Gaussian", "Uniform", "checked_box", "gaussian_log_pdf"]


@dataclass(frozen=True)
class Gaussian:
    """Normal distribution with mean (n,) and covariance (n, n), positive definite.

    Examples
    --------
    >>> import sphfilter as sf
    >>> print(sf.Gaussian([0.0], [[4.0]]).pdf([[0.0], [2.0]]).round(4))
    [0.1995 0.121 ]
    """

    mean: np.ndarray
    cov: np.ndarray

    def __post_init__(self):
        mean = array("mean", self.mean, (None,))
        object.__setattr__(self, "mean", mean)
        object.__setattr__(self, "cov", covariance("cov", self.cov, dim=len(mean)))

    def pdf(self, X):
        """Density at the states X (M, n)."""
        from scipy import stats  # on use: import time

        return np.atleast_1d(stats.multivariate_normal(self.mean, self.cov).pdf(X))


@dataclass(frozen=True)
class Uniform:
    """Uniform distribution on a box (n, 2) of lower and upper bounds.

    Examples
    --------
    >>> import sphfilter as sf
    >>> print(sf.Uniform([[0.0, 2.0]]).pdf([[1.0], [3.0]]))
    [0.5 0. ]
    """

    box: np.ndarray

    def __post_init__(self):
        object.__setattr__(self, "box", checked_box(self.box))

    def pdf(self, X):
        """Density at the states X (M, n)."""
        inside = np.all((self.box[:, 0] <= X) & (self.box[:, 1] >= X), axis=1)
        return inside / np.prod(self.box[:, 1] - self.box[:, 0])


def checked_box(box):
    """Return `box` as an array (n, 2) whose bounds rise, or raise `ModelError`."""
    box = array("box", box, (None, 2))
    if np.any(box[:, 1] <= box[:, 0]):
        raise ModelError(f"box must hold (low, high) with low < high for every state, got {box.tolist()}")
    return box


def gaussian_log_pdf(mean, cov):
    """Return log N(X; mean, cov) as a function of states X (M, n)."""
    factor = np.linalg.cholesky(cov)
    whiten = np.linalg.inv(factor).T
    constant = -np.log(np.diag(factor)).sum() - 0.5 * len(mean) * np.log(2 * np.pi)

    def log_p(X):
        z = (X - mean) @ whiten
        return constant - 0.5 * np.einsum("ia,ia->i", z, z)

    return log_p
