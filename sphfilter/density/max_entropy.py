"""The exponential family with the moments of weighted points, of all that have them the least informed."""

import math
from functools import cache

import numpy as np

from .._types import Floats, Ints
from ..core.family.basis import averages
from ..core.limits import ROUNDS, TINY
from ..core.monomials import up_to
from .family import Family, gaussian_family
from .moments import moments

_FOUND = 1e-9
_LONGEST = 2.0  # change of log p in a round, rms over the density


def max_entropy(x: Floats, mass: Floats, degree: int) -> tuple[Family, float] | None:
    """Find the family of a degree that has the moments of points (N, n) with weights (N,) up to that degree.

    With it its misfit, what chance explains taken off: by how much moments of one degree more, and the
    variance of log p, differ from those of the points. None where no family has the moments.
    """
    mean, cov = moments(x, mass)
    try:
        start = gaussian_family(mean, cov, degree)
    except np.linalg.LinAlgError:
        return None
    rule, n = start.basis, x.shape[1]
    xi = np.ascontiguousarray((x - mean) @ np.linalg.inv(start.A).T)
    power, M = _powers(n, degree + 1), len(start.c)
    wanted, squares = np.empty((2, len(power)))
    averages(power, xi, mass, wanted, squares)
    c = _solved(rule.V, rule.log_w, start.c, wanted[:M])
    if c is None:
        return None
    found = start._replace(c=c).normalised()
    p = found.weighted()[0]
    own, _ = np.empty((2, len(power)))
    averages(power, rule.xi, p, own, _)
    chance = float(np.sum(mass**2))
    off = (wanted - own)[M:]
    odd = float(np.sum(off**2) - chance * np.sum(squares[M:]))
    log_p = found.log_p(x)
    spread = _variance(mass, log_p) / max(_variance(p, found.c @ rule.V), TINY) - 1.0
    by_chance = chance * _variance(mass, (log_p - mass @ log_p) ** 2) / max(_variance(mass, log_p) ** 2, TINY)
    even = (0.5 * spread) ** 2 - 0.25 * by_chance
    return found, math.sqrt(max(odd, 0.0) + max(even, 0.0))


def _solved(V: Floats, log_w: Floats, c: Floats, wanted: Floats) -> Floats | None:
    """Coefficients under which polynomials V (M, N) at nodes average to `wanted`, by Newton's method."""
    c = c.copy()
    for _ in range(ROUNDS):
        log_z, p = _partition(c @ V + log_w)
        off = (wanted - V @ p)[1:]
        if not np.isfinite(off).all():
            return None
        if np.abs(off).max() < _FOUND:
            return c
        centred = (V - (V @ p)[:, None])[1:]
        try:
            step = np.linalg.solve((centred * p) @ centred.T, off)
        except np.linalg.LinAlgError:
            return None
        long = math.sqrt(max(float(off @ step), 0.0))
        step *= min(1.0, _LONGEST / max(long, TINY))
        value, slope = log_z - c[1:] @ wanted[1:], float(off @ step)
        for _ in range(ROUNDS):
            trial = c.copy()
            trial[1:] += step
            if _partition(trial @ V + log_w)[0] - trial[1:] @ wanted[1:] <= value - 1e-4 * slope:
                break
            step, slope = 0.5 * step, 0.5 * slope
        else:
            return None
        c = trial
    return None


def _partition(log_p: Floats) -> tuple[float, Floats]:
    """Logarithm of the sum of exponentials, and each one's part of it."""
    top = float(log_p.max())
    w = np.exp(log_p - top)
    total = float(w.sum())
    return top + math.log(total), w / total


@cache
def _powers(n: int, degree: int) -> Ints:
    return np.array(up_to(degree, n))


def _variance(w: Floats, values: Floats) -> float:
    mean = w @ values
    return float(w @ (values - mean) ** 2)
