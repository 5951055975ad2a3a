"""A prediction repeated, finer and further, where a measurement finds the state in what it lost."""

from dataclasses import dataclass, replace

from ..config import LogDensityScheme
from ..errors import PropagationError
from ..lattice.level_set import lattice_reach
from ..prediction.again import _FURTHER, _MOST, _always
from ..prediction.automatic import FINEST
from ..prediction.predict import predict
from .update import update

__all__ = ["Update", "update_or_predict_again"]

#: Probability of a posterior that hangs on what the prediction lost, from which the prediction is repeated.
_GUESSED = 0.01
_DEEPER = 0.7  # standard deviations that the lattices reach further then, each time


@dataclass(frozen=True)
class Update:
    """The last update of a filter."""

    before: object  # the prior
    measurement: object
    z: object

    def repeated(self, config, n_particles):
        """The posterior on another number of particles."""
        return update(self.before, self.measurement, self.z, config, n_particles=n_particles)[0]


def update_or_predict_again(prediction, prior, model, measurement, z, config, n_particles, fits=_always):
    """Update; if the posterior hangs on what the prediction lost, predict again, finer and further.

    A prediction cuts off what lies below a level of the density, and loses some of what is near. There a
    measurement may find the state.

    Parameters
    ----------
    prediction : Prediction
        What led to the prior.
    fits : callable
        fits(n_particles) says whether there is time for one more prediction on so many.

    Returns
    -------
    ParticleDensity, ParticleDensity, UpdateInfo
        The prior that was used, the posterior, and what was done.
    """
    from scipy.stats import chi2  # on use: import time

    before, lost = prediction.before, prediction.lost
    posterior, info = update(prior, measurement, z, config, n_particles=n_particles)
    known = before is None or before.field is None or prior.field is None or prior.gaussian
    if known or info.extrapolated < _GUESSED:
        return prior, posterior, info
    scheme = config.scheme if isinstance(config.scheme, LogDensityScheme) else LogDensityScheme()
    Z = lattice_reach(scheme, model.dim)
    beyond = chi2.sf(Z**2, model.dim)  # what a Gaussian has there: so much of it may be wrong
    for level, times in enumerate(_FURTHER, start=1):
        times = min(times, FINEST**model.dim)
        sure = info.extrapolated * min(1.0, lost / beyond) < _GUESSED
        if sure or not info.accepted or times * n_particles > _MOST:
            break
        if not fits(times * n_particles):
            late = f"no time to repeat the prediction on {times} times the particles"
            done = "" if info.status == "ok" else f"{info.status}; "
            info = replace(info, status=f"{done}{late}")
            break
        further = replace(config, scheme=replace(scheme, reach=Z + level * _DEEPER))
        try:
            prior, predicted = predict(
                before, model, t=prior.t, config=further, n_particles=times * n_particles
            )
        except PropagationError:
            continue  # on still more particles, perhaps
        lost = predicted.mass_error
        posterior, info = update(prior, measurement, z, config, n_particles=n_particles)
        info = replace(info, status=f"prediction repeated on {times} times the particles")
    return prior, posterior, info
