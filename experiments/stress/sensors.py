"""Sensors of fourteen kinds, as data that can be written in other coordinates."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import gammaln, log_ndtr
from scipy.stats import t as student

import sphfilter as sf

from .equations import in_words, replaced

#: Standard deviation of the errors that one reading in ten has, of the robust likelihood.
_WIDE, _WIDE_SHARE = 10.0, 0.1


@dataclass(frozen=True, kw_only=True)
class GaussianReader:
    """z = h(x) + v, v ~ N(0, R): h as text, or the matrix H.

    Attributes
    ----------
    kind : str
    states, h : tuples of str
    R : ndarray, shape (k, k)
    H : ndarray, shape (k, n), or None
    angles : tuple of int
    """

    kind: str
    states: tuple[str, ...]
    R: np.ndarray
    h: tuple[str, ...] = ()
    H: np.ndarray | None = None
    angles: tuple[int, ...] = ()

    @cached_property
    def sensor(self):
        """What the filter gets."""
        if self.H is not None:
            return sf.GaussianMeasurement(self.H, self.R)
        return sf.GaussianMeasurement.from_expressions(self.states, self.h, self.R, self.angles)

    def sample(self, x, rng):
        """One reading (k,) of the state x (n,)."""
        return self.sensor.sample(x, 0.0, rng)

    def moved(self, T, c):
        """The sensor of y, where x = T y + c, and what its readings are lower by, shape (k,)."""
        if self.H is not None:
            return replace(self, H=self.H @ T), self.H @ c
        words = in_words(self.states, T, c)
        return replace(self, h=tuple(replaced(text, words) for text in self.h)), 0.0

    def halved(self):
        """The sensor of which two equal readings say what one of this says, and log p - 2 log p' of them."""
        k = len(self.R)
        constant = 0.5 * (k * np.log(2.0 * np.pi) + np.linalg.slogdet(self.R)[1]) + k * np.log(2.0)
        return replace(self, R=2.0 * self.R), constant

    def __str__(self):
        what = self.H.tolist() if self.H is not None else ", ".join(self.h)
        return f"{self.kind}: z = {what}, R = {self.R.tolist()}"


@dataclass(frozen=True, kw_only=True)
class LikelihoodReader:
    """A likelihood of u = a·x.

    Attributes
    ----------
    kind : str
        Of `LIKELIHOODS`.
    a : ndarray, shape (n,)
    offset : float
        u = a·x + offset.
    about : tuple of float
        What the likelihood takes besides z and u: a scale, and more.
    share : float
        Power of the likelihood.
    """

    kind: str
    a: np.ndarray
    about: tuple[float, ...]
    offset: float = 0.0
    share: float = 1.0
    H = None

    @cached_property
    def sensor(self):
        """What the filter gets."""
        return sf.LikelihoodMeasurement(self._log_likelihood, dim_z=1)

    def _log_likelihood(self, z, X, t):
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            return self.share * LIKELIHOODS[self.kind][0](z[0], X @ self.a + self.offset, *self.about)

    def sample(self, x, rng):
        """One reading (1,) of the state x (n,)."""
        return np.array([LIKELIHOODS[self.kind][1](x @ self.a + self.offset, rng, *self.about)])

    def moved(self, T, c):
        """As `GaussianReader.moved`."""
        return replace(self, a=self.a @ T, offset=self.offset + float(self.a @ c)), 0.0

    def halved(self):
        """As `GaussianReader.halved`."""
        return replace(self, share=0.5 * self.share), 0.0

    def __str__(self):
        return f"{self.kind}{self.about}: u = {self.a.tolist()}·x + {self.offset:.4g}"


def _normal(z, u, s):
    return -0.5 * ((z - u) / s) ** 2 - np.log(s) - 0.5 * np.log(2.0 * np.pi)


def _robust(z, u, s):
    narrow = np.log(1.0 - _WIDE_SHARE) + _normal(z, u, s)
    return np.logaddexp(narrow, np.log(_WIDE_SHARE) + _normal(z, u, _WIDE))


def _robust_sample(u, rng, s):
    return u + (_WIDE if rng.random() < _WIDE_SHARE else s) * rng.standard_normal()


def _quantised(z, u, width, s):
    """P(the reading u + s v is rounded to z); by the upper tails, which keep their logarithms."""
    far = np.abs(z - u)
    if s == 0.0:
        return np.where(far <= 0.5 * width, 0.0, -np.inf)
    near, beyond = log_ndtr((0.5 * width - far) / s), log_ndtr(-(0.5 * width + far) / s)
    return near + np.log1p(-np.exp(beyond - near))


def _quantised_sample(u, rng, width, s):
    return width * np.round((u + s * rng.standard_normal()) / width)


def _laplace(z, u, s):
    return -np.abs(z - u) / s - np.log(2.0 * s)


def _poisson(z, u, level, slope):
    """Counts of rate exp(level + slope u)."""
    log_rate = level + slope * u
    return z * log_rate - np.exp(np.minimum(log_rate, 700.0)) - gammaln(z + 1.0)


def _poisson_sample(u, rng, level, slope):
    return float(rng.poisson(np.exp(min(level + slope * u, 12.0))))


#: Log-likelihood(z, u, ...) and sample(u, rng, ...) of each kind.
LIKELIHOODS = {
    "Laplace": (_laplace, lambda u, rng, s: u + rng.laplace(scale=s)),
    "robust": (_robust, _robust_sample),
    "quantised": (_quantised, _quantised_sample),
    "Poisson": (_poisson, _poisson_sample),
    "Student": (
        lambda z, u, s, nu: student.logpdf((z - u) / s, nu) - np.log(s),
        lambda u, rng, s, nu: u + s * rng.standard_t(nu),
    ),
}
