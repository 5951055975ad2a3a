"""One filter's histories over many runs, its innovations and ranks, reduced to numbers."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import consistency
from .._types import Bools, Floats, in_a_line
from ..consistency import p_values
from ..filter.results import FilterResult


@dataclass(frozen=True, kw_only=True)
class Innovations:
    """Measurements against their predictions.

    Attributes
    ----------
    n_measurements, acceptance : int, float
        Measurements that came, over all runs, and the fraction of these measurements that was used.
    nis : float
        Normalised innovation squared per degree of freedom, over all measurements that came; one is right.
        Rejected measurements count: a filter must not look better for measurements that it refused.
    nis_accepted : float
        The same number over the measurements that were used, with their own degrees of freedom: below one
        where a test of acceptance cuts tails off.
    nis_inside : float
        Fraction of the epochs whose sum over the runs lies in the 95 % interval of χ² with as many degrees of
        freedom as components came there.
    whiteness : float
        Correlation of successive innovations, averaged over the runs; zero is right.
    whiteness_p : float
        p-value of that zero, from the products of successive innovations: the average of products is zero for
        innovations of every shape, the average of correlations is not zero for skewed innovations.
    """

    n_measurements: int
    acceptance: float
    nis: float
    nis_accepted: float
    nis_inside: float
    whiteness: float
    whiteness_p: float


@dataclass(frozen=True, kw_only=True)
class Ranks:
    """Ranks of measurements in predictions and of truths in posteriors, all uniform if the filter is right.

    Attributes
    ----------
    pit, state_pit : ndarray, shapes (k, 10), (n, 10)
        Histograms of the ranks, as fractions: .1 in each bin is right.
    hpd : ndarray, shape (10,)
        Histogram of the ranks among regions of highest density; NaN for samples, which have no density.
    pit_p, state_pit_p, hpd_p : ndarray, shapes (k,), (n,), and float
        p-values of uniform ranks; NaN where ranks are not tested (fewer than ten runs, or eight readings).
    outside_95 : float
        How often the truth lies outside the region of highest density that holds 95 %; .05 is right.
    """

    pit: Floats
    state_pit: Floats
    hpd: Floats
    pit_p: Floats
    state_pit_p: Floats
    hpd_p: float
    outside_95: float

    __repr__ = in_a_line


@dataclass(frozen=True, kw_only=True)
class FilterReport:
    """Figures of one filter over all runs; errors are errors of the updated mean at the measurement times.

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

    __repr__ = in_a_line


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
    read = result.innovation[done], result.innovation_cov[done], accepted[done]
    return FilterReport(
        n_runs=len(x),
        n_failed=int(np.sum(~done)),
        n_rejected=int(np.sum(~accepted[done])),
        **_errors(x[done] - truth[done]),
        **_consistency(truth[done], x[done], P[done]),
        run_time=_over_runs(np.median, run_time[done]),
        log_evidence=_over_runs(np.mean, run_evidence),
        log_evidence_std=_standard_error(run_evidence),
        innovations=_innovations_of(*read, None if came is None else came[done]),
        ranks=_ranks_of(result.pit[done], result.state_pit[done], result.hpd_rank[done]),
    )


def _errors(error: Floats) -> dict[str, Any]:
    """Return peaks and root mean squares of errors (R, T, n)."""
    if error.size == 0:
        error = np.full((1, 1, error.shape[2]), np.nan)
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


def _innovations_of(innovation: Floats, cov: Floats, accepted: Bools, came: Bools | None) -> Innovations:
    """Reduce innovations (R, T, k), their covariances, what was accepted and what came (R, T)."""
    seen = np.isfinite(innovation)
    told: Bools = np.any(seen, axis=2)
    came = told if came is None else came
    used = told & accepted
    y = np.where(seen, innovation, 0.0)
    S = np.where(seen[..., None] & seen[..., None, :], cov, np.eye(y.shape[2]))  # missing ones add nothing
    square, dof = consistency.nis(y, S), seen.sum(axis=2)
    whole = np.where(np.all(seen, axis=2)[..., None], innovation, np.nan)
    white, products = consistency.whiteness(whole, S), consistency.lagged_products(whole, S)
    epoch, some = dof.sum(axis=0), np.maximum(dof.sum(axis=0), 1)
    each = np.where(epoch > 0, np.sum(square * told, axis=0) / some, np.nan)  # NaN where nothing came
    return Innovations(
        n_measurements=int(came.sum()),
        acceptance=_ratio(np.sum(came & accepted), came.sum()),
        nis=_ratio(square[told].sum(), dof[told].sum()),
        nis_accepted=_ratio(square[used].sum(), dof[used].sum()),
        nis_inside=float(consistency.fraction_inside(each, consistency.nees_bounds(1, some))),
        whiteness=float(np.nanmean(white)) if np.isfinite(white).any() else np.nan,
        whiteness_p=p_values.same_mean(products[:, None], 0.0),
    )


def _ranks_of(pit: Floats, state_pit: Floats, hpd_rank: Floats) -> Ranks:
    """Reduce ranks (R, T, k), (R, T, n) and (R, T) to `Ranks`."""
    each = p_values.histogram
    known = np.isfinite(hpd_rank)
    return Ranks(
        pit=np.array([each(p) for p in np.moveaxis(pit, 2, 0)]),
        state_pit=np.array([each(p) for p in np.moveaxis(state_pit, 2, 0)]),
        hpd=each(hpd_rank) if known.any() else np.full(10, np.nan),
        pit_p=np.array([p_values.uniform_epochs(p) for p in np.moveaxis(pit, 2, 0)]),
        state_pit_p=np.array([p_values.uniform_runs(p) for p in np.moveaxis(state_pit, 2, 0)]),
        hpd_p=p_values.uniform_runs(hpd_rank),
        outside_95=_ratio(np.sum(hpd_rank[known] > 0.95), known.sum()),
    )


def _ratio(part: Any, whole: Any) -> float:
    return float(part / whole) if whole else np.nan
