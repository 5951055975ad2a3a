"""Predictions repeated: finer and further where a reading finds the state in what one lost, on more points
where it finds too few, together with what was read since.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..config import FilterConfig, LogDensityScheme
from ..core.cloud.bridge import MORE as PIECES
from ..core.cloud.control import points_for
from ..core.limits import EDGE, LARGEST_EXPONENT, LOOK, SAID, WRONG
from ..core.step_control import HELPED, TRIES
from ..density.as_family import may_miss
from ..density.left_out import LeftOut, lacking
from ..density.memory import MISSED, Memory
from ..density.particle_density import ParticleDensity
from ..density.passage import age_of, stored_key
from ..density.points import CloudState
from ..density.resample import max_particles_of, target_of
from ..errors import ModelError, PropagationError
from ..info import NOTHING_CAME, Code, UpdateInfo
from ..lattice.level_set import lattice_reach
from ..model.dynamics import Dynamics
from ..model.measurements import Reading, Sensor
from ..model.sde import SDE
from ..model.sensors import Sensors
from ..prediction.again import Ladder, Outcome
from ..prediction.predict import Prediction, predict
from .by_cloud import error_added
from .stacked import Stacked
from .update import told_of, update

_LADDER = Ladder(deeper=0.7)
#: Evaluations of a model by the points of one try, at most: a dozen seconds, at 2·10⁷ a second as compiled
#: noise of four states was measured (`experiments stress --random-case 65537:36`: 30 to 80 s without).
_MOST_EVALUATIONS = 2**28

#: Prior, posterior, and what the update says.
Read = tuple[ParticleDensity, ParticleDensity, UpdateInfo]


class Update(NamedTuple):
    """The last update of a filter: where its density comes from."""

    before: ParticleDensity  # the prior
    measurement: Sensor
    z: ArrayLike | None
    own: bool = True  # the filter's own sensor
    prediction: Prediction = Prediction()  # and what was read since, this too

    @classmethod
    def after(
        cls, origin: Any, before: ParticleDensity, sensor: Sensor, z: Any, info: UpdateInfo, own: bool = True
    ) -> "Update":
        """An update of a density of this origin: a `Prediction`, an `Update` or none."""
        known = prediction_of(origin)
        if info.reason != NOTHING_CAME:
            prior = before if known.prior is None else known.prior
            readings, log_evidence = (*known.readings, (sensor, z)), known.log_evidence + info.log_evidence
            known = known._replace(readings=readings, prior=prior, log_evidence=log_evidence)
        return cls(before, sensor, z, own, known)

    def repeated(self, config: Any, n_particles: int) -> ParticleDensity:
        """The posterior on another number of particles."""
        return update(self.before, self.measurement, self.z, config, n_particles=n_particles)[0]


def prediction_of(origin: Any) -> Prediction:
    """The prediction that led to a density of this origin, with the readings since."""
    if isinstance(origin, Update):
        return origin.prediction
    return origin if isinstance(origin, Prediction) else Prediction()


def update_or_predict_again(
    prediction: Prediction,
    prior: ParticleDensity,
    model: Dynamics,
    measurement: Sensor,
    z: ArrayLike | None,
    config: FilterConfig,
    n_particles: int | Literal["auto"],
    fits: Callable[[int], bool] | None = None,
) -> Outcome[UpdateInfo]:
    """Update; if the posterior hangs on what the prediction lost, or on too few points, predict again.

    A prediction cuts off what lies below a level of the density, and loses some of what is near. There a
    measurement z (k,) may find the state. `prediction` is what led to the prior, with readings of the same
    time before this one; `n_particles` bounds the posterior's, and fits(n_particles) says whether there is
    time for one more prediction on so many. The `Outcome` begins with the prior that was used.
    """
    before, lost = prediction.before, prediction.lost
    posterior, info = update(prior, measurement, z, config, n_particles=n_particles)
    bound, asked = max_particles_of(prior, n_particles), _Asked(prediction, measurement, z, config)
    if posterior.form.own_points:
        return Outcome(*asked.on_more_points((prior, posterior, info)), bound)
    posterior, info = asked.used_together((posterior, info), n_particles)
    if before is not None and may_miss(prior):
        return Outcome(*asked.without_family((prior, posterior, info)), bound)
    known = prior.gaussian or info.extrapolated < SAID
    if known or prediction.readings or before is None or before.form.cell is None:
        return Outcome(prior, posterior, info, bound)
    from scipy.stats import chi2  # on use: import time

    scheme = config.scheme if isinstance(config.scheme, LogDensityScheme) else LogDensityScheme()
    Z = lattice_reach(scheme, model.dim)
    beyond = chi2.sf(Z**2, model.dim)  # what a Gaussian has there: so much of it may be wrong
    for rung in _LADDER.within(model.dim).rungs(bound):
        if info.extrapolated * min(1.0, lost / beyond) < SAID or not info.accepted:
            break
        if fits is not None and not fits(rung.n_particles):
            late = f"no time to repeat the prediction on {rung.times} times the particles"
            info = info.also(Code.LATE, late)
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


class _Asked(NamedTuple):
    """A reading, and the prediction before it, which both may be made again."""

    prediction: Prediction
    measurement: Sensor
    z: ArrayLike | None
    config: FilterConfig

    def used_together(
        self, once: tuple[ParticleDensity, UpdateInfo], n_particles: Any
    ) -> tuple[ParticleDensity, UpdateInfo]:
        """The posterior of all readings of one time at once, and what the last says; or as they were used.

        A lattice ends where little is left of a density by one reading. Of that the next may make much more.
        """
        (posterior, info), prior, before = once, self.prediction.prior, self.prediction.log_evidence
        ends = info.accepted and info.mass_left_out > 0.0  # of other densities nothing is left out
        readings: Any = (*self.prediction.readings, (self.measurement, self.z))
        few = len(readings) <= LOOK  # else each more costs more
        if prior is None or posterior.gaussian or prior.domain is not None or not (ends and few):
            return once
        if posterior.left_out is None:  # nodes of the prior know of nothing: points that are drawn may
            x, mass = prior.form.drawn(32 * LOOK, stored_key(age_of(prior), len(readings)))
            log_l = sum(sensor.log_likelihood(z, x, prior.t) for sensor, z in readings)
            log_l = log_l - before - info.log_evidence
            mass = mass * np.exp(np.minimum(log_l, LARGEST_EXPONENT))
            posterior = posterior.noted(left_out=LeftOut.of(posterior, x, mass, prior.logpdf(x) + log_l))
            once = posterior, told_of(info, lacking(posterior))
        far = lacking(posterior)
        if far.mean <= MISSED * self.config.target_error and far.variance <= 0.5 * WRONG:
            return once
        try:
            sensors = Sensors({str(k): sensor for k, (sensor, _) in enumerate(readings)})
            z = np.concatenate([Reading.of(numbers).z for _, numbers in readings])
            posterior, said = update(prior, sensors, z, self.config, n_particles=n_particles)
        except (ModelError, PropagationError):
            return once
        if said.flagged and not once[1].flagged:
            return once
        own: Any = {name: getattr(info, name) for name in ("innovation", "innovation_cov", "reason")}
        return posterior, replace(said, log_evidence=said.log_evidence - before, **own)

    def without_family(self, once: Read) -> Read:
        """Both again as something else, where a reading makes too much of a family's error."""
        (prior, _, info), before = once, self.prediction.before
        assert before is not None
        target, known = target_of(prior, self.config, None), before.needs
        if target is None or known is None or self.config.time_budget or not info.error > MISSED * target:
            return once
        try:
            again = self.again(before.noted(needs=known._replace(waits=max(known.waits, 1))))
        except PropagationError:
            return once
        return again if again[2].error < info.error else once

    def again(self, start: ParticleDensity, target: float | None = None) -> Read:
        """Predict from a start, to another target if one is given, and update by all readings of the time."""
        config, prediction = self.config, self.prediction
        finer = config if target is None else replace(config, target_error=target)
        if prediction.before is None:  # what was read before is in the prior, and nothing leads to that
            return start, *update(start, self.measurement, self.z, config, n_particles="auto")
        prior, log_evidence = prediction.from_density(start, finer, "auto"), 0.0
        first = prior if prediction.readings else None
        for sensor, numbers in prediction.readings:
            prior, info = update(prior, sensor, numbers, config, n_particles="auto")
            log_evidence += info.log_evidence
        asked = self._replace(prediction=prediction._replace(prior=first, log_evidence=log_evidence))
        once = update(prior, self.measurement, self.z, config, n_particles="auto")
        return prior, *asked.used_together(once, "auto")

    def on_more_points(self, once: Read) -> Read:
        """Both again where a reading finds too few points, or points that know no way to be led.

        Readings of the same time are used once more; without a prediction, the prior itself is drawn anew.
        """
        (prior, posterior, info), best, before = once, once, self.prediction.before
        start, finer = prior if before is None else before, True
        target, known, budget = target_of(prior, self.config, None), start.needs, self.config.time_budget
        as_it_was = bool(prior.form.own_points)
        in_vain = start.error > EDGE or (before is None and as_it_was)  # it lies elsewhere, or is all of it
        if target is None or known is None or budget or in_vain or info.reason == NOTHING_CAME:
            return once
        for tries in range(TRIES):
            cloud = posterior.cloud
            assert cloud is not None
            led = before is None or as_it_was
            error = _deciding(posterior, info, target, 0.0 if led else cloud.inherited.error)
            if error > MISSED * target:
                error = _added(self.prediction, prior, posterior, error, target)
            more = points_for(cloud.size, error, target, prior.dim) if error > MISSED * target else 0
            if more <= cloud.size and (tries > 0 or led):
                break
            if _evaluations(self.prediction, cloud) * more > _MOST_EVALUATIONS:
                break
            wanted = known._replace(points=more or known.points, waits=max(known.waits, 1))
            try:
                asked = target * target / error if more and led and finer and error < EDGE else target
                start = start.noted(needs=wanted)
                prior, posterior, info = self.again(start, asked)
            except PropagationError:  # what there is already is better than none
                break
            grown, better = bool(posterior.form.own_points), info.error < best[2].error
            # for so much less, a lattice was taken for cheaper
            if not grown and not better and asked < target:
                (prior, posterior, info), finer = best, False
                continue
            helped = _deciding(posterior, info, target) < HELPED * _deciding(*best[1:], target)
            if (more and grown) or better:  # more points know better what they do not know
                best = prior, posterior, info
            if not helped or not grown:  # what is wrong was wrong before, and no points here cure it
                break
        return best if best is once else _remembering(best, once, known, target)


