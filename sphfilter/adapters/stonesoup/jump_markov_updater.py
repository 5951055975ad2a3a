"""Stone Soup's updater interface to models that switch between modes."""

import datetime
from collections.abc import Sequence
from functools import reduce
from operator import or_
from typing import Any

import numpy as np
from scipy.special import logsumexp
from stonesoup.base import Property
from stonesoup.models.measurement.base import MeasurementModel
from stonesoup.types.state import State

from ..._types import Floats
from ...config import checked_filter_config
from ...density.modes import ModeDensities
from ...errors import ModelError, PropagationError
from ...filter.reading_at_prior import predicted_reading
from ...filter.update_modes import ModesUpdateInfo
from ...filter.update_modes_again import update_or_predict_modes_again
from ...info import Code
from ...model.measurements import GaussianSensor, Sensor
from ...model.named import driven
from ...prediction.mixing_modes import mixture
from ...validate import short
from .association import Alone, Part
from .density_updater import DensityUpdater
from .failures import OnFailure
from .jump_markov_predictor import JumpMarkovPredictor
from .jump_markov_states import JumpMarkovState, JumpMarkovStateUpdate
from .states import Step, origin_of

__all__ = ["JumpMarkovUpdater"]


class JumpMarkovUpdater(DensityUpdater[JumpMarkovStateUpdate]):
    """Multiplies the densities of all modes with likelihoods, and their probabilities with the evidence.

    Parameters
    ----------
    predictor : JumpMarkovPredictor
        Whose model and settings count here too.
    measurement_model : MeasurementModel, GaussianMeasurement or LikelihoodMeasurement, optional
        Of all modes; for detections without one of their own.

    Raises
    ------
    ModelError
        A predictor of another kind.
    """

    _most_kept = 64  # posteriors of all modes
    predictor: JumpMarkovPredictor = Property(doc="Whose model and settings count here too.")

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        if not isinstance(self.predictor, JumpMarkovPredictor):
            raise ModelError(
                f"predictor must be a JumpMarkovPredictor, got {short(self.predictor)}; SPHUpdater goes with "
                f"others"
            )

    @property
    def _on_failure(self) -> OnFailure:
        return self.predictor.on_failure

    def _started(self, state: State) -> JumpMarkovState:
        return self.predictor._started(state)

    def _alone(self, state: JumpMarkovState, sensor: Sensor, z: Floats) -> Alone:
        try:
            step = self._multiplied(state, sensor, z)
        except PropagationError:
            return Alone(_evidence_of_points(state.modes, sensor, z), None)
        return Alone(step.info.log_evidence, step if step.info.accepted else None)

    def _multiplied(self, state: JumpMarkovState, sensor: Sensor, z: Floats) -> Step:
        """The `Step` of a detection; kept a while."""
        predictor, prior, origin = self.predictor, state.modes, origin_of(state)
        settings = checked_filter_config(predictor.config), predictor.n_particles
        sensors = dict.fromkeys(predictor.transition_model.names, sensor)
        likelihood = tuple(sensor.log_likelihood(z, p.x, p.t).tobytes() for _, _, p in prior.some)

        def multiplied() -> Step:
            return Step(*update_or_predict_modes_again(origin, prior, sensors, z, *settings)[1:])

        return self._kept.result((prior, likelihood, *settings), multiplied)

    def _associated(self, state: JumpMarkovState, missed: float, parts: Sequence[Part]) -> Step:
        config = checked_filter_config(self.predictor.config)
        each = [(part.weight, part.used) for part in parts]
        modes = mixture([(missed, state.modes), *((weight, step.after) for weight, step in each)], config)
        told = _joined([step.info for weight, step in each if weight > config.target_error])
        return Step(modes, self._said(modes, **told))

    def _said(self, modes: ModeDensities, **known: Any) -> ModesUpdateInfo:
        usual: dict[str, Any] = {"accepted": True, "log_evidence": 0.0, "n_particles": modes.n_particles}
        return ModesUpdateInfo(error=modes.error, **usual | known)

    def _sensor(
        self, measurement_model: MeasurementModel | Sensor | None, timestamp: datetime.datetime | None
    ) -> Sensor:
        found: Sensor = driven(
            super()._sensor(measurement_model, timestamp), self.predictor.transition_model.inputs
        )
        return found

    def _reading(
        self, state: JumpMarkovState, sensor: GaussianSensor
    ) -> tuple[Floats, Floats, Floats, Floats]:
        modes = state.modes
        each = [(np.exp(log_w), p.mean(), *predicted_reading(p, sensor)) for _, log_w, p in modes.some]
        w, means, readings, S, cross = (np.array(part) for part in zip(*each, strict=True))
        about = readings[w.argmax()]
        off = sensor.residual(readings, about)  # angles are averaged around that of the likeliest mode
        middle = w @ off
        off, apart, domain = off - middle, means - modes.moments[0], modes.heaviest.domain
        apart = apart if domain is None else domain.nearest(apart)
        S = np.einsum("k,kab->ab", w, S) + np.einsum("k,ka,kb->ab", w, off, off)
        cross = np.einsum("k,kab->ab", w, cross) + np.einsum("k,ka,kb->ab", w, apart, off)
        return modes.moments[0], about + middle, S, cross


def _joined(infos: Sequence[ModesUpdateInfo]) -> dict[str, Any]:
    """Status, code and scheme of several updates."""
    flagged = [info for info in infos if info.status != "ok"]
    return {
        "status": "; ".join(dict.fromkeys(info.status for info in flagged)) or "ok",
        "code": reduce(or_, (info.code for info in flagged), Code.OK),
        "scheme": ", ".join(dict.fromkeys(info.scheme for info in infos)),
    }


def _evidence_of_points(modes: ModeDensities, sensor: Sensor, z: Floats) -> float:
    """Log-evidence where no posterior can be made: a sum over the points of all modes."""
    each = [(log_w, p, sensor.log_likelihood(z, p.x, p.t)) for _, log_w, p in modes.some]
    return float(logsumexp([log_w + logsumexp(log_l, b=p.mass) for log_w, p, log_l in each]))
