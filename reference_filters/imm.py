"""filterpy's interacting multiple models: the rival of `JumpMarkovFilter`, a Gaussian for each mode.

At a prediction the Gaussians of the modes are mixed and replaced by one with their mean and covariance; the
modes jump at the times of the readings only. Kalman filters of this package carry the Gaussians.
"""

from typing import NamedTuple

import numpy as np
from filterpy.kalman import IMMEstimator

from ._base import ReferenceFilter, gaussian_start
from .kalman import ExtendedKalmanFilter, KalmanFilter, UnscentedKalmanFilter

_KINDS = {"kalman": KalmanFilter, "ekf": ExtendedKalmanFilter, "ukf": UnscentedKalmanFilter}


class _Member:
    """A Kalman filter as filterpy's estimator asks it."""

    def __init__(self, filt):
        self.filt, self.x, self.P = filt, filt.x, filt.P
        self.likelihood, self.span = 1.0, (0.0, 0.0)

    def predict(self, u=None):
        (self.x, self.P), _ = self.filt._predicted((self.x, self.P), *self.span)

    def update(self, z):
        self.filt.t = self.span[1]
        (self.x, self.P), facts = self.filt._updated((self.x, self.P), z, self.filt.measurement)
        self.likelihood = float(np.exp(facts["log_evidence"]))


class _Belief(NamedTuple):
    """Means (M, n), covariances (M, n, n) and probabilities (M,) of the modes, and the moments of all."""

    means: np.ndarray
    covs: np.ndarray
    mu: np.ndarray
    whole: tuple


class ImmFilter(ReferenceFilter):
    """Interacting multiple models of a JumpMarkovModel.

    Parameters
    ----------
    model : JumpMarkovModel
    measurement : GaussianMeasurement
    x0, P0 : array_like, shapes (n,), (n, n)
    mode_probabilities : array_like, shape (M,), optional
    kind : {"kalman", "ekf", "ukf"}, optional
        Of the filters of the modes; Kalman where they are linear, else unscented.

    Attributes
    ----------
    mode_probabilities : ndarray, shape (M,)
    """

    def __init__(self, model, measurement, x0, P0, t0=0.0, dt=None, *, mode_probabilities=None, kind=None):
        self.model = model
        x0, P0 = gaussian_start(x0, P0, model.dim)
        modes = list(model.modes.values())
        kind = kind or (
            "kalman" if all(mode.linear for mode in modes) and measurement.H is not None else "ukf"
        )
        members = [_Member(_KINDS[kind](mode, measurement, x0, P0, t0)) for mode in modes]
        mu = model.stationary if mode_probabilities is None else np.asarray(mode_probabilities, dtype=float)
        self._engine = IMMEstimator(members, mu, np.eye(len(mu)))
        super().__init__(self._told(), measurement, t0, dt)

    @property
    def mode_probabilities(self):
        return self._belief.mu

    def _told(self):
        engine = self._engine
        means, covs = np.array([m.x for m in engine.filters]), np.array([m.P for m in engine.filters])
        return _Belief(means, covs, engine.mu.copy(), (engine.x.copy(), engine.P.copy()))

    def _set(self, belief):
        engine = self._engine
        for member, x, P in zip(engine.filters, belief.means, belief.covs, strict=True):
            member.x, member.P = x, P
        engine.mu = belief.mu.copy()
        return engine

    def _moments(self, belief):
        return belief.whole

    def _predicted(self, belief, t0, t1):
        engine = self._set(belief)
        engine.M = self.model.transition(t1 - t0)
        engine._compute_mixing_probabilities()
        for member in engine.filters:
            member.span = t0, t1
        engine.predict()
        return self._told()._replace(mu=engine.cbar.copy()), len(engine.filters)

    def _updated(self, belief, z, measurement):
        engine = self._set(belief)
        engine.cbar = belief.mu  # which the prediction has mixed already
        engine.update(z)
        likelihoods = np.array([member.likelihood for member in engine.filters])
        return self._told(), {"log_evidence": float(np.log(likelihoods @ belief.mu))}
