"""Is a filter as good as it says? Normalised errors over runs, and the intervals they must fall in.

Arrays only: runs first, then epochs, (R, T, ...); without the run axis, (T, ...), for a single run. A run
that is NaN (the filter failed) is left out of averages, and the number left is returned. Mathematics of 002
6.5 and Bar-Shalom, Li & Kirubarajan (2001) 5.4; the intervals of 002 (65), (66) and (68) are corrected here.
"""

from collections.abc import Sequence
from typing import overload

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaincinv, ndtri

from .._types import Bools, Floats, Ints
from ..errors import ModelError


def distance(x: ArrayLike, mean: ArrayLike, cov: ArrayLike) -> Floats:
    """Mahalanobis distance: how many standard deviations x lies from the mean of N(mean, cov).

    It is |L⁻¹ (x − mean)| with L Lᵀ = cov; its square is what `nees` and `nis` are.

    Parameters
    ----------
    x, mean : array_like, shape (..., n)
    cov : array_like, shape (..., n, n)
        The leading axes of the three are broadcast.

    Returns
    -------
    float or ndarray, shape (...)
        NaN where an argument is; infinite where a covariance is not positive definite.

    Raises
    ------
    ModelError
        Shapes that do not fit.

    Examples
    --------
    >>> from sphfilter import consistency
    >>> print(consistency.distance([[1.5, 2.0], [1.0, 5.0]], [1.0, 2.0], [[0.25, 0.0], [0.0, 1.0]]))
    [1. 3.]
    """
    e, cov = np.subtract(x, mean, dtype=float), np.asarray(cov, dtype=float)
    leading = np.broadcast_shapes(e.shape[:-1], cov.shape[:-2])
    e, cov = np.broadcast_to(e, leading + e.shape[-1:]), np.broadcast_to(cov, leading + cov.shape[-2:])
    return np.sqrt(nis(e, cov))[()]


def nees(truth: ArrayLike, mean: ArrayLike, cov: ArrayLike) -> Floats:
    """Normalised estimation error squared, 002 (63): χ² with n degrees of freedom for a consistent filter.

    Parameters
    ----------
    truth, mean : array_like, shape (R, T, n) or (T, n)
    cov : array_like, shape (R, T, n, n) or (T, n, n)

    Returns
    -------
    ndarray, shape (R, T) or (T,)
        NaN, infinite or an error as in `distance`.

    Examples
    --------
    >>> from sphfilter import consistency
    >>> print(consistency.nees([[1.0, 2.0]], [[1.5, 2.0]], [[[0.25, 0.0], [0.0, 1.0]]]))
    [1.]
    """
    truth, mean, cov = _checked(truth, mean, cov)
    return _normalised_square(mean - truth, cov)


def nis(innovation: ArrayLike, S: ArrayLike) -> Floats:
    """Normalised innovation squared: χ² with k degrees of freedom for a consistent filter.

    Parameters
    ----------
    innovation : array_like, shape (R, T, k) or (T, k)
        Measurement minus its prediction.
    S : array_like, shape (R, T, k, k) or (T, k, k)
        Covariance of the innovation.

    Returns
    -------
    ndarray, shape (R, T) or (T,)
        As in `nees`.

    Examples
    --------
    >>> from sphfilter import consistency
    >>> print(consistency.nis([[2.0], [0.0]], [[[4.0]], [[4.0]]]))
    [1. 0.]
    """
    return nees(np.zeros(np.shape(innovation)), innovation, S)


def nmee(truth: ArrayLike, mean: ArrayLike, cov: ArrayLike) -> Floats:
    """Normalised mean estimation error: the summands of 002 (67), which are N(0, 1) for a consistent filter.

    Returns
    -------
    ndarray, shape (R, T, n) or (T, n)
        (mean − truth) / standard deviation for each state; NaN where an argument is, infinite where the
        variance is not positive. `run_average` of these numbers is 002 (67).

    Examples
    --------
    >>> from sphfilter import consistency
    >>> print(consistency.nmee([[1.0, 2.0]], [[1.5, 2.0]], [[[0.25, 0.0], [0.0, 1.0]]]))
    [[1. 0.]]
    """
    truth, mean, cov = _checked(truth, mean, cov)
    sd = np.sqrt(np.maximum(np.diagonal(cov, axis1=-2, axis2=-1), 0.0))
    error = mean - truth
    return np.divide(error, sd, out=np.where(np.isnan(error), np.nan, np.inf), where=sd != 0)


def _checked(truth: ArrayLike, mean: ArrayLike, cov: ArrayLike) -> tuple[Floats, Floats, Floats]:
    truth, mean, cov = (np.asarray(a, dtype=float) for a in (truth, mean, cov))
    if truth.shape != mean.shape or mean.ndim < 1 or cov.shape != (*mean.shape, mean.shape[-1]):
        raise ModelError(
            "errors need shapes (..., n), (..., n) and a covariance (..., n, n); "
            f"got {truth.shape}, {mean.shape} and {cov.shape}"
        )
    return truth, mean, cov


