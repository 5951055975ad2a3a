"""The length of the next step, and numbers that many files share."""

import math

import numpy as np
import pytest

from sphfilter.core import limits
from sphfilter.core.step_control import GROW, next_step


@pytest.mark.parametrize("order", [3.0, 4.0, 5.0])
def test_a_step_that_is_as_wrong_as_allowed_is_followed_by_one_nine_tenths_as_long(order):
    assert next_step(2.0, 1.0, order) == 1.8
    assert next_step(2.0, 2.0**-order, order) == pytest.approx(3.6)


@pytest.mark.parametrize(
    ("over", "times"), [(0.0, GROW), (1e-300, GROW), *((bad, 1 / GROW) for bad in (1e300, np.inf, np.nan))]
)
def test_no_step_is_followed_by_one_of_another_size(over, times):
    assert next_step(0.5, over, 3.0) == 0.5 * times


def test_limits_are_where_double_precision_ends():
    eps = np.finfo(float).eps
    least, nothing = math.exp(-limits.NOTHING), math.exp(-limits.NOTHING - 1.0)
    assert least + 1.0 > 1.0 and nothing + 1.0 == 1.0
    assert pytest.approx(eps) == limits.ROUNDING**2 and np.isfinite(1.0 / limits.TINY)
    assert np.finfo(float).tiny < limits.TINY and np.isfinite(1e3 * math.exp(limits.LARGEST_EXPONENT))
    assert math.erfc(limits.EDGE / math.sqrt(2.0)) == pytest.approx(2e-9, rel=0.02)
