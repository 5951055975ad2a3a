"""Sensors that read the state at one time, as one; and passages one after the other, as one."""

from typing import Any, NamedTuple

import numpy as np

from .._types import Bools, Floats, Ints
from ..core._addresses import NOWHERE_AT
from ..core._views import as_compiled
from ..core.cloud.blocks import products
from ..core.cloud.guide import Ahead, Moved, joined, linear_reading, log_normals, near_of, without_noise
from ..core.cloud.linearise import lower_and_rows
from ..core.cloud.reader import Reader
from ..core.cloud.steps import NO_LEG
from ..core.cloud.weights import finite_rows
from ..core.limits import DIFFERENCE
from ..density.moments import columns
from ..model.domain import Domain
from ..model.measurements import block as block_of
from ..model.measurements import has_gaussian_noise, has_own_likelihood, is_gaussian
from ..model.sensors import Sensors

_NOTHING, _NO_MATRIX, _NO_ROWS = np.empty(0), np.empty((0, 0)), np.empty((0, 1, 1))


class Stacked(NamedTuple):
    """Sensors that read the state at one time, as one; and what a guide asks of those of Gaussian noise."""

    asked: tuple[Any, ...]
    domain: Domain | None
    guides: tuple[Any, ...] = ()  # those of Gaussian noise; of them is the rest
    z: Floats = np.empty(0)  # what was read, (k,) components that came
    angle: Bools = np.empty(0, bool)  # which of them are angles, (k,)
    H: Floats | None = None  # (1, k, n), where all are linear
    R: Floats | None = None  # (1, k, k), where it is the same in all states
    root: Floats | None = None  # lower, of R, where the likelihood is known to be that Gaussian
    reader: Reader | None = None  # all that in one, where compiled code knows the sensor
    pilot: Floats | None = None  # (j, n), the last components: linear, of unit noise

    @classmethod
    def of(cls, readings: tuple[Any, ...], domain: Domain | None) -> "Stacked":
        """The readings of one time, each of them `Asked`; of several sensors as one, those of each."""
        readings = tuple(member for asked in readings for member in _members(asked))
        guides = tuple(a for a in readings if is_gaussian(a.measurement) or has_gaussian_noise(a.measurement))
        if not guides:
            return cls(readings, domain)
        sensors = [a.measurement for a in guides]
        z = _joined([np.atleast_1d(np.asarray(a.numbers))[a.seen] for a in guides])
        angle = np.array(
            [k in a.measurement.angles for a in guides for k in np.flatnonzero(a.seen)], dtype=bool
        )
        H = R = root = None
        if all(s.H is not None for s in sensors):
            H = _joined([s.H[a.seen] for s, a in zip(sensors, guides, strict=True)])[None]
        if all(s.noise_cov is not None for s in sensors):
            R = _blocks([block_of(s.noise_cov, a.seen) for s, a in zip(sensors, guides, strict=True)])[None]
        if len(guides) == len(readings) and all(map(has_own_likelihood, sensors)) and R is not None:
            root = _blocks([s.root(a.seen) for s, a in zip(sensors, guides, strict=True)])
        made = cls(readings, domain, guides, z, angle, H, R, root)
        return made._replace(reader=made._reader())

    @property
    def hidden(self) -> bool:
        """Whether some say nothing but a likelihood."""
        return len(self.guides) < len(self.asked)

    def with_pilot(self, rows: Floats, z: Floats) -> "Stacked":
        """The sensor with linear readings z (j,) of unit noise, rows (j, n), beside it for a guide."""
        known = bool(self.guides)
        H = rows[None] if not known else None if self.H is None else np.concatenate([self.H[0], rows])[None]
        one = np.eye(len(z))[None]
        R = one if not known else None if self.R is None else _blocks([self.R, one])
        angle = np.append(self.angle, np.zeros(len(z), bool))
        return self._replace(z=np.append(self.z, z), angle=angle, H=H, R=R, pilot=rows)

    def again(self, asked: Any) -> "Stacked":
        """The sensor with other numbers read, all of them, at another time."""
        z = np.asarray(asked.numbers)
        reader = None if self.reader is None else self.reader._replace(z=z, t=float(asked.t))
        return self._replace(asked=(asked,), guides=(asked,), z=z, reader=reader)

    def _reader(self) -> Reader | None:
        """What compiled code reads by; None for states in a domain, and sensors of which it knows no h."""
        if self.root is None or self.R is None or self.domain is not None:
            return None
        if self.H is not None:
            h, p, H = NOWHERE_AT, _NOTHING, np.array(self.H[0])
        elif len(self.asked) == 1 and self.asked[0].seen.all():
            (h, p), H = self.asked[0].measurement.compiled, _NO_MATRIX
        else:
            return None
        return Reader(h, p, H, self.z, self.angle, np.array(self.R[0]), self.root, float(self.asked[0].t))

    def log_likelihood(self, x: Floats, h: Floats | None = None) -> Floats:
        """Log-likelihood (N,) of states, of which the readings may be known; none where one is no number."""
        if self.root is not None:
            h = self.predict(x) if h is None else h
            values, wrong = log_normals(self.z, columns(h), self.angle, self.root)
            if not wrong:
                return np.asarray(values)
        return self.log_weights(x, self.asked)

    def log_weights(self, x: Floats, readings: tuple[Any, ...]) -> Floats:
        """Log-likelihood (N,) of states (N, n) by some of the readings; none where a state is no number."""
        fine, every = finite_rows(columns(x))
        X = x if every else x[fine]
        X = X if self.domain is None else self.domain.wrap(X)
        values = readings[0].log_weight(X)
        for asked in readings[1:]:
            values = values + asked.log_weight(X)
        if every:
            return np.asarray(values)
        log_l = np.full(len(x), -np.inf)
        log_l[fine] = values
        return log_l

    def predict(self, x: Floats) -> Floats:
        """Readings (N, k) of states, components that came; NaN where a state is no number."""
        fine, every = finite_rows(columns(x))
        own = x if every else x[fine]
        X = own if self.domain is None else self.domain.wrap(own)
        parts = [a.measurement.predict(X, a.t) for a in self.guides]
        parts = [h if a.seen.all() else h[:, a.seen] for h, a in zip(parts, self.guides, strict=True)]
        parts += [] if self.pilot is None else [own @ self.pilot.T]
        values = _joined(parts, axis=1)
        if every:
            return np.ascontiguousarray(values)
        h = np.full((len(x), values.shape[1]), np.nan)
        h[fine] = values
        return h

    def residual(self, h: Floats) -> Floats:
        """Residuals of what was read and readings (N, k), angles wrapped."""
        return _wrapped(self.z - h, self.angle)

    def jacobian(self, c: Floats) -> Floats:
        """∂h/∂x at states (blocks, n), (blocks, k, n) or (1, k, n): by differences where h is no matrix."""
        if self.H is not None:
            return self.H
        blocks, n = c.shape
        step = DIFFERENCE * np.maximum(1.0, np.abs(c))
        moves = step[:, :, None] * np.eye(n)
        h = self.predict(np.concatenate([c[:, None] + moves, c[:, None] - moves], axis=1).reshape(-1, n))
        h = h.reshape(blocks, 2, n, -1)
        off = _wrapped(h[:, 0] - h[:, 1], self.angle) / (2.0 * step[:, :, None])
        return np.ascontiguousarray(np.swapaxes(off, 1, 2))

    def covariance(self, c: Floats) -> Floats:
        """Noise covariances at states (blocks, n), (blocks, k, k) or (1, k, k)."""
        if self.R is not None:
            return self.R
        parts = []
        for a in self.guides:
            own, k = a.measurement.noise_cov, len(a.seen)
            own = a.measurement.covariance(c, a.t) if own is None else np.broadcast_to(own, (len(c), k, k))
            parts.append(own[:, a.seen][:, :, a.seen])
        if self.pilot is not None:
            one = np.eye(len(self.pilot))
            parts.append(np.broadcast_to(one, (len(c), *one.shape)))
        return _blocks(parts)


