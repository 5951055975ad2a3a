"""Smoothing on points: λ is carried back over the filter's clouds, and points that it leads go forward.

The second way forward is a particle filter of its own, whose weights are exact whatever λ is. Its points lie
where all measurements find the state: in six states hardly one in a hundred of the filter's does. But λ has
to be quadratic about each block. Where it is not, the filter's points get weights by how likely those of
later epochs come from them, and need nothing but transitions that are wider than the points are apart.
"""

import copy
import math
from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from .._types import Floats
from ..config import CloudScheme
from ..core.cloud.control import SHADOW, error_by, least_error
from ..core.cloud.pace import Steps
from ..core.cloud.weights import effective, normalise
from ..density.as_cloud import cloud_density
from ..density.moments import moments
from ..density.particle_density import ParticleDensity
from ..density.passage import along, stored_key
from ..density.points import Points, Told
from ..density.quasi_random import systematic
from ..errors import PropagationError
from ..filter.sph_filter import SPHFilter
from ..info import WITHIN
from ..prediction.backward_points import Ahead, Leg, Said, parts_of, rooted, start_led, steps_of
from ..prediction.cloud import as_points, squared_differences

#: Points of a cloud, of which an update leaves twice as many, and at which λ is known. Measured: a quarter of
#: them leaves means of linear models in four states .017 off, not .007.
POINTS = 2048


class SmoothedEpoch(NamedTuple):
    """What is known of one epoch, given all measurements."""

    density: ParticleDensity
    log_evidence: float  # of all measurements, nats
    extrapolated: float  # probability; NaN where nothing tells
    error: float  # of the mean, in standard deviations
    variance_error: float  # as a part of the variance, where it is most


class _Smoothed(NamedTuple):
    """Points and weights given all measurements, and the log-evidence of these."""

    points: Points
    log_evidence: float


def on_clouds(epochs: Sequence[Any], start: ParticleDensity) -> list[SmoothedEpoch]:
    """Smooth the epochs of a filter that carries clouds, from a start at the time of the first.

    Densities have as many points as the filter's scheme; that of the last epoch may be the filter's.
    """
    count, sides = epochs[0].filt.config.scheme.n_points, (_Side(False), _Side(True))
    backs = [side.back(epochs) for side in sides]
    led = (side.smoothed(epochs, start, count, back) for side, back in zip(sides, backs, strict=True))
    try:
        found = _told(led, count)
    except PropagationError:  # no point that is led sees what is to come
        found = []
    known = max(epoch.filt.density.error for epoch in epochs)  # by the filter
    if not found or max(each.error for each in found) > WITHIN * known:
        both = (side.weighted(epochs, back) for side, back in zip(sides, backs, strict=True))
        weighted = _told(both, count)
        pairs = zip(found or weighted, weighted, strict=True)
        found = [other if WITHIN * other.error < one.error else one for one, other in pairs]  # surely better
    out = []
    for epoch, each in zip(epochs, found, strict=True):
        own: Any = {"error": each.error, "cloud": None}
        density = cloud_density(epoch.filt.density, *each.points[:2], each.moments, **own)
        out.append(SmoothedEpoch(density, each.log_evidence, math.nan, each.error, each.variance_error))
    last = epochs[-1].filt.density  # nothing comes after it: that is the filter's, too
    if last.error < found[-1].error:
        out[-1] = out[-1]._replace(density=last, error=last.error, variance_error=epochs[-1].variance_error)
    return out


class _Told(NamedTuple):
    """Points given all measurements, their moments, the log-evidence, errors of mean and variance."""

    points: Points
    moments: tuple[Floats, Floats]
    log_evidence: float
    error: float
    variance_error: float


def _told(clouds: Iterable[list[_Smoothed]], count: int) -> list[_Told]:
    """Points of every epoch with the error that the shadow beside them tells, of a cloud and a shadow."""
    many, few = clouds
    out, told = list[_Told](), Told()
    for one, other in zip(many, few, strict=True):
        sums = [moments(side.points.x, side.points.w) for side in (one, other)]
        told = told.after(*squared_differences(one.points, other.points, None, sums))
        error = max(error_by(told.mean), least_error(effective(one.points.w), count))
        # the evidence with λ in it, beside that without: so many nats are about as many standard deviations
        error = math.hypot(error, one.log_evidence - many[-1].log_evidence)
        out.append(_Told(one.points, sums[0], one.log_evidence, error, told.errors.variance))
    return out


def between(filt: SPHFilter, t: float, n_steps: int, u: Any) -> list[ParticleDensity]:
    """The filter's densities at the beginnings of equal steps up to time t, seconds, with inputs u."""
    filt, start = copy.copy(filt), filt.t
    densities = [filt.density]
    for k in range(1, n_steps):
        filt.predict(t=start + k / n_steps * (t - start), u=u)
        densities.append(filt.density)
    return densities


class _Back(NamedTuple):
    """A way back over the filter's points."""

    said: Said  # of the first epoch's states
    last: Points  # of the last epoch
    parts: list[list[tuple[Leg, Points, Ahead]]]  # of every interval: points where they begin, and come to


