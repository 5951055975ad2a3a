"""Errors of one run against its reference, against the truth, and of a set of runs."""

from dataclasses import dataclass

import numpy as np

from experiments.show.comparison import Distance, moment_errors, rms
from sphfilter import consistency


@dataclass(frozen=True)
class Errors(Distance):
    """Distance of a run from the reference, root mean squares over its epochs."""

    worst: float  # the largest |L⁻¹ (m − m_ref)|, whose root mean square is `mean`
    total: float  # |log-evidence of the whole run|, nats


def errors(result, reference):
    """Errors of a `FilterResult` against that of the reference."""
    mean, cov = moment_errors(result.x, result.P, reference.x, reference.P)
    evidence = rms(result.log_evidence - reference.log_evidence)
    total = abs(np.sum(result.log_evidence) - np.sum(reference.log_evidence))
    return Errors(rms(mean), rms(cov), evidence, float(mean.max()), float(total))


def left_by_epoch(result, reference):
    """Errors of the mean at every epoch (T,), root mean squares over the states: what `info.error` tells."""
    mean, _ = moment_errors(result.x, result.P, reference.x, reference.P)
    return mean / np.sqrt(result.x.shape[1])


def truth_errors(result, truth):
    """Root-mean-square error of each state (n,), and NEES, both over the epochs of a run."""
    rmse = np.sqrt(np.mean((result.x - truth) ** 2, axis=0))
    return rmse, float(np.mean(consistency.nees(truth, result.x, result.P)))


def root_mean_square(values):
    """Root mean square of what is finite; NaN of nothing."""
    values = np.asarray(values, dtype=float)
    values = values[np.isfinite(values)]
    return rms(values) if values.size else np.nan
