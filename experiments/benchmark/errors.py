"""Errors of one run against its reference, against the truth, and of a set of runs."""

from dataclasses import dataclass, fields, replace

import numpy as np

from experiments.show.comparison import distance
from sphfilter import consistency

__all__ = ["Errors", "errors", "root_mean_square", "truth_errors"]


@dataclass(frozen=True)
class Errors:
    """Distance of a run from the reference, root mean squares over its epochs.

    Attributes
    ----------
    mean : float
        |L⁻¹ (m − m_ref)| with L Lᵀ = C_ref: posterior standard deviations.
    worst : float
        The largest of it.
    cov : float
        ‖L⁻¹ (C − C_ref) L⁻ᵀ‖ (Frobenius) over √n.
    evidence : float
        Log-evidence of a measurement, nats.
    total : float
        |Log-evidence of the whole run|, nats.
    """

    mean: float
    worst: float
    cov: float
    evidence: float
    total: float


def errors(result, reference):
    """Errors of a `FilterResult` against that of the reference."""
    d = distance(_as_runs(result), _as_runs(reference))
    white = np.linalg.solve(np.linalg.cholesky(reference.P), (result.x - reference.x)[..., None])
    return Errors(
        mean=d.mean,
        worst=float(np.linalg.norm(white, axis=(1, 2)).max()),
        cov=d.cov,
        evidence=d.evidence,
        total=float(abs(np.sum(result.log_evidence) - np.sum(reference.log_evidence))),
    )


def truth_errors(result, truth):
    """Root-mean-square error of each state (n,), and NEES, both over the epochs of a run."""
    rmse = np.sqrt(np.mean((result.x - truth) ** 2, axis=0))
    one = _as_runs(result)
    return rmse, float(np.mean(consistency.nees(truth[None], one.x, one.P)))


def root_mean_square(values):
    """Root mean square of what is finite; NaN of nothing."""
    values = np.asarray(values, dtype=float)
    values = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(values**2))) if values.size else np.nan


def _as_runs(result):
    """The result with a first axis for runs, one long."""
    histories = {f.name: getattr(result, f.name)[None] for f in fields(result) if f.name != "t"}
    return replace(result, **histories)
