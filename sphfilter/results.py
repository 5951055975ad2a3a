"""What a run of a filter leaves behind, and the one loop that every filter's ``run`` calls."""

from dataclasses import dataclass, fields

import numpy as np

from .errors import ModelError

__all__ = ["FilterResult", "run_filter"]


@dataclass(frozen=True)
class FilterResult:
    """Histories of one run; the first axis is the measurement epoch.

    Attributes
    ----------
    t : ndarray, shape (T,)
        Measurement times, seconds.
    x_prior, x : ndarray, shape (T, n)
        Mean before and after the update.
    P_prior, P : ndarray, shape (T, n, n)
        Covariance before and after the update.
    log_evidence : ndarray, shape (T,)
        Log-density of each measurement given all earlier ones (zero where none came); their sum is the
        log-evidence of the run.
    accepted : ndarray of bool, shape (T,)
        False where a measurement came and the filter rejected it.

    Examples
    --------
    >>> import sphfilter as sf
    >>> model, sensor = sf.LinearSDE([[-1.0]], noise=[[1.0]]), sf.GaussianMeasurement([[1.0]], [[0.1]])
    >>> flt = sf.SPHFilter(model, sensor, x0=[0.0], P0=[[1.0]])
    >>> result = flt.run(times=[0.5, 1.0], measurements=[0.3, None])
    >>> print(result.x.ravel().round(3), result.log_evidence.round(3), result.accepted)
    [0.262 0.159] [-0.855  0.   ] [ True  True]
    """

    t: np.ndarray
    x_prior: np.ndarray
    P_prior: np.ndarray
    x: np.ndarray
    P: np.ndarray
    log_evidence: np.ndarray
    accepted: np.ndarray

    def save(self, path):
        """Write the arrays to a ``.npz`` file."""
        np.savez_compressed(path, **{f.name: getattr(self, f.name) for f in fields(self)})

    @classmethod
    def load(cls, path):
        """Read what `save` wrote."""
        with np.load(path) as data:
            return cls(**{f.name: data[f.name] for f in fields(cls)})


def run_filter(filt, times, measurements):
    """Predict to each time and update with its measurement.

    Parameters
    ----------
    filt : object with ``predict(t=)``, ``update(z)``, ``t``, ``x``, ``P``, ``log_likelihood``
    times : array_like, shape (T,)
        Absolute times, seconds, not decreasing and none before ``filt.t``. A time equal to the filter's
        own is not predicted to, so repeated times and ``times[0] == t0`` are updates only.
    measurements : sequence of length T
        One measurement a time; None or NaN where none came.

    Returns
    -------
    FilterResult
    """
    times = np.asarray(times, dtype=float)
    if times.ndim != 1 or len(times) != len(measurements):
        raise ModelError(
            f"run needs as many measurements as times; got times of shape {times.shape} "
            f"and {len(measurements)} measurements"
        )
    if len(times) and (not np.all(np.isfinite(times)) or np.any(np.diff(times) < 0) or times[0] < filt.t):
        raise ModelError(
            f"times must be finite, not decreasing and not before the filter's own time {filt.t:g}"
        )
    rows = [_epoch(filt, t, z) for t, z in zip(times, measurements, strict=True)]
    n = len(filt.x)
    empty = {"x_prior": (0, n), "P_prior": (0, n, n), "x": (0, n), "P": (0, n, n)}
    names = ("x_prior", "P_prior", "x", "P", "log_evidence", "accepted")
    columns = (
        {name: np.array(column) for name, column in zip(names, zip(*rows, strict=True), strict=True)}
        if rows
        else {name: np.empty(empty.get(name, (0,))) for name in names}
    )
    columns["accepted"] = columns["accepted"].astype(bool)
    return FilterResult(t=times, **columns)


def _epoch(filt, t, z):
    if t > filt.t:
        filt.predict(t=t)
    x_prior, P_prior = filt.x.copy(), filt.P.copy()
    info = filt.update(z)
    return x_prior, P_prior, filt.x.copy(), filt.P.copy(), filt.log_likelihood, info.accepted