class _Side(NamedTuple):
    """The cloud, or its shadow: an eighth of the points, and fewer parts of each interval."""

    shadow: bool

    def smoothed(
        self, epochs: Sequence[Any], start: ParticleDensity, count: int, back: _Back
    ) -> list[_Smoothed]:
        """Points of every epoch, given all measurements: led by what is said of them."""
        count = max(count // SHADOW, 256) if self.shadow else count
        x, log_w = _started(start, back.said, count, stored_key(0, self.shadow))
        log_w += epochs[0].log_likelihood(x)
        out: list[_Smoothed] = []
        for epoch, parts in zip(epochs[1:], back.parts, strict=True):
            for k, (leg, *_) in enumerate(parts):
                key = stored_key(stored_key(len(out), k), 2 + self.shadow)
                ahead = Ahead.of(x, _weights(log_w, leg)[0], leg, key)
                w, log_evidence = _weights(log_w + ahead.said, leg)
                if k == 0:
                    out.append(_Smoothed(Points(x, w), log_evidence))
                x, log_w = ahead.led_on(w, key)
                log_w += log_evidence - np.log(count)
            log_w = log_w + epoch.log_likelihood(x)
        w, log_evidence = _weights(log_w, None)
        return [*out, _Smoothed(Points(x, w), log_evidence)]

    def weighted(self, epochs: Sequence[Any], back: _Back) -> list[_Smoothed]:
        """The filter's points of every epoch, with weights given all measurements."""
        points, log_evidence = back.last, epochs[-1].filt.log_evidence - epochs[0].filt.log_evidence
        out = [points]
        for parts in back.parts[::-1]:
            for _, begin, ahead in parts[::-1]:
                points = Points(begin.x, ahead.weights(begin.w, points.x, points.w))
            out.append(points)
        return [_Smoothed(each, log_evidence) for each in out[::-1]]

    def _points(self, density: ParticleDensity, count: int) -> Points:
        """Points of a density, a few thousand of them, evenly along the curve."""
        state = as_points(density, count)
        x, w = (state.shadow if self.shadow else state.points)[:2]
        if len(w) <= POINTS:
            return Points(x, w)
        order = along(x, w)
        return Points(x[order[systematic(w[order], POINTS)]], np.full(POINTS, 1.0 / POINTS))

    def back(self, epochs: Sequence[Any]) -> _Back:
        """The way back over the filter's points."""
        last: Any = epochs[-1]
        every: list[list[tuple[Leg, Points, Ahead]]] = []
        end = self._points(last.filt.density, last.filt.config.scheme.n_points)
        said = Said(*end[:2], last.log_likelihood(end.x))
        for before, after in zip(epochs[-2::-1], epochs[:0:-1], strict=True):
            parts: list[tuple[Leg, Points, Ahead]] = []
            for over, points in self._over(before.filt, after):
                leg = over(said)
                ahead = Ahead.of(*points[:2], leg, stored_key(len(every), 4 + self.shadow))
                said = Said(*points[:2], ahead.said)
                parts.insert(0, (leg, points, ahead))
            said = said._replace(values=said.values + before.log_likelihood(said.x))
            every.insert(0, parts)
        return _Back(said, end, every)

    def _over(self, filt: SPHFilter, after: Any) -> list[tuple[Any, Points]]:
        """Parts of an interval from the last one back: legs of what is said at their ends; and points."""
        u, (t0, t1), scheme = after.filt.inputs, (filt.t, after.filt.t), filt.config.scheme
        assert isinstance(scheme, CloudScheme)
        model: Any = filt.model.with_inputs(u)
        count = scheme.n_points
        x, w = self._points(filt.density, count)[:2]
        steps = Steps(max(after.n_steps, 1), as_points(after.filt.density, count).pace.stiff)
        parts = parts_of(model, x, w, (t0, t1), steps)
        if self.shadow and not model.own_steps(t0, t1):
            parts = max(parts // 4, min(parts // 2, 2))  # longer, so that what parts are off by is seen
        densities, end, out = between(filt, t1, parts, u), t1, list[tuple[Any, Points]]()
        for density in densities[::-1]:
            own = model.own_steps(density.t, end)
            each = Steps(own) if own else steps_of(steps, parts)
            leg = partial(Leg, model, (density.t, end), each)
            out.append((leg, self._points(density, count)))
            end = density.t
        return out


def _started(start: ParticleDensity, said: Said, count: int, key: int) -> tuple[Floats, Floats]:
    """Points (count, n) of a start that are led to what is said, and their log-weights (count,)."""
    mean, root = start.mean(), rooted(start.cov())
    u, log_w = start_led(mean, root, count, said, key)
    x = mean + np.einsum("ab,ib->ia", root, u)
    if start.form.degree != 2:
        log_normal = -0.5 * (u**2 + np.log(2.0 * np.pi)).sum(axis=1) - np.log(np.diag(root)).sum()
        with np.errstate(divide="ignore"):
            log_w = log_w + np.log(start.pdf(x)) - log_normal
    return x, log_w - np.log(count)


def _weights(log_w: Floats, leg: Leg | None) -> tuple[Floats, float]:
    """Weights (N,) of sum one, and the logarithm of their sum."""
    w = np.zeros(len(log_w))
    total = normalise(np.nan_to_num(log_w, nan=-np.inf), w)
    if not np.isfinite(total):
        when = "" if leg is None else f" at t = {leg.span[0]:g}"
        raise PropagationError(f"no point that goes forward{when} sees the measurements to come; take more")
    return w, float(total)
