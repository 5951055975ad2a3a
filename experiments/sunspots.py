"""The yearly sunspot number: its data, a sensor that does not see a sign, forecasts and how well they fit.

The number s is the squared amplitude of a Van der Pol oscillator under noise (Mininni, Gómez and Mindlin
2000), for the magnetic field of the Sun turns over in each cycle and spots do not show its sign. The sensor
is y = √s = |x + v|; on the scale of the root the noise v is about as large in busy years as in quiet ones.
The sign is left open: the oscillator is the same for (x, u) and (−x, −u), so both branches make the same
forecasts of s, and filters that carry a density count both. EKF and UKF cannot, and take the sign of their
own prediction. To alternate signs at each minimum beforehand, as is usual, would tell a filter of 1976 that
the minimum had been reached, which was known years later. Nothing here looks ahead: the forecast for a year
uses the measurements up to its origin only.
"""

import copy
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import brentq
from scipy.special import logsumexp, ndtr

import sphfilter as sf
from reference_filters.grid import GridFilter
from reference_filters.particle import ParticleFilter
from sphfilter.errors import ConfigError
from sphfilter.files.csv_data import read_measurements

from .own_data.model_file import load_model

_DATA = Path(__file__).parent / "data"
#: The first year that is forecast; the model is fitted to the years before.
FIRST = 1949
#: Probabilities of the central intervals that are scored and drawn.
LEVELS = (0.5, 0.9, 0.95)
#: Probabilities of the quantiles kept of a forecast: median, then lower and upper end of each interval.
_PROBABILITIES = (0.5, *(p for level in LEVELS for p in (0.5 - level / 2, 0.5 + level / 2)))
#: Nodes of a grid below this part of the maximum are left out of a forecast.
_NEGLIGIBLE = 1e-7


def load():
    """The fitted model as a `Scenario`, and the `Measurements`: roots y of the numbers, year by year."""
    return load_model(_DATA / "sunspots.toml"), roots(read_measurements(_DATA / "sunspots.csv", 1))


def roots(data):
    """Square roots of measured numbers; a negative number is refused."""
    if np.any(data.z < 0):
        year = data.times[np.argmax(np.any(data.z < 0, axis=1))]
        raise ConfigError(f"the sunspot number of {year:g} is negative")
    return replace(data, z=np.sqrt(data.z))


def split(data):
    """Years before `FIRST`, and from it on."""
    before = data.times < FIRST
    return (replace(data, times=data.times[part], z=data.z[part]) for part in (before, ~before))


@dataclass(frozen=True)
class FoldedMixture:
    """Density of y = |z| ≥ 0, where z is a mixture of Gaussians: both signs of z are counted."""

    # shape (K,): weights sum to one
    weights: np.ndarray
    means: np.ndarray
    std: np.ndarray

    @classmethod
    def ahead(cls, filt, variance):
        """Forecast of |x₀ + v|, v ~ N(0, variance), from the density a filter carries now."""
        points = _points(filt)
        if points is None:
            return cls(np.ones(1), filt.x[:1], np.sqrt(filt.P[:1, 0] + variance))
        weights, means, spread = points
        return cls(weights, means, np.sqrt(variance + spread))

    def logpdf(self, y):
        """Log-density at one y ≥ 0."""
        signed = np.array([[y], [-y]])
        log_kernels = -0.5 * ((signed - self.means) / self.std) ** 2 - np.log(self.std * np.sqrt(2 * np.pi))
        return float(logsumexp(log_kernels, b=np.broadcast_to(self.weights, log_kernels.shape)))

    def cdf(self, y):
        """Probability of |z| ≤ y."""
        return float(self.weights @ (ndtr((y - self.means) / self.std) - ndtr((-y - self.means) / self.std)))

    def quantile(self, probability):
        """The y below which lies `probability`."""
        top = np.max(np.abs(self.means) + 10 * self.std)
        return brentq(lambda y: self.cdf(y) - probability, 0.0, top, xtol=1e-6)


def _points(filt):
    """Weights, x₀ and variances, shape (K,), of what carries the density; None for mean and covariance."""
    if isinstance(filt, sf.SPHFilter):
        p = filt.density
        spread = p.kernel_variance * p.h**2 if p.read_out == "mixture" else np.zeros(p.n_particles)
        return p.mass, p.x[:, 0], spread
    if isinstance(filt, ParticleFilter):
        return filt.weights, filt.particles[:, 0], np.zeros(filt.n_particles)
    if isinstance(filt, GridFilter):
        p = filt.density
        kept = p.values.ravel() > _NEGLIGIBLE * p.values.max()
        weights = p.values.ravel()[kept]
        return weights / weights.sum(), p.box.nodes()[kept, 0], np.zeros(len(weights))
    return None


