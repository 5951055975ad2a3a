"""One filter's histories over many runs, its innovations and ranks, reduced to numbers."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import consistency
from .._lines import in_a_line
from .._types import Bools, Floats
from ..consistency import p_values
from ..filter.results import FilterResult


@dataclass(frozen=True, kw_only=True)
class Innovations:
    """Measurements against their predictions."""

    n_measurements: int  # that came, over all runs
    acceptance: float  # fraction of these that was used
    #: Normalised innovation squared per degree of freedom, over all measurements that came; one is right.
    #: Rejected measurements count: a filter must not look better for measurements that it refused.
    nis: float
    #: The same number over the measurements that were used, with their own degrees of freedom: below one
    #: where a test of acceptance cuts tails off.
    nis_accepted: float
    #: Fraction of the epochs whose sum over the runs lies in the 95 % interval of χ² with as many degrees of
    #: freedom as components came there.
    nis_inside: float
    whiteness: float  # correlation of successive innovations, averaged over the runs; zero is right
    #: p-value of that zero, from the products of successive innovations: the average of products is zero for
    #: innovations of every shape, the average of correlations is not zero for skewed innovations.
    whiteness_p: float


@dataclass(frozen=True, kw_only=True)
class Ranks:
    """Ranks of measurements in predictions and of truths in posteriors, all uniform if the filter is right.

    Their p-values are NaN where ranks are not tested (fewer than ten runs, or eight readings).
    """

    pit: Floats  # (k, 10), histograms of the ranks of measurements, as fractions: .1 in each bin is right
    state_pit: Floats  # (n, 10), those of truths
    hpd: Floats  # (10,), of truths among regions of highest density; NaN for samples, which have no density
    pit_p: Floats  # (k,), p-values of uniform ranks
    state_pit_p: Floats  # (n,)
    hpd_p: float
    outside_95: float  # how often truths lie outside the region of highest density of 95 %; .05 is right

    __repr__ = in_a_line


@dataclass(frozen=True, kw_only=True)
class FilterReport:
    """Figures of one filter over all runs; errors are errors of the updated mean at the measurement times.

    Runs in which the filter failed (raised, or gave something that is not finite) count in `n_failed` and
    nowhere else.
    """

    n_runs: int
    n_failed: int
    max_peak_error: Floats  # (n,), largest absolute error of a run, at most (002 Tables 7, 9, 11)
    mean_peak_error: Floats  # and averaged over the runs
    rms_error: Floats  # (n,), root mean square over runs and epochs
    rms_error_std: Floats  # its standard error, by the differences between runs (NaN for one run)
    run_time: float  # median wall-clock seconds of a run; NaN if unknown
    nees: float  # average NEES over runs and epochs; n for a consistent filter
    nees_inside: float  # fraction of the epochs whose run-averaged NEES lies in its 95 % interval
    nees_inside_one_sided: float
    nees_above: float  # fractions of the epochs above and below the two-sided interval
    nees_below: float
    exits: int  # epochs outside of that interval
    nmee: Floats  # (n,), average NMEE, zero for a consistent filter
    nmee_p: Floats  # p-value of that zero (NaN for few runs)
    nmee_inside: Floats  # (n,), fraction of the epochs whose run-averaged NMEE lies in its 95 % interval
    n_rejected: int  # measurements the filter rejected, over all runs
    n_diverged: int  # runs whose NEES, averaged over 5 updates, exceeds its 99.99 % point
    log_evidence: float  # of a run, averaged over the runs
    log_evidence_std: float  # standard error of that average
    innovations: Innovations
    ranks: Ranks
    #: p-value of so many exits at the referee's rate (at a rate of one in twenty, if the referee's is lower);
    #: NaN without a referee.
    exits_p: float = np.nan
    verdict: str = ""  # all these figures in one sentence

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
    return FilterReport(
        n_runs=len(x),
        n_failed=int(np.sum(~done)),
        n_rejected=int(np.sum(~accepted[done])),
        **_errors(x[done] - truth[done]),
        **_consistency(truth[done], x[done], P[done]),
        run_time=_over_runs(np.median, run_time[done]),
        log_evidence=_over_runs(np.mean, run_evidence),
        log_evidence_std=_standard_error(run_evidence),
        innovations=_innovations_of(
            result.innovation[done],
            result.innovation_cov[done],
            accepted[done],
            None if came is None else came[done],
        ),
        ranks=_ranks_of(result.pit[done], result.state_pit[done], result.hpd_rank[done]),
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


def _innovations_of(
    innovation: Floats, cov: Floats, accepted: Bools, came: Bools | None = None
) -> Innovations:
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
    total = dof.sum(axis=0)
    over_runs = np.where(total > 0, (square * told).sum(axis=0) / np.maximum(total, 1), np.nan)
    bounds = consistency.nees_bounds(1, np.maximum(total, 1))
    return Innovations(
        n_measurements=int(came.sum()),
        acceptance=_ratio(np.sum(came & accepted), came.sum()),
        nis=_ratio(square[told].sum(), dof[told].sum()),
        nis_accepted=_ratio(square[used].sum(), dof[used].sum()),
        nis_inside=float(consistency.fraction_inside(over_runs, bounds)),
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
