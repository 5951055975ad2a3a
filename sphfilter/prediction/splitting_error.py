"""What steps of a splitting get wrong of densities between whose modes states jump."""

from typing import NamedTuple

import numpy as np

from .._types import Floats
from ..density.as_family import unrolled
from ..density.modes import ModeDensities, Ripple, no_ripple
from ..density.particle_density import ParticleDensity
from ..density.pieces import Pieces, nodes, root_of
from ..model.discretization import linear_transition, transition
from ..model.jump_markov import JumpMarkovModel
from ..model.sde import SDE

__all__ = ["splitting_error"]

_ROUNDS, _NEAR = 4, 2.5  # in which a part of a density grows, and standard deviations by which
_ENTRIES = 2**21  # of an array of states times Gaussians


class _Flow(NamedTuple):
    """X -> Phi X + offset + N(0, Q)."""

    Phi: Floats
    offset: Floats
    Q: Floats

    def after(self, first: "_Flow") -> "_Flow":
        """The flow of another one, and then of this."""
        return _Flow(
            self.Phi @ first.Phi,
            self.Phi @ first.offset + self.offset,
            self.Phi @ first.Q @ self.Phi.T + self.Q,
        )

    def of(self, mean: Floats, cov: Floats) -> tuple[Floats, Floats]:
        return self.Phi @ mean + self.offset, self.Phi @ cov @ self.Phi.T + self.Q


def _powers(sde: SDE, x: Floats, t: float, h: float, count: int) -> list[_Flow]:
    """The flows of a model, linearised about a state, over 0, h, ..., count h seconds."""
    n = len(x)
    if sde.linear:
        one = _Flow(*linear_transition(sde, h))
    else:
        A = np.nan_to_num(sde.jacobian(x, t))
        b = np.nan_to_num(sde.drift(x[None], t)[0]) - A @ x
        one = _Flow(*transition(A, b, 2.0 * np.nan_to_num(sde.diffusion(x[None], t)[0]), h))
    flows = [_Flow(np.eye(n), np.zeros(n), np.zeros((n, n)))]
    for _ in range(count):
        flows.append(one.after(flows[-1]))
    return flows


def splitting_error(modes: ModeDensities, model: JumpMarkovModel, dt: float, steps: int) -> list[Ripple]:
    """What is wrong with each mode's density after dt seconds in so many steps.

    With jumps from mode j at the times s, the density of mode i has ∫ λ_ji U_i(dt - s) U_j(s) p_j ds. Of
    that the steps make a trapezoidal rule; what Simpson's rule adds to it is taken for its error, over the
    density, rms over the mass.
    """
    h, t = 0.5 * dt / steps, modes.heaviest.t
    starts = {j: _narrow(p) for j, _, p in modes.some}
    flows = {
        (i, j): _powers(model.modes[model.names[i]], mean, t, h, 2 * steps)
        for j, (mean, _) in starts.items()
        for i in range(len(model.names))
        if i == j or model.rates[i, j] > 0.0 or model.rates[j, i] > 0.0
    }
    simpson = np.array([1.0, *[4.0, 2.0] * (steps - 1), 4.0, 1.0]) * h / 3.0
    trapezoid = np.array([1.0, *[0.0, 2.0] * (steps - 1), 0.0, 1.0]) * h
    P, off = model.transition(dt), [no_ripple(model.dim) for _ in model.names]
    for i in range(len(off)):
        means, covs, extra = [], [], []
        for j, (mean, cov) in starts.items():
            rate = model.rates[j, i]
            if i == j or rate == 0.0:
                continue
            first, then = flows[j, j], flows[i, j]
            ends = [then[2 * steps - m].of(*first[m].of(mean, cov)) for m in range(2 * steps + 1)]
            extra += list(modes.w[j] * rate * (simpson - trapezoid))
            means += [mean for mean, _ in ends]
            covs += [cov for _, cov in ends]
        if np.any(extra):
            whole = float(modes.w @ P[:, i])
            off[i] = _absolute(np.array(means), np.array(covs), np.array(extra) / whole)
    return off


def _narrow(density: ParticleDensity) -> tuple[Floats, Floats]:
    """Mean (n,) and covariance (n, n) of a density, or of its heaviest part with all that lies about it."""
    if density.pieces is not None:
        w, middle, own = density.pieces.w, density.pieces.mean, density.pieces.cov
    elif density.families is not None:
        A = density.families.A
        w, middle, own = density.families.w, density.families.mu, np.einsum("kab,kcb->kac", A, A)
    else:
        return unrolled(density)
    mean, cov = middle[0], own[0]
    for _ in range(_ROUNDS):
        z = np.linalg.solve(np.linalg.cholesky(cov), (middle - mean).T)
        near = np.sum(z**2, axis=0) < _NEAR**2
        share = w[near] / w[near].sum()
        mean = share @ middle[near]
        off = middle[near] - mean
        cov = np.einsum("k,kab->ab", share, own[near]) + np.einsum("k,ka,kb->ab", share, off, off)
    return mean, cov


def _absolute(mean: Floats, cov: Floats, w: Floats) -> Ripple:
    """The size of a sum of Gaussians with weights w (K,) of either sign."""
    own = w != 0.0
    several, w = Pieces(np.zeros(own.sum()), mean[own], root_of(cov[own])), w[own]
    xi, u = nodes(mean.shape[1])
    X = (several.mean[:, None] + np.einsum("kab,ib->kia", several.root, xi)).reshape(-1, mean.shape[1])
    step = max(1, _ENTRIES // several.mean.size)
    ratio = np.concatenate([_balance(several, w, X[i : i + step]) for i in range(0, len(X), step)])
    return Ripple(X, np.outer(np.abs(w), u).ravel() * ratio)


def _balance(several: Pieces, w: Floats, X: Floats) -> Floats:
    """What Gaussians with weights of either sign are at states, over the same with weights above zero."""
    each = several.log_each(X)
    p = np.exp(each - each.max(axis=1, keepdims=True))
    return np.asarray(np.abs(p @ w) / (p @ np.abs(w)))
