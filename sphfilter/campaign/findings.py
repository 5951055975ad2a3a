"""What the innovations and the ranks of a campaign's runs say of a filter, as numbers."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import consistency
from .._types import Bools, Floats, Ints
from ..consistency import p_values

__all__ = ["Innovations", "Ranks", "innovations_of", "ranks_of"]


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


def innovations_of(
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
    bounds = consistency.nees_bounds(1, np.maximum(dof.sum(axis=0), 1))
    return Innovations(
        n_measurements=int(came.sum()),
        acceptance=_ratio(np.sum(came & accepted), came.sum()),
        nis=_ratio(square[told].sum(), dof[told].sum()),
        nis_accepted=_ratio(square[used].sum(), dof[used].sum()),
        nis_inside=float(consistency.fraction_inside(_ratios(square * told, dof), bounds)),
        whiteness=float(np.nanmean(white)) if np.isfinite(white).any() else np.nan,
        whiteness_p=p_values.same_mean(products[:, None], 0.0),
    )


def ranks_of(pit: Floats, state_pit: Floats, hpd_rank: Floats) -> Ranks:
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


def _ratios(square: Floats, dof: Ints) -> Floats:
    """Sums over the runs per degree of freedom, shape (T,); NaN where nothing came."""
    total = dof.sum(axis=0)
    return np.where(total > 0, square.sum(axis=0) / np.maximum(total, 1), np.nan)
