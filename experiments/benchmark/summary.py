"""From rows of single runs to one line a competitor, and what is best of several lines."""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from .errors import root_mean_square
from .told import NONE, told_and_left

#: What is measured against the reference, and in what unit.
MEASURES = {
    "mean": "error of the mean (posterior standard deviations)",
    "cov": "error of the covariance (relative)",
    "total": "error of the log-evidence of a run (nat)",
}
#: The reference must be so many times better than an error it is used for.
_MARGIN = 5.0


@dataclass(frozen=True)
class ReferenceError:
    """A scenario's references: what they are, and root mean squares of their own errors over the runs."""

    kind: str
    mean: float
    cov: float
    evidence: float
    total: float

    @classmethod
    def of(cls, references):
        """Put the references of all runs together."""
        numbers = {
            name: root_mean_square([getattr(r, name) for r in references])
            for name in ("mean", "cov", "evidence", "total")
        }
        return cls(kind=references[-1].kind, **numbers)


@dataclass(frozen=True)
class Line:
    """One competitor on one scenario, over all runs."""

    scenario: str
    family: str
    series: str
    size: int
    threads: int
    n_used: float  # particles at most, as the filter reports them; median of the runs
    # runs in all, and those in which the filter raised something (the numbers are of the others)
    runs: int
    failed: int
    # as in `errors.Errors`: root mean squares over the runs; `worst` is the largest
    mean: float
    worst: float
    cov: float
    evidence: float
    total: float
    hellinger: float  # root mean square over runs and epochs; NaN above two states
    rmse: np.ndarray  # shape (n,): root-mean-square distance from the truth
    nees: float
    # median over runs and repeats
    seconds: float
    cpu_seconds: float
    spread: float  # interquartile range of the seconds over their median
    # evaluations of the velocity at all particles, and of the drift at a state; medians of the runs
    evaluations: float
    drift: float
    schemes: dict  # predictions by scheme
    fallbacks: float  # part of the predictions that did not use the scheme most used, or reported trouble
    refused: int  # measurements refused
    memory: float  # growth of the process, MB; the largest of the runs
    certified: bool  # the reference's own error of the mean is at most a fifth of this one
    # shape (K, 2): at every epoch the error of the mean that the filter told, and the one that it left
    told: np.ndarray
    failure: str  # one of the messages


def summarise(scenario, method, rows, drift, reference):
    """Put the rows of all runs of a competitor, from `measure`, together in a `Line`.

    `drift` are evaluations of the drift in the first run; `reference` is a `ReferenceError`.
    """
    done = [row for row in rows if "failure" not in row]
    times = np.array([t for row in done for t in row["seconds"]])
    measures = ("mean", "cov", "evidence", "total", "hellinger")
    rms = {key: root_mean_square([row[key] for row in done]) for key in measures}
    schemes = sum((Counter(row["schemes"]) for row in done), Counter())
    return Line(
        scenario=scenario.name,
        family=method.family,
        series=method.series,
        size=method.size,
        threads=method.threads,
        runs=len(rows),
        failed=len(rows) - len(done),
        n_used=_median(row["n_used"] for row in done),
        **rms,
        worst=max((row["worst"] for row in done), default=np.nan),
        rmse=_rmse([row["rmse"] for row in done], scenario.model.dim),
        nees=float(np.mean([row["nees"] for row in done])) if done else np.nan,
        seconds=_median(times),
        cpu_seconds=_median(t for row in done for t in row["cpu_seconds"]),
        spread=float(np.subtract(*np.quantile(times, [0.75, 0.25])) / np.median(times)) if done else np.nan,
        evaluations=_median(row["evaluations"] for row in done),
        drift=drift,
        schemes=dict(schemes),
        fallbacks=_fallbacks(done, schemes),
        refused=sum(row["refused"] for row in done),
        memory=max((row["memory"] for row in done), default=np.nan),
        certified=bool(reference.mean * _MARGIN <= rms["mean"]),
        told=told_and_left(done) if method.family == "auto" else NONE,
        failure=next((row["failure"] for row in rows if "failure" in row), ""),
    )


def _median(values):
    values = list(values)
    return float(np.median(values)) if values else np.nan


def _rmse(values, n):
    return np.sqrt(np.mean(np.square(values), axis=0)) if values else np.full(n, np.nan)


def _fallbacks(done, schemes):
    """Part of the predictions by another scheme than the most used, or in trouble."""
    n = sum(row["predictions"] for row in done)
    if not n:
        return 0.0
    others = n - max(schemes.values())
    return max(others, sum(len(row["troubles"]) for row in done)) / n


def particle_law(lines, measure="mean"):
    """c of the law seconds = c / error² of the best particle filter on one thread; NaN without one.

    The law of its best size: larger ones meet the bias of the time step, smaller ones overhead.
    """
    costs = [i.seconds * getattr(i, measure) ** 2 for i in lines
             if i.family in ("pf", "pf4") and i.threads == 1 and not i.failed]  # fmt: skip
    return float(np.nanmin(costs)) if len(costs) and np.isfinite(costs).any() else np.nan


def fastest_to_reach(lines, error):
    """The fastest of the lines whose mean error is at most `error`, or None."""
    reached = [i for i in lines if not i.failed and i.mean <= error]
    return min(reached, key=lambda i: i.seconds, default=None)
