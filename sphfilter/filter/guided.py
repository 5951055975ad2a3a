"""Bayes' rule on points: weighted, and once more from ancestors that the reading chooses.

Both passes are weighted together: each point by its likelihood over the mixture of what it may have been
drawn from, so that the guide, whatever it is worth, never makes a posterior worse than none.
"""

from typing import Any, NamedTuple

import numpy as np

from .._types import Bools, Floats, Ints
from ..core.cloud.guide import (
    along_rows,
    look_ahead,
    missed,
    spread,
    weigh_together,
    without_noise,
)
from ..core.cloud.linearise import lower_and_rows
from ..core.cloud.noise import even_normals, mixed, uniform
from ..core.cloud.weights import effective, normalise
from ..density.nets import net
from ..density.passage import even, gone
from ..density.points import Points, Prior
from ..model.domain import Domain
from ..model.measurements import has_gaussian_noise, is_gaussian

__all__ = ["Weighed", "weighed"]

#: Effective part of weights, from which they are good enough as they are.
_EVEN = 0.9
#: Times the reading's own noise that the guide sees: 1.2 has heavy weights on two wells, 2 is as good.
_WIDER = 1.5
#: Variance of a point's own rest about the mean of four neighbours', over that of one.
_OWN = 1.0 + 1.0 / 4.0


class Weighed(NamedTuple):
    """A posterior as points, its log-evidence, and whether it took a second pass."""

    points: Points
    log_evidence: float
    guided: bool


def weighed(points: Points, readings: tuple[Any, ...], key: int, domain: Domain | None = None) -> Weighed:
    """Prior times the likelihood of all readings of one time.

    Parameters
    ----------
    points : Points
        The prior; or the posterior of readings of the same time before, whose prior is taken.
    readings : tuple of Asked
    key : int
    domain : Domain, optional

    Returns
    -------
    Weighed
        Its evidence is that of these readings, given those before.
    """
    before = 0.0
    if points.prior is not None:
        points, earlier, before = points.prior
        readings = (*earlier, *readings)
    x, w, path = points.x, points.w, points.path
    log_l, b = _log_likelihood(x, readings, domain), np.empty(len(w))
    log_evidence = normalise(np.log(w) + log_l, b)
    found = None
    if path is not None and effective(b) < _EVEN * effective(w):
        found = _twice(points, log_l, readings, key, domain)
    family = np.arange(len(w))
    if found is not None:
        x, b, log_evidence, family = found
    heavy = b > 0.0
    if not heavy.all():
        x, b, family = x[heavy], b[heavy], family[heavy]
    after = Points(x, b, None, Prior(points, readings, log_evidence), family)
    return Weighed(after, log_evidence - before, found is not None)


def _log_likelihood(x: Floats, readings: tuple[Any, ...], domain: Domain | None) -> Floats:
    X = x if domain is None else domain.wrap(x)
    total = readings[0].log_weight(X)
    for asked in readings[1:]:
        total = total + asked.log_weight(X)
    return total


def _twice(
    points: Points, log_l: Floats, readings: tuple[Any, ...], key: int, domain: Domain | None
) -> tuple[Floats, Floats, float, Ints] | None:
    """States (N + N, n), weights, log-evidence and families of both passes; None without a guide."""
    sensor = _Stacked.of(readings, domain)
    if sensor is None:
        return None
    x, w, (x0, block, passages, U) = points.x, points.w, points.path
    (count, n), key = x.shape, np.uint64(mixed(np.uint64(key), np.uint64(11)))
    flow, lower, rows, start, end = _joined(passages)
    u = U[0] if rows is None else along_rows(rows, block, np.concatenate(U, axis=1))
    H = sensor.jacobian(end)
    HL, HPhi = np.ascontiguousarray(H @ lower), np.ascontiguousarray(H @ flow)
    bare = without_noise(x, x0, u, lower, flow, block)
    hy, r = sensor.predict(x), sensor.residual(sensor.predict(bare))
    C = missed(hy, x0, u, w, block, start, HL, HPhi, sensor.angle)
    R = np.ascontiguousarray(_WIDER * (sensor.covariance(end) + _OWN * C))
    z, cut = even_normals(net(count, n), key), uniform(key, np.uint64(0))
    ancestor, u, log_ratio = look_ahead(r, u, w, block, HL, R, z, cut)
    if not len(ancestor):
        return None
    y, block = x0[ancestor], block[ancestor]
    V = [u] if rows is None else _led(rows, block, u, len(passages), key)
    for passage, own in zip(passages, V, strict=True):
        y = gone(passage, y, own, block, True)
    log_l = np.concatenate([log_l, _log_likelihood(y, readings, domain)])
    b = np.empty(2 * count)
    log_evidence = weigh_together(log_l, log_ratio, w, b)
    return np.concatenate([x, y]), b, log_evidence, np.concatenate([np.arange(count), ancestor])