def _members(asked: Any) -> tuple[Any, ...]:
    """A reading of `Sensors` as those of each that came, where some say nothing but a likelihood."""
    sensors = asked.measurement
    if not isinstance(sensors, Sensors) or is_gaussian(sensors) or has_gaussian_noise(sensors):
        return (asked,)
    z, rows = np.asarray(asked.numbers), {name: sensors.rows(name) for name in sensors}
    return tuple(
        asked._replace(measurement=sensors[name], z=z[own], seen=asked.seen[own])
        for name, own in rows.items()
        if asked.seen[own].any()
    )


def _joined(parts: list[Any], axis: int = 0) -> Any:
    """Arrays one after the other."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=axis)


def _blocks(parts: list[Floats]) -> Floats:
    """Matrices (..., k, k) as blocks on the diagonal of one."""
    if len(parts) == 1:
        return np.ascontiguousarray(parts[0])
    size, at = sum(p.shape[-1] for p in parts), 0
    out = np.zeros((*parts[0].shape[:-2], size, size))
    for p in parts:
        k = p.shape[-1]
        out[..., at : at + k, at : at + k] = p
        at += k
    return out


class Walked(NamedTuple):
    """Points that have gone a way of one or more passages."""

    x: Floats  # (N, n), where they began
    y: Floats  # (N, n), where they came
    u: tuple[Floats, ...]  # (N, n) each: normals that moved the ends of each passage
    w: Floats  # (N,) weights
    block: Ints  # (N,)


class Seen(NamedTuple):
    """A way of points as a sensor sees it, linearised in blocks: what a guide is made of."""

    rows: Floats  # (blocks, n, d) of what moves the end among what moves all passages; none of a single one
    u: Floats  # what moves each point's end, (n, N)
    ahead: Ahead


def seen(sensor: Stacked, passages: Any, walked: Walked, h: Floats, misses: float) -> Seen:
    """A way as a sensor sees it, of points that have `Walked` along passages.

    Of the ends, the readings are h (N, k). A guide takes `misses` times what linearity misses.
    """
    first, rows, u = passages[0], _NO_ROWS, [columns(v) for v in walked.u]
    end, flow, lower, whole = passages[-1].end, first.flow, first.lower, u[0]
    if len(passages) > 1:
        for p in passages[1:]:
            flow, lower = joined(flow, lower, p.flow, p.lower)
        lower, rows = lower_and_rows(lower)
        whole = products(rows, np.concatenate(u), walked.block)
    moved = Moved(columns(walked.x), columns(walked.y), whole, walked.w, walked.block, flow, lower)
    y = without_noise(moved, max(near_of((p.leg or NO_LEG).kind) for p in passages))
    r = columns(sensor.residual(sensor.predict(y.T)))
    H, R = map(as_compiled, (sensor.jacobian(end), sensor.covariance(end)))
    about = linear_reading(moved, columns(h), H, R, sensor.angle, misses)
    return Seen(rows, whole, Ahead(r, y, lower, *about))


def _wrapped(r: Floats, angle: Bools) -> Floats:
    """Differences (..., k) with those of angles in (-π, π]."""
    if angle.any():
        r[..., angle] -= 2.0 * np.pi * np.round(r[..., angle] / (2.0 * np.pi))
    return r
