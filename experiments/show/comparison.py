"""Distances from a reference: of means and covariances, and of filters from the one that is exact."""

from dataclasses import dataclass

import numpy as np

from sphfilter import consistency


@dataclass(frozen=True)
class Distance:
    """Root mean squares over runs and epochs of the distance from a reference filter."""

    mean: float  # |L⁻¹ (m − m_ref)| with L Lᵀ = C_ref: reference standard deviations
    cov: float  # ‖L⁻¹ (C − C_ref) L⁻ᵀ‖ (Frobenius) over √n
    evidence: float  # difference of the log-evidence of a measurement, nats


def reference_name(scenario, names):
    """Name of the filter to compare with: the exact one, else the grid; None if neither runs."""
    return next((name for name in (scenario.settings.exact, "grid") if name in names), None)


def distances(results, reference):
    """`Distance` of every other filter from the `reference`, by name; results have runs first."""
    return {name: distance(r, results[reference]) for name, r in results.items() if name != reference}


def distance(result, reference):
    """Distance of one filter's results from another's, runs first; NaN where no run has both."""
    done = np.isfinite(result.x).all(axis=(1, 2)) & np.isfinite(reference.x).all(axis=(1, 2))
    if not done.any():
        return Distance(np.nan, np.nan, np.nan)
    mean, cov = moment_errors(result.x[done], result.P[done], reference.x[done], reference.P[done])
    return Distance(rms(mean), rms(cov), rms((result.log_evidence - reference.log_evidence)[done]))


def moment_errors(x, P, x_ref, P_ref):
    """Errors (...) of means (..., n) and covariances (..., n, n) in the reference's standard deviations.

    They are |L⁻¹ (x − x_ref)| and ‖L⁻¹ (P − P_ref) L⁻ᵀ‖ (Frobenius) over √n, with P_ref = L Lᵀ.
    """
    # in units of the standard deviations, so that metres and radians may share a state
    pairs = _scale_of(P_ref)
    L = np.linalg.cholesky(P_ref / pairs)
    half = np.linalg.solve(L, (P - P_ref) / pairs)
    off = np.linalg.solve(L, np.swapaxes(half, -1, -2))
    n = P_ref.shape[-1]
    return consistency.distance(x, x_ref, P_ref), np.linalg.norm(off, axis=(-2, -1)) / np.sqrt(n)


def least_eigenvalue(P):
    """Least eigenvalue of all covariances (T, n, n), each scaled to a unit diagonal; 1 of none."""
    return float(np.linalg.eigvalsh(P / _scale_of(P)).min(initial=1.0))


def _scale_of(P):
    """Products of standard deviations, shape (..., n, n)."""
    scale = np.sqrt(np.diagonal(P, axis1=-2, axis2=-1))
    return scale[..., :, None] * scale[..., None, :]


def rms(values):
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
