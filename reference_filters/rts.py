"""Exact smoothing of linear models: Rauch, Tung and Striebel (1965)."""

import numpy as np

from .kalman import KalmanFilter


def smooth_linear(model, measurement, start, times, measurements, sensors=None):
    """Smooth with the Kalman filter's results.

    Parameters
    ----------
    model : SDE
        Linear.
    measurement : GaussianMeasurement
        With a matrix.
    start : tuple
        (x0, P0) or (x0, P0, t0).
    times : array_like, shape (T,)
        Not decreasing, seconds.
    measurements : sequence of length T
        None or NaN where none came.
    sensors : sequence of length T, optional
        The sensor of each measurement, if they are of several.

    Returns
    -------
    x : ndarray, shape (T, n)
    P : ndarray, shape (T, n, n)
    log_evidence : float
    """
    filt = KalmanFilter(model, measurement, *start)
    prior, posterior, steps = [], [], []
    for k, (t, z) in enumerate(zip(times, measurements, strict=True)):
        steps.append(t - filt.t)
        if t > filt.t:
            filt.predict(t=t)
        prior.append((filt.x, filt.P))
        filt.update(z, None if sensors is None else sensors[k])
        posterior.append((filt.x, filt.P))
    smoothed = [posterior[-1]]
    for k in range(len(steps) - 2, -1, -1):
        (x, P), (x_next, P_next), (ahead, spread) = posterior[k], smoothed[-1], prior[k + 1]
        Phi, _, _ = filt.model.to_linear().discretize(steps[k + 1])
        gain = np.linalg.solve(spread, Phi @ P).T
        smoothed.append((x + gain @ (x_next - ahead), P + gain @ (P_next - spread) @ gain.T))
    x, P = (np.array(part) for part in zip(*smoothed[::-1], strict=True))
    return x, P, filt.log_evidence
