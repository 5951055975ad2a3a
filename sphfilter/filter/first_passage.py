"""First passages: the probability that a state has been in a region by a time.

Points go on, and are taken out where they are seen inside. Between looks at g, positive inside, noise of
variance s² a second takes one from g₁ < 0 to g₂ < 0 over the border with probability exp(-2 g₁ g₂ / (s² h)),
whatever the drift (Brownian bridge; exact where g is linear, noise constant): so much of its weight goes.
"""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from .._types import Floats
from ..core.cloud.control import SHADOW
from ..core.cloud.pace import FIRST_TRIED, Steps
from ..core.limits import LITTLE, TINY
from ..density.particle_density import ParticleDensity
from ..density.passage import (
    MOST,
    age_of,
    chosen_steps,
    moved_freely,
    moved_points,
    points_of_sample,
    stored_key,
)
from ..density.points import Points
from ..density.quasi_random import STATES
from ..model.discrete import DiscreteModel
from ..model.domain import Domain
from ..model.dynamics import Dynamics
from ..model.paths import noise_root
from ..model.timing import spans
from ..prediction.cloud import least_steps, without_runaways

#: A region of states X (M, n): booleans (M,), or numbers that are positive inside.
Event: TypeAlias = Callable[[Floats], ArrayLike]

_MOST_LOOKS = 2**11  # measured: of Brownian motion and booleans .55 is then .005 off, in two seconds


def inside(event: Event) -> Callable[[Floats], Any]:
    """An event as a function of states that returns booleans."""
    return lambda X: np.asarray(event(X)) > 0


