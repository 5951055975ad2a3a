"""Steady state of oscillators with linear damping: Gibbs' density, for any potential and on rings too."""

from dataclasses import dataclass
from functools import cached_property
from math import prod

import numpy as np
from scipy.special import factorial2

from sphfilter import validate
from sphfilter.errors import ModelError

#: Nodes along a position axis: the trapezoidal rule converges faster than any power, on a ring as where the
#: density has died away at both ends.
_NODES = {1: 2049, 2: 769, 3: 129}


@dataclass(frozen=True)
class GibbsSteadyState:
    """Steady state of dx_i = v_i dt, dv_i = -(c v_i + ∂V/∂x_i) dt + dW_i, with E[dW_i²] = q dt.

    The density is Z⁻¹ exp(-(2c/q) (Σ v_i²/2 + V(x))): 000 (157) for the potential of Duffing's equation. All
    degrees of freedom share c and q; there are up to three.

    Attributes
    ----------
    potential : callable
        V, of positions (M, k) -> (M,), in units of v².
    box : array_like, shape (k, 2)
        Positions that are not negligible; a whole turn of an angle.
    c, q : float
        Damping 1/s, spectral density of the noise on the velocities.
    positions, velocities : tuple of k int, optional
        Where they stand in the state; x₁, v₁, x₂, v₂, ... if not given.

    Examples
    --------
    >>> ring = GibbsSteadyState(lambda x: 1.0 - np.cos(x[:, 0]), [[-np.pi, np.pi]], c=0.2, q=0.5)
    >>> round(ring.expectation(lambda x: np.cos(x[:, 0])), 6)  # I₁(.8) / I₀(.8)
    0.371075
    """

    potential: object
    box: np.ndarray
    c: float
    q: float = 1.0
    positions: tuple = None
    velocities: tuple = None

    def __post_init__(self):
        box = validate.array("box", self.box, (None, 2))
        k = len(box)
        if k not in _NODES or np.any(box[:, 1] <= box[:, 0]):
            raise ModelError(f"box must hold (low, high) of one to three positions, got {box.tolist()}.")
        object.__setattr__(self, "box", box)
        for name, first in (("positions", 0), ("velocities", 1)):
            given = getattr(self, name)
            object.__setattr__(self, name, tuple(range(first, 2 * k, 2)) if given is None else tuple(given))
        if sorted((*self.positions, *self.velocities)) != list(range(2 * k)):
            raise ModelError(f"positions and velocities must share the {2 * k} states out among them.")
        validate.positive("c", self.c)
        validate.positive("q", self.q)

    @property
    def temperature(self):
        """Variance of each velocity, q / (2 c)."""
        return self.q / (2.0 * self.c)

    @cached_property
    def _nodes(self):
        """Positions (M, k), their probabilities (M,), and the logarithm of the integral of the positions."""
        m = _NODES[len(self.box)]
        axes = [np.linspace(low, high, m) for low, high in self.box]
        weight = np.ones(m)
        weight[[0, -1]] = 0.5
        weights = np.array([1.0])
        for low, high in self.box:
            weights = np.multiply.outer(weights, weight * (high - low) / (m - 1)).ravel()
        x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
        log_p = -np.asarray(self.potential(x), dtype=float) / self.temperature
        mass = weights * np.exp(log_p - log_p.max())
        return x, mass / mass.sum(), np.log(mass.sum()) + log_p.max()

    def pdf(self, X):
        """Density at the states X (M, 2k), shape (M,)."""
        X = np.asarray(X, dtype=float)
        x, v, T = X[:, self.positions], X[:, self.velocities], self.temperature
        log_p = -self.potential(x) / T - self._nodes[2] - 0.5 * np.sum(v**2, axis=1) / T
        return np.exp(log_p - 0.5 * v.shape[1] * np.log(2.0 * np.pi * T))

    def expectation(self, function):
        """Mean of a function of the positions (M, k) -> (M,)."""
        x, mass, _ = self._nodes
        return float(mass @ np.asarray(function(x), dtype=float))

    def moment(self, powers):
        """Raw moment E Π x_d^a_d for the powers a of all 2k states."""
        a = [powers[d] for d in self.positions]
        b = [powers[d] for d in self.velocities]
        if any(k % 2 for k in b):
            return 0.0
        of_velocities = prod(float(factorial2(k - 1)) * self.temperature ** (k / 2) for k in b if k)
        return of_velocities * self.expectation(lambda x: np.prod(x ** np.array(a), axis=1))
