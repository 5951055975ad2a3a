"""Student's intervals of a mean that was found by groups of samples, and how far another value is from it.

000 section 4.1.2. The samples are split into G groups; each gives the statistic once. Groups being large,
their values are normal, and their mean minus the exact value, over its standard error, is Student's t with
G − 1 degrees of freedom.
"""

import numpy as np
from scipy.stats import t as student

from sphfilter import validate
from sphfilter.errors import ModelError


def interval_factor(n_groups, level=0.95):
    """Half width of the interval in standard deviations of a group, Q(½ + level/2) / √G: 000 (142).

    Of ten groups it is .7154 at 95 %; 000 (143) prints .714.
    """
    n_groups = validate.count("n_groups", n_groups, 2)
    level = validate.real("level", level)
    if not 0.0 < level < 1.0:
        raise ModelError(f"level must lie between 0 and 1, such as 0.95; got {level!r}.")
    return float(student.ppf(0.5 + 0.5 * level, n_groups - 1)) / np.sqrt(n_groups)


def standard_error(group_values):
    """Standard error Δm / √G of the mean of G groups, 000 (138).

    Parameters
    ----------
    group_values : array_like, shape (G, ...)
        The statistic as each group of samples gives it; groups have equal sizes.
    """
    values = _checked(group_values)
    return values.std(axis=0, ddof=1) / np.sqrt(len(values))


def mean_interval(group_values, level=0.95):
    """Lower and upper end of the interval that holds the exact value with probability `level`, 000 (142).

    Parameters
    ----------
    group_values : array_like, shape (G, ...)
    level : float

    Returns
    -------
    low, high : ndarray, shape (...)
    """
    values = _checked(group_values)
    mean, half = values.mean(axis=0), interval_factor(len(values), level) * values.std(axis=0, ddof=1)
    return mean - half, mean + half


def pivot(group_values, value, level=0.95):
    """Normalised pivot Ẑ of `value`, shape (...): within ±1 where the interval holds it, 000 (144).

    Zero where the groups and the value all agree, infinite where the groups agree on something else.

    Parameters
    ----------
    group_values : array_like, shape (G, ...)
    value : array_like, shape (...)
        What another method gives for the statistic.
    level : float
    """
    values = _checked(group_values)
    difference = values.mean(axis=0) - np.asarray(value, dtype=float)
    half = interval_factor(len(values), level) * values.std(axis=0, ddof=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(difference == 0.0, 0.0, difference / half)


def _checked(group_values):
    values = np.asarray(group_values, dtype=float)
    if values.ndim == 0 or len(values) < 2:
        raise ModelError(f"an interval needs the values of two groups or more, got shape {values.shape}.")
    return values
