"""How many particles a prediction needs: ``n_particles="auto"``, and what the next measurement tells."""

import math
from dataclasses import dataclass, replace

from ..errors import LatticeError, ModelError, PropagationError, UnresolvedError
from ..lattice.level_set import fewest_particles
from .predict import predict

__all__ = ["Prediction", "fewest", "predict_from_finer", "predict_to_target"]

#: Error of the posterior mean, in standard deviations, over the probability that the lattices of a prediction
#: lose or gain: 1 to 6 on the Van der Pol and Duffing oscillators at 100 to 800 particles.
_ERROR_PER_MASS = 4.0
_MOST = 20_000
_ORDER = 1.5  # the error falls about as N^-1.5
_SLACK = 4.0  # below the target by so much, fewer particles are tried next time
_TRIES = 4
_HELPED = 0.8  # times the loss, which more particles have to bring it below
_FURTHER = 3, 9  # times the particles then


@dataclass(frozen=True)
class Prediction:
    """The last prediction of a filter."""

    before: object = None  # the density it began with; None if there was none
    lost: float = 0.0  # probability that the lattices lost
    model: object = None
    t: float = 0.0  # seconds, where it ended

    def repeated(self, config, n_particles):
        """The density it ended with on another number of particles."""
        return predict(self.before, self.model, t=self.t, config=config, n_particles=n_particles)[0]


def fewest(dim, n_particles):
    """Number of particles that "auto" begins with and never goes below."""
    if n_particles != "auto":
        raise ModelError(f'n_particles must be a whole number or "auto", got {n_particles!r}')
    return max(60, 3 * fewest_particles(dim))


def _always(n_particles):
    return True


def predict_to_target(density, model, dt, config, *, t, n_particles, fits=_always):
    """Predict, again with more particles where the error seen is above the target.

    Parameters
    ----------
    fits : callable
        fits(n_particles) says whether there is time for one more prediction on so many.

    Returns
    -------
    ParticleDensity, PredictInfo, int
        The number is the bound for the next lattice.
    """
    best, ratio = None, math.inf
    for _ in range(_TRIES):
        try:
            moved, info = predict(density, model, dt, config, t=t, n_particles=n_particles)
        except PropagationError:
            if best is None:
                raise
            break
        if info.scheme != "log_density":
            return moved, info, n_particles
        alike = best is not None and best[1].status == info.status == "ok"
        if alike and info.mass_error > _HELPED * best[1].mass_error:
            break  # the density itself is coarse, not what it becomes
        best = moved, info, n_particles
        ratio = _ERROR_PER_MASS * info.mass_error / config.target_error
        if ratio <= 1.0 or n_particles >= _MOST:
            break
        more = min(math.ceil(n_particles * min(max(ratio ** (1.0 / _ORDER), 1.2), 3.0)), _MOST)
        if not fits(more):
            late = f"the prediction on {more} particles that the target asks for: no time for it"
            best = moved, replace(info, skipped=(*info.skipped, late)), n_particles
            break
        n_particles = more
    moved, info, n_particles = best
    if ratio < 1.0 / _SLACK:
        n_particles = max(fewest(model.dim, "auto"), int(0.8 * n_particles))
    return moved, info, n_particles


def predict_from_finer(predicted, model, density, origin, config, n_particles):
    """Predict; if the density is too coarse for that, repeat what led to it on more particles.

    Parameters
    ----------
    predicted : callable
        A density to what `predict_to_target` returns.
    density : ParticleDensity
    origin : Update, Prediction or None
        Where it comes from.

    Returns
    -------
    ParticleDensity, tuple
        The density that was predicted, and what `predicted` returned.
    """
    try:
        return density, predicted(density)
    except (LatticeError, UnresolvedError):
        noisy = model.diffusion_rows.any()  # else nothing ever smooths what is too coarse
        if origin is None or origin.before is None or origin.before.field is None or not noisy:
            raise
        for times in _FURTHER:
            if times * n_particles > _MOST:
                break
            try:
                finer = origin.repeated(config, times * n_particles)
                moved, info, bound = predicted(finer)
                what = type(origin).__name__.lower()
                status = f"the {what} before repeated on {times} times the particles"
                return finer, (moved, replace(info, status=status), bound)
            except PropagationError:
                continue
        raise
