"""Bookkeeping shared by the reference filters: times, priors and posteriors, evidence, missing measurements.

A reference filter is three pure functions of a belief (whatever it carries of the density); this class is
the stateful, filterpy-shaped shell around them. A step that raises leaves the filter as it was.
"""

from abc import ABC, abstractmethod

import numpy as np

from sphfilter import validate
from sphfilter.errors import ModelError, PropagationError
from sphfilter.filter.readings import numbers_of
from sphfilter.filter.results import run_filter
from sphfilter.info import PredictInfo, UpdateInfo
from sphfilter.model.named import driven


class ReferenceFilter(ABC):
    """Base of the reference filters.

    Attributes
    ----------
    x, P : ndarray, shapes (n,), (n, n)
        Mean and covariance now.
    x_prior, P_prior, x_post, P_post : ndarray
        The same after the last prediction and after the last update.
    t : float
        Time now, seconds.
    log_likelihood, log_evidence : float
        Log-density of the last measurement given the earlier ones (zero if it was missing); their sum.
    driven : SDE or None
        The model with the inputs that it had in the last prediction; None if the filter has no model.
    """

    #: The model of a filter that has one; set before `__init__` is called.
    model = None
    #: Whether what it tells is exact; any other filter does not say how far off it is.
    exact = False
    #: Whether predictions are made with `driven`.
    takes_inputs = False

    def __init__(self, belief, measurement=None, t0=0.0, dt=None):
        self.measurement = measurement
        self.driven = self.model
        self.dt = dt
        self.t = float(t0)
        self.log_likelihood = 0.0
        self.log_evidence = 0.0
        self._belief = belief
        self.x, self.P = self._moments(belief)
        self.x_prior, self.P_prior = self.x_post, self.P_post = self.x, self.P

    @abstractmethod
    def _predicted(self, belief, t0, t1):
        """Return the belief at t1 > t0 and the number of steps taken."""

    @abstractmethod
    def _updated(self, belief, z, measurement):
        """Return the belief after `z` and the keyword arguments of its `UpdateInfo` (log_evidence, ...)."""

    @abstractmethod
    def _moments(self, belief):
        """Return mean (n,) and covariance (n, n)."""

    def predict(self, dt=None, *, t=None, u=None):
        """Carry the density forward by `dt` seconds, or to the absolute time `t`.

        The model's inputs are `u` over the interval, in their order or by name; without `u`, what the model
        has.

        Returns
        -------
        PredictInfo

        Raises
        ------
        ModelError
            Neither or both of `dt` and `t` given (and no `dt` at construction), or a time gone by; `u` of a
            filter that takes no inputs.
        PropagationError
            The density cannot be carried so far; the filter is as it was before.
        """
        t1 = self._end_of_step(dt, t)
        before, self.driven = self.driven, self.model if u is None else self._with_inputs(u)
        try:
            belief, n_steps = self._predicted(self._belief, self.t, t1) if t1 > self.t else (self._belief, 0)
            x, P = self._finite_moments(belief, "prediction", t1)
        except Exception:
            self.driven = before
            raise
        self._belief, self.t, self.x, self.P = belief, t1, x, P
        self.x_prior, self.P_prior = x, P
        return PredictInfo(n_steps=n_steps, scheme=type(self).__name__)

    def update(self, z, measurement=None):
        """Condition the density on `z`, shape (k,); None or NaN components are missing.

        Parameters
        ----------
        z : array_like, float, mapping of sensors' names to their readings, or None
        measurement : optional
            Another sensor than the filter's own, for this update only.

        Returns
        -------
        UpdateInfo
        """
        measurement = self.measurement if measurement is None else measurement
        if measurement is None:
            raise ModelError("update needs a measurement model: give one here or at construction")
        measurement, z = driven(measurement, getattr(self.driven, "inputs", {})), numbers_of(measurement, z)
        untold = 0.0 if self.exact else np.nan
        if np.any(measurement.observed(z)):
            z = np.atleast_1d(np.asarray(validate.unmasked(z), dtype=float))
            belief, facts = self._updated(self._belief, z, measurement)
            facts = {"evidence_error": untold} | facts
        else:
            belief, facts = self._belief, {"log_evidence": 0.0, "reason": "missing"}
        info = UpdateInfo(accepted=True, **{"error": untold} | facts)
        x, P = self._finite_moments(belief, "update", self.t)
        if not np.isfinite(info.log_evidence):
            raise PropagationError(
                f"update at t = {self.t:g}: the measurement {z} has no density under the prediction "
                f"(log-evidence {info.log_evidence}); check its unit and the measurement noise"
            )
        self._belief, self.x, self.P, self.x_post, self.P_post = belief, x, P, x, P
        self.log_likelihood = info.log_evidence
        self.log_evidence += info.log_evidence
        return info

    def run(self, times, measurements, truth=None, observer=None, inputs=None):
        """Predict to each time and update; see `sphfilter.filter.results.run_filter`."""
        if inputs is not None:
            self._check_inputs()
        return run_filter(self, times, measurements, truth, observer, inputs=inputs)

    def _check_inputs(self):
        if not self.takes_inputs:
            raise ModelError(
                f"{type(self).__name__} takes no inputs; the Kalman filters, ParticleFilter and GridFilter do"
            )

    def _with_inputs(self, u):
        self._check_inputs()
        return self.model.with_inputs(u)

    def _end_of_step(self, dt, t):
        if dt is not None and t is not None:
            raise ModelError("predict takes either dt or t, not both")
        if t is None:
            dt = self.dt if dt is None else dt
            if dt is None:
                raise ModelError("predict needs dt or t (or dt at construction)")
            t = self.t + validate.seconds("dt", dt)
        else:
            (t,) = validate.onwards(np.atleast_1d(np.asarray(t, dtype=float)), self.t)
        if not np.isfinite(t) or t < self.t:
            raise ModelError(f"cannot predict from t = {self.t:g} to {t:g}: times must not decrease")
        return float(t)

    def _finite_moments(self, belief, step, t):
        x, P = self._moments(belief)
        if not np.isfinite(x.sum() + P.sum()):  # a sum is as finite as its terms
            raise PropagationError(
                f"the filter diverged in its {step} to t = {t:g}: mean or covariance is not finite (x = {x})"
            )
        return x, P


def gaussian_start(x0, P0, dim):
    """Check and copy the start N(x0, P0), shapes (dim,), (dim, dim)."""
    return validate.array("x0", x0, (dim,)), validate.covariance("P0", P0, dim)
