"""Errors of one run against its reference, against the truth, and of a set of runs."""

from dataclasses import dataclass

import numpy as np

from experiments.show.comparison import moment_errors, rms
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
    mean, cov = moment_errors(result.x, result.P, reference.x, reference.P)
    return Errors(
        mean=rms(mean),
        worst=float(mean.max()),
        cov=rms(cov),
        evidence=rms(result.log_evidence - reference.log_evidence),
        total=float(abs(np.sum(result.log_evidence) - np.sum(reference.log_evidence))),
    )


def truth_errors(result, truth):
    """Root-mean-square error of each state (n,), and NEES, both over the epochs of a run."""
    rmse = np.sqrt(np.mean((result.x - truth) ** 2, axis=0))
    return rmse, float(np.mean(consistency.nees(truth, result.x, result.P)))


def root_mean_square(values):
    """Root mean square of what is finite; NaN of nothing."""
    values = np.asarray(values, dtype=float)
    values = values[np.isfinite(values)]
    return rms(values) if values.size else np.nan
