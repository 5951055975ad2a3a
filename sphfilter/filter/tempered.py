"""Points moved to where a likelihood is, by degrees: for sensors that say nothing but a likelihood.

Powers b of the likelihood rise to one, each as far as half of the points still carry it. At each, points
are drawn anew, and the noise of the ways that they came is changed a little: u into √(1-s²) u + s v with a
new normal v, and of the noise beside it a part s². Both leave the prior as it is, so that the likelihoods'
powers alone accept or not (Neal 2001; Cotter, Roberts, Stuart & White 2013).
"""

import math
from typing import Any, NamedTuple

import numpy as np

from .._types import Floats, Ints, OfStates
from ..core.cloud.move import affine, move_along
from ..core.cloud.noise import noise_of, renew, uniforms
from ..core.cloud.weights import effective, normalise, systematic
from ..core.limits import LOOK, TINY
from ..density.moments import columns
from ..density.passage import normals, sub_key
from ..density.points import Carried, Points
from ..model.compile import surfacing

#: Passes of N points in all, twenty times both of the guided ones, 20 · 2 = 40; of these, such that draw from
#: the prior, as long as they have fewer independent points than are enough: a draw adds points, a move parts
#: copies.
_PASSES, _DRAWS = 40, 28
_MOVES = 3  # at each power: a third of moves is accepted, and (2/3)³ leaves one of two copies apart
#: E-foldings to either side of steps tried: from e^-8 of the prior's width up to all of it; later, a factor.
_AT_FIRST, _LATER = 4.0, 1.0


class _Ways(NamedTuple):
    """Ways of M points: starts, normals u and kept noise of each passage, ends, the draws they come from."""

    start: Floats  # (M, n)
    block: Ints
    u: tuple[Floats, ...]  # (M, n)
    noise: tuple[Floats | None, ...]  # (3, d, M); None where a passage has none beside u
    end: Floats  # (M, n)
    log_l: Floats  # (M,)
    lineage: Ints  # (M,)

    def chosen(self, i: Ints) -> "_Ways":
        """The ways of numbers i."""
        u, noise = [v[i] for v in self.u], [None if z is None else z[:, :, i] for z in self.noise]
        return _Ways(
            self.start[i], self.block[i], tuple(u), tuple(noise), self.end[i], self.log_l[i], self.lineage[i]
        )

    def moved(self, taken: Any, new: "_Ways") -> "_Ways":
        """The new ones where they are taken, bool (M,)."""
        rows = taken[:, None]
        u = [np.where(rows, a, b) for a, b in zip(new.u, self.u, strict=True)]
        pairs = zip(new.noise, self.noise, strict=True)
        noise = [None if a is None or b is None else np.where(taken, a, b) for a, b in pairs]
        end, log_l = np.where(rows, new.end, self.end), np.where(taken, new.log_l, self.log_l)
        return self._replace(u=tuple(u), noise=tuple(noise), end=end, log_l=log_l)


class _Steps(NamedTuple):
    """Steps s of moves, spread about one by so many e-foldings to either side."""

    size: float = math.exp(-_AT_FIRST)
    spread: float = _AT_FIRST

    def of(self, count: int, key: Any) -> Floats:
        """A step for each point, (count,)."""
        return np.minimum(1.0, self.size * np.exp(self.spread * (2.0 * uniforms(key, count) - 1.0)))

    def after(self, steps: Floats, taken: Any) -> "_Steps":
        """About those that took points farthest; much smaller ones where none was taken."""
        went = taken * steps**2
        if not went.sum() > 0.0:
            return _Steps(self.size * math.exp(-self.spread), self.spread)
        return _Steps(math.exp(float(np.sum(went * np.log(steps)) / went.sum())), _LATER)


def tempered(points: Points, log_likelihood: OfStates, key: int) -> Carried | None:
    """A posterior by ever higher powers of a likelihood, of a prior with the path that its points came.

    The log-likelihood is a function of states (M, n), shape (M,). None where no draw of the prior can have
    been read.
    """
    path, N = points.path, len(points.w)
    assert path is not None
    ways, log_w, passes = _drawn(points, log_likelihood, key)
    log_evidence, b, steps, older = 0.0, 0.0, _Steps(), np.tile(points.older, passes)
    mass = np.tile(points.w, passes)
    if ways is None:
        return None
    while b < 1.0:
        before, w = b, np.empty(len(log_w))
        b = _power(log_w, ways.log_l, b, N) if passes + 2 * _MOVES <= _PASSES else 1.0
        log_evidence += normalise(_risen(log_w, ways.log_l, b - before), w)
        ways = ways.chosen(systematic(w, N, uniforms(sub_key(key, 2000 + passes), 1)[0]))
        log_w = np.full(N, -math.log(N))
        while True:
            for _ in range(_MOVES):
                ways, steps = _moved(
                    ways, path.passages, log_likelihood, b, steps, sub_key(key, 1000 + passes)
                )
                passes += 1
            found = Carried.of(ways.end, log_w + log_evidence, ways.lineage, mass)
            if b < 1.0 or found.effective >= LOOK or passes + _MOVES > _PASSES:
                break
    return Carried.of(ways.end, log_w + log_evidence, ways.lineage, mass, older)


