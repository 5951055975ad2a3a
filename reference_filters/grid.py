"""Grid filter in one and two dimensions: the referee that certifies the others where the state is small.

Strang splitting of the Fokker-Planck equation on a box that moves, turns and stretches with the density.
Advection is semi-Lagrangian: the density at a node is that at the foot of its characteristic times
exp(-∫ ∇·f dt). Diffusion is the exact Gaussian convolution, in Fourier space. Each step is done once whole
and once in two halves: extrapolated, they are of fourth order in time; their difference sets the step.
The boxes before and after an advection may differ at no cost, so the box is fitted anew at every step.
"""

import numpy as np
from scipy.stats import qmc

from sphfilter import validate
from sphfilter.density.weighted import WeightedStates
from sphfilter.errors import ModelError, PropagationError

from ._base import ReferenceFilter, gaussian_start
from ._characteristics import follow
from .grid_density import FLOOR, Box, GridDensity, fitted_box

#: Points in a cell that stand for it.
_CELL_POINTS = 16


class GridFilter(ReferenceFilter):
    """Split-step grid filter for models of one or two states whose noise does not depend on the state.

    Parameters
    ----------
    model : SDE
    measurement : measurement model or None
    x0, P0 : array_like, shapes (n,), (n, n), optional
        Gaussian start.
    t0, dt : float
        Start, and interval of `predict()` without arguments, seconds.
    size : int
        Nodes an axis.
    tol : float
        L1 distance allowed between a step and its two halves; what is kept is more accurate by two orders.
    density : GridDensity, optional
        Start of any shape, instead of x0 and P0.
    box : array_like, shape (n, 2), optional
        Box to stay in, instead of one that follows the density.
    """

    takes_inputs = True

    def __init__(self, model, measurement, x0=None, P0=None, t0=0.0, dt=None, *, size=96, tol=1e-3,
                 density=None, box=None):  # fmt: skip
        if model.dim not in (1, 2):
            raise ModelError(f"GridFilter takes 1 or 2 states, the model has {model.dim}: use ParticleFilter")
        if model.state_dependent_noise:
            raise ModelError("GridFilter needs noise that does not depend on the state: use ParticleFilter")
        self.model = model
        self.size = validate.count("size", size, 16)
        self.tol = validate.positive("tol", tol)
        self._fixed_box = None if box is None else Box.between(box, self.size)
        self._step_hint = np.inf
        if density is None:
            density = _gaussian(*gaussian_start(x0, P0, model.dim), self.size, self._fixed_box)
        super().__init__(density, measurement, t0, dt)

    @property
    def density(self):
        """The density now, a `GridDensity`."""
        return self._belief

    def spread(self):
        """Points in every cell as `WeightedStates`: sums over nodes alone see an edge half a cell off."""
        p = self._belief
        parts = qmc.Sobol(p.box.dim, scramble=False).random(_CELL_POINTS) - 0.5 + 0.5 / _CELL_POINTS
        X = (p.box.nodes()[:, None] + parts @ p.box.axes.T * (2.0 / p.box.size)).reshape(-1, p.box.dim)
        values = p.pdf(X)
        some = values > FLOOR * values.max()
        X, values = X[some], values[some]

        def logpdf(Y):
            return np.log(np.maximum(p.pdf(Y), 1e-300))

        return WeightedStates(X, values / values.sum(), logpdf, np.log(values))

    def _moments(self, belief):
        return belief.moments()

    def _predicted(self, belief, t0, t1):
        t, n_steps, step = t0, 0, self._step_hint
        while t < t1:
            dt = (t1 - t) / np.ceil((t1 - t) / min(step, t1 - t))
            proposal, error = self._step(belief, t, dt)
            if error <= self.tol:
                self._check_resolved(proposal, t + dt)
                belief, n_steps = proposal, n_steps + 1
                t = t1 if t + dt > t1 - 1e-9 * dt else t + dt
                self._step_hint = step
            elif dt < 1e-5 * (t1 - t0):
                raise PropagationError(
                    f"grid step at t = {t:g} s: its error of {error:.2g} does not fall with the step "
                    f"({dt:.2g} s); raise size above {self.size} or tol above {self.tol:g}"
                )
            step = dt * np.clip(0.9 * (self.tol / max(error, 1e-300)) ** (1 / 3), 0.2, 3.0)
        return belief.normalised(), n_steps

    def _check_resolved(self, p, t):
        """Splines ring where the nodes are too far apart: a deep undershoot tells."""
        undershoot = -p.values.min() / p.values.max()
        if not undershoot < 0.01:
            raise PropagationError(
                f"the grid of {self.size} nodes an axis is too coarse at t = {t:g} s: the density falls to "
                f"{-undershoot:.2g} of its maximum; raise size"
            )

    def _step(self, p, t, dt):
        """Extrapolated step, and the L1 error of the finer of its two parts."""
        D0, D1, D2 = (self.driven.diffusion(p.box.centre[None], t + c * dt)[0] for c in (0.5, 0.25, 0.75))
        boxes = self._boxes_ahead(p, t, 0.5 * dt)
        if boxes is None:
            return p, np.inf
        box1, box2 = boxes
        whole = self._advected(p, p.coefficients(dt * D0), t, dt, box2).blurred(dt * D0)
        half = self._advected(p, p.coefficients(0.5 * dt * D1), t, 0.5 * dt, box1)
        blurred = half.coefficients(0.5 * dt * (D1 + D2))
        halves = self._advected(half, blurred, t + 0.5 * dt, 0.5 * dt, box2).blurred(0.5 * dt * D2)
        difference = (halves.values - whole.values) / 3.0
        error = np.abs(difference).sum() * box2.cell
        # a step so long that both ways lose the density agree perfectly
        kept = np.isfinite(error) and abs(halves.mass - p.mass) < 0.1 * p.mass
        return GridDensity(box2, halves.values + difference), (error if kept else np.inf)

    def _advected(self, p, coefficients, t, dt, box):
        """Transport over dt of the density with these spline coefficients, on the nodes of `box`."""
        feet, dilation = follow(self.driven, box.nodes(), t + dt, -dt)
        with np.errstate(over="ignore", invalid="ignore"):
            values = p.interpolated(feet, coefficients) * np.exp(dilation)
        values[~np.isfinite(values)] = 0.0  # characteristics that come from infinity carry nothing
        return GridDensity(box, values.reshape(box.shape))

    def _boxes_ahead(self, p, t, dt):
        """Boxes that will hold the density after dt and 2 dt; None if that is too long to tell."""
        if self._fixed_box is not None:
            return self._fixed_box, self._fixed_box
        X, weights = p.support(stride=2)
        D = self.driven.diffusion(p.box.centre[None], t + dt)[0]
        boxes = []
        for i in range(2):
            X, _ = follow(self.driven, X, t + i * dt, dt)
            if not np.all(np.abs(p.box.indices(X)) < 1e3 * self.size):
                return None
            boxes.append(fitted_box(X, weights, 2.0 * (i + 1) * dt * D, self.size))
        return boxes

    def _updated(self, belief, z, measurement):
        prior = belief
        for _ in range(60):
            box = prior.box
            log_likelihood = measurement.log_likelihood(z, box.nodes(), self.t).reshape(box.shape)
            top = np.max(log_likelihood)
            if not np.isfinite(top):
                return belief, {"log_evidence": -np.inf}
            power = _resolved_power(prior.values, log_likelihood - top)
            posterior = GridDensity(box, prior.values * np.exp(power * (log_likelihood - top)))
            if not posterior.mass > 0.0:
                return belief, {"log_evidence": -np.inf}
            fitted = self._box_of(posterior)
            if power == 1.0 and (self._fixed_box is not None or fitted.cell > 0.7 * box.cell):
                log_evidence = top + np.log(posterior.mass / belief.mass)
                return posterior.normalised(), {"log_evidence": float(log_evidence)}
            if self._fixed_box is not None:
                break
            prior = belief.on(fitted)
        raise PropagationError(
            f"the posterior at t = {self.t:g} s is finer than {self.size} nodes an axis resolve; raise size"
        )

    def _box_of(self, p):
        if self._fixed_box is not None:
            return self._fixed_box
        spacing = p.box.axes * (2.0 / p.box.size)
        return fitted_box(*p.support(), spacing @ spacing.T, self.size)


def _resolved_power(prior, log_likelihood):
    """Largest power <= 1 of the likelihood whose product with the prior still lives on enough nodes.

    A product on a handful of nodes says nothing of the box that it needs: a needle is approached by steps.
    """
    enough = 3.0**prior.ndim  # a Gaussian on three nodes an axis is summed to 1e-6

    def n_nodes(power):
        w = np.maximum(prior, 0.0) * np.exp(power * log_likelihood)
        top = w.max()
        return w.sum() ** 2 / np.sum(w * w) if top > 1e-150 else 0.0

    if n_nodes(1.0) >= enough:
        return 1.0
    low, high = -60.0, 0.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if n_nodes(np.exp(middle)) >= enough else (low, middle)
    return np.exp(low)


def _gaussian(x0, P0, size, box):
    """N(x0, P0) on `box`, or on one that fits."""
    L = np.linalg.cholesky(P0)
    if box is None:
        box = fitted_box(x0[None], np.ones(1), P0, size)
    to_white = np.linalg.inv(L)
    return GridDensity.sampled(lambda X: np.exp(-0.5 * np.sum(((X - x0) @ to_white.T) ** 2, axis=1)), box)
