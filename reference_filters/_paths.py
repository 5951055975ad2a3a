"""Many paths of a model over an interval, in blocks that threads share."""

from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import NamedTuple

import numpy as np

from sphfilter.core._addresses import address_of
from sphfilter.errors import PropagationError
from sphfilter.model.compile import surfacing
from sphfilter.model.paths import noise_root, rate_of_time

from ._blocks import move_blocks, standard_normals
from ._inlined import compiled, fits, pattern_of
from ._lanes import move_lanes
from ._step_length import BIAS_PER_ERROR, PLATEN, SHIFTED_PATH, SPLIT
from ._weights import LANES, merged, moments_of

#: States at which the rate of change with time is looked at.
_LOOKED_AT = 64
#: Blocks a thread must have before another one is worth its start (about 50 µs).
_BLOCKS_PER_THREAD = 8
_THE_SAME = np.empty(0, np.int64)


class Moved(NamedTuple):
    """States (n, N) at the end of an interval, their mean (n,) and covariance (n, n), and steps."""

    states: np.ndarray
    mean: np.ndarray
    cov: np.ndarray
    n_steps: int


class Paths:
    """How the states of a model are moved.

    Noise that does not depend on the state has steps that are compiled for the model (`_inlined`). Other
    noise has Platen's scheme of weak order 2, a drift that is Python code steps that call it on many states
    at once, and a linear model its exact transition. Domains are the caller's.

    Parameters
    ----------
    model : sphfilter.SDE
        Its inputs may be others from one call to the next.
    order : {2, 4}
        4: RK4 along simple random paths, of weak order 3 as measured and of order 4 where there is no noise;
        2: jumps of noise around RK4 steps.
    step : float or None
        Longest step, seconds. None: each block of 256 states takes what keeps the error in bounds.
    n_threads : int
        For many states; the result does not depend on it.
    """

    def __init__(self, model, order=4, step=None, n_threads=1):
        self.model, self.step, self.n_threads, self._order = model, step, n_threads, order
        self._scheme = PLATEN if model.state_dependent_noise else SPLIT if order == 2 else SHIFTED_PATH
        self._root = noise_root(model.spectral_density)
        self._first = np.inf
        self._exact, self._addresses = {}, (address_of(model.drift_batch), address_of(model.noise_batch))
        self._inlined = not model.linear and fits(model)
        if self._inlined:
            self._own = compiled(model.drift_batch, pattern_of(model), order)  # addresses need it alive
            self._addresses = (*map(address_of, self._own), self._addresses[1])

    def __reduce__(self):
        # addresses of compiled code mean nothing in another process
        return Paths, (self.model, self._order, self.step, self.n_threads), {"_first": self._first}

    def move(self, x, t0, t1, variance, tolerance, rng):
        """Move the states x (N, n) from t0 to t1 in place; returns the most steps of a block. See `moved`."""
        w = np.full(len(x), 1.0 / len(x))
        found = self.moved(np.ascontiguousarray(x.T), None, w, (t0, t1), variance, tolerance, rng)
        x[:] = found.states.T
        return found.n_steps

    def moved(self, old, taken, w, span, variance, tolerance, rng):
        """States moved over an interval, each with noise of its own.

        Parameters
        ----------
        old : ndarray, shape (n, N)
        taken : ndarray of int64, shape (N,), or None
            Numbers of the old states at which the new ones start; None: at their own.
        w : ndarray, shape (N,)
            Weights of the new ones, for the moments.
        span : tuple (t0, t1)
            Seconds.
        variance : ndarray, shape (n,)
            Of the states at t0: errors are counted in standard deviations.
        tolerance : float
            Bias allowed to the moments at t1, in standard deviations.
        rng : numpy Generator
            Gives one seed.

        Returns
        -------
        Moved

        Raises
        ------
        PropagationError
            A state is not finite, or no step is short enough.
        """
        seed, N = int(rng.integers(2**63)), old.shape[1]
        if self._inlined:
            new, n_blocks = np.empty_like(old), -(-N // LANES)
            report, moments = np.empty((n_blocks, 2)), np.empty((n_blocks, 1 + len(old) + len(old) ** 2))
            arrays = old, _THE_SAME if taken is None else taken, new, w, report, moments
            numbers = span, self._limits(old, span, tolerance)
            self._in_blocks(move_lanes(), arrays, report, numbers, variance, seed)
            mean, cov = np.empty(len(old)), np.empty((len(old), len(old)))
            merged(moments, mean, cov)
            return Moved(new, mean, cov, self._steps(report, span))
        start = old if taken is None else old[:, taken]
        if self.model.linear:
            new, n_steps = self._exactly(start, span[1] - span[0], seed), 1
        else:
            x, report = np.ascontiguousarray(start.T), np.empty((-(-N // LANES), 2))
            numbers = span, self._limits(start, span, tolerance)
            self._in_blocks(move_blocks(), (x, report), report, numbers, variance, seed)
            new, n_steps = np.ascontiguousarray(x.T), self._steps(report, span)
        return Moved(new, *moments_of(new, w), n_steps)

    def _limits(self, x, span, tolerance):
        """Longest step, first guess and tolerance of the compiled loops."""
        if self.step is not None:
            return self.step, self.step, np.inf
        rate = rate_of_time(self.model, x[:, :_LOOKED_AT].T, *span)
        error = tolerance / BIAS_PER_ERROR[self._scheme]
        rough = (4.0 * error) ** (1 / 3) if self._scheme == SHIFTED_PATH else np.sqrt(error)
        return (rough / rate if rate > 0.0 else np.inf), self._first, tolerance

    def _in_blocks(self, loop, arrays, report, numbers, variance, seed):
        """Run a compiled loop over all blocks, in threads where there are many."""
        n_blocks = len(report)
        rest = *numbers, self._addresses, (self.model.p, variance, self._root), (self._scheme, seed)

        def share(first, last):
            with surfacing():
                loop(*arrays, np.arange(first, last), *rest)

        n_shares = max(1, min(self.n_threads, n_blocks // _BLOCKS_PER_THREAD))
        edges = [n_blocks * i // n_shares for i in range(n_shares + 1)]
        if n_shares == 1:
            share(0, n_blocks)
        else:
            list(_threads(n_shares).map(share, edges[:-1], edges[1:]))

    def _steps(self, report, span):
        """Most steps of a block; the first of them is what the next interval tries."""
        if not report[:, 0].all():
            raise PropagationError(
                f"the model blew up between t = {span[0]:g} and t = {span[1]:g} s: a particle is not finite "
                "or needs ever shorter steps. Check the drift and its parameters for growth without bound"
            )
        self._first = report[:, 1].min()
        return int(report[:, 0].max())

    def _exactly(self, x, dt, seed):
        key = dt, *self.model.inputs.values()
        if key not in self._exact:
            Phi, offset, Qd = self.model.to_linear().discretize(dt)
            self._exact[key] = Phi, offset[:, None], noise_root(Qd)
        Phi, offset, root = self._exact[key]
        return Phi @ x + offset + root @ standard_normals(seed, *x.shape[::-1]).T


@cache
def _threads(n):
    return ThreadPoolExecutor(n)
