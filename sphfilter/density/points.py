"""Weighted points, and the way they came since the last reading."""

import math
from typing import Any, NamedTuple

import numpy as np

from .._types import Floats, Ints
from ..core.cloud.steps import Leg
from ..core.cloud.weights import weighted_moments

__all__ = ["ORDER", "SHADOW", "CloudState", "Pace", "Passage", "Path", "Points", "Prior", "Told", "moments"]


class Passage(NamedTuple):
    """A change of points, linearised in blocks: x_T ≈ end + Φ (x_0 - start) + L u.

    A prediction over an interval, or noise about each point.
    """

    leg: Leg | None  # None: the linear change is exact
    key: int
    start: Floats  # centres of the blocks, (blocks, n)
    end: Floats  # without noise, (blocks, n)
    flow: Floats  # Φ, (blocks, n, n)
    lower: Floats  # L, (blocks, n, n)
    rows: Floats  # V, (blocks, n, d): u = V ξ of the noise ξ of all steps
    model: Any = None  # of a prediction; keeps the functions that the leg calls
    span: tuple[float, float] = (0.0, 0.0)  # seconds
    steps: tuple[int, bool] = (0, False)


class Path(NamedTuple):
    """Where points were after the last reading, and what has moved them since."""

    x: Floats  # (N, n), at the begin
    block: Ints  # (N,), of each point, never decreasing
    passages: tuple[Passage, ...]
    u: tuple[Floats, ...]  # (N, n) each: standard normals that moved the ends of each passage


class Prior(NamedTuple):
    """What the readings of one time were asked of, so that one more is asked of the same."""

    points: "Points"
    readings: tuple[Any, ...]
    log_evidence: float


class Points(NamedTuple):
    """Weighted points x (N, n), weights w (N,) of sum one, and where they come from."""

    x: Floats
    w: Floats
    path: Path | None = None  # since the last reading
    prior: Prior | None = None  # before the readings of this time
    #: (N,): points of a number come from one point of the prior; None: each its own.
    family: Ints | None = None


class Told(NamedTuple):
    """Squares of what a cloud and its shadow are apart by, smoothed over the record; or NaN."""

    mean: float = math.nan  # of the means, in standard deviations, over the states
    variance: float = math.nan  # of the covariances, relative
    log_evidence: float = math.nan  # nats, of one reading

    def after(self, mean: float, variance: float, log_evidence: float = math.nan) -> "Told":
        """With the squares of one more reading; those before count as long as a few readings."""
        pairs = zip(self, (mean, variance, log_evidence), strict=True)
        # what is much worse than before is believed at once, to half of it
        return Told(*[_smoothed(old, new) for old, new in pairs])

    def or_expected(self, number: float, n: int) -> "Told":
        """These; before any, what a shadow of so many independent points of n states usually shows."""
        if not math.isnan(self.mean):
            return self
        mean = _EXPECTED_SQUARE / max(number, 1.0)
        return self._replace(mean=mean, variance=(n + 1.0) * mean)

    def of(self, times: float) -> "Told":
        """The same for so many times the points; fewer points leave what was wrong as it was."""
        return Told(*[square * max(times, 1.0) ** (-2.0 * ORDER) for square in self])

    @property
    def errors(self) -> "Told":
        """The errors of the cloud itself, where its shadow's fall as they do with the number of points."""
        return Told(*[math.sqrt(square) * SHADOW**-ORDER for square in self])


def _smoothed(old: float, new: float) -> float:
    if old != old or new != new:  # one of them is not known
        return new if old != old else old
    return max(0.25 * new, old + _NEW * (new - old))


#: Points of a cloud over those of its shadow; an error falls with their number to about this power.
SHADOW, ORDER = 8, 0.6
_NEW = 0.4  # weight of the last squared difference among all
#: Squared error of a mean over that of as many points drawn at random: .3 to .65 of the error after the first
#: readings of 90 random models, whatever part of the points carries them.
_EXPECTED_SQUARE = 0.25


class Pace(NamedTuple):
    """Steps that a model has needed, and what they may be off by."""

    step: float = 0.0  # seconds, of the first prediction after a reading
    stiff: bool = False
    legs: int = 0  # predictions since the last reading
    bias: float = 0.0  # that their steps have had, in standard deviations


class CloudState(NamedTuple):
    """What a cloud is besides its points: how they came, a smaller cloud beside it, and what that tells."""

    points: Points
    shadow: Points
    size: int  # points that the errors told are of; after a reading there are twice as many
    told: Told = Told()
    pace: Pace = Pace()
    inherited: float = 0.0  # error of the mean before it became points, as far as readings have left it


def moments(x: Floats, w: Floats) -> tuple[Floats, Floats]:
    """Mean (n,) and covariance (n, n) of weighted points, the same bits whatever the threads."""
    n = x.shape[1]
    mean, cov = np.empty(n), np.empty((n, n))
    weighted_moments(x, w, mean, cov)
    return mean, cov
