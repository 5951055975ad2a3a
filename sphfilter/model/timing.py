"""Times at which a model jumps by itself."""

import math
from collections.abc import Callable, Iterable

import numpy as np

from .._types import Floats

_SAMPLES = 1024  # of a condition's sign in an interval: changes 1 / 1024 = .001 of it apart may be missed
_BESIDE = 64 * float(np.finfo(float).eps)  # of a time, relative: farther than its rounding in a step


def beside(t: float, t0: float, t1: float) -> tuple[float, float]:
    """Return times just before and just after t that steps between t0 and t1 do not confuse by rounding."""
    gap = _BESIDE * max(abs(t0), abs(t1))
    return t - gap, t + gap


def spans(breaks: Iterable[float], t0: float, t1: float) -> list[tuple[float, float]]:
    """Return the spans of an interval between the times at which a model jumps, which are left out."""
    found, begin = [], t0
    for before, after in (beside(stop, t0, t1) for stop in breaks):
        found += [(begin, before)] if begin < before else []
        begin = after
    return [*found, (begin, t1)] if begin < t1 else found


def roots(value: Callable[[float], Floats], t0: float, t1: float, step: float) -> list[float]:
    """Times in [t0, t1] at which a number that `value` returns changes its sign, or is zero at an end.

    They are looked at every `step` seconds at least; a number that does not oscillate may change at any time.
    """
    from scipy.optimize import brentq  # on use: import time

    parts = _SAMPLES + (0 if math.isinf(step) else math.ceil((t1 - t0) / step))
    times = np.linspace(t0, t1, parts + 1)
    values = np.array([value(t) for t in times])
    above = values >= 0.0
    found = [
        float(brentq(lambda t, k=k: value(t)[k], times[i], times[i + 1], xtol=1e-300, rtol=1e-15))
        for i, k in zip(*np.nonzero(above[1:] != above[:-1]), strict=True)
    ]
    return sorted(found + [float(times[i]) for i in (0, -1) if (values[i] == 0.0).any()])
