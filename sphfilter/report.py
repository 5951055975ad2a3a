"""The numbers of a campaign: errors, consistency, rejections and divergences of each filter. No pictures."""

from dataclasses import asdict, dataclass

import numpy as np

from . import consistency
from .errors import ModelError

__all__ = ["FilterReport", "Report", "report"]


@dataclass(frozen=True, kw_only=True)
class FilterReport:
    """What one filter did; errors are those of the updated mean at the measurement times.

    Runs in which the filter failed (raised, or gave something that is not finite) count in `n_failed` and
    nowhere else.

    Attributes
    ----------
    n_runs, n_failed : int
        All runs, and those failed.
    max_peak_error, mean_peak_error : ndarray, shape (n,)
        Largest absolute error of a run: its maximum and mean over the runs (002 Tables 7, 9, 11).
    rms_error, rms_error_std : ndarray, shape (n,)
        Root mean square over runs and epochs, and the standard error of it, estimated from the differences
        between runs (NaN for one run).
    run_time : float
        Median wall-clock seconds of a run; NaN if unknown.
    nees : float
        Average NEES over runs and epochs; n for a consistent filter.
    nees_inside, nees_inside_one_sided : float
        Fraction of the epochs whose run-averaged NEES lies in its 95 % interval.
    nmee_inside : ndarray, shape (n,)
        Fraction of the epochs whose run-averaged NMEE lies in its 95 % interval.
    n_rejected : int
        Measurements the filter rejected, over all runs.
    n_diverged : int
        Runs that diverged, by `consistency.diverged`: the NEES averaged over 5 updates exceeds its 99.99 %
        point.
    log_evidence, log_evidence_std : float
        Log-evidence of a run, averaged over the runs, and the standard error of the average.
    """

    n_runs: int
    n_failed: int
    max_peak_error: np.ndarray
    mean_peak_error: np.ndarray
    rms_error: np.ndarray
    rms_error_std: np.ndarray
    run_time: float
    nees: float
    nees_inside: float
    nees_inside_one_sided: float
    nmee_inside: np.ndarray
    n_rejected: int
    n_diverged: int
    log_evidence: float
    log_evidence_std: float


#: Heading of each row, field, and whether there is one a state.
_ROWS = (
    ("Max peak error", "max_peak_error", True),
    ("Mean peak error", "mean_peak_error", True),
    ("RMS error", "rms_error", True),
    ("Standard error of RMS", "rms_error_std", True),
    ("Run time, median (s)", "run_time", False),
    ("NEES, average", "nees", False),
    ("NEES inside interval", "nees_inside", False),
    ("NEES inside, one-sided", "nees_inside_one_sided", False),
    ("NMEE inside interval", "nmee_inside", True),
    ("Measurements rejected", "n_rejected", False),
    ("Runs diverged", "n_diverged", False),
    ("Runs failed", "n_failed", False),
    ("Log-evidence of a run", "log_evidence", False),
    ("Standard error of it", "log_evidence_std", False),
)


@dataclass(frozen=True)
class Report:
    """Numbers of all filters.

    Attributes
    ----------
    scenario : str
    dim, n_runs, n_epochs : int
        States, runs, measurement times in a run.
    filters : dict of str to FilterReport

    Examples
    --------
    >>> import numpy as np
    >>> import sphfilter as sf
    >>> result = sf.FilterResult(
    ...     t=np.array([1.0]), x_prior=np.zeros((1, 1)), P_prior=np.ones((1, 1, 1)), x=np.array([[0.3]]),
    ...     P=np.array([[[0.09]]]), log_evidence=np.zeros(1), accepted=np.ones(1, dtype=bool),
    ... )
    >>> numbers = sf.report(result, truth=[[0.0]])
    >>> print(f"{numbers.n_epochs} epoch, NEES {numbers.filters['filter'].nees:.2f}")
    1 epoch, NEES 1.00
    """

    scenario: str
    dim: int
    n_runs: int
    n_epochs: int
    filters: dict

    def rows(self):
        """Return the table as a list of (label, {filter: number}); states are counted from 1, as in 002."""
        table = []
        for label, field, per_state in _ROWS:
            values = {name: getattr(f, field) for name, f in self.filters.items()}
            if not per_state:
                table.append((label, values))
                continue
            for d in range(self.dim):
                table.append((f"{label} (state {d + 1})", {name: float(v[d]) for name, v in values.items()}))
        return table

    def as_dict(self):
        """Return everything as plain dictionaries, lists and numbers, as JSON wants them."""
        return asdict(self, dict_factory=lambda pairs: {k: _plain(v) for k, v in pairs})

    def __str__(self):
        rows = [("", {name: name for name in self.filters}), *self.rows()]
        width = max(len(label) for label, _ in rows)
        lines = [f"{self.scenario}: {self.n_runs} runs of {self.n_epochs} updates".lstrip(": ")]
        for label, values in rows:
            cells = (v if isinstance(v, str) else f"{v:.4g}" for v in values.values())
            lines.append(f"{label:{width}}" + "".join(f"  {cell:>12}" for cell in cells))
        return "\n".join(lines)