def _normalised_square(e: Floats, P: Floats) -> Floats:
    """Return eᵀ P⁻¹ e over the leading axes."""
    known: Bools = np.all(np.isfinite(e), axis=-1) & np.all(np.isfinite(P), axis=(-2, -1))
    e, P = np.where(known[..., None], e, 0.0), np.where(known[..., None, None], P, np.eye(e.shape[-1]))
    # in the units of the standard deviations, so that metres and radians may share a state
    variance = np.diagonal(P, axis1=-2, axis2=-1)
    scale = np.sqrt(np.where(variance > 0, variance, 1.0))
    w, V = np.linalg.eigh(P / (scale[..., :, None] * scale[..., None, :]))
    definite: Bools = np.all(w > 1e-14, axis=-1)
    y = np.einsum("...ij,...i->...j", V, e / scale)
    square = np.sum(y**2 / np.where(definite[..., None], w, 1.0), axis=-1)
    return np.where(known, np.where(definite, square, np.inf), np.nan)


def run_average(values: ArrayLike) -> tuple[Floats, Ints]:
    """Average over the runs, 002 (64) and (67).

    Parameters
    ----------
    values : array_like, shape (R, T, ...)

    Returns
    -------
    average : ndarray, shape (T, ...)
        NaN where no run is left.
    n_runs : ndarray of int, shape (T, ...)
        Runs that the average is of; runs that are NaN are left out.

    Examples
    --------
    >>> import numpy as np
    >>> from sphfilter import consistency
    >>> average, n_runs = consistency.run_average([[1.0, 2.0], [3.0, np.nan]])
    >>> print(average, n_runs)
    [2. 2.] [2 1]
    """
    values = np.asarray(values, dtype=float)
    known = ~np.isnan(values)
    n_runs = known.sum(axis=0)
    total = np.where(known, values, 0.0).sum(axis=0)
    return np.where(n_runs > 0, total / np.maximum(n_runs, 1), np.nan), n_runs


@overload
def nees_bounds(dim: int, n_runs: int, alpha: float = 0.05, sided: int = 2) -> tuple[float, float]: ...


@overload
def nees_bounds(
    dim: int, n_runs: Ints | Sequence[int], alpha: float = 0.05, sided: int = 2
) -> tuple[Floats, Floats]: ...


def nees_bounds(
    dim: int, n_runs: int | Ints | Sequence[int], alpha: float = 0.05, sided: int = 2
) -> tuple[float | Floats, float | Floats]:
    """Interval of the run-averaged NEES (or NIS) of a consistent filter.

    002 (65), (66) with the factor 1/k_R in place of the printed 1/√k_R: the sum of k_R independent χ² of k_D
    degrees of freedom is χ² with k_R k_D, and the average is that divided by k_R.

    Parameters
    ----------
    dim : int
        k_D: states (NEES) or measured components (NIS).
    n_runs : int or array_like of int
        k_R.
    alpha : float
        Probability to fall outside.
    sided : int
        2, or 1 for the interval that starts at zero.

    Returns
    -------
    lower, upper : float or ndarray

    Examples
    --------
    >>> from sphfilter import consistency
    >>> print("{:.3f} {:.3f}".format(*consistency.nees_bounds(dim=2, n_runs=25)))
    1.294 2.857
    """
    alpha = _probability(alpha)
    if sided not in (1, 2):
        raise ModelError(f"sided must be 1 or 2, got {sided!r}")
    runs: Floats = np.asarray(n_runs, dtype=float)
    upper = _chi2(1.0 - alpha / sided, dim * runs) / runs
    lower = _chi2(alpha / 2.0, dim * runs) / runs if sided == 2 else np.zeros_like(upper)
    return lower[()], upper[()]


@overload
def nmee_bounds(n_runs: int, alpha: float = 0.05) -> tuple[float, float]: ...


@overload
def nmee_bounds(n_runs: Ints | Sequence[int], alpha: float = 0.05) -> tuple[Floats, Floats]: ...


def nmee_bounds(
    n_runs: int | Ints | Sequence[int], alpha: float = 0.05
) -> tuple[float | Floats, float | Floats]:
    """Interval of the run-averaged NMEE of a consistent filter: ±1.96/√k_R, where 002 (68) prints ±1.96.

    Returns
    -------
    lower, upper : float or ndarray

    Examples
    --------
    >>> from sphfilter import consistency
    >>> print("{:.3f} {:.3f}".format(*consistency.nmee_bounds(n_runs=25)))
    -0.392 0.392
    """
    upper = -ndtri(_probability(alpha) / 2.0) / np.sqrt(np.asarray(n_runs, dtype=float))
    return -upper[()], upper[()]


def _probability(alpha: float) -> float:
    if not 0 < alpha < 1:
        raise ModelError(f"alpha must lie between 0 and 1, got {alpha!r}")
    return alpha


def _chi2(p: float, dof: float | Floats) -> Floats:
    """Return the quantile of χ²."""
    return 2.0 * gammaincinv(dof / 2.0, p)


