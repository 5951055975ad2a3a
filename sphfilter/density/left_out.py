"""What a density leaves out: too little to be kept, far away, where the next reading may find the state."""

import math
from typing import Any, NamedTuple

import numpy as np

from .._types import Floats
from ..core.limits import LARGEST_EXPONENT, LOOK, NOTHING
from ..lattice.check import Remote, felt, remote
from ..lattice.resolved import HIGHER
from .quasi_random import systematic


class LeftOut(NamedTuple):
    """States x (K, n) of which a density knows nothing, and their probabilities, mass (K,)."""

    x: Floats
    mass: Floats

    @classmethod
    def of(cls, new: Any, x: Floats, mass: Floats, log_p: Floats) -> "LeftOut | None":
        """Those of states with masses, of log-density `log_p` (K,), of which `new` knows too little."""
        some = log_p > -np.inf  # behind a wall neither knows of any
        x, mass, known = x[some], mass[some], new.logpdf(x[some]) if some.any() else 0.0
        return cls(x, np.where(log_p[some] - known > HIGHER, mass, 0.0)).read(np.zeros(len(x)))

    def read(self, log_weight: Floats) -> "LeftOut | None":
        """What is left, more than rounding, of log-likelihoods (K,) less the log-evidence."""
        mass = self.mass * np.exp(np.minimum(log_weight, LARGEST_EXPONENT))
        kept = mass > math.exp(-NOTHING)
        return LeftOut(self.x[kept], mass[kept]) if kept.any() else None

    def beside(self, others: "LeftOut | None", density: Any) -> "LeftOut":
        """These and others, left out of a density: some hundreds at most, by what they count."""
        x, mass = self if others is None else map(np.concatenate, zip(self, others, strict=True))
        times, many = felt(density.mean(), density.cov(), x), 8 * LOOK
        some = systematic(mass * times / (mass @ times), many)
        return LeftOut(x, mass) if len(mass) <= many else LeftOut(x[some], mass @ times / many / times[some])


def lacking(density: Any) -> Remote:
    """Moments that a density lacks by what was left out of it."""
    left = density.left_out
    return Remote() if left is None else remote(density.mean(), density.cov(), *left)
