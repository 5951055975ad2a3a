"""Sensors that read the state at one time, as one; and passages one after the other, as one."""

from typing import Any, NamedTuple

import numpy as np

from .._types import Bools, Floats
from ..core.cloud.linearise import lower_and_rows
from ..core.cloud.weights import finite_rows
from ..model.domain import Domain
from ..model.measurements import has_gaussian_noise, is_gaussian

__all__ = ["Stacked", "joined"]


def joined(passages: Any) -> tuple[Floats, Floats, Floats | None, Floats, Floats]:
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

    @classmethod
    def of(cls, readings: tuple[Any, ...], domain: Domain | None) -> "Stacked | None":
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
