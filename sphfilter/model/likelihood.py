"""A sensor of any likelihood."""

import inspect
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from .. import validate
from .._types import Floats, Seed
from ..errors import ModelError
from .measurements import PlainSensor

#: loglik(z, X, t) → (N,), and sample(X, t, rng) → (N, k).
LogLikelihood: TypeAlias = Callable[[Floats, Floats, float], ArrayLike]
Sampler: TypeAlias = Callable[[Floats, float, np.random.Generator], ArrayLike]
#: peaks(z) → (M, n), states.
Peaks: TypeAlias = Callable[[Floats], ArrayLike]


class LikelihoodMeasurement(PlainSensor):
    """Any sensor whose likelihood can be computed.

    Parameters
    ----------
    loglik : callable
        loglik(z, X, t) → (N,): log p(z | x) of every state X (N, n); −inf where z is impossible. It should
        contain its normalising constant, or the evidence lacks it.
    dim_z : int, optional
        Length of z; not checked when None.
    sample : callable, optional
        sample(X, t, rng) → (N, k), for simulation.
    peaks : callable, optional
        peaks(z) → (M, n): states at which the likelihood of z may be far higher than around, so that a
        lattice would overlook them.

    Examples
    --------
    >>> import numpy as np
    >>> import sphfilter as sf
    >>> counter = sf.LikelihoodMeasurement(lambda z, X, t: z[0] * X[:, 0] - np.exp(X[:, 0]))  # a Poisson rate
    >>> print(counter.log_likelihood([3.0], np.log([[1.0], [3.0]])).round(3))
    [-1.     0.296]
    """

    def __init__(
        self,
        loglik: LogLikelihood,
        dim_z: int | None = None,
        sample: Sampler | None = None,
        peaks: Peaks | None = None,
    ) -> None:
        if not callable(loglik):
            raise ModelError(f"loglik must be a function (z, X, t) -> (N,), got {loglik!r}.")
        _check_arguments(loglik)
        self.dim_z: int | None = None if dim_z is None else validate.count("dim_z", dim_z)
        self._loglik, self._sample, self.peaks = loglik, sample, peaks

    def __repr__(self) -> str:
        name = getattr(self._loglik, "__name__", self._loglik)
        return f"LikelihoodMeasurement(loglik={name}, dim_z={self.dim_z})"

    def log_likelihood(self, z: ArrayLike | None, X: ArrayLike, t: float = 0.0) -> Floats:
        """Return log p(z | x) for each state X (N, n), shape (N,); zeros when all of z is missing."""
        X = np.asarray(X, dtype=float)
        z, seen = self.reading(z)
        if not seen.any():
            return np.zeros(len(X))
        value = np.array(self._loglik(z, X, t) if len(X) else [], dtype=float)
        if value.shape != (len(X),):
            raise ModelError(f"loglik returned shape {value.shape}; ({len(X)},) is needed, one per state.")
        wrong = np.flatnonzero(np.isnan(value) | (value == np.inf))
        if wrong.size:
            raise ModelError(
                f"loglik returned {value[wrong[0]]} at state {X[wrong[0]]}; "
                "it must be finite, or -inf where z is impossible."
            )
        return value

    def sample(self, x: ArrayLike, t: float = 0.0, rng: Seed = None) -> Floats:
        """Draw readings of one state (n,) → (k,), or of many (N, n) → (N, k)."""
        if self._sample is None:
            raise ModelError("This LikelihoodMeasurement cannot be simulated; give it sample=f(X, t, rng).")
        X = np.array(x, dtype=float, ndmin=2)
        z = np.array(self._sample(X, t, validate.generator(rng)), dtype=float).reshape(len(X), -1)
        return z[0] if np.ndim(x) == 1 else z


def _check_arguments(loglik: Callable[..., object]) -> None:
    """Refuse a likelihood that cannot be called with (z, X, t), where its signature is known."""
    try:
        signature = inspect.signature(loglik)
    except (TypeError, ValueError):
        return
    try:
        signature.bind(None, None, None)
    except TypeError:
        raise ModelError(
            f"loglik must be a function of (z, X, t), but its arguments are {signature}."
        ) from None
