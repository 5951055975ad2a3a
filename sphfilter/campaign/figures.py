"""One filter's histories over many runs, reduced to numbers."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import consistency
from .._types import Bools, Floats
from ..consistency import p_values
from ..filter.results import FilterResult
from .findings import Innovations, Ranks, innovations_of, ranks_of

__all__ = ["FilterReport", "filter_report"]


@dataclass(frozen=True, kw_only=True)
class FilterReport:
    """What one filter did in all runs; errors are errors of the updated mean at the measurement times.

    Runs in which the filter failed (raised, or gave something that is not finite) count in `n_failed` and
    nowhere else.

    Attributes
    ----------
    n_runs, n_failed : int
        All runs, and those failed.
    max_peak_error, mean_peak_error : ndarray, shape (n,)
        Largest absolute error of a run: its maximum and mean over the runs (002 Tables 7, 9, 11).
    rms_error, rms_error_std : ndarray, shape (n,)
        Root mean square over runs and epochs, and its standard error, estimated from the differences
        between runs (NaN for one run).
    run_time : float
        Median wall-clock seconds of a run; NaN if unknown.
    nees : float
        Average NEES over runs and epochs; n for a consistent filter.
    nees_inside, nees_inside_one_sided : float
        Fraction of the epochs whose run-averaged NEES lies in its 95 % interval.
    nees_above, nees_below : float
        Fractions of the epochs above and below the two-sided interval.
    exits, exits_p : int, float
        Epochs outside of that interval, and the p-value of so many epochs at the referee's rate (at a rate of
        one in twenty, if the referee's is lower). The p-value is NaN without a referee.
    nmee, nmee_p : ndarray, shape (n,)
        Average NMEE, zero for a consistent filter, and the p-value of that zero (NaN for few runs).
    nmee_inside : ndarray, shape (n,)
        Fraction of the epochs whose run-averaged NMEE lies in its 95 % interval.
    n_rejected : int
        Measurements the filter rejected, over all runs.
    n_diverged : int
        Runs that diverged, by `consistency.diverged`: the NEES averaged over 5 updates exceeds its 99.99 %
        point.
    log_evidence, log_evidence_std : float
        Log-evidence of a run, averaged over the runs, and the standard error of the average.
    innovations : Innovations
    ranks : Ranks
    verdict : str
        All these figures in one sentence.
    """

    n_runs: int
    n_failed: int
    max_peak_error: Floats
    mean_peak_error: Floats
    rms_error: Floats
    rms_error_std: Floats
    run_time: float
    nees: float
    nees_inside: float
    nees_inside_one_sided: float
    nees_above: float
    nees_below: float
    exits: int
    nmee: Floats
    nmee_p: Floats
    nmee_inside: Floats
    n_rejected: int
    n_diverged: int
    log_evidence: float
    log_evidence_std: float
    innovations: Innovations
    ranks: Ranks
    exits_p: float = np.nan
    verdict: str = ""


def filter_report(
    result: FilterResult, truth: Floats, run_time: Floats, came: Bools | None = None
) -> FilterReport:
    """Reduce the histories of a filter, runs first, to its numbers.

    `came` (R, T) says when there was a measurement, if innovations need not say it.
    """
    x, P, log_evidence = (np.asarray(a) for a in (result.x, result.P, result.log_evidence))
    accepted = np.asarray(result.accepted)
    done = np.isfinite(x).all(axis=(1, 2)) & np.isfinite(P).all(axis=(1, 2, 3))
    run_evidence = log_evidence[done].sum(axis=1)
    return FilterReport(
        n_runs=len(x),
        n_failed=int(np.sum(~done)),
        n_rejected=int(np.sum(~accepted[done])),
        **_errors(x[done] - truth[done]),
        **_consistency(truth[done], x[done], P[done]),
        run_time=_over_runs(np.median, run_time[done]),
        log_evidence=_over_runs(np.mean, run_evidence),
        log_evidence_std=_standard_error(run_evidence),
        innovations=innovations_of(
            result.innovation[done],
            result.innovation_cov[done],
            accepted[done],
            None if came is None else came[done],
        ),
        ranks=ranks_of(result.pit[done], result.state_pit[done], result.hpd_rank[done]),
    )


def _errors(error: Floats) -> dict[str, Any]:
    """Return peaks and root mean squares of errors (R, T, n)."""
    if error.size == 0:
        nothing = np.full(error.shape[2], np.nan)
        names = ("max_peak_error", "mean_peak_error", "rms_error", "rms_error_std")
        return dict.fromkeys(names, nothing)
    peak = np.abs(error).max(axis=1)
    run_square = np.mean(error**2, axis=1)
    rms = np.sqrt(run_square.mean(axis=0))
    # of the mean square, carried through the root
    rms_std = _standard_error(run_square) / (2.0 * np.where(rms > 0, rms, 1.0))
    return {
        "max_peak_error": peak.max(axis=0),
        "mean_peak_error": peak.mean(axis=0),
        "rms_error": rms,
        "rms_error_std": rms_std,
    }


def _consistency(truth: Floats, x: Floats, P: Floats) -> dict[str, Any]:
    """Return the consistency figures of errors that are all finite, runs first."""
    dim = truth.shape[2]
    nees, nmee = consistency.nees(truth, x, P), consistency.nmee(truth, x, P)
    nees_average, n_runs = consistency.run_average(nees)
    nmee_average, n_nmee = consistency.run_average(nmee)
    # where no run is left the average is NaN and counts nowhere, whatever the interval
    n_runs, n_nmee = np.maximum(n_runs, 1), np.maximum(n_nmee, 1)
    low, high = consistency.nees_bounds(dim, n_runs)
    one_sided = consistency.nees_bounds(dim, n_runs, sided=1)
    return {
        "nees": _over_runs(np.mean, nees),
        "nees_inside": float(consistency.fraction_inside(nees_average, (low, high))),
        "nees_inside_one_sided": float(consistency.fraction_inside(nees_average, one_sided)),
        "nees_above": _over_runs(np.mean, nees_average > high),
        "nees_below": _over_runs(np.mean, nees_average < low),
        "exits": int(np.sum((nees_average > high) | (nees_average < low))),
        "nmee": nmee_average.mean(axis=0),
        "nmee_p": np.array([p_values.same_mean(e, 0.0) for e in np.moveaxis(nmee, 2, 0)]),
        "nmee_inside": consistency.fraction_inside(nmee_average, consistency.nmee_bounds(n_nmee)),
        "n_diverged": int(np.sum(consistency.diverged(nees, dim))),
    }


def _over_runs(average: Callable[..., Any], values: NDArray[Any]) -> float:
    return float(average(values)) if values.size else np.nan


def _standard_error(values: Floats) -> Any:
    """Return the standard error of the mean over the first axis; NaN for fewer than two rows."""
    if len(values) < 2:
        return np.full(values.shape[1:], np.nan)[()]
    return np.std(values, axis=0, ddof=1) / np.sqrt(len(values))
