"""What leaves the well that a density of one state lies in: mean first-passage times.

An exponential family that is fitted to one well knows nothing of the next: its defect is asked where it is.
"""

import math

import numpy as np

from .._types import Floats
from ..core.limits import EDGE, LARGEST_EXPONENT
from ..density.as_family import moments_on_line
from ..density.particle_density import ParticleDensity
from ..model.sde import SDE

_STATES = 512  # of one side; measured: times are good to .03 (tests/prediction/test_escape.py)
_FAR = 3.0  # times the edge of a density, where wells are looked for: of U ≈ d² / 8, e^-40 leaves by then


def escaped(density: ParticleDensity, model: SDE, t1: float) -> float:
    """Part by which what leaves the well of a density of one state until t1, seconds, widens its variance.

    The model is taken as it is now. Zero in more states, in a domain (on a circle the next may be the same),
    and where no well lies beyond the nodes of a family.
    (C. Gardiner, "Stochastic Methods", 4th ed. 2009, 5.5: the mean first-passage time; what has left is in
    another well, twice as far off as the barrier.)
    """
    if density.dim != 1 or not model.domain.unbounded:
        return 0.0
    mean, cov = (float(part.item()) for part in moments_on_line(density))
    left, reach = 0.0, EDGE * math.sqrt(cov)
    for side in (-1.0, 1.0):
        off = side * reach * np.linspace(-1.0, _FAR, _STATES)
        x = (mean + off)[:, None]
        f, D = side * model.drift(x, density.t)[:, 0], model.diffusion(x, density.t)[:, 0, 0]
        beyond = np.flatnonzero((f > 0.0) & (side * off > 0.5 * reach))
        if len(beyond) and np.isfinite(f).all() and (D > 0.0).all():
            time = _passage(side * off, f, D, int(beyond[0]))
            left += min((t1 - density.t) / time, 1.0) * 4.0 * float(off[beyond[0]]) ** 2 / cov
    return left


def _passage(y: Floats, f: Floats, D: Floats, barrier: int) -> float:
    """Mean time until a state that begins at zero first passes a barrier, one of places y (K,), seconds."""
    from scipy.integrate import cumulative_trapezoid  # on use: import time

    y, f, D = y[: barrier + 1], f[: barrier + 1], D[: barrier + 1]
    U = -cumulative_trapezoid(f / D, y, initial=0.0)
    U = np.minimum(U - U.min(), 0.5 * LARGEST_EXPONENT)  # forever, and of times it a number is left
    inside = cumulative_trapezoid(np.exp(-U) / D, y, initial=0.0)
    return float(cumulative_trapezoid(np.where(y > 0.0, np.exp(U) * inside, 0.0), y)[-1])
