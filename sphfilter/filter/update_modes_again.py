"""A prediction of all modes repeated, where a measurement hangs on what its steps or mergers lost."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from .._types import Floats
from ..config import FilterConfig
from ..core.cloud.control import points_for
from ..core.step_control import HELPED, MORE, TRIES
from ..density.as_family import gaussians_of
from ..density.memory import MISSED
from ..density.modes import ModeDensities
from ..info import Code, UpdateInfo
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

_REPEATED = "the prediction before repeated in more steps of the jumps between modes"
_COARSE = "steps of the jumps between modes leave {:.2g} of the posterior in doubt"
_APART = "the prediction before repeated with fewer Gaussians merged, for the reading is far out"
_LATE = "no time to repeat the prediction before, in more steps of the jumps or with fewer Gaussians merged"
_MERGED = "mergers of Gaussians leave {:.2g} nat of the log-evidence in doubt"
#: Standard deviations of a reading from its prediction, beyond which mergers are not checked by their nodes,
#: which end at √(5 + √10) = 2.86 of one state. Measured: half changes no run, twice an error by 2.2.
_FAR = 3.0
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
    target = config.target_error
    modes, info = update_modes(prior, sensors, z, config, n_particles)
    off = float(modes.w @ modes.splitting)
    far = _far(prior, modes.w, [info.modes.get(name) for name in sensors])
    if modes is prior or prediction is None:
        return prior, modes, info
    if n_particles == "auto" and config.scheme == "auto" and goes_as_points(prior):
        again = partial(_again, prediction, prior.heaviest.t, sensors, z, config)
        prior, modes, info = _on_more_points(prediction, (prior, modes, info), again, target, fits)
        off = float(modes.w @ modes.splitting)
    if off <= target and not far:
        return prior, modes, info
    t, in_doubt = prior.heaviest.t, 0.0
    more = off > target and prediction.n_substeps < MOST_SUBSTEPS
    told = [(Code.REPEATED, what) for what, is_so in ((_REPEATED, more), (_APART, far)) if is_so]
    finer = MORE * (off / target) if more else 1.0
    apart = far or 1.0
    for _ in range(TRIES if far else int(more)):
        if not fits(1.0):
            told = [(Code.LATE, _LATE)]
            break
        before = info.log_evidence
        finer, apart = (max(finer, MORE), MORE * apart) if far else (finer, apart)
        prior, _ = predict_modes(
            prediction.before, prediction.model, t, config, n_particles, finer=finer, apart=apart
        )
        modes, info = update_modes(prior, sensors, z, config, n_particles)
        in_doubt = abs(info.log_evidence - before) if far else 0.0
        if in_doubt <= _IN_DOUBT:
            break
    off = float(modes.w @ modes.splitting)
    if off > MISSED * target:
        told.append((Code.COARSE, _COARSE.format(off)))
    if in_doubt > _IN_DOUBT:
        told.append((Code.COARSE, _MERGED.format(in_doubt)))
    for code, sentence in told:
        info = info.also(code, sentence)
    return prior, modes, replace(info, evidence_error=math.hypot(info.evidence_error, in_doubt))


def _again(
    prediction: ModesPrediction,
    t: float,
    sensors: Mapping[str, Sensor],
    z: ArrayLike | None,
    config: FilterConfig,
    points: int,
) -> _Read:
    """The prediction and the reading on another number of points in each mode."""
    prior, _ = predict_modes(prediction.before.cut(points), prediction.model, t, config, "auto")
    return prior, *update_modes(prior, sensors, z, config, "auto")


def _on_more_points(
    prediction: ModesPrediction,
    read: _Read,
    again: Callable[[int], _Read],
    target: float,
    fits: Callable[[float], bool],
) -> _Read:
    """Predict and update again where a reading finds too few points: what was wrong before no points cure."""
    usual, least = read[1], MISSED * max(target, prediction.before.error)
    for _ in range(TRIES):
        prior, modes, info = read
        points = points_of_modes(prior, target)
        more = points_for(points, modes.error, target, prior.heaviest.dim)
        if not modes.error > least or more <= points or not fits(more / points):
            break
        other = again(more)
        if not other[2].error < HELPED * info.error:
            break
        read = other[0], other[1].remembering(usual), other[2]
    return read


def _far(prior: ModeDensities, w: Floats, infos: Sequence[UpdateInfo | None]) -> float:
    """Square of a reading's distance from its prediction over modes of posterior probabilities w (M,).

    Where mergers change log p by its rms near the middle, they change it so many times more there. Zero where
    the reading is near, or nothing was merged.
    """
    several = [p for _, _, p in prior.some if not p.gaussian]
    if not several or not all(gaussians_of(p) for p in several):
        return 0.0
    square = 0.0
    for share, info in zip(w, infos, strict=True):
        if info is not None and info.innovation is not None and info.innovation_cov is not None:
            square += float(share) * float(
                info.innovation @ np.linalg.solve(info.innovation_cov, info.innovation)
            )
    return square if square > _FAR**2 else 0.0