def fold(variance):
    """Sensor y = |x₀ + v|, v ~ N(0, variance): p(y | x) = N(y; x₀, R) + N(−y; x₀, R)."""

    def log_likelihood(y, X, t):
        """Both signs of y[0] for the states X (N, n)."""
        near, far = (-0.5 * (sign * y[0] - X[:, 0]) ** 2 / variance for sign in (1.0, -1.0))
        return np.logaddexp(near, far) - 0.5 * np.log(2 * np.pi * variance)

    return sf.LikelihoodMeasurement(log_likelihood, dim_z=1)


def learn(filt, y, signed, folded):
    """Update a filter with y = |x₀ + v|; NaN is missing.

    A filter that carries a density counts both signs (`folded`). One that carries a mean and a covariance
    cannot: it takes the sign of its own prediction, the likelier of the two, and the `signed` sensor.
    """
    if _points(filt) is not None:
        return filt.update([y], folded)
    return filt.update([np.copysign(y, filt.x[0])], signed)


@dataclass(frozen=True)
class Score:
    """How forecasts at one horizon fit T targets; sunspot numbers s = y²."""

    # shape (T,)
    year: np.ndarray
    observed: np.ndarray
    log_score: np.ndarray  # shape (T,): log-density of the observed s, nats
    # shape (T,): probability the forecast gave to numbers below the observed: uniform if forecasts are
    # calibrated
    pit: np.ndarray
    median: np.ndarray  # shape (T,)
    intervals: np.ndarray  # shape (T, 3, 2): central intervals of `LEVELS`

    @classmethod
    def of(cls, years, y, forecasts):
        """Score forecasts of y, each a `FoldedMixture`; the density of s = y² is that of y over 2 y."""
        quantiles = np.array([[f.quantile(p) for p in _PROBABILITIES] for f in forecasts]) ** 2
        return cls(
            year=np.asarray(years),
            observed=np.asarray(y) ** 2,
            log_score=np.array([f.logpdf(v) - np.log(2 * v) for f, v in zip(forecasts, y, strict=True)]),
            pit=np.array([f.cdf(v) for f, v in zip(forecasts, y, strict=True)]),
            median=quantiles[:, 0],
            intervals=quantiles[:, 1:].reshape(len(quantiles), len(LEVELS), 2),
        )

    @property
    def coverage(self):
        """Part of the targets inside the intervals of `LEVELS`, shape (3,)."""
        inside = (self.intervals[..., 0] <= self.observed[:, None]) & (
            self.observed[:, None] <= self.intervals[..., 1]
        )
        return inside.mean(axis=0)


def score_forecasts(filt, years, y, sensor, horizons, first):
    """Run a filter over yearly measurements; scores of its forecasts from `first` on, by horizon.

    The filter is at the time of the first measurement or before. Years and measurements y have shape (T,);
    NaN is missing and no target. The `sensor` is that of the signed value, `horizons` are years ahead, all
    with the same first target.
    """
    variance = sensor.noise_cov[0, 0]
    folded, made = fold(variance), {h: {} for h in horizons}
    for i, year in enumerate(years):
        if year > filt.t:
            filt.predict(t=year)
        learn(filt, y[i], sensor, folded)
        if year + max(horizons) >= first:
            ahead = copy.copy(filt)  # its density is replaced by a prediction, never changed in place
            for h in range(1, min(max(horizons), len(years) - 1 - i) + 1):
                ahead.predict(t=years[i + h])
                if h in made and years[i + h] >= first and np.isfinite(y[i + h]):
                    made[h][i + h] = FoldedMixture.ahead(ahead, variance)
    return {h: Score.of(years[list(of)], y[list(of)], list(of.values())) for h, of in made.items()}


def score_history(past, years, y):
    """Score one forecast for all targets: the law of the values `past`, whatever the phase of the cycle.

    Silverman's width of the kernels. A forecast that knows the oscillation should do better.
    """
    width = 1.06 * np.std(past) * len(past) ** -0.2
    law = FoldedMixture(np.full(len(past), 1 / len(past)), np.asarray(past), np.full(len(past), width))
    return Score.of(years, y, [law] * len(y))