def passed(
    density: ParticleDensity, models: Sequence[Dynamics], times: Floats, event: Event
) -> tuple[Floats, Floats]:
    """Probabilities (K,) that an event has been by each of the times, and their standard errors.

    Models are those of the intervals that end at the times.
    """
    bridged = _numbers(event, density.x[:1], density.domain) is not None
    keys = [(count, stored_key(age_of(density), count)) for count in (STATES // SHADOW, STATES)]
    clouds = [points_of_sample(Points(*density.form.drawn(n, key)), n, key) for n, key in keys]
    found: list[Floats] = []
    apart, looks = [], 1
    before = of_looks = np.full(len(times), np.nan)
    while True:
        few, many = (_absorbed(density, points, models, times, event, looks) for points in clouds)
        found.append(many)
        apart.append((many - few) / SHADOW**0.6)
        best = np.mean(found[-2:], axis=0) if bridged else _limit(found)
        # what is told whatever the looks: of so few points, and of the density
        known = np.sqrt(np.mean(np.square(apart), axis=0) + density.error**2 / (2.0 * math.pi))
        changed, of_looks = of_looks, np.abs(best - before)
        # changes fall by √2 at least (see `_limit`): until they do, they do not tell what is left
        settled = (of_looks < np.fmax(np.minimum(known, changed / math.sqrt(2.0)), STATES**-0.6)).all()
        much = len(found) > 1 and 2 * looks * len(times) > _MOST_LOOKS
        if much or settled or isinstance(models[0], DiscreteModel):
            break
        before, looks = best, 2 * looks
    error = np.hypot(known, 0.0 if len(found) == 1 else of_looks)
    return np.clip(np.maximum.accumulate(best), 0.0, 1.0), error


def _limit(found: Sequence[Floats]) -> Floats:
    """The limit of numbers at looks that are twice as often each time: by the rate at which they change.

    What booleans miss goes as the root of the time between looks, up to its square: changes fall by √2 to 4.
    """
    if len(found) < 3:
        return found[-1]
    before, after = found[-2] - found[-3], found[-1] - found[-2]
    rate = np.clip(np.sum(before * after) / max(np.sum(after * after), TINY), math.sqrt(2.0), 4.0)
    return np.asarray(found[-1] + after / (rate - 1.0))


def _absorbed(
    density: ParticleDensity, points: Points, models: Sequence[Any], times: Floats, event: Event, looks: int
) -> Floats:
    """Parts (K,) of points of a density that have been seen in a region by each time.

    Looks in each interval are so many, or one after every step of a model in discrete time.
    """
    age, count, domain, t = age_of(density), len(points.w), density.domain, density.t
    points, left, out = *_taken_out(points, inside(event), domain), np.empty(len(times))
    for k, (model, end) in enumerate(zip(models, times.tolist(), strict=True)):
        own = model.own_steps(t, end) if isinstance(model, DiscreteModel) else looks
        looked, steps = pairwise(np.linspace(t, end, own + 1).tolist()), None
        ways = [span for a, b in looked if a < b for span in spans(model.breaks(a, b), a, b)]
        for begin, stop in ways if left > 0.0 else []:
            age += 1
            key = stored_key(age, count)
            steps = steps or _steps(points, model, (begin, stop), key)
            path, key = points.path, stored_key(key, 1)
            if path is not None and len(path.passages) < MOST // 2:
                new = moved_points(points, model, begin, stop, steps, count, key)
            else:  # points of a new path, each as wide as their distance, would go in and out by that
                new = points._replace(x=moved_freely(points.x, model, (begin, stop), steps, key))
            new, _ = without_runaways(new, domain)
            part = _missed(points.x, new.x, model, (begin, stop), event, domain)
            new, kept = _taken_out(new, inside(event), domain, part)
            points, left = new, left * kept
        t, out[k] = end, 1.0 - left
    return out


def _steps(points: Points, model: Dynamics, span: tuple[float, float], key: int) -> Any:
    """Steps of a span whose bias is little beside what points miss."""
    least = least_steps(model, points.x, span)
    if model.own_steps(*span):
        return Steps(least)
    allowed = LITTLE * len(points.w) ** -0.5
    first = Steps(min(least, FIRST_TRIED))
    return chosen_steps(points, model, span, first, (least, 64 * max(least, FIRST_TRIED)), allowed, key)[0]


def _missed(
    before: Floats, after: Floats, model: Any, span: tuple[float, float], event: Event, domain: Any
) -> Floats:
    """Probabilities (N,) that points have been in a region between two looks; none, where nothing tells."""
    if isinstance(model, DiscreteModel):
        return np.zeros(len(after))
    g = [_numbers(event, X, domain) for X in (before, after)]
    if g[0] is None or g[1] is None:
        return np.zeros(len(after))
    columns = model.noise(before, span[0]) @ noise_root(model.spectral_density)
    step, square = LITTLE * math.sqrt(span[1] - span[0]), np.zeros(len(before))  # of the noise
    for k in range(columns.shape[2]):
        to = step * columns[:, :, k]
        there, back = (_numbers(event, before + sign * to, domain) for sign in (1.0, -1.0))
        square += ((there - back) / (2.0 * step)) ** 2
    way = -2.0 * g[0] * g[1] / np.maximum(square * (span[1] - span[0]), TINY)
    return np.where((g[0] < 0.0) & (g[1] < 0.0), np.exp(np.minimum(way, 0.0)), 0.0)


def _numbers(event: Event, X: Floats, domain: Domain | None) -> Any:
    """The numbers of an event at states; None of one that is booleans."""
    found = np.asarray(event(X if domain is None else domain.wrap(X)))
    return found if found.dtype.kind == "f" else None


def _taken_out(
    points: Points, within: Callable[[Floats], Any], domain: Domain | None, missed: Floats | float = 0.0
) -> tuple[Points, float]:
    """Points without what is in a region, or has been, and the part that is left."""
    X = points.x if domain is None else domain.wrap(points.x)
    w = np.where(np.asarray(within(X), dtype=bool), 0.0, points.w * (1.0 - missed))
    left = float(w.sum())
    return (points._replace(w=w / left) if left > 0.0 else points), left
