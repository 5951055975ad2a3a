"""What later measurements say, λ, carried back from points to those before; and points that it leads on.

Each point's transition is linearised by itself, and put right by how the model moves the points of its block;
λ is quadratic about where a block comes. Both only say which points to draw, and are what λ is good to.
"""

from typing import NamedTuple

import numpy as np

from .._types import Floats, Ints
from ..core.cloud.ahead import LEAST, expected, fitted, led, shared_out
from ..core.cloud.blocks import block_roots, blocks_of, centres
from ..core.cloud.pace import Steps
from ..core.limits import FAR
from ..density.moments import columns
from ..density.passage import Transitions, along, stored_key
from ..density.quasi_random import even, systematic
from ..errors import PropagationError
from ..model.dynamics import Dynamics

#: What linearisation leaves on average over blocks, in standard deviations of the noise, up to which an
#: interval is one leg. Measured: at .13 and .05 means of two wells are .027 and .014 off.
_BENT = 0.05
_MOST_PARTS = 16  # measured: half leaves variances of two wells 1.7 times as far off, twice changes nothing
_LOOKED = 1024  # points by which that is judged, in sixteen blocks; measured: half and twice change nothing
#: Steps of a part at least. Of what noise adds to a position within a step its velocity does not tell a
#: quarter, 1/4 N^-2 of N steps' variance.
_FEWEST_STEPS = 8


class Said(NamedTuple):
    """λ at points x (N, n) of weights (N,): the log-likelihood of all measurements from then on."""

    x: Floats
    w: Floats
    values: Floats  # (N,), nats


class Leg(NamedTuple):
    """A part of an interval between measurements, and what is said of states at its end."""

    model: Dynamics
    span: tuple[float, float]  # seconds
    steps: Steps
    later: Said


class Ahead(NamedTuple):
    """Points in order along the curve, before a leg, and what is said of where they come."""

    order: Ints  # (N,)
    moves: Transitions
    ends: tuple[Floats, Floats, Ints]  # (N, n), L (N, n, n) and blocks (N,)
    about: tuple[Floats, Floats]  # as of `fitted`
    values: Floats  # λ, (N,)

    @classmethod
    def of(cls, x: Floats, w: Floats, leg: Leg, key: int) -> "Ahead":
        """Look ahead from points x (N, n) of weights w (N,)."""
        order = along(x, w)
        moves = Transitions.of(leg.model, np.ascontiguousarray(x[order]), leg.span, leg.steps)
        ends = _put_right(moves, key)
        about, values = _looked_at(ends, leg.later)
        return cls(order, moves, ends, about, values)

    @property
    def said(self) -> Floats:
        """λ (N,) of the points in the order in which they were given."""
        out = np.empty(len(self.order))
        out[self.order] = self.values
        return out

    def weights(self, w: Floats, y: Floats, later: Floats) -> Floats:
        """Weights (N,) given all measurements, of points of weights w (N,), by `later` (M,), those of y."""
        (end, lower, _), out, own = self.ends, np.empty(len(w)), np.empty(len(w))
        shared_out(end, rooted(_squares(lower)), w[self.order], np.ascontiguousarray(y), later, own)
        out[self.order] = own
        return out

    def led_on(self, w: Floats, key: int) -> tuple[Floats, Floats]:
        """Ends (N, n) of points drawn by weights (N,) that have λ in them, and log-weights without it."""
        own = systematic(w[self.order], len(w))
        u, told = _led(self.ends, self.about, own, key)
        return self.moves.moved(u, key, own), -self.values[own] - told


def start_led(mean: Floats, root: Floats, count: int, said: Said, key: int) -> tuple[Floats, Floats]:
    """Standard normals u (count, n) for which mean + L u is led to what is said, and log-weights (count,)."""
    ends = mean[None].copy(), root[None].copy(), np.zeros(1, np.int64)
    about, _ = _looked_at(ends, said)
    u, told = _led(ends, about, np.zeros(count, np.int64), key)
    return u, -told


def parts_of(model: Dynamics, x: Floats, w: Floats, span: tuple[float, float], steps: Steps) -> int:
    """Parts of an interval, by what linearisation leaves of how points x (N, n) of weights w (N,) move."""
    if model.linear:
        return 1
    if model.own_steps(*span):
        return model.own_steps(*span)
    x = np.ascontiguousarray(x[systematic(w, min(len(w), _LOOKED))])
    x, parts = x[along(x, np.full(len(x), 1.0 / len(x)))], 2  # of which its shadow takes one
    while parts < _MOST_PARTS:
        end = span[0] + (span[1] - span[0]) / parts
        moves = Transitions.of(model, x, (span[0], end), steps_of(steps, parts))
        shifted, bent, _ = _put_right(moves, 0)
        square = (shifted - moves.end) ** 2 + ((bent - moves.lower) ** 2).sum(axis=2)
        if np.all(square.mean(axis=0) <= _BENT**2 * (moves.lower**2).sum(axis=2).mean(axis=0)):
            break
        parts *= 2
    return parts


