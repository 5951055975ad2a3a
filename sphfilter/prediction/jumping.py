"""Clouds of points whose states jump between the modes of a model: every point takes jumps of its own.

The points of a mode after an interval are those that were in it all the way, which one prediction carries,
and those that came into it. Of these each draws the modes that it was in between the times of jumps, from the
last to the first, begins at a point of the first, and goes from time to time by the equation of each.

A reading weights all and leads none. Led along their way since the last jump, group by group, equal points
were off by 1 to 1/2.7 as much in 4 to 7 times the time: for equal time more, also where 4 % carry a reading.
"""

import math
from functools import reduce
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from .._types import Floats, Ints
from ..config import CloudScheme
from ..core.cloud.control import SHADOW
from ..core.cloud.lineages import LINES
from ..core.cloud.pace import Steps
from ..core.limits import GOLDEN, TINY
from ..density.as_cloud import cloud_of
from ..density.modes import ModeDensities
from ..density.moments import moments
from ..density.passage import Use, along, moved_freely, stored_key
from ..density.points import FRESH, CloudState, Points
from ..errors import PropagationError
from ..info import PredictInfo
from ..model.jump_markov import JumpMarkovModel
from .cloud import (
    Carried,
    as_points,
    carried_cloud,
    info_of,
    shadow_size,
    squared_differences,
    unrolled_about_mean,
    without_runaways,
)
from .splitting_error import jump_times, jumps_of

#: Probability of a mode below which it may not stop a prediction: 10,000 standard deviations off it moves a
#: mean by 1e4 · 1e-12 = 1e-8 of one.
UNLIKELY = 1e-12


def suits(model: JumpMarkovModel) -> bool:
    """Whether clouds are cheaper than sums of densities: not where these are Gaussians, or of one state."""
    modes = model.modes.values()
    walled, linear = any(m.domain.walled.any() for m in modes), all(m.linear for m in modes)
    return model.dim > 1 and not walled and not linear


class Way(NamedTuple):
    """An interval, and the times in it at which states jump between modes."""

    times: Floats  # (Q + 2,) seconds: its begin, the times of jumps, its end
    jumps: tuple[Floats, ...]  # Q matrices (M, M): probabilities of the mode of a column after that of a row

    @classmethod
    def of(cls, model: JumpMarkovModel, span: tuple[float, float], steps: int) -> "Way":
        """With so many steps of the splitting of equations; maps jump where each step begins."""
        t0, dt = span[0], span[1] - span[0]
        if model.transitions is not None:
            starts = model.starts(*span)
            return cls(np.array([t0, *starts, span[1]]), (model.transitions,) * len(starts))
        if not model.rates.any():
            return cls(np.array(span), ())
        share, weight = jump_times(steps, jumps_of(model, dt))
        times = np.array([t0, *(t0 + share * dt), span[1]])
        return cls(times, tuple(model.transition(part * dt) for part in weight.tolist()))

    @property
    def span(self) -> tuple[float, float]:
        """Begin and end, seconds."""
        return float(self.times[0]), float(self.times[-1])

    def forward(self, w: Floats) -> list[Floats]:
        """Probabilities (M,) of the modes at the begin, and after each time of jumps."""
        found = [w]
        for P in self.jumps:
            found.append(np.einsum("i,ij->j", found[-1], P))
        return found

    def in_doubt(self, modes: ModeDensities) -> tuple[Floats, Floats]:
        """What probabilities in doubt make of the end: variances (M,) of log w, and wrong parts (M,).

        Jumps even errors out; but of states that come from other modes, and lie elsewhere, are then too many.
        """
        came = reduce(np.matmul, self.jumps, np.eye(len(modes.w)))
        whole = np.maximum(modes.w @ came, TINY)
        off = modes.in_doubt[:, None] * came / whole
        wrong = off * (1.0 - modes.w[:, None] * came / whole) * modes.apart(came)
        return np.log1p(np.sqrt(np.sum(off**2, axis=0))) ** 2, np.sqrt(np.sum(wrong**2, axis=0))

    def modes_before(self, forward: list[Floats], j: int, u: Floats) -> Ints:
        """Modes (K, Q + 1) between the jumps of states that end in mode j, of numbers u (K,) below one.

        The modes before an end are drawn one after the other by what is left of the number. Those that never
        left mode j are the least numbers.
        """
        path, Q, M = np.full((len(u), len(self.jumps) + 1), j), len(self.jumps), len(forward[0])
        order, u = np.array([j, *(i for i in range(M) if i != j)]), u.copy()
        for q in range(Q, 0, -1):
            for m in np.unique(path[:, q]):
                own = path[:, q] == m
                came = np.cumsum(forward[q - 1][order] * self.jumps[q - 1][order, m])
                edges = np.concatenate([[0.0], came / came[-1]])
                k = np.clip(np.searchsorted(edges, u[own], side="right") - 1, 0, M - 1)
                u[own] = (u[own] - edges[k]) / np.maximum(edges[k + 1] - edges[k], TINY)
                path[own, q - 1] = order[k]
        return path


