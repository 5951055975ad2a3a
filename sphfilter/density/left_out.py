"""What a density leaves out: too little to be kept, far away, where the next reading may find the state."""

import math
from typing import NamedTuple

import numpy as np

from .._types import Bools, Floats
from ..core.limits import LARGEST_EXPONENT, LOOK, NOTHING
from ..lattice.check import Remote, felt, remote
from .quasi_random import systematic


class LeftOut(NamedTuple):
    """States x (K, n) of which a density knows nothing, and their probabilities, mass (K,)."""

    x: Floats
    mass: Floats

    def read(self, log_weight: Floats, chosen: Bools | bool = True) -> "LeftOut | None":
        """What a reading leaves of them, or of those chosen; None of less than rounding.

        By their log-likelihoods (K,) less the log-evidence.
        """
        mass = self.mass * np.exp(np.minimum(log_weight, LARGEST_EXPONENT))
        chosen = chosen & (mass > math.exp(-NOTHING))
        return LeftOut(self.x[chosen], mass[chosen]) if chosen.any() else None

    def beside(self, moments: tuple[Floats, Floats]) -> Remote:
        """What they would add to a density of this mean (n,) and covariance (n, n)."""
        return remote(*moments, self.x, self.mass)

    def with_others(self, others: "LeftOut | None", moments: tuple[Floats, Floats]) -> "LeftOut":
        """These and others beside a density of these moments: some hundreds at most, by what they count."""
        x, mass = self if others is None else map(np.concatenate, zip(self, others, strict=True))
        times, many = felt(*moments, x), 8 * LOOK
        chosen = systematic(mass * times / (mass @ times), many)
        return (
            LeftOut(x, mass) if len(mass) <= many else LeftOut(x[chosen], mass @ times / many / times[chosen])
        )
