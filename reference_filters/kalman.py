"""Kalman, extended and unscented Kalman filters on filterpy, in continuous time.

filterpy does the updates, on a scratch object that is given mean, covariance and sensor each time: its
`update(None)` keeps the likelihood of the measurement before, a NaN in `z` poisons its state for good, and
its sigma points are stale at a second update without a prediction. Priors, posteriors, evidence and missing
measurements are the business of `ReferenceFilter`.
"""

from functools import partial

import numpy as np
from filterpy import kalman as fp

from sphfilter.core._jit import jit
from sphfilter.errors import ModelError, PropagationError
from sphfilter.model.measurements import has_gaussian_noise, is_gaussian

from ._base import ReferenceFilter, gaussian_start
from ._moment_ode import LINEARISED, SIGMA_POINTS, propagate_moments


class _GaussianFilter(ReferenceFilter):
    """A filter whose belief is a mean and a covariance."""

    takes_inputs = True

    def __init__(self, model, measurement, x0, P0, t0=0.0, dt=None):
        self.model = model
        super().__init__(gaussian_start(x0, P0, model.dim), measurement, t0, dt)

    def _moments(self, belief):
        return belief

    def _updated(self, belief, z, measurement):
        if not (is_gaussian(measurement) or has_gaussian_noise(measurement)):
            raise ModelError(
                f"{type(self).__name__} needs a GaussianMeasurement, not {type(measurement).__name__}; "
                "the particle and grid filters take any likelihood"
            )
        seen, R = np.flatnonzero(measurement.observed(z)), measurement.noise_cov
        if R is None:  # it depends on the state: that of the mean
            R = measurement.covariance(belief[0][None], self.t)[0]
        if seen.size < measurement.dim_z:
            R = R[np.ix_(seen, seen)]
        try:
            x, P, y, S = self._condition(*belief, z, measurement, seen, R)
            log_evidence = _log_normal(y, S)
            if np.isnan(log_evidence):
                raise np.linalg.LinAlgError("innovation covariance")
        except np.linalg.LinAlgError as error:
            raise PropagationError(
                f"update at t = {self.t:g}: a covariance is not positive definite ({error}); "
                f"P = {belief[1].tolist()}"
            ) from error
        facts = {"log_evidence": log_evidence, "innovation": y, "innovation_cov": S}
        return (x, 0.5 * (P + P.T)), facts


class KalmanFilter(_GaussianFilter):
    """Exact filter of a linear model with linear Gaussian sensors.

    Parameters
    ----------
    model : LinearSDE, or an SDE whose `linear` is True
    measurement : GaussianMeasurement with a matrix, or None if every update brings its own
    x0, P0 : array_like, shapes (n,), (n, n)
    t0 : float
        Start, seconds.
    dt : float, optional
        Interval of `predict()` without arguments.
    """

    exact = True

    def __init__(self, model, measurement, x0, P0, t0=0.0, dt=None):
        if not model.linear:
            raise ModelError(f"KalmanFilter needs a linear model, not {model!r}; take ExtendedKalmanFilter")
        super().__init__(model, measurement, x0, P0, t0, dt)
        self._engine = fp.KalmanFilter(dim_x=model.dim, dim_z=1)
        self._transitions = {}

    def _predicted(self, belief, t0, t1):
        key = t1 - t0, *self.driven.inputs.values()
        if key not in self._transitions:
            self._transitions[key] = self.driven.to_linear().discretize(t1 - t0)
        Phi, offset, Qd = self._transitions[key]
        return fp.predict(*belief, F=Phi, Q=Qd, u=offset), 1

    def _condition(self, x, P, z, measurement, seen, R):
        if measurement.H is None:
            raise ModelError("KalmanFilter needs a measurement given as a matrix; take ExtendedKalmanFilter")
        engine = self._engine
        engine.x, engine.P = x, P
        engine.update(z[seen], R=R, H=measurement.H[seen])
        return engine.x, engine.P, engine.y, engine.S


