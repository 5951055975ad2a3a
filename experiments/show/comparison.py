"""Distance of every filter from the one that is exact (or the referee), epoch by epoch."""

from dataclasses import dataclass

import numpy as np

__all__ = ["Distance", "distance", "distances", "reference_name"]


@dataclass(frozen=True)
class Distance:
    """Root mean squares over runs and epochs of the distance from a reference filter.

    Attributes
    ----------
    mean : float
        |L⁻¹ (m − m_ref)| with L Lᵀ = C_ref: reference standard deviations.
    cov : float
        ‖L⁻¹ (C − C_ref) L⁻ᵀ‖ (Frobenius) over √n.
    evidence : float
        Difference of the log-evidence of a measurement, nats.
    """

    mean: float
    cov: float
    evidence: float


def reference_name(scenario, names):
    """Name of the filter to compare with: the exact one, else the grid; None if neither runs."""
    return next((name for name in (scenario.settings.exact, "grid") if name in names), None)


def distances(results, reference):
    """Distance of every other filter from `reference`.

    Parameters
    ----------
    results : dict of str to FilterResult, runs first
    reference : str

    Returns
    -------
    dict of str to Distance
    """
    return {name: distance(r, results[reference]) for name, r in results.items() if name != reference}


def distance(result, reference):
    """Distance of one filter's results from another's, runs first; NaN where no run has both."""
    done = np.isfinite(result.x).all(axis=(1, 2)) & np.isfinite(reference.x).all(axis=(1, 2))
    if not done.any():
        return Distance(np.nan, np.nan, np.nan)
    L = np.linalg.cholesky(reference.P[done])
    mean = np.linalg.solve(L, (result.x - reference.x)[done][..., None])
    half = np.linalg.solve(L, (result.P - reference.P)[done])
    cov = np.linalg.solve(L, np.swapaxes(half, -1, -2))
    n = result.x.shape[-1]
    evidence = (result.log_evidence - reference.log_evidence)[done]
    return Distance(
        mean=float(np.sqrt(np.mean(np.sum(mean**2, axis=(-2, -1))))),
        cov=float(np.sqrt(np.mean(np.sum(cov**2, axis=(-2, -1))) / n)),
        evidence=float(np.sqrt(np.mean(evidence**2))),
    )
