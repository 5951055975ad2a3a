"""Sensors that read the state at one time, as one; and passages one after the other, as one."""

from typing import Any, NamedTuple

import numpy as np

from .._types import Bools, Floats, Ints
from ..core.cloud.guide import along_rows, missed, without_noise
from ..core.cloud.linearise import lower_and_rows
from ..core.cloud.weights import finite_rows
from ..model.domain import Domain
from ..model.measurements import has_gaussian_noise, is_gaussian

__all__ = ["Seen", "Stacked", "seen"]


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


class Stacked(NamedTuple):
    """Sensors with Gaussian noise that read the state at one time, as one."""

    asked: tuple[Any, ...]
    domain: Domain | None
    z: Floats  # what was read, (k,) components that came
    angle: Bools  # which of them are angles, (k,)

    @classmethod
    def of(cls, readings: tuple[Any, ...], domain: Domain | None) -> "Stacked | None":
        """None where a sensor has no noise that is Gaussian."""
        fine = all(is_gaussian(a.measurement) or has_gaussian_noise(a.measurement) for a in readings)
        if not fine:
            return None
        z = np.concatenate([np.atleast_1d(np.asarray(a.numbers))[a.seen] for a in readings])
        angle = [np.isin(np.flatnonzero(a.seen), list(a.measurement.angles)) for a in readings]
        return cls(readings, domain, z, np.concatenate(angle))

    def predict(self, x: Floats) -> Floats:
        """Readings (N, k) of states, components that came; NaN where a state is no number."""
        fine, every = finite_rows(x)
        X = x if every else x[fine]
        X = X if self.domain is None else self.domain.wrap(X)
        parts = [a.measurement.predict(X, a.t) for a in self.asked]
        parts = [h if a.seen.all() else h[:, a.seen] for h, a in zip(parts, self.asked, strict=True)]
        values = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)
        if every:
            return np.ascontiguousarray(values)
        h = np.full((len(x), values.shape[1]), np.nan)
        h[fine] = values
        return h

    def residual(self, h: Floats) -> Floats:
        """What was read less readings (N, k), angles wrapped."""
        return _wrapped(self.z - h, self.angle)

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


class Seen(NamedTuple):
    """A way of points as a sensor sees it, linearised in blocks: what a guide is made of."""

    rows: Floats | None  # of what moves the end among what moves all passages; None of a single one
    u: Floats  # what moves each point's end, (N, n)
    HL: Floats  # (blocks, k, n)
    r: Floats  # what was read less what each point would read without its noise, (N, k)
    R: Floats  # noise covariances, (blocks, k, k)
    C: Floats  # what linearity misses, (k, k)


def seen(sensor: Stacked, passages: Any, x: Floats, y: Floats, u: Any, w: Floats, block: Ints) -> Seen:
    """A way as a sensor sees it, of points of weights w (N,) from x to y (N, n), with u of each passage."""
    flow, lower, rows, start, end = _joined(passages)
    whole = u[0] if rows is None else along_rows(rows, block, np.concatenate(u, axis=1))
    H = sensor.jacobian(end)
    HL, HPhi = np.ascontiguousarray(H @ lower), np.ascontiguousarray(H @ flow)
    r = sensor.residual(sensor.predict(without_noise(y, x, whole, lower, flow, block)))
    C = missed(sensor.predict(y), x, whole, w, block, start, HL, HPhi, sensor.angle)
    return Seen(rows, whole, HL, r, sensor.covariance(end), C)


def _wrapped(r: Floats, angle: Bools) -> Floats:
    """Differences (..., k) with those of angles in (-π, π]."""
    if angle.any():
        r[..., angle] -= 2.0 * np.pi * np.round(r[..., angle] / (2.0 * np.pi))
    return r