def _plain(value):
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def report(campaign_or_result, truth=None):
    """Work out the numbers of a campaign, or of one filter's result.

    Parameters
    ----------
    campaign_or_result : CampaignResult or FilterResult
        A FilterResult may be that of one run, or stacked with the runs first.
    truth : array_like, shape (T, n) or (R, T, n)
        True states at the measurement times; for a FilterResult only, a campaign carries its own.

    Returns
    -------
    Report

    Raises
    ------
    ModelError
        A truth that is missing, superfluous or of another shape than the means.

    Examples
    --------
    >>> import numpy as np
    >>> import sphfilter as sf
    >>> model, sensor = sf.LinearSDE([[-1.0]], noise=[[1.0]]), sf.GaussianMeasurement([[1.0]], [[0.1]])
    >>> truth, z = sf.simulate(model, sensor, [0.0], np.arange(9.0), rng=1)
    >>> result = sf.SPHFilter(model, sensor, [0.0], [[1.0]], n_particles=60).run(np.arange(1.0, 9.0), z[1:])
    >>> print(sf.report(result, truth=truth[1:]).filters["filter"].rms_error.round(2))
    [0.12]
    """
    if hasattr(campaign_or_result, "results"):
        if truth is not None:
            raise ModelError("a campaign carries its truth: leave truth= out")
        c = campaign_or_result
        filters = {name: _filter_report(r, c.truth, c.run_time[name]) for name, r in c.results.items()}
        return _report(c.scenario, c.truth, filters)
    if truth is None:
        raise ModelError("report of a filter's result needs truth=, shape (T, n)")
    result, truth = campaign_or_result, np.asarray(truth, dtype=float)
    if truth.shape != np.shape(result.x):
        raise ModelError(f"truth has shape {truth.shape}, but the means have {np.shape(result.x)}")
    single = truth.ndim == 2
    truth = truth[None] if single else truth
    return _report("", truth, {"filter": _filter_report(result, truth, np.full(len(truth), np.nan), single)})


def _report(scenario, truth, filters):
    n_runs, n_epochs, dim = truth.shape
    return Report(scenario=scenario, dim=dim, n_runs=n_runs, n_epochs=n_epochs, filters=filters)


def _filter_report(result, truth, run_time, single=False):
    """Reduce the histories of a filter, runs first unless `single`, to its numbers."""
    x, P, log_evidence, accepted = (
        np.asarray(a)[None] if single else np.asarray(a)
        for a in (result.x, result.P, result.log_evidence, result.accepted)
    )
    done = np.isfinite(x).all(axis=(1, 2)) & np.isfinite(P).all(axis=(1, 2, 3))
    numbers = {"n_runs": len(x), "n_failed": int(np.sum(~done)), "n_rejected": int(np.sum(~accepted[done]))}
    run_evidence = log_evidence[done].sum(axis=1)
    return FilterReport(
        **numbers,
        **_errors(x[done] - truth[done]),
        **_consistency(truth[done], x[done], P[done]),
        run_time=_over_runs(np.median, run_time[done]),
        log_evidence=_over_runs(np.mean, run_evidence),
        log_evidence_std=_standard_error(run_evidence),
    )


def _errors(error):
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


def _consistency(truth, x, P):
    """Return the consistency figures of errors that are all finite, runs first."""
    dim = truth.shape[2]
    nees = consistency.nees(truth, x, P)
    nees_average, n_runs = consistency.run_average(nees)
    nmee_average, n_nmee = consistency.run_average(consistency.nmee(truth, x, P))
    # where no run is left the average is NaN and counts nowhere, whatever the interval
    n_runs, n_nmee = np.maximum(n_runs, 1), np.maximum(n_nmee, 1)
    inside = {
        sided: consistency.fraction_inside(nees_average, consistency.nees_bounds(dim, n_runs, sided=sided))
        for sided in (2, 1)
    }
    return {
        "nees": _over_runs(np.mean, nees),
        "nees_inside": float(inside[2]),
        "nees_inside_one_sided": float(inside[1]),
        "nmee_inside": consistency.fraction_inside(nmee_average, consistency.nmee_bounds(n_nmee)),
        "n_diverged": int(np.sum(consistency.diverged(nees, dim))),
    }


def _over_runs(average, values):
    return float(average(values)) if values.size else np.nan


def _standard_error(values):
    """Return the standard error of the mean over the first axis; NaN for fewer than two rows."""
    if len(values) < 2:
        return np.full(values.shape[1:], np.nan)[()]
    return np.std(values, axis=0, ddof=1) / np.sqrt(len(values))
