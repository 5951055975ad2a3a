"""Is a filter as good as it says? Normalised errors over runs, and the intervals they must fall in."""

from .normalised import (
    distance,
    diverged,
    fraction_inside,
    lagged_products,
    nees,
    nees_bounds,
    nis,
    nmee,
    nmee_bounds,
    run_average,
    whiteness,
)

__all__ = ["distance", "diverged", "fraction_inside", "lagged_products", "nees", "nees_bounds", "nis",
           "nmee", "nmee_bounds", "run_average", "whiteness"]  # fmt: skip
