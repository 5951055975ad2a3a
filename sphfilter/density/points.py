"""Weighted points, and the way they came since the last reading."""

import math
from typing import Any, NamedTuple

import numpy as np

from .._types import Floats, Ints
from ..core.cloud import lineages
from ..core.cloud.control import decisive, error_by, expected_square, remembered, smoothed, square_of_more
from ..core.cloud.inherited import Inherited
from ..core.cloud.pace import Bias
from ..core.cloud.steps import Leg
from .moments import columns

NO_LINES = np.empty((0, 0), np.int64)  # of points each its own
FRESH = Inherited(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, np.empty(0))  # of points that have no errors but their own


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
    older: Ints = NO_LINES  # (readings, N): where those came from


class Prior(NamedTuple):
    """The prior of the readings of one time, so that one more is asked of the same."""

    points: "Points"
    readings: tuple[Any, ...]
    log_evidence: float


class Points(NamedTuple):
    """Weighted points x (N, n), weights w (N,) of sum one, and where they come from."""

    x: Floats
    w: Floats
    path: Path | None = None  # since the last reading
    prior: Prior | None = None  # before the readings of this time
    #: (readings, N): points of a number in the first row come from one point of the prior, in the second from
    #: one of the prior of the reading before; None: each its own.
    lineage: Ints | None = None

    @property
    def older(self) -> Ints:
        """Lineages (readings, N) of a prior's points."""
        if self.path is not None:
            return self.path.older
        return NO_LINES if self.lineage is None else self.lineage


class Told(NamedTuple):
    """Squares of what a cloud and its shadow are apart by, smoothed over the record; or NaN."""

    mean: float = math.nan  # of the means, in standard deviations, over the states
    variance: float = math.nan  # of the covariances, relative, where they are apart most
    log_evidence: float = math.nan  # nats, of one reading

    def after(self, mean: float, variance: float, log_evidence: float = math.nan) -> "Told":
        """With the squares of one more reading; those before count as long as a few readings."""
        pairs, part = zip(self, (mean, variance, log_evidence), strict=True), remembered(self.mean, mean)
        return Told(*[smoothed(old, new, part) for old, new in pairs])

    def or_expected(self, number: float, n: int) -> "Told":
        """These; before any, what a shadow of so many independent points of n states usually shows."""
        if not math.isnan(self.mean):
            return self
        mean = expected_square(number)
        return self._replace(mean=mean, variance=(n + 1.0) * mean)

    def of(self, times: float) -> "Told":
        """Errors of so many times the points; fewer points leave what was wrong as it was."""
        return Told(*[square_of_more(square, times) for square in self])

    @property
    def errors(self) -> "Told":
        """The errors of the cloud itself, where its shadow's fall as they do with the number of points."""
        return Told(*[error_by(square) for square in self])

    def decisive(self, target: float, n: int) -> float:
        """The error that decides on the points of a cloud in n states, against a target."""
        return decisive(*self.errors[:2], target, n)


class Pace(NamedTuple):
    """Steps that a model has needed, and what they may be off by."""

    step: float = 0.0  # seconds, of the first prediction after a reading
    stiff: bool = False
    legs: int = 0  # predictions since the last reading
    bias: Bias = Bias(0.0, 0.0)  # that their steps have had


class CloudState(NamedTuple):
    """State of a cloud: points, a smaller cloud beside them, the errors that it tells, the pace of steps."""

    points: Points
    shadow: Points
    size: int  # points that the errors told are of; after a reading there are twice as many
    told: Told = Told()
    pace: Pace = Pace()
    inherited: Inherited = FRESH
    age: int = 0  # predictions since the start: its random numbers hang on it, and on no clock

    @property
    def begins(self) -> bool:
        """Whether a reading has left it, or it has just become points."""
        path = self.points.path
        return path is None or all(passage.model is None for passage in path.passages)


class Carried(lineages.Carried):
    """What `core.cloud.lineages` says of states x (N, n), which are rows here.

    Copies of a point count once. Where points are few, the error of a mean is about 1/√effective standard
    deviations, and that of the log-evidence 1/√lineages, whatever clouds agree on.
    """

    @classmethod
    def of(cls, x: Floats, log_w: Floats, ancestor: Ints, mass: Floats, older: Ints = NO_LINES) -> "Carried":
        """States with log-weights (N,) whose sum is the evidence, and each one's ancestor (N,) in the prior.

        The prior's points have weights (M,), and may have lineages (readings, M).
        """
        x, *rest = lineages.carriers(columns(x), log_w, ancestor, mass.copy(), older)
        return cls(x.T, *rest)
