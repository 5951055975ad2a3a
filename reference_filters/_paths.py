"""Many paths of a model over an interval, in blocks that threads share."""

from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np

from sphfilter.core._addresses import address_of
from sphfilter.core.paths.blocks import MOST_STEPS, move_blocks, standard_normals
from sphfilter.core.paths.normals import LANES
from sphfilter.core.paths.step_length import BIAS_PER_ERROR, PLATEN, SHIFTED_PATH, SPLIT
from sphfilter.errors import PropagationError
from sphfilter.model.compile import surfacing
from sphfilter.model.domain import Domain
from sphfilter.model.simulate import noise_root, rate_of_time

__all__ = ["Paths"]

#: States at which the rate of change with time is looked at.
_LOOKED_AT = 64
#: Blocks a thread must have before another one is worth its start (about 50 µs).
_BLOCKS_PER_THREAD = 8


class Paths:
    """How the states of a model are moved.

    Parameters
    ----------
    model : sphfilter.SDE
        Its inputs may be others from one call of `move` to the next.
    order : {2, 4}
        4: RK4 along simple random paths, of weak order 3 as measured and of order 4 where there is no noise;
        2: jumps of noise between RK4 steps. Noise that depends on the state has Platen's scheme of weak
        order 2 in either case, and a linear model its exact transition.
    step : float or None
        Longest step, seconds. None: each block of 256 states takes what keeps the error in bounds.
    n_threads : int
        For many states; the result does not depend on it.
    """

    def __init__(self, model, order=4, step=None, n_threads=1):
        self.model, self.step, self.n_threads = model, step, n_threads
        self._scheme = PLATEN if model.state_dependent_noise else SPLIT if order == 2 else SHIFTED_PATH
        self._root = noise_root(model.spectral_density)
        self._first = np.inf
        self._exact = {}

    def move(self, x, t0, t1, variance, tolerance, rng):
        """Move the states x (N, n) from t0 to t1 in place, each with noise of its own.

        Parameters
        ----------
        variance : ndarray, shape (n,)
            Of the states at t0: errors are counted in standard deviations.
        tolerance : float
            Bias allowed to the moments at t1, in standard deviations.
        rng : numpy Generator
            Gives one seed.

        Returns
        -------
        int
            Most steps taken by a block.

        Raises
        ------
        PropagationError
            A state is not finite, or no step is short enough.
        """
        seed = int(rng.integers(2**63))
        if self.model.linear:
            return self._exactly(x, t1 - t0, seed)
        report, alive = self._in_blocks(x, (t0, t1), self._limits(x, t0, t1, tolerance), variance, seed)
        if not (report[:, 0].all() and alive.all()):
            raise PropagationError(
                f"the model blew up between t = {t0:g} and t = {t1:g} s: a particle is not finite or needs "
                "ever shorter steps. Check the drift and its parameters for growth without bound"
            )
        self._first = report[:, 1].min()
        return int(report[:, 0].max())

    def _limits(self, x, t0, t1, tolerance):
        """Longest step, first guess, tolerance and most steps of the compiled loop."""
        if self.step is not None:
            return self.step, self.step, np.inf, MOST_STEPS
        rate = rate_of_time(self.model, x[:_LOOKED_AT], t0, t1)
        error = tolerance / BIAS_PER_ERROR[self._scheme]
        rough = (4.0 * error) ** (1 / 3) if self._scheme == SHIFTED_PATH else np.sqrt(error)
        return (rough / rate if rate > 0.0 else np.inf), self._first, tolerance, MOST_STEPS

    def _in_blocks(self, x, span, limits, variance, seed):
        n_blocks = -(-len(x) // LANES)
        report, alive = np.zeros((n_blocks, 2)), np.ones(len(x), dtype=bool)
        free = np.empty((0, len(x)))  # noise that ends anywhere
        everywhere = Domain(*self.model.dim * [None]).codes
        addresses = address_of(self.model.drift_batch), address_of(self.model.noise_batch)
        constants = self.model.p, variance, self._root

        def share(first, last):
            which, stream = np.arange(first, last), (self._scheme, seed)
            with surfacing():
                numbers = span, limits, addresses, constants
                move_blocks()(x, alive, free, report, which, *numbers, everywhere, stream)

        n_shares = max(1, min(self.n_threads, n_blocks // _BLOCKS_PER_THREAD))
        edges = [n_blocks * i // n_shares for i in range(n_shares + 1)]
        if n_shares == 1:
            share(0, n_blocks)
        else:
            list(_threads(n_shares).map(share, edges[:-1], edges[1:]))
        return report, alive

    def _exactly(self, x, dt, seed):
        key = dt, *self.model.inputs.values()
        if key not in self._exact:
            Phi, offset, Qd = self.model.to_linear().discretize(dt)
            self._exact[key] = Phi.T, offset, noise_root(Qd).T
        Phi_T, offset, root_T = self._exact[key]
        x[:] = x @ Phi_T + offset + standard_normals(seed, *x.shape) @ root_T
        return 1


@cache
def _threads(n):
    return ThreadPoolExecutor(n)
