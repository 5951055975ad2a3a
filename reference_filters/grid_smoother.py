"""Fixed-interval smoothing on a grid in one and two dimensions: the referee of smoothed densities.

The density given all measurements is that of the filter times β(x, t) = p(later measurements | x). log β is
carried back on a box that stays: over short steps, drift and noise one after the other (Strang), along the
drift's characteristics and by Gauss-Hermite points of the noise, between the nodes by splines of log β.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates, spline_filter
from scipy.special import logsumexp

from sphfilter import validate

from ._characteristics import follow
from .grid import GridFilter
from .grid_density import Box, GridDensity

_ORDER = 5  # of the splines
_POINTS = 9  # Gauss-Hermite points of one noise


@dataclass(frozen=True)
class SmoothedGrid:
    """Smoothed densities at T times.

    Attributes
    ----------
    x : ndarray, shape (T, n)
    P : ndarray, shape (T, n, n)
    densities : list of GridDensity
    log_evidence : ndarray, shape (T,)
        Of all measurements, nats: from filter and β at each time. They agree but for errors.
    """

    x: np.ndarray
    P: np.ndarray
    densities: list
    log_evidence: np.ndarray


def smooth_on_grid(model, measurement, start, times, measurements, *, size=128, nodes=200, step=0.02):
    """Smooth on a grid.

    Parameters
    ----------
    model : SDE
        Of one or two states, with noise that does not depend on them.
    measurement : measurement model
    start : tuple
        (x0, P0) or (x0, P0, t0).
    times : array_like, shape (T,)
        Increasing, seconds.
    measurements : sequence of length T
        None or NaN where none came.
    size : int
        Nodes an axis of the filter's grid.
    nodes : int
        Nodes an axis of the box that carries log β.
    step : float
        Longest step of β, seconds; errors are of second order.

    Returns
    -------
    SmoothedGrid
    """
    times = validate.times("times", times)
    filt = GridFilter(model, measurement, *start, size=size)
    filtered, evidence = [], [0.0]
    for t, z in zip(times, measurements, strict=True):
        if t > filt.t:
            filt.predict(t=t)
        filt.update(z)
        filtered.append(filt.density)
        evidence.append(filt.log_evidence)
    box = _around(filtered, nodes)
    log_beta, smoothed, total = np.zeros(box.shape), [], []
    for k in reversed(range(len(times))):
        if k + 1 < len(times):
            log_beta = _carried(model, box, log_beta, times[k], times[k + 1], step)
        density, log_mass = _product(filtered[k], box, log_beta)
        smoothed.append(density)
        total.append(log_mass + evidence[k + 1])
        if np.any(measurement.observed(measurements[k])):
            z = np.atleast_1d(np.asarray(measurements[k], dtype=float))
            log_beta = log_beta + measurement.log_likelihood(z, box.nodes(), times[k]).reshape(box.shape)
    smoothed.reverse()
    x, P = (np.array(part) for part in zip(*(p.moments() for p in smoothed), strict=True))
    return SmoothedGrid(x, P, smoothed, np.array(total[::-1]))


def _around(densities, size):
    """The box along the axes that holds the boxes of all densities."""
    corners = np.concatenate([p.box.nodes() for p in densities])
    return Box.between(np.stack([corners.min(axis=0), corners.max(axis=0)], axis=1), size)


def _carried(model, box, log_beta, t0, t1, longest):
    """log β at t0 on the nodes of the box, from that at t1."""
    count = int(np.ceil((t1 - t0) / longest - 1e-9))
    h = (t1 - t0) / count
    log_beta = _averaged(model, box, log_beta, t1 - 0.25 * h, 0.5 * h)
    for k in reversed(range(count)):
        t = t0 + k * h
        ends, _ = follow(model, box.nodes(), t, h)
        log_beta = _between(box, spline_filter(log_beta, _ORDER), ends).reshape(box.shape)
        part = h if k else 0.5 * h
        log_beta = _averaged(model, box, log_beta, t + 0.5 * (h - part), part)
    return log_beta


def _averaged(model, box, log_beta, t, h):
    """Logarithm of the mean of β over the noise of h seconds, D as it is at time t."""
    w, V = np.linalg.eigh(model.diffusion(box.centre[None], t)[0])
    points, weights = np.polynomial.hermite_e.hermegauss(_POINTS)
    log_weights = np.log(weights / weights.sum())
    for axis in np.flatnonzero(w > 1e-14 * w.max()):
        spline, push = spline_filter(log_beta, _ORDER), np.sqrt(2.0 * w[axis] * h) * V[:, axis]
        values = [_between(box, spline, box.nodes() + p * push) for p in points]
        log_beta = logsumexp(np.array(values) + log_weights[:, None], axis=0).reshape(box.shape)
    return log_beta


def _between(box, spline, X):
    """A spline at the states X (M, n); beyond the box, its value at the edge."""
    at = np.clip(np.nan_to_num(box.indices(X)), 0, box.size - 1).T
    return map_coordinates(spline, at, order=_ORDER, mode="mirror", prefilter=False)


def _product(p, box, log_beta):
    """A filter's density times β, normalised, and the logarithm of its integral."""
    log_weight = _between(box, spline_filter(log_beta, _ORDER), p.box.nodes()).reshape(p.box.shape)
    top = log_weight[p.values > 1e-9 * p.values.max()].max()
    raw = GridDensity(p.box, p.values * np.exp(np.minimum(log_weight - top, 300.0)))
    return raw.normalised(), float(top + np.log(raw.mass / p.mass))
