"""Grid filters of models that switch between modes: the referees of `JumpMarkovFilter`.

They solve ∂p_i/∂t = L_i p_i + Σ_j λ_ji p_j for the densities p_i of all modes on one fixed grid: in one or
two states with steps that are split, to be refined until they no longer matter; in one state whole, too.
"""

import math

import numpy as np
from scipy import sparse
from scipy.sparse import linalg

from sphfilter import validate
from sphfilter.errors import ModelError

from ._base import ReferenceFilter, gaussian_start
from .boxed_grid import BoxedGridFilter, _march, _plan, weighed
from .fine_grid import difference


class JumpGridFilter(ReferenceFilter):
    """Split-step grid filter of a JumpMarkovModel, in a fixed box with equal steps.

    Parameters
    ----------
    model : JumpMarkovModel
        Each of whose modes `BoxedGridFilter` takes.
    measurement : measurement model, or mapping of these by mode
    x0, P0 : array_like, shapes (n,), (n, n)
        Gaussian start, in every mode.
    mode_probabilities : array_like, shape (M,), optional
    box, size, step
        As of `BoxedGridFilter`. The error is of second order in the step.

    Attributes
    ----------
    mode_probabilities : ndarray, shape (M,)
    """

    def __init__(self, model, measurement, x0, P0, t0=0.0, dt=None, *, mode_probabilities=None, box, size=64,
                 step=0.1):  # fmt: skip
        self.model, self.step = model, validate.positive("step", step)
        x0, P0 = gaussian_start(x0, P0, model.dim)
        grids = [BoxedGridFilter(m, None, x0, P0, box=box, size=size) for m in model.modes.values()]
        self._key, self.nodes, self._axes = grids[0]._key, grids[0].nodes, grids[0]._axes
        w = model.stationary if mode_probabilities is None else np.asarray(mode_probabilities, dtype=float)
        self._shared = isinstance(measurement, dict)
        belief = np.array([share * grid._belief for share, grid in zip(w, grids, strict=True)])
        self._grid = grids[0]
        super().__init__(belief, measurement, t0, dt)

    @property
    def mode_probabilities(self):
        return self._belief.sum(axis=(1, 2))

    def _moments(self, belief):
        return self._grid._moments(belief.sum(axis=0))

    def _predicted(self, belief, t0, t1):
        n_steps = math.ceil((t1 - t0) / self.step * (1 - 1e-9))
        h = (t1 - t0) / n_steps
        plans = [_plan(mode, *self._key, float(f"{h:.12g}")) for mode in self.model.modes.values()]
        half, whole = self.model.transition(0.5 * h), self.model.transition(h)
        p = np.einsum("ji,jab->iab", half, belief)
        for step in range(n_steps):
            p = np.array([
                _march(own, plan.begin, plan.between, plan.end, plan.corners, plan.weights, 1)
                for own, plan in zip(p, plans, strict=True)
            ])  # fmt: skip
            p = np.einsum("ji,jab->iab", whole if step < n_steps - 1 else half, p)
        return p / p.sum(), n_steps

    def _updated(self, belief, z, measurement):
        several = (
            measurement if isinstance(measurement, dict) else dict.fromkeys(self.model.names, measurement)
        )
        each = [several[name].log_likelihood(z, self.nodes, self.t) for name in self.model.names]
        return weighed(belief, np.array(each))


def unsplit_jump_filter(model, measurement, x0, P0, times, readings, *, mode_probabilities=None,
                        box=(-9.0, 9.0), size=1201, step=0.01):  # fmt: skip
    """Mean, variance, log-evidence so far and mode probabilities after every reading, of one state.

    Finite differences of order ten and Padé steps of order four of the equations of all modes together:
    nothing is split.

    Returns
    -------
    ndarray, shape (T, 3 + M)
    """
    if model.dim != 1:
        raise ModelError(f"unsplit_jump_filter takes 1 state, the model has {model.dim}")
    x = np.linspace(*box, size)
    d, M = x[1] - x[0], len(model.names)
    blocks = [[model.rates[j, i] * sparse.identity(size) for j in range(M)] for i in range(M)]
    for i, mode in enumerate(model.modes.values()):
        f, D = mode.drift(x[:, None], 0.0)[:, 0], mode.diffusion(x[:, None], 0.0)[:, 0, 0]
        own = -difference(1, size, d) @ sparse.diags(f) + difference(2, size, d) @ sparse.diags(D)
        blocks[i][i] = blocks[i][i] + own
    G, one = sparse.bmat(blocks, format="csc"), sparse.identity(M * size, format="csc")
    w = model.stationary if mode_probabilities is None else np.asarray(mode_probabilities, dtype=float)
    p = np.exp(-0.5 * (x - x0) ** 2 / P0)
    p = np.outer(w, p / p.sum()).ravel()
    told, log_evidence, t, steps = [], 0.0, 0.0, {}
    for end, z in zip(times, readings, strict=True):
        count = math.ceil((end - t) / step * (1 - 1e-9))
        if count:
            h = round((end - t) / count, 12)
            if h not in steps:
                square = G @ G * (h * h / 12.0)
                steps[h] = (
                    (one + G * (h / 2) + square).tocsc(),
                    linalg.splu((one - G * (h / 2) + square).tocsc()),
                )
            ahead, back = steps[h]
            for _ in range(count):
                p = back.solve(ahead @ p)
        t = end
        p = np.maximum(p, 0.0) / np.maximum(p, 0.0).sum()
        if z is not None:
            log_l = measurement.log_likelihood(z, x[:, None], t)
            p = p * np.tile(np.exp(log_l - log_l.max()), M)
            log_evidence += math.log(p.sum()) + log_l.max()
            p /= p.sum()
        modes = p.reshape(M, size)
        whole = modes.sum(axis=0)
        mean = whole @ x
        told.append([mean, whole @ (x - mean) ** 2, log_evidence, *modes.sum(axis=1)])
    return np.array(told)
