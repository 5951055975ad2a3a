"""A guide for sensors that say nothing but a likelihood: linear readings that would have moved moments so.

The first pass over a prior's points tells mean and covariance before and after such sensors. A linear sensor
with Gaussian noise that makes the same of a Gaussian leads points to where the likelihood is. It only leads:
weights are those of the likelihood itself.
"""

import numpy as np

from .._types import Floats
from ..core.cloud.weights import effective, normalise, prior_times
from ..core.limits import ALIKE
from ..density.moments import moments
from ..density.points import Points
from .stacked import Stacked

_NARROWEST = 1e-12  # part of a prior's variance that rounding leaves


def piloted(sensor: Stacked, points: Points, log_l: Floats) -> Stacked:
    """The sensors with linear readings beside them, in place of those that say nothing but a likelihood.

    `log_l` (N,) is the log-likelihood of all readings at the prior's points. The sensors are the same where
    too few points can have been read to tell how they lie, or none lie closer.
    """
    before, after = np.empty(len(points.w)), np.empty(len(points.w))
    known = sensor.log_weights(points.x, sensor.guides) if sensor.guides else np.zeros(len(points.w))
    could = np.isfinite(normalise(prior_times(points.w, known), before))
    if not could or not np.isfinite(normalise(prior_times(points.w, log_l), after)):
        return sensor
    n, carriers = points.x.shape[1], min(effective(before), effective(after))
    if carriers <= n + 1:
        return sensor
    (mean, cov), (moved, narrower) = moments(points.x, before), moments(points.x, after)
    try:
        white = np.linalg.inv(np.linalg.cholesky(cov))
    except np.linalg.LinAlgError:
        return sensor
    s, V = np.linalg.eigh(white @ narrower @ white.T)
    s = np.maximum(s, _NARROWEST)
    # mean and covariance of few points are off themselves: by 1 / carriers and (n + 1) / carriers of it
    s = s * (1.0 + (n + 2) / carriers)
    rows = (V.T @ white)[s < ALIKE]
    s = s[s < ALIKE]
    # of unit noise, √(1/s - 1) e leaves variance s along e, and moves the mean by 1 - s of what it reads
    gain = np.sqrt(1.0 / s - 1.0)
    z = gain * (rows @ mean + rows @ (moved - mean) / (1.0 - s))
    return sensor.with_pilot(np.ascontiguousarray(gain[:, None] * rows), z) if len(s) else sensor
