"""How many particles a prediction needs: ``n_particles="auto"``."""

import math

from .errors import ModelError
from .level_set import fewest_particles
from .predict import predict

__all__ = ["fewest", "predict_adapting"]

#: Error of the posterior mean, in standard deviations, over the probability that the lattices of a prediction
#: lose or gain: 1 to 6 on the Van der Pol and Duffing oscillators at 100 to 800 particles.
_ERROR_PER_MASS = 4.0
_MOST = 20_000
_ORDER = 1.5  # the error falls about as N^-1.5
_SLACK = 4.0  # below the target by so much, fewer particles are tried next time
_TRIES = 4


def fewest(dim, n_particles):
    """Number of particles that "auto" begins with and never goes below."""
    if n_particles != "auto":
        raise ModelError(f'n_particles must be a whole number or "auto", got {n_particles!r}')
    return max(60, 3 * fewest_particles(dim))


def predict_adapting(density, model, dt, config, *, t, n_particles):
    """Predict, again with more particles where the error seen is above the target.

    Returns
    -------
    ParticleDensity, PredictInfo, int
        The number is the bound for the next lattice.
    """
    for attempt in range(_TRIES):
        moved, info = predict(density, model, dt, config, t=t, n_particles=n_particles)
        if info.scheme != "log_density":
            return moved, info, n_particles
        ratio = _ERROR_PER_MASS * info.mass_error / config.target_error
        if ratio <= 1.0 or n_particles >= _MOST:
            break
        if attempt < _TRIES - 1:
            more = n_particles * min(max(ratio ** (1.0 / _ORDER), 1.2), 3.0)
            n_particles = min(math.ceil(more), _MOST)
    if ratio < 1.0 / _SLACK:
        n_particles = max(fewest(model.dim, "auto"), int(0.8 * n_particles))
    return moved, info, n_particles
