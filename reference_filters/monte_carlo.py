"""Monte-Carlo reference of a transient: moments and probabilities at given times, with Student's intervals.

000 sections 4.1.1 and 4.1.2. Paths are drawn a chunk at a time and only sums over them are kept, so that 10⁸
of them need no memory. A chunk is known by its number and belongs to one of G groups; sums are kept on disk
after every chunk, so that a run can be stopped, resumed, and extended.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sphfilter import validate

from ._path_sums import PathSums
from ._store import save
from .intervals import mean_interval, pivot, standard_error

#: To be raised when a change of the program changes what it would find.
_VERSION = 1
#: Most paths of a chunk.
_CHUNK = 100_000


@dataclass(frozen=True)
class MonteCarloReference:
    """S statistics at T times, by G groups of paths.

    Attributes
    ----------
    times : ndarray, shape (T,)
        Seconds.
    names : tuple of S str
        "E[q^2 v]" for raw, "C[q^2 v]" for central moments, then the names of the indicators.
    group_values : ndarray, shape (G, T, S)
        Each statistic as each group gives it; a central moment is about the group's own mean.
    n_paths : int
        Of all groups together.
    """

    times: np.ndarray
    names: tuple
    group_values: np.ndarray
    n_paths: int

    @property
    def mean(self):
        """Mean of the groups, shape (T, S)."""
        return self.group_values.mean(axis=0)

    @property
    def standard_error(self):
        """Standard error of `mean`, shape (T, S)."""
        return standard_error(self.group_values)

    def interval(self, level=0.95):
        """Ends of the interval that holds the exact value with probability `level`: two arrays (T, S)."""
        return mean_interval(self.group_values, level)

    def pivot(self, value, level=0.95):
        """Normalised pivot Ẑ of another method's `value`, shape (T, S): within ±1 inside the interval."""
        return pivot(self.group_values, value, level)

    def select(self, *names):
        """The same reference with these statistics only, in this order."""
        for name in names:
            validate.choice("name of a statistic", name, self.names)
        columns = [self.names.index(name) for name in names]
        return replace(self, names=names, group_values=self.group_values[:, :, columns])


def simulate_statistics(model, start, times, *, moments=(), central=(), indicators=None, n_paths, t0=0.0,
                        groups=10, rng=0, step=None, tolerance=1e-4, n_threads=1, cache=None,
                        progress=None):  # fmt: skip
    """Moments and probabilities of a model at given times, from many simulated paths.

    Additive noise is stepped with weak order 3 as measured, any other with weak order 2, and a linear model
    exactly. Angles are put between their ends at every output; reflecting walls mirror after every step,
    which takes weak order 1 near them, and what leaves through a bounded axis is an error.

    Parameters
    ----------
    model : sphfilter.SDE
    start : Gaussian, Uniform, array_like (n,), or object with draw(rng, N) -> (N, n)
        Law of the state at `t0`; an array is a state that is known.
    times : array_like, shape (T,)
        Non-decreasing, seconds, none before `t0`.
    moments, central : sequences of powers, n whole numbers each
        Raw moments E Π x_d^a_d, 000 (131), and central ones, 000 (133).
    indicators : mapping of str to callable, optional
        X (N, n) -> (N,), truth values or numbers, of which the mean is taken. In the cache the name stands
        for the function: let it contain what may change, such as a threshold.
    n_paths : int
        At least this many; all that are in the cache count. Chunks have 10⁵ paths when n_paths is a multiple
        of 10⁵ `groups`: such a number can be raised later and what is there is used.
    t0 : float
    groups : int
        G, for the intervals.
    rng : int or Generator
        Seed.
    step : float, optional
        Longest step, seconds. None: steps follow from `tolerance`.
    tolerance : float
        Bias allowed over an interval between outputs, in standard deviations.
    n_threads : int
        The result does not depend on it.
    cache : path, optional
        Folder of the finished chunks.
    progress : callable(n_done, n_wanted), optional
        Called after every chunk.

    Returns
    -------
    MonteCarloReference

    Raises
    ------
    ModelError
        Statistics, start or times that do not fit the model.
    PropagationError
        A path is not finite or left the domain.
    """
    asked = PathSums(model, start, t0, times, moments, central, indicators, step, tolerance, n_threads)
    groups = validate.count("groups", groups, 2)
    share = -(-validate.count("n_paths", n_paths, 2 * groups) // groups)
    chunks = -(-share // _CHUNK)
    size = -(-share // chunks)
    seed = int(validate.generator(rng).integers(2**62))
    path = None if cache is None else Path(cache) / f"paths-{asked.name((size, groups, seed, _VERSION))}.npz"
    done, centre, sums = _load(path, (groups, *asked.shape))
    wanted = groups * max(chunks, -(-done // groups))
    for i in range(done, wanted):
        found, centre = asked.over(size, np.random.default_rng([seed, i]), centre)
        sums[i % groups] += found
        save(path, done=i + 1, centre=centre, sums=sums)
        if progress is not None:
            progress((i + 1) * size, wanted * size)
    return MonteCarloReference(asked.times, asked.names, asked.statistics(sums, centre), wanted * size)


def _load(path, shape):
    """Number of finished chunks, centre and sums by group; none, None and zeros at first."""
    if path is None or not path.exists():
        return 0, None, np.zeros(shape)
    with np.load(path) as data:
        return int(data["done"]), data["centre"], data["sums"]