def carried_with_jumps(
    modes: ModeDensities, model: JumpMarkovModel, way: Way, count: int, target: float
) -> tuple[ModeDensities, dict[int, PredictInfo]]:
    """Carry the densities of all modes over an interval as clouds; and what is said of each, by its number.

    Of the points `count` stay in each mode; `target` is the error of the mean that is asked for, in standard
    deviations. Raises `PropagationError` if a mode that is not unlikely cannot be carried; it says why.
    """
    sources = _Sources(modes, model, way, count, target)
    forward, log_w = way.forward(sources.w), np.full(len(modes.w), -math.inf)
    densities: list[Any] = [None] * len(log_w)
    infos = {}
    for j, w in enumerate(forward[-1].tolist()):
        stayed = sources.carried(j) if w > 0.0 else None
        if stayed is None:
            continue
        state, sums, error = sources.together(forward, j, stayed)
        log_w[j] = math.log(w)
        about = modes.densities[j] or modes.heaviest
        known: dict[str, Any] = {"t": way.span[1], "capacity": about.capacity, "error": error}
        densities[j] = cloud_of(about, state, sums, **known)
        if about.needs is not None:
            densities[j] = densities[j].noted(needs=about.needs.gone_on()._replace(points=count))
        infos[j] = info_of(model.modes[model.names[j]], count, stayed.steps, stayed.lost, error)
    return ModeDensities(log_w, densities, modes.splitting), infos


