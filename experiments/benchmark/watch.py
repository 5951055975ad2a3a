"""A filter under observation: what its steps report, densities at chosen epochs, a limit of time."""

import numpy as np

from sphfilter.consistency.ranks import clock
from sphfilter.errors import SphfilterError
from sphfilter.filter.results import run_filter

from .densities import snapshot


class TooSlow(SphfilterError):
    """A run passed its limit of time."""


class Watched:
    """Stands for a filter in `run_filter` and notes what its predictions and updates report.

    What take(filter) returns of its density is kept in `densities` at the `epochs` asked for; `limit` seconds
    after its start, without those in which numba compiled, the next prediction raises `TooSlow`.
    """

    def __init__(self, filt, epochs=(), limit=np.inf, take=snapshot):
        self._filt, self._epochs, self._limit, self._take = filt, frozenset(epochs), limit, take
        self._start = clock()
        self.predictions, self.updates, self.densities = [], [], {}

    x = property(lambda self: self._filt.x)
    P = property(lambda self: self._filt.P)
    t = property(lambda self: self._filt.t)
    log_likelihood = property(lambda self: self._filt.log_likelihood)

    model = property(lambda self: self._filt.model)
    measurement = property(lambda self: self._filt.measurement)

    def predict(self, *, t, **driving):
        """As the filter's own."""
        if clock() - self._start > self._limit:
            raise TooSlow(f"stopped at t = {self.t:g} s, after {self._limit:g} s of computing")
        info = self._filt.predict(t=t, **driving)
        self.predictions.append(info)
        return info

    def update(self, z):
        """As the filter's own."""
        info = self._filt.update(z)
        if len(self.updates) in self._epochs:
            self.densities[len(self.updates)] = self._take(self._filt)
        self.updates.append(info)
        return info

    def run(self, times, z, inputs=None):
        """Run the filter; see `sphfilter.filter.results.run_filter`."""
        return run_filter(self, times, z, inputs=inputs)


def watch_peak():
    """Forget the process's peak of resident memory so far; returns False where the system cannot."""
    try:
        with open("/proc/self/clear_refs", "w") as file:
            file.write("5")
    except OSError:
        return False
    return True


def resident(peak=False):
    """Resident memory of the process, or its peak since `watch_peak`, in MB; NaN where unknown."""
    name = "VmHWM:" if peak else "VmRSS:"
    try:
        with open("/proc/self/status") as file:
            return next(float(line.split()[1]) / 1024 for line in file if line.startswith(name))
    except (OSError, StopIteration):
        return np.nan