def _evaluations(prediction: Prediction, cloud: CloudState) -> float:
    """Evaluations of drifts and noises that predictions of a point take, if it is led piece by piece."""
    total, t = 0.0, math.nan if prediction.before is None else prediction.before.t
    for model, end in prediction.legs:
        if isinstance(model, SDE) and not model.linear and cloud.pace.step > 0.0:
            noises = len(model.spectral_density) if model.state_dependent_noise else 0
            total += 4 * (1 + noises) * (end - t) / cloud.pace.step  # Runge and Kutta's method, of each
        t = end
    return PIECES * total


def _remembering(best: Read, once: Read, known: Memory, target: float) -> Read:
    """The best of several tries, whose next cloud has as many points as before, or more if these helped."""
    prior, posterior, info = best
    cloud, needs = posterior.cloud, posterior.needs
    if cloud is None or needs is None:
        return best
    if _deciding(posterior, info, target) < HELPED * _deciding(*once[1:], target):
        told = cloud.told.decisive(target, prior.dim)
        known = known._replace(calm=max(known.calm, 0)).told(told, target, cloud.size, prior.dim)
    points = known.cloud(target, prior.dim)
    return prior, posterior.noted(needs=needs._replace(points=points, calm=known.calm)), info


def _added(
    prediction: Prediction, prior: ParticleDensity, posterior: ParticleDensity, error: float, target: float
) -> float:
    """The part of an error that prediction and reading have added: what was there before, no points cure."""
    before, cloud = prediction.before, posterior.cloud
    if before is None or before.cloud is None:
        return error
    assert cloud is not None and cloud.points.prior is not None
    seen = Stacked.of(cloud.points.prior.readings, prior.domain)
    points: Any = posterior.form.bare
    about = prediction.legs, before.t, seen, points.summed, target
    added = error_added(before.cloud, cloud, *about)
    return added if added < error else error


def _deciding(posterior: ParticleDensity, info: UpdateInfo, target: float, inherited: float = 0.0) -> float:
    """Error that decides whether a reading is made again on more points, in standard deviations.

    Without what was inherited of a density that will not be there again.
    """
    told = math.nan if posterior.cloud is None else posterior.cloud.told.decisive(target, posterior.dim)
    return max(math.sqrt(max(info.error**2 - inherited**2, 0.0)), told)
