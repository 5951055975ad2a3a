"""Where states live: axes without bounds, angles, and axes that end at a wall."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from .. import validate
from .._types import Bools, Floats
from ..core import domain as core
from ..core.domain import KINDS
from ..core.field.walls import NO_WALLS, Walls
from ..errors import ModelError

#: None without bounds, else (kind, low, high); an end that is not there is None.
Axis: TypeAlias = Sequence[str | float | None] | None


class Domain:
    """The kind and the ends of every axis of the state.

    Parameters
    ----------
    *axes : None, or (kind, low, high)
        One for each state: None where the axis has no bounds, else the kind and the ends (None for an end
        that is not there). "periodic": high is low again, as of an angle. "bounded": a particle that leaves
        stops the prediction with an error. "reflecting": nothing passes the wall; the drift is asked a little
        beyond it, where it should go on smoothly.

    Raises
    ------
    ModelError
        An unknown kind, or ends that do not rise.

    Examples
    --------
    >>> import numpy as np
    >>> import sphfilter as sf
    >>> print(sf.Domain(("periodic", -np.pi, np.pi), None).wrap([[4.0, 7.0]]).round(4))
    [[-2.2832  7.    ]]
    """

    def __init__(self, *axes: Axis) -> None:
        self.axes = tuple(_axis(f"axis {d} of the domain", axis) for d, axis in enumerate(axes))
        kinds, lows, highs = zip(*self.axes, strict=True) if axes else ((), (), ())
        self.kinds, self.low, self.high = kinds, np.array(lows, dtype=float), np.array(highs, dtype=float)
        self.periodic = np.array([kind == "periodic" for kind in kinds], dtype=bool)
        #: Axes that end.
        self.walled = np.array([kind in ("bounded", "reflecting") for kind in kinds], dtype=bool)

    @classmethod
    def of(cls, value: "DomainLike", dim: int) -> "Domain":
        """Return a domain of `dim` axes: as given, of a sequence of axes, or without bounds for None."""
        axes = [None] * dim if value is None else value
        domain = axes if isinstance(axes, Domain) else cls(*axes)
        if len(domain.axes) != dim:
            raise ModelError(
                f"domain has {len(domain.axes)} axes, but there are {dim} states; give one for each"
            )
        return domain

    def __reduce__(self) -> tuple[Any, ...]:
        return Domain, self.axes

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Domain) and self.axes == other.axes

    def __hash__(self) -> int:
        return hash(self.axes)

    def __repr__(self) -> str:
        return f"Domain{self.axes}"

    @property
    def dim(self) -> int:
        """Number of axes."""
        return len(self.axes)

    @cached_property
    def unbounded(self) -> bool:
        """Whether no axis is periodic and none ends at a wall."""
        return not (self.periodic.any() or self.walled.any())

    @cached_property
    def walls(self) -> Walls:
        """Walls, low and high, shape (n,) each, infinite where an axis has none; empty if none has."""
        if not self.walled.any():
            return NO_WALLS
        return np.where(self.walled, self.low, -np.inf), np.where(self.walled, self.high, np.inf)

    @property
    def period(self) -> Floats:
        """Lengths of the periodic axes, zero for others, shape (n,)."""
        return np.where(self.periodic, self.high - self.low, 0.0)

    @cached_property
    def codes(self) -> core.Domain:
        """The domain as compiled functions take it."""
        kind = np.array([KINDS.index(kind) for kind in self.kinds], dtype=np.int64)
        return core.Domain(kind, self.low, self.high)

    def whole(self, low: Floats, high: Floats) -> Bools:
        """Which periodic axes the extent from low to high (n,) goes round whole, bool (n,)."""
        return self.periodic & (high - low > self.period * (1.0 - 1e-9))

    def within(self, low: Floats, high: Floats, margin: float | Floats) -> tuple[Floats, Floats]:
        """The extent low, high (n,) cut at the walls, and whole on a periodic axis that it nearly fills."""
        all_round = self.periodic & (high - low + margin >= self.period)
        low = np.where(self.walled, np.maximum(low, self.low), np.where(all_round, self.low, low))
        return low, np.where(self.walled, np.minimum(high, self.high), np.where(all_round, self.high, high))

    def wrap(self, X: ArrayLike) -> Floats:
        """States X (M, n) with angles between their ends."""
        X = np.array(X, dtype=float)
        core.go_round(self.codes, X)
        return X

    def fold(self, X: ArrayLike) -> Floats:
        """States X (M, n) with angles between their ends, and what passed a mirror mirrored."""
        X = self.wrap(X)
        core.bounce(self.codes, X)
        return X

    def nearest(self, differences: ArrayLike) -> Floats:
        """Differences (M, n) of states, the short way round periodic axes."""
        D = np.array(differences, dtype=float)
        d = self.periodic
        D[:, d] -= self.period[d] * np.rint(D[:, d] / self.period[d])
        return D

    def fits(self, X: Floats) -> Bools:
        """Which coordinates of states X (..., n) lie between walls, if their axis has any."""
        return ~self.walled | ((self.low <= X) & (self.high >= X))

    def contains(self, X: Floats) -> Bools:
        """Which of the states X (M, n) lie between the walls, shape (M,)."""
        return np.all(self.fits(X), axis=-1)

    def mean(self, X: Floats, mass: Floats) -> Floats:
        """Mean of states X (N, n), the mean direction on periodic axes (which go round once), shape (n,)."""
        mean = mass @ X
        for d in np.flatnonzero(self.periodic):
            scale = 2.0 * np.pi / self.period[d]
            angle = np.angle(mass @ np.exp(1j * scale * (X[:, d] - self.low[d])))
            mean[d] = self.low[d] + angle % (2.0 * np.pi) / scale
        return mean

    def seen(self, x: Floats, mass: Floats, h: Floats, reach: float) -> tuple[Floats, Floats, Floats]:
        """Particles with the images of those within `reach` of an end: (x, mass, h)."""
        if self.unbounded:
            return x, mass, h
        view = core.view_of(self.codes, *(np.array(a) for a in (x, mass, h)), float(reach))
        return view.x, view.m, view.h


#: A domain, or its axes; None has no bounds.
DomainLike: TypeAlias = Domain | Sequence[Axis] | None
_NO_END = None, "none"  # TOML has no None


def _axis(name: str, axis: Axis) -> tuple[str, float, float]:
    if axis is None or axis == "unbounded" or tuple(axis)[:1] == ("unbounded",):
        return "unbounded", -np.inf, np.inf
    if isinstance(axis, str) or len(axis) != 3:
        raise ModelError(
            f'{name} must be None or (kind, low, high), e.g. ("periodic", -3.14, 3.14), got {axis!r}'
        )
    kind = validate.choice(name, str(axis[0]), KINDS)
    low = -np.inf if axis[1] in _NO_END or axis[1] == -np.inf else validate.real(f"low of {name}", axis[1])
    high = np.inf if axis[2] in _NO_END or axis[2] == np.inf else validate.real(f"high of {name}", axis[2])
    if not low < high or (kind == "periodic" and not np.isfinite(high - low)):
        raise ModelError(
            f"{name} must rise from low to high, finite if it is periodic; got {low:g} to {high:g}"
        )
    return kind, low, high
