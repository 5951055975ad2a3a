"""How many particles a prediction needs: ``n_particles="auto"``."""

import math
from collections.abc import Callable
from dataclasses import replace

from .._types import Interval
from ..config import FilterConfig
from ..density.particle_density import ParticleDensity
from ..errors import ModelError, PropagationError
from ..info import Code, PredictInfo
from ..lattice.level_set import fewest_particles
from ..model.sde import SDE
from .again import MOST, Outcome
from .predict import predict

__all__ = ["fewest", "predict_to_target"]

#: Error of the posterior mean, in standard deviations, over the probability that the lattices of a prediction
#: lose or gain: 1 to 6 on the Van der Pol and Duffing oscillators at 100 to 800 particles.
_ERROR_PER_MASS = 4.0
_ORDER = 1.5  # the error falls about as N^-1.5
_SLACK = 4.0  # below the target by so much, fewer particles are tried next time
_TRIES = 4
_HELPED = 0.8  # times the loss, which more particles have to bring it below


def fewest(dim: int, n_particles: object) -> int:
    """Number of particles that "auto" begins with and never goes below."""
    if n_particles != "auto":
        raise ModelError(f'n_particles must be a whole number or "auto", got {n_particles!r}')
    return max(60, 3 * fewest_particles(dim))


def predict_to_target(
    density: ParticleDensity,
    model: SDE,
    dt: Interval | None,
    config: FilterConfig,
    *,
    t: float | None,
    n_particles: int,
    fits: Callable[[int], bool] | None = None,
) -> Outcome[PredictInfo]:
    """Predict, again with more particles where the error seen is above the target.

    Parameters
    ----------
    density : ParticleDensity
    model : SDE
    dt, t : float or None
        Interval, or absolute time to predict to, seconds.
    config : FilterConfig
    n_particles : int
        Of the first try.
    fits : callable, optional
        fits(n_particles) says whether there is time for one more prediction on so many.

    Returns
    -------
    Outcome
    """
    best: Outcome[PredictInfo] | None = None
    ratio = math.inf
    for _ in range(_TRIES):
        try:
            moved, info = predict(density, model, dt, config, t=t, n_particles=n_particles, goes_on=False)
        except PropagationError:
            if best is None:
                raise
            break
        if info.scheme != "log_density":
            return Outcome(density, moved, info, n_particles)
        alike = best is not None and best.info.code == info.code == Code.OK
        if best is not None and alike and info.mass_error > _HELPED * best.info.mass_error:
            break  # the density itself is coarse, not what it becomes
        best = Outcome(density, moved, info, n_particles)
        ratio = _ERROR_PER_MASS * info.mass_error / config.target_error
        if ratio <= 1.0 or n_particles >= MOST:
            break
        more = min(math.ceil(n_particles * min(max(ratio ** (1.0 / _ORDER), 1.2), 3.0)), MOST)
        if fits is not None and not fits(more):
            late = f"the prediction on {more} particles that the target asks for: no time for it"
            best = best._replace(info=replace(info, skipped=(*info.skipped, late)))
            break
        n_particles = more
    assert best is not None  # the first try raises or is one
    if ratio < 1.0 / _SLACK:
        return best._replace(bound=max(fewest(model.dim, "auto"), int(0.8 * best.bound)))
    return best