class ExtendedKalmanFilter(_GaussianFilter):
    """Moments of the model linearised about the mean, integrated in continuous time.

    dm/dt = f(m), dP/dt = J P + P Jᵀ + 2 D(m) by an adaptive fifth-order scheme; noise that depends on the
    state enters at the mean. The update is filterpy's (Joseph form).

    Parameters
    ----------
    model : SDE
    measurement, x0, P0, t0, dt
        As `KalmanFilter`; any GaussianMeasurement.
    rtol : float
        Error allowed per integration step, in standard deviations.
    """

    def __init__(self, model, measurement, x0, P0, t0=0.0, dt=None, rtol=1e-6):
        super().__init__(model, measurement, x0, P0, t0, dt)
        self.rtol = rtol
        self._engine = fp.ExtendedKalmanFilter(dim_x=model.dim, dim_z=1)

    def _predicted(self, belief, t0, t1):
        m, P, n_steps = propagate_moments(self.driven, LINEARISED, *belief, t0, t1, rtol=self.rtol)
        return (m, P), n_steps

    def _condition(self, x, P, z, measurement, seen, R):
        engine = self._engine
        engine.x, engine.P = x, P
        engine.update(
            z,
            HJacobian=lambda x: measurement.jacobian(x, self.t)[seen],
            Hx=lambda x: measurement.predict(x[None], self.t)[0],
            R=R,
            residual=lambda z, zhat: measurement.residual(z, zhat)[seen],
        )
        return engine.x, engine.P, engine.y, engine.S


class UnscentedKalmanFilter(_GaussianFilter):
    """Moments averaged over sigma points, integrated in continuous time (Särkkä 2007).

    Parameters
    ----------
    model, measurement, x0, P0, t0, dt, rtol
        As `ExtendedKalmanFilter`. Noise that depends on the state is averaged over the sigma points.
    kappa : float, optional
        Spread of Julier's sigma points, n + kappa > 0. Default max(3 - n, 0): the Gaussian kurtosis where
        that needs no negative weight.
    """

    def __init__(self, model, measurement, x0, P0, t0=0.0, dt=None, kappa=None, rtol=1e-6):
        super().__init__(model, measurement, x0, P0, t0, dt)
        self.rtol = rtol
        self.kappa = float(max(3 - model.dim, 0) if kappa is None else kappa)
        if not self.kappa > -model.dim:
            raise ModelError(f"kappa must be above -n = {-model.dim}; got {kappa}")
        points = fp.JulierSigmaPoints(model.dim, kappa=self.kappa, sqrt_method=_upper_root)
        self._engine = fp.UnscentedKalmanFilter(model.dim, 1, dt=0.0, hx=None, fx=None, points=points)

    def _predicted(self, belief, t0, t1):
        m, P, n_steps = propagate_moments(
            self.driven, SIGMA_POINTS, *belief, t0, t1, kappa=self.kappa, rtol=self.rtol
        )
        return (m, P), n_steps

    def _condition(self, x, P, z, measurement, seen, R):
        engine = self._engine
        engine.x, engine.P = x, P
        engine.sigmas_f = engine.points_fn.sigma_points(x, P)
        engine.residual_z, engine.z_mean = np.subtract, None
        if measurement.angles:
            engine.residual_z = residual = partial(_partial_residual, measurement, seen)
            # The mean relative to the central point is right for angles too.
            engine.z_mean = lambda Z, W: Z[0] + W @ np.array([residual(z, Z[0]) for z in Z])
        # filterpy asks for one sigma point after the other; all of them take no longer than one
        readings = iter(measurement.predict(engine.sigmas_f, self.t)[:, seen])
        engine.update(z[seen], R=R, hx=lambda s: next(readings))
        return engine.x, engine.P, engine.y, engine.S


def _partial_residual(measurement, seen, z, zhat):
    """Residual of the components `seen`: angles are counted in the full vector."""
    full = np.zeros((2, measurement.dim_z))
    full[0, seen], full[1, seen] = z, zhat
    return measurement.residual(full[0], full[1])[seen]


def _upper_root(P):
    return np.linalg.cholesky(P).T  # scipy's takes longer than the rest of the points


@jit
def _log_normal(y, S):
    """Log-density of N(0, S) at y, NaN for a singular S. (filterpy's is slower than the update.)"""
    k = y.size
    L, white = np.zeros((k, k)), np.empty(k)
    value = -0.5 * k * np.log(2.0 * np.pi)
    for a in range(k):
        for b in range(a + 1):
            s = S[a, b]
            for c in range(b):
                s -= L[a, c] * L[b, c]
            L[a, b] = s / L[b, b] if b < a else np.sqrt(s)
        if not L[a, a] > 0.0:
            return np.nan
        r = y[a]
        for c in range(a):
            r -= L[a, c] * white[c]
        white[a] = r / L[a, a]
        value -= 0.5 * white[a] ** 2 + np.log(L[a, a])
    return value
