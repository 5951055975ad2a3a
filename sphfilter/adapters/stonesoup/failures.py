"""What stands for a density that could not be carried, so that a tracker goes on."""

from collections.abc import Sequence
from typing import Any, Literal, TypeAlias

import numpy as np

from ..._types import Floats
from ...density.distributions import Gaussian
from ...density.moments import moments, moments_of_sum
from ...density.particle_density import ParticleDensity
from ...errors import ModelError, PropagationError
from ...filter.reading_at_prior import predicted_reading
from ...info import Code
from ...model.discrete import DiscreteModel
from ...model.measurements import Sensor, is_gaussian

OnFailure: TypeAlias = Literal["gaussian", "drop", "raise"]
ON_FAILURE = "gaussian", "drop", "raise"
#: Of moments, relative: 1e-4 = 1e-6 / .01 of the error that a filter aims at; linearising adds far more.
_TOLERANCE = 1e-6


def said(problem: PropagationError, what: str) -> dict[str, Any]:
    """Status and code of an info whose step ended in a problem."""
    return {"status": f"{what}: {problem}", "code": Code.FALLBACK}


def linearised(density: ParticleDensity, model: Any, dt: float) -> Gaussian:
    """The Gaussian that the model, linearised along its mean, makes of a density, as an extended Kalman
    filter predicts: dm/dt = f(m), dP/dt = F P + P F' + 2 D(m). Refused if that is infinite, or no Gaussian.
    """
    if isinstance(model, DiscreteModel):
        m, P = density.mean(), density.cov()
        for t in model.starts(density.t, density.t + dt):
            F, G = np.split(model.jacobian(m, t)[0], [model.dim], axis=1)
            m = model.transition(m, t)[0]
            P = F @ P @ F.T + G @ model.covariance @ G.T
        return _gaussian(m, P)
    from scipy.integrate import solve_ivp  # on use: import time

    n = density.dim

    def rate(t: float, moments: Floats) -> Floats:
        m, P = moments[:n], moments[n:].reshape(n, n)
        FP = model.jacobian(m, t) @ P
        return np.concatenate(
            [model.drift(m[None], t)[0], (FP + FP.T + 2.0 * model.diffusion(m[None], t)[0]).ravel()]
        )

    start = np.concatenate([density.mean(), density.cov().ravel()])
    with np.errstate(all="ignore"):
        found = solve_ivp(rate, (density.t, density.t + dt), start, rtol=_TOLERANCE, atol=0.0)
    if not found.success:
        raise ModelError(f"the moments could not be carried either: {found.message}")
    return _gaussian(found.y[:n, -1], found.y[n:, -1].reshape(n, n))


def multiplied(density: ParticleDensity, sensor: Sensor, z: Floats) -> Gaussian:
    """The Gaussian that a reading makes of a density, by the covariance of the two.

    With a Gaussian sensor as an unscented Kalman filter does it, with the density's particles as its points;
    with another one the moments of the particles, weighted by likelihood. Refused if too few are likely.
    """
    mean, cov = density.mean(), density.cov()
    if is_gaussian(sensor):
        reading, S, cross = predicted_reading(density, sensor)
        gain = np.linalg.solve(S + sensor.noise_cov, cross.T).T
        return _gaussian(mean + gain @ sensor.residual(z, reading), cov - gain @ cross.T)
    log_w = sensor.log_likelihood(z, density.x, density.t) + np.log(density.mass)
    highest = log_w.max(initial=-np.inf)
    if not np.isfinite(highest):
        raise ModelError("the likelihood is zero at all particles")
    w = np.exp(log_w - highest)
    return _gaussian(*moments(density.x, w / w.sum()))


def merged(parts: Sequence[tuple[float, Gaussian]]) -> Gaussian:
    """The Gaussian with the mean and covariance of a mixture of weights and Gaussians."""
    w, means, covs = (np.array(part) for part in zip(*((w, p.mean, p.cov) for w, p in parts), strict=True))
    return _gaussian(*moments_of_sum(w / w.sum(), means, covs))


def _gaussian(mean: Floats, cov: Floats) -> Gaussian:
    return Gaussian(mean, 0.5 * (cov + cov.T))