def _joined(passages: Any) -> tuple[Floats, Floats, Floats | None, Floats, Floats]:
    """Passages one after the other as one: Φ, L, rows of what moves the end among all u, begin and end."""
    if len(passages) == 1:
        (only,) = passages
        return only.flow, only.lower, None, only.start, only.end
    flow, parts = np.broadcast_to(np.eye(passages[0].flow.shape[1]), passages[0].flow.shape), []
    for p in reversed(passages):
        parts.append(flow @ p.lower)
        flow = flow @ p.flow
    G = np.ascontiguousarray(np.concatenate(parts[::-1], axis=2))
    lower, rows = lower_and_rows(G)
    return np.ascontiguousarray(flow), lower, rows, passages[0].start, passages[-1].end


def _led(rows: Floats, block: Ints, u: Floats, parts: int, key: int) -> list[Floats]:
    """What moves the points in each passage, (N, n) each, such that together it moves their ends by u."""
    count, n = u.shape
    fresh = [even(count, n, int(mixed(np.uint64(key), np.uint64(20 + k))) >> 1) for k in range(parts)]
    U = np.concatenate(fresh, axis=1)
    spread(rows, block, u, U)
    return [np.ascontiguousarray(U[:, k * n : (k + 1) * n]) for k in range(parts)]


class _Stacked(NamedTuple):
    """Sensors with Gaussian noise that read the state at one time, as one."""

    asked: tuple[Any, ...]
    domain: Domain | None

    @classmethod
    def of(cls, readings: tuple[Any, ...], domain: Domain | None) -> "_Stacked | None":
        """None where a sensor has no noise that is Gaussian."""
        fine = all(is_gaussian(a.measurement) or has_gaussian_noise(a.measurement) for a in readings)
        return cls(readings, domain) if fine else None

    @property
    def angle(self) -> Bools:
        """Which components are angles, (k,)."""
        parts = []
        for a in self.asked:
            own = np.zeros(len(a.seen), bool)
            own[list(a.measurement.angles)] = True
            parts.append(own[a.seen])
        return np.concatenate(parts)

    def predict(self, x: Floats) -> Floats:
        """Readings (N, k) of states, components that came."""
        X = x if self.domain is None else self.domain.wrap(x)
        return np.concatenate([a.measurement.predict(X, a.t)[:, a.seen] for a in self.asked], axis=1)

    def residual(self, h: Floats) -> Floats:
        """What was read less readings (N, k), angles wrapped."""
        z = np.concatenate([np.atleast_1d(np.asarray(a.numbers))[a.seen] for a in self.asked])
        return _wrapped(z - h, self.angle)

    def jacobian(self, c: Floats) -> Floats:
        """∂h/∂x at states (blocks, n), (blocks, k, n): by central differences where h is no matrix."""
        (blocks, n), matrices = c.shape, [a.measurement.H for a in self.asked]
        if all(H is not None for H in matrices):
            H = np.concatenate([M[a.seen] for M, a in zip(matrices, self.asked, strict=True)])
            return np.broadcast_to(H, (blocks, *H.shape))
        step = np.finfo(float).eps ** (1 / 3) * np.maximum(1.0, np.abs(c))
        moves = step[:, :, None] * np.eye(n)
        h = self.predict(np.concatenate([c[:, None] + moves, c[:, None] - moves], axis=1).reshape(-1, n))
        h = h.reshape(blocks, 2, n, -1)
        off = _wrapped(h[:, 0] - h[:, 1], self.angle) / (2.0 * step[:, :, None])
        return np.ascontiguousarray(np.swapaxes(off, 1, 2))

    def covariance(self, c: Floats) -> Floats:
        """Noise covariances (blocks, k, k) at states (blocks, n)."""
        sizes = [int(a.seen.sum()) for a in self.asked]
        R, at = np.zeros((len(c), sum(sizes), sum(sizes))), 0
        for a, k in zip(self.asked, sizes, strict=True):
            sensor = a.measurement
            own = sensor.noise_cov if sensor.noise_cov is not None else sensor.covariance(c, a.t)
            R[:, at : at + k, at : at + k] = np.broadcast_to(own, (len(c), len(a.seen), len(a.seen)))[
                :, a.seen
            ][:, :, a.seen]
            at += k
        return R


def _wrapped(r: Floats, angle: Bools) -> Floats:
    """Differences (..., k) with those of angles in (-π, π]."""
    if angle.any():
        r[..., angle] -= 2.0 * np.pi * np.round(r[..., angle] / (2.0 * np.pi))
    return r