class _Sources:
    """Clouds of all modes, and where one prediction carries each."""

    def __init__(
        self, modes: ModeDensities, model: JumpMarkovModel, way: Way, count: int, target: float
    ) -> None:
        self.w = modes.w.copy()
        self._models = [model.modes[name] for name in model.names]
        self._way, self._count, self._target = way, count, target
        self._domain, self._heaviest = modes.heaviest.domain, int(np.argmax(modes.w))
        self._states = {i: as_points(density, count) for i, _, density in modes.some}
        self._carried: dict[int, Carried | None] = {}
        for i in self._states:
            try:
                self._carried[i] = self._alone(i, i)
            except PropagationError as problem:
                if self.w[i] > UNLIKELY:
                    raise PropagationError(f"mode {model.names[i]!r}: {problem}") from problem
                self._carried[i], self.w[i] = None, 0.0

    def _alone(self, i: int, j: int) -> Carried:
        """The cloud of mode i carried by the model of mode j."""
        scheme = CloudScheme(n_points=self._count)
        return carried_cloud(
            self._states[i], self._models[j], self._way.span, scheme, self._target, self._domain
        )

    def carried(self, j: int) -> Carried | None:
        """The cloud that stays in mode j; of a mode without one, another's carried by its model; or None."""
        if j not in self._carried:
            self._carried[j] = self._alone(self._heaviest, j)
        return self._carried[j]

    def together(
        self, forward: list[Floats], j: int, stayed: Carried
    ) -> tuple[CloudState, tuple[Floats, Floats], float]:
        """The cloud of mode j with those that came, its moments, and the error of its mean."""
        staying = math.prod(float(P[j, j]) for P in self._way.jumps)  # probability of no jump
        state, share = stayed.state, self.w[j] * staying / forward[-1][j]
        clouds, sums, inherited = [], [], share * state.inherited.error**2
        for k, points in enumerate((state.points, state.shadow)):
            key = stored_key(stored_key(stayed.state.age, Use.JUMPS + k), j)
            if share < 1.0:
                came, before = self._came(forward, j, share, k, key)
                x, w = np.concatenate([points.x, came.x]), [share * points.w, (1.0 - share) * came.w]
                lineage = _side_by_side(self._numbered(points.older, k, j), came.older)
                points = unrolled_about_mean(Points(x, np.concatenate(w), lineage=lineage), self._domain)
                inherited += (1.0 - share) * before**2 if k == 0 else 0.0
            clouds.append(points)
            sums.append(moments(points.x, points.w))
        off = squared_differences(clouds[0], clouds[1], self._domain, sums)
        own = state.inherited
        brought = FRESH._replace(error=math.sqrt(inherited), missed=own.missed, wider=own.wider)
        error = math.hypot(state.told.after(*off).errors.mean, state.pace.bias.mean, brought.error)
        state = state._replace(points=clouds[0], shadow=clouds[1], inherited=brought)
        return state, sums[0], error

    def _came(self, forward: list[Floats], j: int, share: float, k: int, key: int) -> tuple[Points, float]:
        """Points that came into mode j, of the clouds (k = 0) or their shadows; the error they had before."""
        many = self._count if k == 0 else shadow_size(self._count)
        many = math.ceil(many * max(1.0 / SHADOW, 1.0 - share))
        path = self._way.modes_before(forward, j, share + (1.0 - share) * (np.arange(many) + 0.5) / many)
        x, square = np.empty((many, len(self._models[j].states))), 0.0
        lineage = np.empty((LINES - 1, many), np.int64)
        for i in np.unique(path[:, 0]).tolist():
            own = np.flatnonzero(path[:, 0] == i)
            points = unrolled_about_mean((self._states[i].points, self._states[i].shadow)[k], self._domain)
            chosen = _evenly(points, len(own), stored_key(key, i))
            x[own], older = points.x[chosen], self._numbered(points.older, k, i)
            lineage = lineage[: len(older)]
            if len(lineage):
                lineage[:, own] = older[: len(lineage), chosen]
            square += len(own) / many * self._states[i].inherited.error ** 2
        for gap, span in enumerate(pairwise(self._way.times.tolist())):
            if span[0] == span[1]:
                continue
            for i in np.unique(path[:, gap]).tolist():
                own = path[:, gap] == i
                x[own] = self._moved(i, x[own], span, stored_key(key, len(forward[0]) * (gap + 1) + i))
        points = Points(x, np.full(many, 1.0 / many), lineage=lineage)
        return without_runaways(points, self._domain)[0], math.sqrt(square)

    def _numbered(self, lineage: Ints, k: int, i: int) -> Ints:
        """Lineages of mode i, whose last ancestors have numbers that those of no other mode have."""
        first, i = 0, i if i in self._states else self._heaviest
        for mode, state in self._states.items():
            lines = (state.points, state.shadow)[k].older
            first += int(lines[0].max()) + 1 if mode < i and len(lines) else 0
        return np.concatenate([lineage[:1] + first, lineage[1:]])

    def _moved(self, i: int, x: Floats, span: tuple[float, float], key: int) -> Floats:
        """Points (K, n) moved by the model of mode i, each along noise of its own."""
        model, whole, stayed = self._models[i], self._way.span[1] - self._way.span[0], self.carried(i)
        assert stayed is not None
        part = math.ceil(stayed.steps * (span[1] - span[0]) / whole - 1e-9)
        steps = Steps(model.own_steps(*span) or part, stayed.state.pace.stiff)
        return moved_freely(x, model, span, steps, key)


def _evenly(points: Points, count: int, key: int) -> Ints:
    """Numbers (count,) of points as often as they weigh; any run lies evenly along the curve through all."""
    order = along(points.x, points.w)
    edges = np.cumsum(points.w[order])
    place = (np.arange(count) * GOLDEN + key * 2.0**-63) % 1.0
    at = np.searchsorted(edges / edges[-1], place, side="right")
    return np.asarray(order[np.minimum(at, len(order) - 1)])


def _side_by_side(one: Ints, other: Ints) -> Ints:
    """Lineages of two sets of points, as far back as both are known."""
    known = min(len(one), len(other))
    return np.concatenate([one[:known], other[:known]], axis=1)
