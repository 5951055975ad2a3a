"""Grid filter in a box chosen by hand: the fastest rival in one and two dimensions, where its box is right.

Strang splitting of the Fokker-Planck equation with equal steps. Diffusion is exact and, with the filter that
turns values into coefficients of quintic B-splines, one dense matrix an axis. Advection is semi-Lagrangian,
with feet and weights computed once for all steps of the same length and model, and kept for the next filter.
There is no error control: compare sizes and steps.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit
from scipy import fft

from sphfilter import validate
from sphfilter.errors import ModelError

from ._base import ReferenceFilter, gaussian_start
from ._characteristics import follow
from ._spline import spline_symbol, spline_weights
from .particle import ParticleFilter

#: Nodes a spline covers.
_TAPS = 6
#: Parts of a step in which characteristics are followed.
_PARTS = 8


class BoxedGridFilter(ReferenceFilter):
    """Split-step grid filter in a fixed box with equal steps.

    Parameters
    ----------
    model : SDE
        Of one or two states, autonomous, with constant noise that is not correlated between the states.
    measurement : measurement model or None
    x0, P0 : array_like, shapes (n,), (n, n)
        Gaussian start.
    t0, dt : float
        Start, and interval of `predict()` without arguments, seconds.
    box : array_like, shape (n, 2)
        What leaves it is lost; it should reach six standard deviations from the mean, at all times.
    size : int
        Nodes an axis.
    step : float
        Longest time step, seconds. The error is of second order.
    """

    def __init__(self, model, measurement, x0, P0, t0=0.0, dt=None, *, box, size=64, step=0.1):
        if model.dim not in (1, 2):
            raise ModelError(f"BoxedGridFilter takes 1 or 2 states, the model has {model.dim}")
        D = model.diffusion(np.zeros((1, model.dim)), 0.0)[0]
        if not (model.autonomous and model.constant_diffusion and np.array_equal(D, np.diag(np.diag(D)))):
            raise ModelError(
                "BoxedGridFilter needs a model without time, with constant noise of its own for each state: "
                "take GridFilter"
            )
        self.model, self.step = model, validate.positive("step", step)
        size = validate.count("size", size, 2 * _TAPS)
        box = validate.array("box", box, (model.dim, 2))
        if not np.all(box[:, 1] > box[:, 0]):
            raise ModelError(f"box must be rows (low, high), got {box.tolist()}")
        self._key = tuple(map(tuple, box.tolist())), size
        self.nodes, self._axes = _nodes(*self._key)
        x0, P0 = gaussian_start(x0, P0, model.dim)
        white = (self.nodes - x0) @ np.linalg.inv(np.linalg.cholesky(P0)).T
        p = np.exp(-0.5 * np.sum(white**2, axis=1)).reshape(size, -1)
        if not p.sum() > 0.0:
            raise ModelError(f"the start at {x0} lies outside of the box {box.tolist()} or between its nodes")
        super().__init__(p / p.sum(), measurement, t0, dt)

    @property
    def probabilities(self):
        """Probabilities of the cells around `nodes`, summing to one; slightly negative in the tails."""
        return self._belief.ravel()

    def _moments(self, belief):
        x, y = self._axes
        along, across = belief.sum(axis=1), belief.sum(axis=0)
        mean = np.array([x @ along, y @ across])
        dx, dy = x - mean[0], y - mean[1]
        mixed = dx @ belief @ dy
        cov = np.array([[dx**2 @ along, mixed], [mixed, dy**2 @ across]])
        n = self.model.dim
        return mean[:n], cov[:n, :n]

    def _predicted(self, belief, t0, t1):
        n_steps = int(np.ceil((t1 - t0) / self.step * (1 - 1e-9)))
        plan = _plan(self.model, *self._key, float(f"{(t1 - t0) / n_steps:.12g}"))
        p = _march(belief, plan.begin, plan.between, plan.end, plan.corners, plan.weights, n_steps)
        return p / p.sum(), n_steps

    def _updated(self, belief, z, measurement):
        return weighed(belief, measurement.log_likelihood(z, self.nodes, self.t))


def weighed(belief, log_likelihood):
    """Belief times likelihood, and the log-evidence; the belief as it is where that is nothing."""
    top = log_likelihood.max()
    if not np.isfinite(top):
        return belief, {"log_evidence": -np.inf}
    posterior = belief * np.exp(log_likelihood - top).reshape(belief.shape)
    mass = posterior.sum()
    if not mass > 0.0:
        return belief, {"log_evidence": -np.inf}
    return posterior / mass, {"log_evidence": float(top + np.log(mass))}


def box_of_case(model, measurement, case):
    """Box (n, 2) that holds all particles of a particle filter on the measurements of a case, and between.

    What a hand would choose, with hindsight: looked at ten times an interval, and widened by .15 of its
    widths to either side. The case has times, z, x0, P0, t0.
    """
    filt = ParticleFilter(model, measurement, case.x0, case.P0, case.t0, n_particles=2000, rng=0)
    low, high = filt.particles.min(axis=0), filt.particles.max(axis=0)
    for t1, z in zip(case.times, case.z, strict=True):
        for t in np.linspace(filt.t, t1, 11)[1:]:
            filt.predict(t=t)
            low = np.minimum(low, filt.particles.min(axis=0))
            high = np.maximum(high, filt.particles.max(axis=0))
        filt.update(z)
    return np.stack([low - 0.15 * (high - low), high + 0.15 * (high - low)], axis=1)


@dataclass(frozen=True)
class _Plan:
    """Everything about steps of one length that does not depend on the density.

    Attributes
    ----------
    begin, between, end : tuple of two ndarrays
        Matrices left and right of the values: half a step of diffusion and spline coefficients, a whole one,
        half a one without. Rows are repeated beyond the ends, so that no spline needs to ask where it is.
    corners : ndarray of int32, shape (M, M', 2)
        First node under the spline at the foot of each node's characteristic; -1 outside of the box.
    weights : ndarray, shape (M, M', 12)
        Values of the splines along both axes; the first six contain exp(-∫ ∇·f dt).
    """

    begin: tuple
    between: tuple
    end: tuple
    corners: np.ndarray
    weights: np.ndarray


@lru_cache(maxsize=16)
def _nodes(box, size):
    """Nodes (M, n), and both axes; a second axis that is not there has one node, at zero."""
    axes = [low + (high - low) / size * (np.arange(size) + 0.5) for low, high in box]
    mesh = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(box))
    return mesh, (axes[0], axes[1] if len(box) == 2 else np.zeros(1))


@lru_cache(maxsize=16)
def _plan(model, box, size, dt):
    X, (x, y) = _nodes(box, size)
    D = np.diag(model.diffusion(X[:1], 0.0)[0])
    variances = [2.0 * dt * d / ((high - low) / size) ** 2 for d, (low, high) in zip(D, box, strict=True)]
    begin = _both([_circulant(0.5 * v, size, True) for v in variances])
    between = _both([_circulant(v, size, True) for v in variances])
    end = _both([_circulant(0.5 * v, size, False) for v in variances])
    feet, dilation = _feet(model, X, dt)
    corners, weights = np.zeros((len(X), 2), dtype=np.int32), np.zeros((len(X), 2 * _TAPS))
    weights[:, _TAPS] = 1.0  # a second axis that is not there
    inside = np.ones(len(X), dtype=bool)
    for a, (low, high) in enumerate(box):
        s = (feet[:, a] - low) * size / (high - low) - 0.5
        inside &= (s >= 0.0) & (s <= size - 1.0)
        s = np.where(inside, s, 0.0)
        corners[:, a] = np.floor(s)
        weights[:, a * _TAPS : (a + 1) * _TAPS] = spline_weights(s - np.floor(s))
    weights[:, :_TAPS] *= np.where(inside, np.exp(dilation), 0.0)[:, None]
    corners[~inside] = -1
    shape = len(x), len(y), -1
    return _Plan(begin, between, end, corners.reshape(shape), weights.reshape(shape))


def _circulant(variance, size, coefficients):
    """Matrix of a Gaussian blur of this variance (in nodes²), and of the splines' coefficients if asked for.

    With coefficients, rows stand for the nodes -2 ... size + 2 of a periodic axis.
    """
    k = 2.0 * np.pi * fft.fftfreq(size)
    column = fft.ifft(np.exp(-0.5 * variance * k**2) / (spline_symbol(k) if coefficients else 1.0)).real
    rows = np.arange(-2, size + 3) if coefficients else np.arange(size)
    return np.ascontiguousarray(column[(rows[:, None] - np.arange(size)) % size])


def _both(matrices):
    """Left matrix and right one, transposed; the latter repeats its only node where there is one axis."""
    if len(matrices) == 1:
        left = matrices[0]
        return left, np.ones((1, 1 if len(left) == left.shape[1] else _TAPS))
    return matrices[0], np.ascontiguousarray(matrices[1].T)


def _feet(model, X, dt):
    """States dt before X (M, n) along the drift, and -∫ ∇·f dt."""
    dilation = np.zeros(len(X))
    for _ in range(_PARTS):
        X, part = follow(model, X, 0.0, -dt / _PARTS)
        dilation += part
    return X, dilation


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def _transported(C, corners, weights, p):
    """Fill p with the splines of coefficients C at the feet; six by six of them at each."""
    for r in range(p.shape[0]):
        for c in range(p.shape[1]):
            i, j = corners[r, c]
            total = 0.0
            if i >= 0:
                for a in range(_TAPS):
                    line = 0.0
                    for b in range(_TAPS):
                        line += weights[r, c, _TAPS + b] * C[i + a, j + b]
                    total += weights[r, c, a] * line
            p[r, c] = total


@njit(cache=True, error_model="numpy")
def _march(p, begin, between, end, corners, weights, n_steps):
    """Values after n_steps of diffusion and advection, beginning and ending with half a diffusion."""
    p = p.copy()
    for s in range(n_steps):
        left, right = begin if s == 0 else between
        _transported(np.dot(np.dot(left, p), right), corners, weights, p)
    return np.dot(np.dot(end[0], p), end[1])