def steps_of(steps: Steps, parts: int) -> Steps:
    """Steps of one part of an interval: enough for their noise to move the states every way."""
    return steps._replace(number=max(-(-steps.number // parts), _FEWEST_STEPS))


def _put_right(moves: Transitions, key: int) -> tuple[Floats, Floats, Ints]:
    """Ends (N, n) and L (N, n, n) with what linearisation leaves, on average over blocks; blocks (N,)."""
    end, lower, block = moves.end, moves.lower, blocks_of(len(moves.x))
    if moves.rows is None:
        return end, lower, block
    u = even(len(end), end.shape[1], stored_key(key, 0), 0)
    # what linearisation leaves of how the model moves points, (N, n)
    left = moves.moved(u, stored_key(key, 1)) - moves.end - np.einsum("iab,ib->ia", moves.lower, u)
    bent = _of_blocks(np.einsum("ia,ib->iab", left, u), block)
    return end + _of_blocks(left, block)[block], lower + bent[block], block


def _of_blocks(values: Floats, block: Ints) -> Floats:
    """Means (blocks, ...) of values (N, ...) of points in blocks (N,)."""
    first, many = np.unique(block, return_index=True, return_counts=True)[1:]
    return np.add.reduceat(values, first) / many.reshape(-1, *[1] * (values.ndim - 1))


def _looked_at(ends: tuple[Floats, Floats, Ints], later: Said) -> tuple[tuple[Floats, Floats], Floats]:
    """Centres and fits of λ where blocks come, first without it and then with it; and log E exp λ (N,)."""
    end, lower, block = ends
    (N, n), noise = end.shape, _of_blocks(_squares(lower), block)
    centre, cov, own = centres(columns(end)), _squares(block_roots(columns(end))) + noise, rooted(noise)
    fits, x = np.empty((len(centre), 1 + n + n * n)), np.ascontiguousarray(later.x)
    fitted(x, later.w, later.values, centre, rooted(cov), fits)
    centre, cov = _shifted(centre, cov, own, fits)
    fitted(x, later.w, later.values, centre, rooted(cov), fits)
    _bounded(own, fits)
    values = np.empty(N)
    expected(end, lower, block, (centre, fits), values)
    # no mean of exp λ is more than its largest: a fit goes on beyond its points
    return (centre, fits), np.minimum(np.nan_to_num(values, nan=-np.inf), later.values.max())


def _shifted(centre: Floats, cov: Floats, own: Floats, fits: Floats) -> tuple[Floats, Floats]:
    """Centres and covariances of regions with λ in them, shifted by `FAR` at most: none has points farther.

    Measured: half and twice of that leave .9 to 1.06 of the errors of means.
    """
    n, root = centre.shape[1], rooted(cov)
    g, H = _bounded(own, fits)
    w, V = np.linalg.eigh(np.eye(n) - np.swapaxes(root, 1, 2) @ H @ root)
    new = _squares(root @ V / np.sqrt(np.maximum(w, LEAST))[:, None, :])
    shift = np.einsum("bac,bc->ba", new, g)
    far = np.linalg.norm(np.linalg.solve(root, shift[:, :, None]), axis=1)
    return centre + shift * np.minimum(FAR / np.maximum(far, FAR), 1.0), new


def _bounded(own: Floats, fits: Floats) -> tuple[Floats, Floats]:
    """Gradients (blocks, n) and second derivatives of fits for which exp λ has a mean over noise."""
    n = own.shape[1]
    if not np.isfinite(fits).all():
        raise PropagationError("what later measurements say is not known where points come; take more")
    g, H = fits[:, 1 : 1 + n], fits[:, 1 + n :].reshape(-1, n, n)
    h, V = np.linalg.eigh(np.swapaxes(own, 1, 2) @ H @ own)
    back = np.linalg.solve(np.swapaxes(own, 1, 2), V)
    H -= np.einsum("bak,bk,bck->bac", back, np.maximum(h - 1.0 + LEAST, 0.0), back)
    return g, H


def _led(
    ends: tuple[Floats, Floats, Ints], about: tuple[Floats, Floats], own: Ints, key: int
) -> tuple[Floats, Floats]:
    """Normals u (M, n) that lead points of numbers (M,); log of how much more often each is drawn so."""
    z = np.ascontiguousarray(even(len(own), ends[0].shape[1], stored_key(key, 2), 0))
    told = np.empty(len(own))
    led(*ends, about, own, z, told)
    return z, told


def _squares(roots: Floats) -> Floats:
    """L Lᵀ of matrices (..., n, n)."""
    return np.einsum("...ab,...cb->...ac", roots, roots)


def rooted(cov: Floats) -> Floats:
    """Lower roots of covariances (..., n, n); a combination of states without spread has next to none."""
    n = cov.shape[-1]
    size = np.maximum(np.einsum("...aa->...a", cov), 1e-12 * np.einsum("...aa->...", cov)[..., None])
    unit = np.sqrt(np.maximum(size, 1e-280))
    one = cov / (unit[..., :, None] * unit[..., None, :]) + 1e-10 * np.eye(n)
    return unit[..., :, None] * np.linalg.cholesky(one)
