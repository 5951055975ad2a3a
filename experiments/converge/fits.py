"""Orders of convergence: slopes of straight lines through logarithms, and how sure they are."""

from typing import NamedTuple

import numpy as np

__all__ = ["Order", "fitted_order"]


_ROUNDING = 1e-12  # errors of which nothing can be said


class Order(NamedTuple):
    """Slope of log(error) over log(size) and its standard error; NaN where too few errors are known."""

    slope: float
    spread: float

    def __str__(self):
        if not np.isfinite(self.slope):
            return "-"
        return f"{self.slope:.2f}" + (f" ± {self.spread:.2f}" if np.isfinite(self.spread) else "")


def fitted_order(sizes, errors):
    """Fit errors (K,) ~ sizes (K,) ** order by least squares of the logarithms.

    The spread is the standard error of the slope from the residuals; it takes three errors, and is large
    where the errors bend, for instance towards a floor. Rounding errors are left out.
    """
    sizes, errors = np.asarray(sizes, dtype=float), np.asarray(errors, dtype=float)
    known = np.isfinite(errors) & (errors > _ROUNDING) & (sizes > 0)
    x, y = np.log(sizes[known]), np.log(errors[known])
    if len(np.unique(x)) < 2:
        return Order(np.nan, np.nan)
    off = x - x.mean()
    slope = float(off @ y / (off @ off))
    if len(x) < 3:
        return Order(slope, np.nan)
    residuals = y - y.mean() - slope * off
    return Order(slope, float(np.sqrt(residuals @ residuals / (len(x) - 2) / (off @ off))))
