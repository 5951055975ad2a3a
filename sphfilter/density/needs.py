"""What a density under a target error has needed so far: the memory of the ladder."""

import math
from typing import NamedTuple

from ..lattice.level_set import fewest_particles

__all__ = ["DOUBT", "Needs", "allowance", "fewest"]

_LONGEST = 4  # doublings of the wait for a family that will not do


class Needs(NamedTuple):
    """What the last steps of a density under a target error needed: where the next one begins."""

    degree: int = 0  # of a family; zero before the first
    waits: int = 0  # predictions before one is tried again
    failed: int = 0  # predictions in a row that none would do for
    nodes: int = 0  # of a lattice; zero before the first
    points: int = 0  # of a cloud; zero before the first

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


#: Times the allowance, up to which a family is taken all the same: so far its estimates scatter, and what
#: comes next costs ten times as much or more.
DOUBT = 2.0


def allowance(error: float, target: float) -> float:
    """Error that a step may add to one that is there: half the target where that is used up."""
    return max(math.sqrt(max(target**2 - error**2, 0.0)), 0.5 * target)


def fewest(dim: int) -> int:
    """Number of nodes that a lattice begins with, and never has less of."""
    return max(60, 3 * fewest_particles(dim))
