"""A function's local quadratic by finite differences, in coordinates in which it is round.

The function is smooth but for a roughness: of a log-evidence, what lattices decide. Steps are therefore as
long as a standard error, not as short as rounding allows.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from .._types import Floats
from ..core.limits import ROUNDS
from ..errors import EstimationError

#: Of points (n,).
Function: TypeAlias = Callable[[Floats], float]

FIRST = 0.1  # of a guess, or of its bounds' width: first step; measured: half 1.2 times the runs, twice .9
_FALL = 0.1, 2.0  # nats to fall over a scale; measured: half or twice the least .9, 1.0 times the runs
_APART = 0.01  # standard errors between points that tell roughness; measured: half, twice move fits by 1e-4
#: Steps of differences, least and most, in standard errors: for roughness h⁴ / (12 √6) of 3e-8 to 8e-3 nats.
STEPS = 0.03, 0.7


class Quadratic(NamedTuple):
    """value + gradient u + u hessian u / 2 around a centre, u (n,) in units of `root`'s columns."""

    value: float
    gradient: Floats
    hessian: Floats
    root: Floats  # (n, n)

    @property
    def shift(self) -> Floats:
        """From the centre to the top, shape (n,), in the units of the parameters."""
        return -self.root @ np.linalg.solve(self.hessian, self.gradient)

    @property
    def rise(self) -> float:
        """By how much the top is above the centre."""
        return -0.5 * float(self.gradient @ np.linalg.solve(self.hessian, self.gradient))

    @property
    def covariance(self) -> Floats:
        """Inverse of the negative Hessian, in the units of the parameters, shape (n, n)."""
        return self.root @ np.linalg.solve(-self.hessian, self.root.T)

    @property
    def flattest(self) -> tuple[float, Floats]:
        """Largest eigenvalue of the Hessian and its direction, in the units of the parameters."""
        values, axes = np.linalg.eigh(self.hessian)
        return float(values[-1]), self.root @ axes[:, -1]


def first_steps(theta: Floats, low: Floats, high: Floats) -> Floats:
    """Steps (n,) to begin with: a part of the parameters, or of the width between their bounds."""
    return np.minimum(FIRST * np.where(theta == 0.0, 1.0, np.abs(theta)), 0.5 * (high - low))


def scales(
    function: Function,
    centre: Floats,
    value: float,
    first: Floats,
    low: Floats,
    high: Floats,
    names: Sequence[str],
) -> Floats:
    """Steps (n,) along each axis over which a function of points (n,) falls by about a nat.

    `centre` is near its largest `value`, off the bounds low and high; steps `first` are where to begin.
    Raises `EstimationError` if it does not fall along an axis, of which there are names.
    """
    found = np.empty(len(centre))
    for k, name in enumerate(names):
        room = 0.9 * min(centre[k] - low[k], high[k] - centre[k])  # the filter may refuse what is on a bound
        d, axis = min(first[k], room), np.eye(len(centre))[k]
        for _ in range(ROUNDS):
            fall = value - 0.5 * (function(centre + d * axis) + function(centre - d * axis))
            if _FALL[0] <= fall <= _FALL[1] or (fall < _FALL[0] and d == room):
                break
            d = min(room, d * np.clip(np.sqrt(0.5 / max(fall, 1e-9)), 0.2, 4.0))  # as if it were a parabola
        else:
            raise EstimationError(
                f"the measurements do not determine {name!r}: from {centre[k] - d:.4g} to "
                f"{centre[k] + d:.4g} the log-evidence changes by {abs(fall):.2g} nat; leave it out of "
                f"guess, or give it bounds"
            )
        found[k] = d / np.sqrt(max(2.0 * fall, _FALL[0]))
    return found


def quadratic(function: Function, centre: Floats, value: float, root: Floats, h: float) -> Quadratic:
    """Gradient and Hessian by differences over h columns of `root` (n, n).

    Raises `EstimationError` if the function is not finite at one of the points.
    """

    def at(*steps: tuple[int, float]) -> float:
        point = centre + h * sum(sign * root[:, k] for k, sign in steps)
        found = function(point)
        if not np.isfinite(found):
            raise EstimationError(
                f"there is no log-evidence at {point}, within a standard error of the maximum at {centre}; "
                f"use more particles, or give bounds that keep away from there"
            )
        return found

    n = len(centre)
    above, below = (np.array([at((k, sign)) for k in range(n)]) for sign in (1.0, -1.0))
    hessian = np.diag((above + below - 2.0 * value) / h**2)
    for i in range(n):
        for j in range(i):
            both = at((i, 1.0), (j, 1.0)) + at((i, -1.0), (j, -1.0))
            alone = above[i] + below[i] + above[j] + below[j]
            hessian[i, j] = hessian[j, i] = (both - alone + 2.0 * value) / (2.0 * h**2)
    return Quadratic(value, (above - below) / (2.0 * h), hessian, root)


def slopes(function: Function, centre: Floats, root: Floats, h: float) -> Floats:
    """Gradient by differences over h columns of `root` (n, n)."""
    ahead, behind = (np.array([function(centre + s * h * d) for d in root.T]) for s in (1.0, -1.0))
    return (ahead - behind) / (2.0 * h)


def roughness(function: Function, centre: Floats, value: float, root: Floats) -> float:
    """Standard deviation of a function's values around a parabola through close points."""
    along = _APART * root.sum(axis=1) / np.sqrt(len(centre))
    at = np.arange(-2.0, 3.0)
    values = np.array([value if k == 0 else function(centre + k * along) for k in at])
    left = values - np.polynomial.Polynomial.fit(at, values, 2)(at)
    return float(np.sqrt(left @ left / (len(at) - 3)))


def step_for(rough: float) -> float:
    """Step of second differences, in standard errors, where a function is rough by so many nats.

    Roughness puts an error of 6^½ rough / h² into a second derivative, the fourth derivative f one of
    f h² / 12; here f is one, that of a log-evidence as far from quadratic as a standard error from its value.
    """
    return float(np.clip((12.0 * np.sqrt(6.0) * rough) ** 0.25, *STEPS))


def slope_step_for(rough: float) -> float:
    """As `step_for`, of first differences, with a third derivative of one."""
    return float(np.clip((3.0 / np.sqrt(2.0) * rough) ** (1.0 / 3.0), *STEPS))