def _risen(log_w: Floats, log_l: Floats, rise: float) -> Floats:
    """Log-weights (M,) after a power has risen; what cannot be read weighs nothing at any power."""
    return np.where(log_l > -np.inf, log_w + rise * np.maximum(log_l, -1e300), -np.inf)


def _drawn(points: Points, log_likelihood: OfStates, key: int) -> tuple[_Ways | None, Floats, int]:
    """Ways that can be read, drawn from the prior once and again; their log-weights, and how often."""
    path, parts, N = points.path, [], len(points.w)
    assert path is not None
    once, w = np.log(np.maximum(points.w, TINY)), np.empty(0)
    for k in range(_DRAWS):
        u, noise = _fresh(path.passages, N, path.x.shape[1], sub_key(key, k))
        end = _ends(path.passages, path.x, path.block, u, noise)
        parts.append(_Ways(path.x, path.block, u, noise, end, log_likelihood(end), np.arange(N) + k * N))
        log_l, log_w = np.concatenate([p.log_l for p in parts]), np.tile(once - math.log(k + 1), k + 1)
        w = np.zeros(len(log_l))
        if np.isfinite(normalise(_risen(log_w, log_l, 1.0), w)) and effective(w) >= LOOK:
            break
    heavy = np.flatnonzero(log_l > -np.inf)
    return (_together(parts).chosen(heavy) if len(heavy) else None), log_w[heavy], len(parts)


def _together(parts: list[_Ways]) -> _Ways:
    """Ways of several draws as one."""
    start, block, u, noise, end, log_l, lineage = zip(*parts, strict=True)
    U = [np.concatenate(v) for v in zip(*u, strict=True)]
    Z = [None if z[0] is None else np.concatenate(z, axis=2) for z in zip(*noise, strict=True)]
    rest = [np.concatenate(v) for v in (end, log_l, lineage)]
    return _Ways(np.concatenate(start), np.concatenate(block), tuple(U), tuple(Z), *rest)


def _fresh(passages: Any, count: int, n: int, key: Any) -> tuple[Any, Any]:
    """Normals (count, n) and noise beside them of every passage."""
    noise = [
        noise_of(sub_key(key, 100 + k), count, p.rows.shape[2], p.leg.kind, p.leg.walls) if p.leg else None
        for k, p in enumerate(passages)
    ]
    return normals(count, n, key, len(passages)), tuple(noise)


def _ends(passages: Any, x: Floats, block: Ints, u: Any, noise: Any) -> Floats:
    """Ends (M, n) of points that start at x (M, n), moved by such noise."""
    for p, v, z in zip(passages, u, noise, strict=True):
        if p.leg is None:
            x = affine(columns(x), columns(v), block, p.start, p.end, p.flow, p.lower).T
            continue
        moving = columns(x).copy()
        with surfacing():
            move_along(p.leg, moving, columns(v), p.rows, block, z)
        x = moving.T
    return x


def _power(log_w: Floats, log_l: Floats, b: float, count: int) -> float:
    """The highest power, b now, that half of the points still carry, or of those that can have been read."""
    w = np.empty(len(log_w))

    def number(power: float) -> float:
        normalise(_risen(log_w, log_l, power - b), w)
        return float(effective(w))

    enough = 0.5 * min(count, number(b))
    if number(1.0) >= enough:
        return 1.0
    low, high = -60.0, 0.0  # logarithms of the rise over what is left
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if number(b + (1.0 - b) * math.exp(middle)) >= enough else (low, middle)
    return b + (1.0 - b) * math.exp(low)


def _moved(
    ways: _Ways, passages: Any, log_likelihood: OfStates, b: float, steps: _Steps, key: Any
) -> tuple[_Ways, _Steps]:
    """Ways after a move of each that its likelihood's power accepts, and the steps to try next."""
    M, n = ways.start.shape
    s = steps.of(M, sub_key(key, 300))
    v, fresh = _fresh(passages, M, n, key)
    stay = np.sqrt(1.0 - s**2)[:, None]
    u = tuple(stay * old + s[:, None] * new for old, new in zip(ways.u, v, strict=True))
    noise = tuple(None if z is None else z.copy() for z in ways.noise)
    for k, (z, new) in enumerate(zip(noise, fresh, strict=True)):
        if z is not None:
            renew(z, new, s**2, sub_key(key, 200 + k))
    end = _ends(passages, ways.start, ways.block, u, noise)
    log_l = log_likelihood(end)
    taken = np.log(uniforms(sub_key(key, 400), M)) < _risen(np.zeros(M), log_l, b) - b * ways.log_l
    new_ways = ways._replace(u=u, noise=noise, end=end, log_l=log_l)
    return ways.moved(taken, new_ways), steps.after(s, taken)
