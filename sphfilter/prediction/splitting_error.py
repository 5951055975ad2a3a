"""Errors of densities between whose modes states jump at a few times of an interval only."""

import math
from collections.abc import Iterator, Sequence
from functools import cache
from typing import NamedTuple, cast

import numpy as np

from .._types import Floats
from ..core.limits import ENTRIES, LOOK
from ..density.as_family import moments_on_line
from ..density.modes import ModeDensities, SplittingError, no_ripple
from ..density.pieces import Pieces
from ..density.quasi_random import net
from ..lattice.level_set import root_of
from ..model.discretization import exponential
from ..model.jump_markov import JumpMarkovModel
from ..model.sde import SDE


def jumps_of(model: JumpMarkovModel, dt: float) -> float:
    """Jumps that a state takes in dt seconds, of the mode that it leaves the soonest."""
    return float(-model.rates.min()) * dt


def jump_times(steps: int, jumps: float) -> tuple[Floats, Floats]:
    """Shares (steps,) of an interval after which states jump, and shares (steps,) for which they do there.

    They are the nodes and weights of Gauss's rule, in as many even pieces as a state may take `jumps`: those
    that have jumped once are summed to degree 2 steps - 1; of several jumps in a piece the order is lost.
    """
    several = math.ceil(jumps)
    pieces = steps if steps <= several else max(p for p in range(1, max(several, 1) + 1) if steps % p == 0)
    nodes, weights = np.polynomial.legendre.leggauss(steps // pieces)
    share = (np.arange(pieces)[:, None] + 0.5 * (1.0 + nodes)) / pieces
    return share.ravel(), np.tile(0.5 * weights / pieces, pieces)


@cache
def _rules(steps: int, jumps: float) -> tuple[Floats, Floats, Floats]:
    """Shares (K,) of an interval, alike from both ends, and what finer rules there add to weights (K,)."""
    (few, w), (more, v) = jump_times(steps, jumps), jump_times(steps + 1, 0.0)
    even = np.linspace(0.0, 1.0, 2 * steps + 1)
    simpson = np.array([-1.0, *[2.0, -2.0] * (steps - 1), 2.0, -1.0]) / (3.0 * steps)
    parts, where = np.unique(np.round(np.concatenate([few, more, even]), 12), return_inverse=True)
    gauss, two = np.concatenate([-w, v, 0.0 * even]), np.concatenate([0.0 * w, 0.0 * v, simpson])
    return parts, np.bincount(where, gauss).astype(float), np.bincount(where, two).astype(float)


class _Flows(NamedTuple):
    """X -> Phi X + offset + N(0, Q) over K times: a model linearised about a state."""

    Phi: Floats  # (K, n, n)
    offset: Floats  # (K, n)
    Q: Floats  # (K, n, n)

    @classmethod
    def about(cls, sde: SDE, x: Floats, t: float, times: Floats) -> "_Flows":
        """Over times (K,), from a state (n,) at time t; by Van Loan's exponential, and doubling."""
        n, K = len(x), len(times)
        A = np.nan_to_num(sde.jacobian(x, t))
        b = np.nan_to_num(sde.drift(x[None], t)[0]) - A @ x
        both, affine = np.zeros((2 * n, 2 * n)), np.zeros((n + 1, n + 1))
        both[:n, :n], both[:n, n:], both[n:, n:] = -A, 2.0 * np.nan_to_num(sde.diffusion(x[None], t)[0]), A.T
        affine[:n, :n], affine[:n, n] = A, b
        doublings = max(0, math.frexp(float(np.linalg.norm(A, 1)) * times[-1])[1])
        h = times[:, None, None] / 2.0**doublings
        E, moved = exponential(both * h), exponential(affine * h)
        Phi, offset = moved[:, :n, :n], moved[:, :n, n:]
        Q = Phi @ E[:, :n, n:]
        for _ in range(doublings):
            offset, Q, Phi = Phi @ offset + offset, Phi @ Q @ Phi.transpose(0, 2, 1) + Q, Phi @ Phi
        return cls(Phi, offset.reshape(K, n), Q)

    def of(self, mean: Floats, cov: Floats) -> tuple[Floats, Floats]:
        """Means (K, n) and covariances (K, n, n) of Gaussians, of one or of K."""
        moved = (self.Phi @ mean[..., None])[..., 0] + self.offset
        return moved, self.Phi @ cov @ self.Phi.transpose(0, 2, 1) + self.Q

    def backwards(self) -> "_Flows":
        """The last time first."""
        return _Flows(*(part[::-1] for part in self))


def splitting_error(
    modes: ModeDensities, model: JumpMarkovModel, dt: float, steps: int
) -> list[SplittingError]:
    """Error of each mode's density after dt seconds in which states jump at so many times.

    With one jump from mode j the density of mode i has ∫ λ_ji U_i(dt - s) U_j(s) p_j ds. Of that the times
    make Gauss's rule; what the rule of one time more adds to it is an error. Two jumps in one part of the
    interval are taken in one order: of the λ dt / 2 that jump once more a trapezoidal rule is made, less
    Simpson's. Both are for Gaussians and the model linearised about them; over the density, averaged over the
    mass.
    """
    leaving = -np.diag(model.rates)
    share, gauss, simpson = _rules(steps, jumps_of(model, dt))
    starts = {j: p.form.heaviest or moments_on_line(p) for j, _, p in modes.some}
    flows = {
        (i, j): _Flows.about(cast(SDE, model.modes[model.names[i]]), mean, modes.heaviest.t, dt * share)
        for j, (mean, _) in starts.items()
        for i in range(len(model.names))
        if i == j or model.rates[i, j] > 0.0 or model.rates[j, i] > 0.0
    }
    P, off = model.transition(dt), [no_ripple(model.dim) for _ in model.names]
    for i in range(len(off)):
        means, covs, extra = [], [], []
        for j, (mean, cov) in starts.items():
            rate = model.rates[j, i]
            if i == j or rate == 0.0:
                continue
            ends = flows[i, j].backwards().of(*flows[j, j].of(mean, cov))
            again = min(0.25 * float(leaving[i] + leaving[j]) * dt, 1.0)
            extra += list(modes.w[j] * rate * dt * (gauss + again * simpson))
            means.append(ends[0])
            covs.append(ends[1])
        if np.any(extra):
            whole = float(modes.w @ P[:, i])
            found = _absolute(np.concatenate(means), np.concatenate(covs), np.array(extra) / whole)
            off[i] = found._replace(exact=all(mode.linear for mode in model.modes.values()))
    return off


def with_excursions(
    off: Sequence[SplittingError], modes: ModeDensities, model: JumpMarkovModel, dt: float, steps: int
) -> list[SplittingError]:
    """Splitting errors with where states may be that have left a mode and are back: for readings far out."""
    P, found = modes.w @ model.transition(dt), []
    for i, ripple in enumerate(off):
        parts = [(mean, cov, wrong / P[i]) for mean, cov, wrong in _excursions(modes, model, i, dt, steps)]
        if parts:
            more = _absolute(*(np.concatenate(part) for part in zip(*parts, strict=True)))
            both = np.concatenate([ripple.X, more.X]), np.concatenate([ripple.off, more.off])
            ripple = SplittingError(*both, ripple.mass, ripple.exact)
        found.append(ripple)
    return found


def _excursions(
    modes: ModeDensities, model: JumpMarkovModel, i: int, dt: float, steps: int
) -> Iterator[tuple[Floats, Floats, Floats]]:
    """Gaussians of states that are back in mode i from each other one, and by how much they are too light.

    In a part T of the interval λ_ik λ_ki (T - s) ds leave for s, and never else; for the steps those that are
    back in the same part, Σ T² / 2, have stayed. All parts are taken for the widest, in the middle.
    """
    density, parts = modes.densities[i], dt * jump_times(steps, jumps_of(model, dt))[1]
    there_and_back = model.rates[i] * model.rates[:, i] * (np.arange(len(modes.w)) != i)
    if density is None or modes.w[i] == 0.0 or not there_and_back.any():
        return
    nodes, weights = np.polynomial.legendre.leggauss(3)  # of the times away: exact to degree five
    away = 0.5 * (1.0 + np.append(-1.0, nodes))
    start = density.form.heaviest or moments_on_line(density)
    t, away_for = modes.heaviest.t, parts.max() * away
    around = _Flows.about(cast(SDE, model.modes[model.names[i]]), start[0], t, 0.5 * (dt - away_for[::-1]))
    around = around.backwards()
    for k in np.flatnonzero(there_and_back).tolist():
        other = _Flows.about(cast(SDE, model.modes[model.names[k]]), start[0], t, away_for)
        alone = np.exp(model.rates[i, i] * (dt - away_for) + model.rates[k, k] * away_for)
        share = np.append(0.0, 0.5 * weights) * (1.0 - away) * alone
        share[0] = -share.sum()
        mass = modes.w[i] * there_and_back[k] * float(parts @ parts)
        yield *around.of(*other.of(*around.of(*start))), mass * share


def _absolute(mean: Floats, cov: Floats, w: Floats) -> SplittingError:
    """The size of a sum of Gaussians with weights w (K,) of either sign."""
    own = w != 0.0
    several, w = Pieces(np.zeros(own.sum()), mean[own], root_of(cov[own])), w[own]
    each, n = math.ceil(LOOK**2 / max(len(w), LOOK)), mean.shape[1]
    X = (several.mean[:, None] + net(each, n) @ several.root.transpose(0, 2, 1)).reshape(-1, n)
    step = max(1, ENTRIES // several.mean.size)
    ratio = np.concatenate([_balance(several, w, X[i : i + step]) for i in range(0, len(X), step)])
    off = np.repeat(np.abs(w) / each, each) * ratio
    return SplittingError(X, off, min(float(off.sum()), 1.0))


def _balance(several: Pieces, w: Floats, X: Floats) -> Floats:
    """Ratio at states of a sum of Gaussians with weights of either sign to the sum of their sizes."""
    each = several.log_each(X)
    p = np.exp(each - each.max(axis=1, keepdims=True))
    return np.asarray(np.abs(p @ w) / (p @ np.abs(w)))