def fraction_inside(values: ArrayLike, bounds: tuple[float | Floats, float | Floats]) -> float | Floats:
    """Return the fraction of epochs whose value lies in the closed interval (lower, upper).

    Parameters
    ----------
    values : array_like, shape (T, ...)
        NaN is left out, of numerator and denominator.
    bounds : tuple of two, each a number or an array of the shape of `values`

    Returns
    -------
    float or ndarray, shape (...)
        NaN where nothing is left.

    Examples
    --------
    >>> from sphfilter import consistency
    >>> print(consistency.fraction_inside([0.5, 1.2, 9.0, 2.0], (0.1, 5.0)))
    0.75
    """
    values = np.asarray(values, dtype=float)
    inside = (values >= bounds[0]) & (values <= bounds[1])
    return run_average(np.where(np.isnan(values), np.nan, inside))[0][()]


def diverged(nees_values: ArrayLike, dim: int, window: int = 5, level: float = 0.9999) -> Bools:
    """Tell which runs have lost the truth at some time.

    The criterion: the NEES averaged over `window` successive updates (over all, if there are fewer) exceeds
    the `level` point of χ²_{window·n}/window. The level is nominal, since errors of successive updates are
    correlated: of exact Kalman filters with 40 updates of two states, 0.3 % count as diverged by chance when
    errors are independent, and 5 % when successive errors correlate by 0.4. Compare with a filter known to be
    consistent.

    Parameters
    ----------
    nees_values : array_like, shape (R, T) or (T,)
    dim : int
        States n.

    Returns
    -------
    ndarray of bool, shape (R,) or ()
        NaN does not exceed anything: a run that failed has not diverged by this criterion.

    Examples
    --------
    >>> import numpy as np
    >>> from sphfilter import consistency
    >>> print(consistency.diverged([np.ones(10), np.linspace(1.0, 90.0, 10)], dim=2))
    [False  True]
    """
    values = np.asarray(nees_values, dtype=float)
    window = min(window, values.shape[-1])
    if window == 0:
        return np.zeros(values.shape[:-1], dtype=bool)
    windows = np.lib.stride_tricks.sliding_window_view(values, window, axis=-1)
    return (windows.sum(axis=-1) > _chi2(level, window * dim)).any(axis=-1)


def whiteness(innovation: ArrayLike, S: ArrayLike, lag: int = 1) -> Floats:
    """Autocorrelation of the normalised innovations over time, one number a run.

    For a consistent filter the number is N(0, 1/((T − lag) k)) to leading order: `nmee_bounds` of (T − lag) k
    is its interval, and `nmee_bounds` of (T − lag) k R the interval of its average over R runs.

    Parameters
    ----------
    innovation, S
        As in `nis`; epochs with NaN are left out.
    lag : int
        Epochs apart, one or more.

    Returns
    -------
    ndarray, shape (R,) or ()
        NaN for a run without two successive innovations.

    Examples
    --------
    >>> import numpy as np
    >>> from sphfilter import consistency
    >>> drawn = np.random.default_rng(1).normal(size=(20, 50, 1))
    >>> print(abs(consistency.whiteness(drawn, np.ones((20, 50, 1, 1)))).max().round(1))
    0.3
    """
    now, later = _pairs(innovation, S, lag)
    size = np.sqrt(np.sum(now**2, axis=(-2, -1)) * np.sum(later**2, axis=(-2, -1)))
    return np.divide(
        np.sum(now * later, axis=(-2, -1)), size, out=np.full_like(size, np.nan), where=size > 0
    )[()]


def lagged_products(innovation: ArrayLike, S: ArrayLike, lag: int = 1) -> Floats:
    """Sum over time of the products of normalised innovations `lag` epochs apart, one number a run.

    The sum is zero on average for a filter that is right, whatever its densities; see `whiteness`.

    Returns
    -------
    ndarray, shape (R,) or ()
        NaN for a run without two such innovations.

    Examples
    --------
    >>> import numpy as np
    >>> from sphfilter import consistency
    >>> print(consistency.lagged_products([[1.0], [2.0], [-1.0]], np.ones((3, 1, 1))))
    0.0
    """
    now, later = _pairs(innovation, S, lag)
    total = np.sum(now * later, axis=(-2, -1))
    return np.where(np.any((now != 0) & (later != 0), axis=(-2, -1)), total, np.nan)[()]


def _pairs(innovation: ArrayLike, S: ArrayLike, lag: int) -> tuple[Floats, Floats]:
    """Normalised innovations and those `lag` epochs later; zero where one of the two is not known."""
    _, nu, cov = _checked(np.zeros(np.shape(innovation)), innovation, S)
    known: Bools = np.all(np.isfinite(nu), axis=-1) & np.all(np.isfinite(cov), axis=(-2, -1))
    known[known] = (np.linalg.eigvalsh(cov[known]) > 0).all(axis=-1)
    root = np.linalg.cholesky(np.where(known[..., None, None], cov, np.eye(nu.shape[-1])))
    w = np.linalg.solve(root, np.where(known[..., None], nu, 0.0)[..., None])[..., 0]
    both = (known[..., :-lag] & known[..., lag:])[..., None]
    return np.where(both, w[..., :-lag, :], 0.0), np.where(both, w[..., lag:, :], 0.0)
