"""How surprising a campaign's figures would be of a filter that is right: p-values over independent runs.

Epochs of a run are correlated, runs are not: what varies between runs says how far an average may stray.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import bdtrc, chdtrc, stdtr

from .._types import Bools, Floats
from ..errors import ModelError

#: Runs from which on the deviation between them is known within a quarter: 1 / √(2 (R - 1)) = .24 of it.
FEWEST_RUNS = 10


def histogram(ranks: ArrayLike, bins: int = 10) -> Floats:
    """Fraction of the ranks (...) in each of `bins` equal parts of (0, 1), shape (bins,); NaN left out."""
    known = _finite(ranks)
    return np.histogram(known, bins, (0.0, 1.0))[0] / max(len(known), 1)


def _finite(values: ArrayLike) -> Floats:
    every: Floats = np.asarray(values, dtype=float)
    return every[np.isfinite(every)]


def uniform_epochs(ranks: ArrayLike) -> float:
    """p-value of the ranks (...) being uniform and all independent: Kolmogorov and Smirnov's test.

    Predictions' ranks of scalar measurements are, of a filter that is right, whatever its model (Diebold et
    al. 1998). Ranks that are NaN are left out; the p-value is NaN for fewer than eight ranks.
    """
    from scipy import stats  # on use: import time

    known = _finite(ranks)
    return float(stats.kstest(known, "uniform").pvalue) if len(known) >= 8 else np.nan


def uniform_runs(ranks: ArrayLike, bins: int = 10) -> float:
    """p-value of the ranks (R, T) being uniform, correlated within a run and independent between runs.

    Pearson's statistic, with the correction of second order for clusters (J. N. K. Rao & A. J. Scott, J. Am.
    Stat. Assoc. 76, 1981): the variation of the fractions between runs says how the statistic is distributed.
    Runs that are NaN somewhere are left out; the p-value is NaN for fewer than `FEWEST_RUNS` runs.
    """
    every: Floats = np.asarray(ranks, dtype=float)
    if every.ndim != 2:
        raise ModelError(f"ranks must be (runs, epochs), got shape {every.shape}")
    whole = every[np.isfinite(every).all(axis=1)]
    R, T = whole.shape
    if R < FEWEST_RUNS or T == 0:
        return np.nan
    fractions = np.array([histogram(run, bins) for run in whole])
    off = fractions.mean(axis=0) - 1.0 / bins
    # the statistic is a sum of squares of normals with these variances
    effects = bins * np.cov(fractions, rowvar=False) / R
    total, square = np.trace(effects), np.sum(effects**2)
    statistic = bins * np.sum(off**2)
    if total == 0.0:
        return float(statistic == 0.0)
    return float(chdtrc(total**2 / square, statistic * total / square))


def same_mean(values: ArrayLike, expected: float) -> float:
    """p-value of the runs' averages of values (R, T) having the expected mean: Student's t.

    Values that are NaN are left out; the p-value is NaN for fewer than `FEWEST_RUNS` runs.
    """
    values = np.asarray(values, dtype=float)
    known = np.isfinite(values)
    n = known.sum(axis=1)
    averages = (np.where(known, values, 0.0).sum(axis=1) / np.maximum(n, 1))[n > 0]
    if len(averages) < FEWEST_RUNS:
        return np.nan
    spread = averages.std(ddof=1) / np.sqrt(len(averages))
    off = averages.mean() - expected
    return float(2.0 * stdtr(len(averages) - 1, -abs(off) / spread)) if spread > 0 else float(off == 0.0)


def more_exits(count: int, of_referee: int, total: int, least: float = 0.05) -> float:
    """p-value of `count` epochs of `total` lying outside, if a referee's fraction is the rate: binomial.

    Where the referee's rate is lower than `least`, which is the rate of a Gaussian, `least` is taken: the
    referee's luck is no standard.
    """
    rate = max(of_referee / total, least)
    return float(bdtrc(count - 1, total, rate) if count else 1.0)


def more_lost(count: int, of_referee: int, total: int) -> float:
    """p-value of `count` of `total` runs being no more than the referee's, by Fisher's exact test."""
    from scipy import stats  # on use: import time

    table = [[count, total - count], [of_referee, total - of_referee]]
    return float(stats.fisher_exact(table, alternative="greater").pvalue)


def holm(p_values: ArrayLike, level: float = 0.01) -> Bools:
    """Which hypotheses are refused, all of them right with probability 1 − level at least: Holm's method.

    Of p-values (K,), NaN where a hypothesis was not tested.
    """
    p = np.asarray(p_values, dtype=float)
    out = np.zeros(len(p), dtype=bool)
    order = np.argsort(p)
    left = int(np.isfinite(p).sum())
    for i in order[:left]:
        if p[i] > level / left:
            break
        out[i], left = True, left - 1
    return out
