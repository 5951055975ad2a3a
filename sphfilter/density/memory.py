"""The memory of the ladder: representations and sizes that a density has needed so far."""

import math
from typing import Any, NamedTuple

from ..config import AnyConfig, FilterConfig, LogDensityScheme
from ..core.cloud.control import next_points, points_for, power_of_two
from ..info import DOUBTFUL, Code, target_missed

#: Error of a cloud after a typical reading, over N^-1/2, as long as nothing tells it: what the first readings
#: leave is forgotten slowly. With half of it thirteen scenes took 1.5 times the time for the same error.
_TYPICAL = 0.6
#: Power of the predictions since a reading, by which their allowances fall: sum_k k^-1.5 = 2.6 of the first.
SHARED = 1.5
#: Times the target, from which a reading is tried again: estimates are no better. Measured: half leaves .8 of
#: three errors for up to 1.1 times the work; twice 3 times one of eight, for 1.5 times the work.
MISSED = 1.5
#: Times the target, from which an error is flagged: it may be three targets then. Measured on 136 random
#: models: with 2 .083 of those that are within three are flagged, with 2.5 and 3 .037; of 28 that are not, 9,
#: 6 and 5.
_FLAGGED = 2.5
USUAL = 200  # particles where no number is given, and nothing tells an error to choose one by
_LONGEST = 4  # doublings of the wait for a family that will not do; measured: half and twice change no run


class Memory(NamedTuple):
    """Memory of what a density's last steps under a target error needed: where the next one begins."""

    degree: int = 0  # of a family; zero before the first
    waits: int = 0  # predictions before one is tried again
    failed: int = 0  # predictions in a row that none would do for
    nodes: int = 0  # of a lattice; zero before the first
    points: int = 0  # of a cloud; zero before the first
    calm: int = 0  # readings in a row that asked for fewer; negative: to wait before there are more
    legs: int = 0  # predictions since the last reading
    smooth: bool = False  # densities are asked for, or summed: lattices, where states are few
    age: int = 0  # predictions since the start

    def gone_on(self) -> "Memory":
        """Memory after one more prediction without a reading."""
        return self._replace(legs=self.legs + 1, age=self.age + 1)

    @property
    def shared(self) -> float:
        """Part of an error budget that a prediction has, where others without a reading come before it.

        What they add is often of one sign, and adds up: to 2.6 times the first one's at most.
        """
        return max(self.legs, 1) ** -SHARED

    def followed(self, degree: int) -> "Memory":
        """Memory after a family of this degree held the density."""
        return self._replace(degree=degree, waits=0, failed=0)

    def refused(self) -> "Memory":
        """Memory after no family held the density: the next is tried after a wait that doubles."""
        failed = self.failed + 1
        return self._replace(failed=failed, waits=2 ** min(failed - 1, _LONGEST) - 1)

    def cloud(self, target: float, dim: int) -> int:
        """Points that a cloud of so many states has for a target error."""
        return self.points or power_of_two(usual_points(target), dim)

    def cut(self, most: int) -> "Memory":
        """Memory whose next cloud has as many points as there is time for, and may have more at once."""
        return self._replace(points=power_of_two(most // 2 + 1), calm=0)

    def told(self, error: float, target: float, count: int, dim: int) -> "Memory":
        """Memory after `count` points had an error: the next cloud has more at once, fewer after a while.

        What a single reading asks beyond that is its own: it is made again on more points.
        """
        points, calm = next_points(self.cloud(target, dim), points_for(count, error, target, dim), self.calm)
        return self._replace(points=points, calm=calm)


def usual_error(count: int) -> float:
    """Error of the mean that a cloud of so many points usually has, in standard deviations."""
    return _TYPICAL / math.sqrt(count)


def usual_points(error: float) -> float:
    """Points of a cloud that usually has an error of the mean, in standard deviations."""
    return (_TYPICAL / error) ** 2


def flagged_from(target: float) -> float:
    """Error told of a mean, from which it is flagged, in standard deviations.

    Less where a target is loose, and an error of so many targets would be wrong whatever was asked.
    """
    return min(_FLAGGED * target, max(DOUBTFUL, MISSED * target))


def flagged_if_missed(code: Code, error: float, target: float) -> dict[str, Any]:
    """Status and code by the error of a step, without the news that a target asked for more nodes or points.

    Nothing where its code has other news.
    """
    if code & ~(Code.CLOUD | Code.FINER):
        return {}
    if error <= flagged_from(target):
        return {"status": "ok", "code": Code.OK}
    return {"status": target_missed(error, target), "code": Code.COARSE}


def tolerated_excess(dim: int) -> float:
    """Factor of its error budget, up to which a family is taken all the same.

    Its estimates scatter by a factor of two, and the truth is less more often than not; what comes next costs
    ten times as much in two dimensions, and fifty times in more.
    """
    return 2.0 if dim <= 2 else 4.0


def error_budget(error: float, target: float, least: float = 0.5) -> float:
    """Error that a step may add to one that is there: a part of the target where that is used up."""
    return max(math.sqrt(max(target**2 - error**2, 0.0)), least * target)


def max_particles(n_particles: int | str, config: AnyConfig | None) -> int | str:
    """A number of particles as given; of "auto" a number where nothing estimates an error to choose by.

    The acceptance test asks where particles lie, and needs some.
    """
    scheme = "auto" if config is None else config.scheme
    estimates = scheme == "auto" or isinstance(scheme, LogDensityScheme)
    if isinstance(config, FilterConfig) and config.acceptance.enabled:
        estimates = False
    return n_particles if n_particles != "auto" or estimates else USUAL
