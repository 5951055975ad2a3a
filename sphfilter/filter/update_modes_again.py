"""A prediction of all modes repeated, where a measurement hangs on what its steps or mergers lost."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..config import FilterConfig
from ..core.cloud.control import points_for
from ..core.limits import FAR
from ..core.step_control import HELPED, MORE, TRIES
from ..density.as_family import gaussians_of
from ..density.memory import MISSED
from ..density.modes import ModeDensities
from ..info import Code
from ..model.measurements import Sensor
from ..prediction.switching import (
    MOST_SUBSTEPS,
    ModesPrediction,
    goes_as_points,
    points_of_modes,
    predict_modes,
)
from .update_modes import ModesUpdateInfo, update_modes

#: Prior, posterior, and what the update says.
_Read = tuple[ModeDensities, ModeDensities, ModesUpdateInfo]

_COARSE = "steps of the jumps between modes leave {:.2g} of the posterior in doubt"
_LATE = "no time to repeat the prediction before, in more steps of the jumps or with fewer Gaussians merged"
_MERGED = "mergers of Gaussians leave {:.2g} nat of the log-evidence in doubt"
_IN_DOUBT = 0.05  # nats that mergers may change there; measured: half and twice change no run


def update_or_predict_modes_again(
    prediction: ModesPrediction | None,
    prior: ModeDensities,
    sensors: Mapping[str, Sensor],
    z: ArrayLike | None,
    config: FilterConfig,
    n_particles: int | str,
    fits: Callable[[float], bool] = lambda times: True,
) -> tuple[ModeDensities, ModeDensities, ModesUpdateInfo]:
    """Update; if the posterior hangs on what the prediction got wrong of the jumps, predict again.

    `prediction` is what led to the prior: None where nothing was predicted, or it cannot be made again;
    fits(times) says whether there is time for that, on so many times the points.
    Returns the prior that was used, the posterior, and what `update_modes` says. Raises `PropagationError` as
    that does, or if a prediction that was made again failed.
    """
    modes, info = update_modes(prior, sensors, z, config, n_particles)
    if modes is prior or prediction is None:
        return prior, modes, info
    far = _far(prediction, prior, modes, info)
    asked = _Asked(prediction, prior.heaviest.t, sensors, z, config, n_particles, fits)
    read = prior, modes, info
    if n_particles == "auto" and config.scheme == "auto" and goes_as_points(prior):
        read = asked.on_more_points(read)
    read, in_doubt, code = asked.finer(read, far)
    prior, modes, info = read
    info = info.also(code, _LATE) if Code.LATE in code else info.noted(code=info.code | code)
    if info.splitting_error > MISSED * config.target_error:
        info = info.also(Code.COARSE, _COARSE.format(info.splitting_error))
    if in_doubt > _IN_DOUBT:
        info = info.also(Code.COARSE, _MERGED.format(in_doubt))
    modes = modes.noted(unsure=modes.unsure + in_doubt**2)
    return prior, modes, replace(info, evidence_error=math.hypot(info.evidence_error, in_doubt))


class _Asked(NamedTuple):
    """A reading of all modes, and the prediction before it, which both may be made again."""

    prediction: ModesPrediction
    t: float  # to which that went
    sensors: Mapping[str, Sensor]
    z: ArrayLike | None
    config: FilterConfig
    n_particles: int | str
    fits: Callable[[float], bool]

    def finer(self, read: _Read, far: float) -> tuple[_Read, float, Code]:
        """Predict and update again in more steps, where these are in doubt, or with fewer Gaussians merged.

        `far` is as of `_far`. Returns what was read, nats of its evidence that are in doubt, and what was
        done.
        """
        target, steps, apart = self.config.target_error, self.prediction.n_substeps, max(far, 1.0)
        in_doubt, code = 0.0, Code.OK
        for _ in range(TRIES):
            off = read[2].splitting_error
            if not far and (off <= target or steps == MOST_SUBSTEPS):
                break
            if not self.fits(1.0):
                return read, in_doubt, code | Code.LATE
            # what steps get wrong falls as their square, or faster
            steps = min(math.ceil(steps * math.sqrt(max(off / target, MORE))), MOST_SUBSTEPS)
            before, reach, apart = read[2].log_evidence, max(math.sqrt(far) / FAR, 1.0), MORE * apart
            read = self.again(n_substeps=steps, apart=apart if far else 1.0, reach=reach)
            code = Code.REPEATED
            in_doubt = abs(read[2].log_evidence - before) if far else 0.0
            far = far if in_doubt > _IN_DOUBT else 0.0
        return read, in_doubt, code

    def again(self, points: int | None = None, **finer: Any) -> _Read:
        """Prediction and reading once more: on so many points in each mode, or by other options."""
        before = self.prediction.before if points is None else self.prediction.before.cut(points)
        settings = self.config, self.n_particles
        prior, _ = predict_modes(before, self.prediction.model, self.t, *settings, **finer)
        return prior, *update_modes(prior, self.sensors, self.z, *settings)

    def on_more_points(self, read: _Read) -> _Read:
        """Both again where a reading finds too few points: what was wrong before no points cure."""
        usual, target = read[1], self.config.target_error
        least = MISSED * max(target, self.prediction.before.error)
        for _ in range(TRIES):
            prior, modes, info = read
            points = points_of_modes(prior, target)
            more = points_for(points, modes.error, target, prior.heaviest.dim)
            if not modes.error > least or more <= points or not self.fits(more / points):
                break
            other = self.again(points=more)
            if not other[2].error < HELPED * info.error:
                break
            read = other[0], other[1].remembering(usual), other[2]
        return read


def _far(
    prediction: ModesPrediction, prior: ModeDensities, modes: ModeDensities, info: ModesUpdateInfo
) -> float:
    """Square of a reading's distance from its prediction in a mode that it may be of, in standard deviations.

    Where mergers change log p by its rms near the middle, they change it so many times more there:
    nodes that check them end at √(5 + √10) = 2.86 of one state. Zero where the reading is not `FAR`
    (measured: half of it changes no run, twice an error by 2.2), or other densities than Gaussians were
    mixed. It may be of a mode that is left again just before it comes, whatever mergers have left of that.
    """
    model = prediction.model
    switches = model.transitions is not None or model.rates.any()
    if not switches or not all(gaussians_of(p) for _, _, p in prior.some):
        return 0.0
    w = np.maximum(modes.w, modes.w @ model.transition(prior.heaviest.t - prediction.before.heaviest.t))
    squares = [0.0]
    for name, share in zip(model.names, w.tolist(), strict=True):
        own = info.modes.get(name)
        if own is not None and own.innovation is not None and own.innovation_cov is not None:
            square = float(own.innovation @ np.linalg.solve(own.innovation_cov, own.innovation))
            squares += [square] if share * square > FAR**2 else []
    return max(squares)
