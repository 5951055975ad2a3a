"""The start of a simulated run: where the truth is, and what the filters are told about it."""

from functools import cache

import numpy as np
from scipy.stats import chi2

from reference_filters.closed_forms import BenesFilter
from sphfilter.consistency import nees
from sphfilter.errors import ConfigError
from sphfilter.model.simulate import simulate

#: Part of the true initial errors that the accepted ellipsoid holds, if the start is consistent (002 6.6).
_ACCEPTED = 0.999
_MAX_REDRAWS = 1000


def gaussian(model, measurement, start, t0, times, rng, inputs=None):
    """Draw the truth from N(mean, cov), which is what the filters start from.

    `inputs` (T, m) are held over the intervals that end at the times. Returns truth (T, n), z (T, k), x0 (n,)
    and P0 (n, n).
    """
    x0, P0 = np.array(start.mean), np.array(start.cov)
    first, held = rng.multivariate_normal(x0, P0), _from_before(model, inputs, 1)
    truth, z = simulate(model, measurement, first, [t0, *times], rng, inputs=held)
    return truth[1:], z[1:], x0, P0


def benes(model, measurement, start, t0, times, rng, inputs=None):
    """Draw the truth from the two Gaussians of a Beneš density; x0 and P0 are its moments."""
    filt = BenesFilter(measurement, start.mean[0], start.cov[0][0])
    weights, means, var = filt.components()
    x = rng.normal(rng.choice(means, p=weights), np.sqrt(var), size=1)
    held = _from_before(model, inputs, 1)
    truth, z = simulate(model, measurement, x, [t0, *times], rng, inputs=held)
    return truth[1:], z[1:], filt.x, filt.P


def two_point(model, measurement, start, t0, times, rng, inputs=None):
    """Burn the truth in and start the filters by two-point differencing (002 6.6, Bar-Shalom et al. §5.5).

    A start is drawn again, burn-in and all, unless its true error lies inside the 99.9 % ellipsoid of P0.
    """
    _check_pairs(measurement, start)
    path = np.concatenate([[t0 - start.burn_in, t0 - start.interval, t0], times])
    held = _from_before(model, inputs, 3)
    for _ in range(_MAX_REDRAWS):
        first = rng.multivariate_normal(np.array(start.mean), np.array(start.cov))
        truth, z = simulate(model, measurement, first, path, rng, inputs=held)
        x0, P0 = two_point_estimate(model, measurement, start, z[1], z[2])
        if nees(truth[2], x0, P0) <= chi2.ppf(_ACCEPTED, model.dim):
            return truth[3:], z[3:], x0, P0
    raise ConfigError(f"no start in {_MAX_REDRAWS} was consistent; is start.interval too long?")


def two_point_estimate(model, measurement, start, z_before, z_now):
    """Mean (n,), covariance (n, n) of (position, velocity) pairs of two measurements `start.interval` apart.

    x̂ = z₀, v̂ = (z₀ − z₋₁)/T₀; P = [[R, R/T₀], [R/T₀, 2R/T₀² + Q T₀/3 + (a T₀/2)²]]. The last two terms are
    not in the textbook: v̂ is the mean velocity of the interval and lags by the noise and by half an interval
    of the model's acceleration, whose root mean square is a.
    """
    T0, R = start.interval, measurement.noise_cov
    intensity = 2.0 * np.diag(model.diffusion(np.zeros((1, model.dim)), 0.0)[0])
    a = acceleration_rms(model, start)
    x0, P0 = np.zeros(model.dim), np.zeros((model.dim, model.dim))
    for j, (position, velocity) in enumerate(start.pairs):
        x0[position], x0[velocity] = z_now[j], (z_now[j] - z_before[j]) / T0
        lag = intensity[velocity] * T0 / 3 + (a[velocity] * T0 / 2) ** 2
        P0[position, position] = R[j, j]
        P0[position, velocity] = P0[velocity, position] = R[j, j] / T0
        P0[velocity, velocity] = 2 * R[j, j] / T0**2 + lag
    return x0, P0


@cache
def acceleration_rms(model, start):
    """Root mean square of each component of the drift once the truth is burnt in, shape (n,).

    A property of the scenario, so always from the same 400 paths.
    """
    rng = np.random.default_rng(0)
    first = rng.multivariate_normal(np.array(start.mean), np.array(start.cov), size=400)
    truth, _ = simulate(model, None, first, [0.0, start.burn_in], rng)
    return np.sqrt(np.mean(model.drift(truth[:, -1], start.burn_in) ** 2, axis=0))


def _from_before(model, inputs, count):
    """Inputs with rows for `count` times before theirs, at which they are what the model says."""
    return None if inputs is None else np.vstack([*count * [[*model.inputs.values()]], inputs])


def _check_pairs(measurement, start):
    observed = measurement.directly_observed
    positions = [position for position, _ in start.pairs]
    h = "a function" if measurement.H is None else measurement.H.tolist()
    if observed is None or list(observed[0]) != positions or np.any(observed[1] != 1.0):
        raise ConfigError(
            f"two-point differencing needs a sensor that reads the positions {positions} of start.pairs, "
            f"one a component and unscaled, with uncorrelated noise; h is {h}"
        )
