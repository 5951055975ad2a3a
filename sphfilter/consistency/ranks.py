"""Are the densities themselves right? Ranks of measurements and truths in them, which must be uniform.

NEES and NMEE ask for mean and covariance only, and their intervals hold for Gaussian posteriors. The ranks
here ask for the whole density and are exact whatever its shape: the probability integral transform (PIT) of
a measurement under its prediction (Dawid, J. R. Stat. Soc. A 147, 1984; Diebold, Gunther & Tay, Int. Econ.
Rev. 39, 1998), and the probability of the region where the posterior is higher than at the truth.
"""

from time import perf_counter
from typing import Protocol

import numpy as np
from numba.core import event
from numpy.typing import ArrayLike
from scipy.special import gammainc, ndtr

from .._types import Floats
from ..density.weighted import WeightedStates, hpd_rank, state_rank
from ..model.measurements import NoisySensor, Sensor, has_gaussian_noise
from ..model.named import driven
from . import normalised

_COMPILED = event.TimingListener()
event.register("numba:compile", _COMPILED)


def clock() -> float:
    """Return seconds by the wall, without those in which numba compiled."""
    return perf_counter() - (_COMPILED.duration if _COMPILED.done else 0.0)


class Ranked(Protocol):
    """The part of a filter that a `Ranker` asks."""

    @property
    def measurement(self) -> Sensor | None:
        """The filter's own sensor."""

    @property
    def t(self) -> float:
        """Time of the density, seconds."""

    def spread(self) -> WeightedStates:
        """The density now as states and weights."""


class Ranker:
    """Ranks measurements and truths in a filter's densities while it runs; the filter sees no truth.

    The truth (T, n) is that at the measurement times.
    """

    def __init__(self, truth: ArrayLike) -> None:
        self.truth = np.asarray(truth, dtype=float)
        self.seconds = 0.0  # by `clock`, spent on ranking, which are not the filter's

    def before(self, filt: Ranked, z: ArrayLike | None, k: int) -> tuple[Floats, Floats, Floats]:
        """Return what `ranked_reading` tells of the next measurement, k numbers, in the prediction."""
        start, sensor = clock(), driven(filt.measurement, getattr(filt, "inputs", {}))
        found = np.full(k, np.nan), np.full(k, np.nan), np.full((k, k), np.nan)
        if has_gaussian_noise(sensor) and sensor.observed(z).any():
            found = ranked_reading(filt.spread(), sensor, sensor.reading(z).z, filt.t)
        self.seconds += clock() - start
        return found

    def after(self, filt: Ranked, epoch: int) -> tuple[Floats, float]:
        """Return the ranks of the truth in the posterior, of each state (n,) and of its density."""
        start, spread, x = clock(), filt.spread(), self.truth[epoch]
        found = state_rank(spread, x), hpd_rank(spread, x)[0]
        self.seconds += clock() - start
        return found


def ranked_reading(
    spread: WeightedStates, sensor: NoisySensor, z: ArrayLike, t: float
) -> tuple[Floats, Floats, Floats]:
    """Rank a measurement z (k,) of time t, seconds, in its predictive density, and tell its innovation.

    The rank (k,) is the probability that the prediction gave to a lower reading, each component alone; of an
    angle, counted from the far side of the predicted direction. NaN where it is missing, as it is in z. The
    innovation (k,) is z minus its expectation; its covariance (k, k) is that of the prediction plus R, its
    mean where it differs from state to state.
    """
    z = sensor.reading(z).z
    h = sensor.predict(spread.X, t)
    known = np.isfinite(h).all(axis=1)  # where h is undefined the likelihood is zero
    R = sensor.covariance(spread.X[known], t)
    h, w = h[known], spread.w[known] / spread.w[known].sum()
    anchor = h[np.argmax(w)]
    # einsum, as sums of matrix products depend on the number of threads in their last bits
    centre = sensor.residual(anchor + np.einsum("i,ij->j", w, sensor.residual(h, anchor)), 0.0)
    off = sensor.residual(h, centre)
    y = sensor.residual(z, centre)
    pit = np.einsum("i,ij->j", w, ndtr((y - off) / np.sqrt(np.diagonal(R, axis1=1, axis2=2))))
    S = np.einsum("i,ij,ik->jk", w, off, off) + np.einsum("i,ijk->jk", w, R)
    return np.clip(pit, 0.0, 1.0), y, S


def gaussian_ranks(
    truth: ArrayLike, mean: ArrayLike, cov: ArrayLike, innovation: Floats, innovation_cov: Floats
) -> dict[str, Floats]:
    """The ranks of a filter that has a mean and a covariance only, taken at its word: Gaussian.

    Of truth and mean (T, n), cov (T, n, n), innovation (T, k) and its covariance (T, k, k): ``pit``,
    ``state_pit`` and ``hpd_rank``, as in `FilterResult`.
    """
    truth = np.asarray(truth, dtype=float)
    variance = np.diagonal(innovation_cov, axis1=-2, axis2=-1)
    square = normalised.nees(truth, mean, cov)
    return {
        "pit": ndtr(innovation / np.sqrt(np.where(variance > 0, variance, np.nan))),
        "state_pit": ndtr(-normalised.nmee(truth, mean, cov)),
        "hpd_rank": gammainc(truth.shape[-1] / 2.0, square / 2.0),
    }
