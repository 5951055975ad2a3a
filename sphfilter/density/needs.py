"""What a density under a target error has needed so far: the memory of the ladder."""

import math
from functools import cache
from typing import NamedTuple

from ..config import FilterConfig, LogDensityScheme, SolverConfig
from ..lattice.level_set import fewest_particles

__all__ = ["AIMED", "MOST_POINTS", "Needs", "allowance", "bound_of", "doubt", "fewest"]

MOST_POINTS = 200_000  # of a cloud
_FEWEST_POINTS, _POINTS = 1000, 1.0  # at least, and times the square of the error
#: Of the target, that a lattice is to add at most where errors of the past use it up, and readings forget
#: little of them; half of it is not tried again.
AIMED = 0.25
_USUAL = 200  # particles of a scheme that estimates no error
_LONGEST = 4  # doublings of the wait for a family that will not do


class Needs(NamedTuple):
    """What the last steps of a density under a target error needed: where the next one begins."""

    degree: int = 0  # of a family; zero before the first
    waits: int = 0  # predictions before one is tried again
    failed: int = 0  # predictions in a row that none would do for
    nodes: int = 0  # of a lattice; zero before the first
    points: int = 0  # that a cloud would have needed; zero before the first
    parts: bool | None = None  # whether noise moves copies of a cloud's points apart; None: not looked at
    share: float = 1.0  # of a prior's volume, that the last reading left

    def followed(self, degree: int) -> "Needs":
        """A family of a degree did."""
        return self._replace(degree=degree, waits=0, failed=0)

    def refused(self) -> "Needs":
        """No family did: the next is tried after a wait that doubles."""
        failed = self.failed + 1
        return self._replace(failed=failed, waits=2 ** min(failed - 1, _LONGEST) - 1)

    def waited(self) -> "Needs":
        """One prediction less to wait."""
        return self._replace(waits=self.waits - 1)

    def cloud(self, target: float) -> int:
        """Points that a cloud needs for a target error."""
        fewest = math.ceil(_POINTS / target**2)
        return max(_FEWEST_POINTS, self.points or math.ceil(fewest / self.share))

    def cloud_error(self, target: float) -> float:
        """Error of the largest cloud that is taken, at least the target."""
        return target * math.sqrt(max(self.cloud(target) / MOST_POINTS, 1.0))


def doubt(dim: int) -> float:
    """Times the allowance, up to which a family is taken all the same.

    Its estimates scatter by a factor of two, and the truth is less more often than not; what comes next costs
    ten times as much in two dimensions, and fifty times in more.
    """
    return 2.0 if dim <= 2 else 4.0


def allowance(error: float, target: float, least: float = 0.5) -> float:
    """Error that a step may add to one that is there: a part of the target where that is used up."""
    return max(math.sqrt(max(target**2 - error**2, 0.0)), least * target)


@cache
def fewest(dim: int) -> int:
    """Number of nodes that a lattice begins with, and never has less of."""
    return max(60, 3 * fewest_particles(dim))


def bound_of(n_particles: int | str, config: SolverConfig | FilterConfig | None) -> int | str:
    """A number of particles as given; of "auto" a number where nothing estimates an error to choose by.

    The acceptance test asks where particles lie, and needs some.
    """
    scheme = "auto" if config is None else config.scheme
    estimates = scheme == "auto" or isinstance(scheme, LogDensityScheme)
    if isinstance(config, FilterConfig) and config.acceptance.enabled:
        estimates = False
    return n_particles if n_particles != "auto" or estimates else _USUAL
