"""The verdict on a run: ok, refused, no reference, timeout or wrong."""

from dataclasses import dataclass

import numpy as np

from experiments.show.comparison import least_eigenvalue, moment_errors, rms
from sphfilter.consistency import nees

__all__ = ["LIMITS", "VERDICTS", "Verdict", "judge", "trusted"]

#: Verdicts from good to bad, and what each means.
VERDICTS = {
    "ok": "agrees with the reference",
    "refused": "said in a sentence that it cannot",
    "no reference": "none that is certain; finite, of mass one, positive definite, truth not absurd",
    "timeout": "stopped after the time limit",
    "wrong": "a wrong answer, or an unexpected exception",
}
#: Allowed error of mean and covariance, in posterior standard deviations.
LIMITS = {"mean": 0.10, "cov": 0.25}
#: A reference's own error must be this much smaller.
_CERTAIN = 0.2
#: Eigenvalue of a covariance scaled to a unit diagonal that rounding may leave; NEES no filter may exceed.
_ROUNDING, _NEES_PER_STATE = -1e-9, 25.0


@dataclass(frozen=True)
class Verdict:
    """Verdict on one run, errors rms over its updates (NaN without a reference), worst mean error."""

    verdict: str
    sentence: str
    mean: float = np.nan
    cov: float = np.nan
    worst: float = np.nan
    evidence: float = np.nan


def trusted(reference):
    """Tell whether the reference's own error is at most a fifth of what is allowed."""
    return (
        reference.name != ""
        and reference.mean_error <= _CERTAIN * LIMITS["mean"]
        and reference.cov_error <= _CERTAIN * LIMITS["cov"]
    )


def judge(outcome, reference):
    """Judge a run.

    Parameters
    ----------
    outcome : Outcome
        Of a filter, complete or up to where it was refused.
    reference : Reference

    Returns
    -------
    Verdict
    """
    if outcome.end == "timeout":
        return Verdict("timeout", outcome.sentence)
    if outcome.end == "crashed":
        return Verdict("wrong", outcome.sentence)
    fault = _fault(outcome)
    if fault:
        return Verdict("wrong", fault)
    errors, far = _errors(outcome, reference) if trusted(reference) and len(outcome.x) else ({}, "")
    if far and outcome.rejection:
        return Verdict("refused", f"measurement refused: {outcome.rejection}", **errors)
    if far:
        return Verdict("wrong", far, **errors)
    if outcome.end == "refused":
        return Verdict("refused", outcome.sentence, **errors)
    if errors:
        return Verdict("ok", "", **errors)
    return _without_reference(outcome, reference)


def _fault(outcome):
    """Return what no run may show whatever the reference, or an empty string."""
    if not (np.isfinite(outcome.x).all() and np.isfinite(outcome.P).all()):
        return "a mean or covariance is not finite"
    if not np.isfinite(outcome.log_evidence).all():
        return "an evidence is not finite"
    variance = np.diagonal(outcome.P, axis1=1, axis2=2)
    if not (variance > 0).all():
        return f"a variance is {variance.min():.3g}"
    if (least := least_eigenvalue(outcome.P)) < _ROUNDING:
        return f"a covariance has a negative eigenvalue, {least:.2g} of its diagonal"
    if abs(outcome.mass - 1.0) > 1e-9:
        return f"the masses sum to {outcome.mass:.6g}"
    return outcome.breach


def _errors(outcome, reference):
    """Errors over the updates done, and a sentence if they are larger than allowed."""
    k = len(outcome.x)
    mean, cov = moment_errors(outcome.x, outcome.P, reference.x[:k], reference.P[:k])
    errors = {"mean": rms(mean), "cov": rms(cov), "worst": float(mean.max())}
    errors["evidence"] = float(abs(outcome.log_evidence.sum() - reference.log_evidence[:k].sum()))
    far = [f"{what} error {errors[what]:.2g}" for what in LIMITS if not errors[what] < LIMITS[what]]
    return errors, ", ".join(far)


def _without_reference(outcome, reference):
    """Only what can be said without one: the truth must not be absurd to the filter."""
    if reference.truth is not None:
        level = nees(reference.truth, outcome.x, outcome.P).mean() / outcome.x.shape[1]
        if not level < _NEES_PER_STATE:
            return Verdict("wrong", f"no reference, and a NEES of {level:.3g} a state where one is expected")
    return Verdict("no reference", reference.why)
