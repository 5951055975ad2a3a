"""A prediction repeated, finer and further, where a measurement finds the state in what it lost."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal, NamedTuple

from numpy.typing import ArrayLike

from ..config import FilterConfig, LogDensityScheme
from ..density.needs import MOST_POINTS
from ..density.particle_density import ParticleDensity
from ..density.resample import particle_bound, target_of
from ..errors import PropagationError
from ..info import Code, UpdateInfo
from ..lattice.level_set import lattice_reach
from ..model.measurements import Sensor
from ..model.sde import SDE
from ..prediction.again import Ladder, Outcome
from ..prediction.predict import Prediction, predict
from .by_ladder import over_allowance
from .update import update

__all__ = ["Update", "update_or_predict_again"]

#: Probability of a posterior that hangs on what the prediction lost, from which the prediction is repeated.
_GUESSED = 0.01
_LADDER = Ladder(deeper=0.7)
_TOO_FEW = 1.5  # times the points that a cloud has, from which it is drawn again
_TRIES = 3  # where so few are left that how many it takes is a guess


class Update(NamedTuple):
    """The last update of a filter: where its density comes from."""

    before: ParticleDensity  # the prior
    measurement: Sensor
    z: ArrayLike | None
    own: bool = True  # the filter's own sensor

    def repeated(self, config: Any, n_particles: int) -> ParticleDensity:
        """The posterior on another number of particles."""
        return update(self.before, self.measurement, self.z, config, n_particles=n_particles)[0]


def update_or_predict_again(
    prediction: Prediction,
    prior: ParticleDensity,
    model: SDE,
    measurement: Sensor,
    z: ArrayLike | None,
    config: FilterConfig,
    n_particles: int | Literal["auto"],
    fits: Callable[[int], bool] | None = None,
) -> Outcome[UpdateInfo]:
    """Update; if the posterior hangs on what the prediction lost, predict again, finer and further.

    A prediction cuts off what lies below a level of the density, and loses some of what is near. There a
    measurement may find the state. Of a cloud it may leave too few points for the target error.

    Parameters
    ----------
    prediction : Prediction
        What led to the prior.
    prior : ParticleDensity
    model : SDE
    measurement : GaussianMeasurement or LikelihoodMeasurement
    z : array_like, shape (k,), or None
    config : FilterConfig
    n_particles : int or "auto"
        Upper bound of the posterior's.
    fits : callable, optional
        fits(n_particles) says whether there is time for one more prediction on so many.

    Returns
    -------
    Outcome
        It begins with the prior that was used.
    """
    before, lost = prediction.before, prediction.lost
    posterior, info = update(prior, measurement, z, config, n_particles=n_particles)
    bound = particle_bound(prior, n_particles)
    if prior.read_out == "cloud":
        once = prior, posterior, info
        return Outcome(*_on_more_points(prediction, once, model, measurement, z, config), bound)
    known = prior.field is None or prior.gaussian or info.extrapolated < _GUESSED
    if known or before is None or before.field is None:
        return Outcome(prior, posterior, info, bound)
    from scipy.stats import chi2  # on use: import time

    scheme = config.scheme if isinstance(config.scheme, LogDensityScheme) else LogDensityScheme()
    Z = lattice_reach(scheme, model.dim)
    beyond = chi2.sf(Z**2, model.dim)  # what a Gaussian has there: so much of it may be wrong
    for rung in _LADDER.within(model.dim).rungs(bound):
        if info.extrapolated * min(1.0, lost / beyond) < _GUESSED or not info.accepted:
            break
        if fits is not None and not fits(rung.n_particles):
            late = f"no time to repeat the prediction on {rung.times} times the particles"
            info = info.marked(Code.LATE, late if info.code == Code.OK else f"{info.status}; {late}")
            break
        further = replace(config, scheme=replace(scheme, reach=Z + rung.deeper))
        try:
            prior, predicted = predict(before, model, t=prior.t, config=further, n_particles=rung.n_particles)
        except PropagationError:
            continue  # on still more particles, perhaps
        lost = predicted.mass_error
        posterior, info = update(prior, measurement, z, config, n_particles=n_particles)
        info = info.marked(Code.REPEATED, f"prediction repeated on {rung.times} times the particles")
    return Outcome(prior, posterior, info, bound)


def _on_more_points(
    prediction: Prediction,
    once: tuple[ParticleDensity, ParticleDensity, UpdateInfo],
    model: SDE,
    measurement: Sensor,
    z: ArrayLike | None,
    config: FilterConfig,
) -> tuple[ParticleDensity, ParticleDensity, UpdateInfo]:
    """Predict and update again on as many points as a target error asks for, where a reading left too few.

    What is lost there the points of later steps do not bring back.
    """
    prior, posterior, _ = once
    target, before, needs = target_of(prior, config, None), prediction.before, prior.needs
    if target is None or before is None or before.needs is None or needs is None or config.time_budget:
        return once
    waits = max(before.needs.waits, 1)  # no family did
    for _ in range(_TRIES):
        over = over_allowance(prior, posterior, target) if posterior.read_out == "cloud" else 0.0
        points = min(math.ceil(over * prior.n_particles), MOST_POINTS)
        if points < _TOO_FEW * prior.n_particles:
            break
        more = before.noted(needs=before.needs._replace(points=points, waits=waits))
        moved, _ = predict(more, model, t=prior.t, config=config, n_particles="auto", goes_on=False)
        prior = moved.noted(needs=needs._replace(points=points))
        posterior, info = update(prior, measurement, z, config, n_particles="auto")
        once = prior, posterior, info
    return once
