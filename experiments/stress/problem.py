"""A filtering problem as data that can be rewritten: its model, its sensors and their readings, its start."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from .equations import Equation
from .sensors import GaussianReader, LikelihoodReader

#: Times of readings that are told one by one.
_LISTED = 20


@dataclass(frozen=True, kw_only=True)
class Problem:
    """All that a filter is given, and what is known besides.

    Attributes
    ----------
    kind : str
        The drift in words.
    equation : Equation
    readers : tuple of GaussianReader and LikelihoodReader
        Read at each time, one after the other.
    z : tuple of ndarray (T, k)
        Readings of each, NaN where nothing was read.
    x0, P0, t0
        Gaussian start, and its time in seconds.
    times : ndarray, shape (T,)
    truth : ndarray, shape (T, n), or None
        Drawn from the model and the start, with readings that are drawn from it; None where they are not.
    n_particles : int or "auto"
    parts : int
        Predictions from one time to the next.
    exact : callable, optional
        exact(problem) -> filter that is right.
    T, c : ndarray, shapes (n, n), (n,), optional
        The states are y with x = T y + c, where x are those of the problem it was made from.
    constant : float
        What log p(z) of every epoch is higher by than that of the problem it was made from.
    """

    kind: str = ""
    equation: Equation
    readers: tuple[GaussianReader | LikelihoodReader, ...]
    z: tuple[np.ndarray, ...]
    x0: np.ndarray
    P0: np.ndarray
    times: np.ndarray
    t0: float = 0.0
    truth: np.ndarray | None = field(default=None, repr=False)
    n_particles: int | str = 200
    parts: int = 1
    exact: Callable | None = None
    T: np.ndarray | None = None
    c: np.ndarray | None = None
    constant: float = 0.0

    @property
    def model(self):
        """The compiled model."""
        return self.equation.model

    @property
    def start(self):
        """Model, no sensor, and start, as the reference filters take them."""
        return self.model, None, self.x0, self.P0, self.t0

    @cached_property
    def sensors(self):
        """What filters are given."""
        return tuple(reader.sensor for reader in self.readers)

    def __str__(self):
        n, T = len(self.x0), len(self.times)
        std = np.sqrt(np.diag(self.P0))
        correlations = np.round(self.P0 / np.outer(std, std), 4).tolist()
        times = self.times.round(4).tolist()
        times = times if T <= _LISTED else [*times[:2], "...", times[-1]]
        return (
            f"{n} states ({self.kind}): {self.equation}; x0 = {self.x0.round(4).tolist()}, "
            f"std {np.round(std, 4).tolist()}, correlations {correlations}; "
            f"{T} readings at {times} by {' and '.join(map(str, self.readers))}; "
            f"{self.n_particles} particles"
        )
