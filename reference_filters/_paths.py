"""Many paths of a model over an interval: blocks that fit the cache, each with steps and normals of its own.

A block is moved through the whole interval before the next one is touched. Its generator is known by its
number and its steps follow from its own states, so that the result does not depend on how threads share the
blocks.
"""

from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np
from numba import types

from sphfilter.core._addresses import ADDRESS, address_of, function_at
from sphfilter.core._jit import jit, jit_for
from sphfilter.core.sde_steps import platen_steps, shifted_path_steps, split_steps
from sphfilter.errors import PropagationError
from sphfilter.model.compile import surfacing
from sphfilter.model.simulate import noise_root, rate_of_time

from ._normals import LANES, fill_normals, seed_lanes
from ._step_length import BIAS_PER_ERROR, PLATEN, SHIFTED_PATH, SPLIT, step_length

__all__ = ["Paths", "standard_normals"]

#: Steps between two looks at the step length, and the most steps a block may take.
_STEPS_PER_LOOK, _MAX_STEPS = 4, 1_000_000
#: States at which the rate of change with time is looked at.
_LOOKED_AT = 64
#: Blocks a thread must have before another one is worth its start (about 50 µs).
_BLOCKS_PER_THREAD = 8


@jit
def _move_block(scheme, x, span, limits, functions, constants, state):
    """Move one block x in place over the span; return (steps taken, length of the first).

    No steps taken means that no step was short enough.
    """
    (t, t1), (longest, h, tolerance) = span, limits
    p, _, L = constants
    N, m = x.shape[0], L.shape[0]
    n_normals = m if scheme == SPLIT else 3 * m if scheme == SHIFTED_PATH else m + m * (m - 1) // 2
    normals = np.empty(((_STEPS_PER_LOOK + 1) * n_normals, N))
    taken, first = 0, 0.0
    while t < t1:
        h = min(h, longest, t1 - t)
        if tolerance < np.inf:
            h = min(step_length(scheme, x, t, h, functions, constants, tolerance), longest)
        if not (h > 0.0 and taken < _MAX_STEPS):
            return 0, t
        left = max(1, int(np.ceil((t1 - t) / h * (1 - 1e-12))))
        n_steps, dt = min(left, _STEPS_PER_LOOK), (t1 - t) / left
        rows = n_normals * (n_steps + 1 if scheme == SPLIT else n_steps)
        fill_normals(state, normals[:rows])
        xi = normals[:rows].reshape((rows // n_normals, n_normals, N))
        if scheme == SPLIT:
            split_steps(x, t, dt, functions[0], functions[1], p, L, xi)
        elif scheme == SHIFTED_PATH:
            shifted_path_steps(x, t, dt, functions[0], functions[1], p, L, xi)
        else:
            platen_steps(x, t, dt, functions[0], functions[1], p, L, xi)
        first = first if taken else dt
        taken += n_steps
        t = t1 if n_steps == left else t + n_steps * dt
    return taken, first


def _move_blocks(x, report, span, limits, addresses, constants, stream):
    """Move the blocks first <= b < last of x (N, n); `report` (blocks, 2) gets what `_move_block` returns."""
    scheme, seed, first, last = stream
    state = np.empty((6, LANES), dtype=np.uint64)
    functions = (function_at(addresses[0]), function_at(addresses[1]))
    for b in range(first, last):
        seed_lanes(np.uint64(seed), np.uint64(b), state)
        block = x[b * LANES : min((b + 1) * LANES, x.shape[0])]
        report[b, 0], report[b, 1] = _move_block(scheme, block, span, limits, functions, constants, state)


@cache
def _compiled_blocks():
    """`_move_blocks` for any model: compiled (or loaded from the disk cache) at first use."""
    vector, matrix = types.float64[::1], types.float64[:, ::1]
    constants = types.Tuple((vector, vector, matrix))
    numbers = types.UniTuple(types.float64, 2), types.UniTuple(types.float64, 3)
    functions, stream = types.UniTuple(ADDRESS, 2), types.UniTuple(types.int64, 4)
    signature = types.void(matrix, matrix, *numbers, functions, constants, stream)
    return jit_for(signature, _move_blocks)


class Paths:
    """How the states of a model are moved.

    Parameters
    ----------
    model : sphfilter.SDE
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
        report = self._in_blocks(x, (t0, t1), self._limits(x, t0, t1, tolerance), variance, seed)
        if not (report[:, 0].all() and np.isfinite(x).all()):
            raise PropagationError(
                f"the model blew up between t = {t0:g} and t = {t1:g} s: a particle is not finite or needs "
                "ever shorter steps. Check the drift and its parameters for growth without bound"
            )
        self._first = report[:, 1].min()
        return int(report[:, 0].max())

    def _limits(self, x, t0, t1, tolerance):
        """Longest step, first guess, tolerance of the compiled loop."""
        if self.step is not None:
            return self.step, self.step, np.inf
        rate = rate_of_time(self.model, x[:_LOOKED_AT], t0, t1)
        error = tolerance / BIAS_PER_ERROR[self._scheme]
        rough = (4.0 * error) ** (1 / 3) if self._scheme == SHIFTED_PATH else np.sqrt(error)
        return (rough / rate if rate > 0.0 else np.inf), self._first, tolerance

    def _in_blocks(self, x, span, limits, variance, seed):
        n_blocks = -(-len(x) // LANES)
        report = np.zeros((n_blocks, 2))
        addresses = address_of(self.model.drift_batch), address_of(self.model.noise_batch)
        constants = self.model.p, variance, self._root

        def share(first, last):
            stream = (self._scheme, seed, first, last)
            with surfacing():
                _compiled_blocks()(x, report, span, limits, addresses, constants, stream)

        n_shares = max(1, min(self.n_threads, n_blocks // _BLOCKS_PER_THREAD))
        edges = [n_blocks * i // n_shares for i in range(n_shares + 1)]
        if n_shares == 1:
            share(0, n_blocks)
        else:
            list(_threads(n_shares).map(share, edges[:-1], edges[1:]))
        return report

    def _exactly(self, x, dt, seed):
        if dt not in self._exact:
            Phi, offset, Qd = self.model.to_linear().discretize(dt)
            self._exact[dt] = Phi.T, offset, noise_root(Qd).T
        Phi_T, offset, root_T = self._exact[dt]
        x[:] = x @ Phi_T + offset + standard_normals(seed, *x.shape) @ root_T
        return 1


@cache
def _threads(n):
    return ThreadPoolExecutor(n)


def standard_normals(seed, N, k):
    """Return independent standard normals, shape (N, k)."""
    out = np.empty((N, k))
    _fill_rows(seed, out)
    return out


@jit
def _fill_rows(seed, out):
    state, rows = np.empty((6, LANES), dtype=np.uint64), np.empty((out.shape[1], LANES))
    for b in range(-(-out.shape[0] // LANES)):
        seed_lanes(np.uint64(seed), np.uint64(b), state)
        fill_normals(state, rows)
        block = out[b * LANES : (b + 1) * LANES]
        block[:] = rows[:, : block.shape[0]].T
