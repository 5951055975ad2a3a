"""Steps as long as an error allows, and tries as large: one rule for all marches."""

import numpy as np

from ._jit import jit
from .limits import TINY

#: Part of the step that the error would allow, and times the last one at most: h min(5, .9 over^(-1/order)),
#: as (4.13) of chapter II of Hairer, Nørsett & Wanner (1993), who take .8 to .9, and 1.5 to 5.
_SAFETY, GROW = 0.9, 5.0
MORE = 4.0  # times the points or nodes of one try, that the next one may have: what tells it may be chance
TRIES = 3  # larger tries after the first: with MORE^TRIES = 64 times the points an error is an eighth
HELPED = 0.7  # times an error, below which another try has to bring it: twice the points leave 2^-.6 = .66


@jit
def next_step(h, over, order):
    """The step after one of length h that was `over` times as wrong as allowed; no number shrinks it most.

    One that is refused shrinks by no more than the next may grow.
    """
    least = 1.0 / GROW
    longer = _SAFETY * max(over, TINY) ** (-1.0 / order) if over < np.inf else least
    return h * min(GROW, max(least, longer))
