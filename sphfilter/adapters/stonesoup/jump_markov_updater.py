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
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.multihypothesis import MultipleHypothesis
from stonesoup.types.state import State

from ..._types import Floats
from ...config import checked_filter_config
from ...density.modes import ModeDensities
from ...errors import ModelError, PropagationError
from ...filter.asked import predicted_reading
from ...filter.update_modes import ModesUpdateInfo
from ...filter.update_modes_again import update_or_predict_modes_again
from ...info import Code
from ...model.measurements import GaussianSensor, Sensor
from ...model.named import driven
from ...prediction.mixing_modes import mixture
from ...validate import short
from .association import one_prediction, probability_of
from .density_updater import DensityUpdater
from .jump_markov_predictor import JumpMarkovPredictor
from .jump_markov_states import JumpMarkovStateUpdate
from .recent import Recent
from .states import origin_of, remember

__all__ = ["JumpMarkovUpdater"]

_KEPT = 64  # posteriors of late, which hypothesisers score first and updates use then


class JumpMarkovUpdater(DensityUpdater):
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

    predictor: JumpMarkovPredictor = Property(doc="Whose model and settings count here too.")

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        if not isinstance(self.predictor, JumpMarkovPredictor):
            raise ModelError(
                f"predictor must be a JumpMarkovPredictor, got {short(self.predictor)}; SPHUpdater goes with "
                f"others"
            )
        self._kept = Recent(_KEPT)

    def log_evidence(self, prediction: State, detection: Detection) -> float:
        """Logarithm of the predicted density of a detection, over all modes."""
        sensor, z = self._asked(prediction, detection)
        try:
            return self._multiplied(prediction, sensor, z)[1].log_evidence
        except PropagationError:
            return _evidence_of_points(self.predictor.modes_of(prediction), sensor, z)

    def update(
        self, hypothesis: SingleHypothesis | MultipleHypothesis, **kwargs: Any
    ) -> JumpMarkovStateUpdate:
        """The posterior of a hypothesis, or of an association of several (PDA, JPDA).

        Parameters
        ----------
        hypothesis : SingleHypothesis or MultipleHypothesis
            Several hypotheses have probabilities and share one prediction: in every mode the posterior is the
            sum of their posteriors (the prior, for a miss), and the mode has the probability of all.

        Returns
        -------
        JumpMarkovStateUpdate

        Raises
        ------
        ModelError
            A detection or state that does not fit, or hypotheses of different times.
        PropagationError
            With ``on_failure="raise"`` of the predictor: the detection cannot have come about in any mode, or
            no density holds the posterior. The prediction is as it was.
        """
        if isinstance(hypothesis, MultipleHypothesis):
            return self._associated(hypothesis)
        prediction, detection = hypothesis.prediction, hypothesis.measurement
        if not hypothesis:
            return self._unused(prediction, hypothesis)
        sensor, z = self._asked(prediction, detection)
        try:
            modes, info = self._multiplied(prediction, sensor, z)
        except PropagationError as problem:
            log_evidence = _evidence_of_points(self.predictor.modes_of(prediction), sensor, z)
            return self._failed(prediction, hypothesis, problem, log_evidence=log_evidence)
        return self._posterior(prediction, hypothesis, modes, info, detection.timestamp)

    def _associated(self, hypotheses: MultipleHypothesis) -> JumpMarkovStateUpdate:
        prediction = one_prediction(hypotheses)
        missed, used = 0.0, []
        for hypothesis in hypotheses:
            weight = probability_of(hypothesis)
            one = self._used(prediction, hypothesis) if weight > 0.0 else None
            if one is None:  # what would not be used alone is not used here
                missed += weight
            else:
                used.append((weight, *one))
        if not used:
            return self._unused(prediction, hypotheses)
        parts = [(missed, self.predictor.modes_of(prediction)), *((w, modes) for w, modes, _ in used)]
        config = checked_filter_config(self.predictor.config)
        try:
            modes = mixture(parts, config)
        except PropagationError as problem:
            return self._failed(prediction, hypotheses, problem)
        said = _joined([info for weight, _, info in used if weight > config.target_error])
        return self._posterior(prediction, hypotheses, modes, _info(modes, **said))

    def _used(
        self, prediction: State, hypothesis: SingleHypothesis
    ) -> tuple[ModeDensities, ModesUpdateInfo] | None:
        """The posterior of one detection of several; None of a miss, and where it would not be used."""
        if not hypothesis:
            return None
        try:
            modes, info = self._multiplied(prediction, *self._asked(prediction, hypothesis.measurement))
        except PropagationError:
            return None
        return (modes, info) if info.accepted else None

    def _multiplied(
        self, prediction: State, sensor: Sensor, z: Floats
    ) -> tuple[ModeDensities, ModesUpdateInfo]:
        """The posterior of a detection; kept a while."""
        predictor, prior, origin = self.predictor, self.predictor.modes_of(prediction), origin_of(prediction)
        settings = checked_filter_config(predictor.config), predictor.n_particles
        sensors = dict.fromkeys(predictor.transition_model.names, sensor)

        def multiplied() -> tuple[ModeDensities, ModesUpdateInfo]:
            return update_or_predict_modes_again(origin, prior, sensors, z, *settings)[1:]

        likelihood = tuple(sensor.log_likelihood(z, p.x, p.t).tobytes() for _, _, p in prior.some)
        return self._kept.result((prior, likelihood, *settings), multiplied)

    def _unused(
        self, prediction: State, hypothesis: SingleHypothesis | MultipleHypothesis
    ) -> JumpMarkovStateUpdate:
        """The posterior of no detection."""
        modes = self.predictor.modes_of(prediction)
        return self._posterior(prediction, hypothesis, modes, _info(modes, reason="no detection was used"))

    def _failed(
        self,
        prediction: State,
        hypothesis: SingleHypothesis | MultipleHypothesis,
        problem: PropagationError,
        **known: Any,
    ) -> JumpMarkovStateUpdate:
        """The posterior of detections that are left out because none could be made of them, or `problem`."""
        if self.predictor.on_failure == "raise":
            raise problem
        modes = self.predictor.modes_of(prediction)
        known |= {"accepted": False, "reason": f"not used: {problem}"}
        info = _info(modes, status="left out", code=Code.FALLBACK, **known)
        return self._posterior(prediction, hypothesis, modes, info)

    def _posterior(
        self,
        prediction: State,
        hypothesis: SingleHypothesis | MultipleHypothesis,
        modes: ModeDensities,
        info: ModesUpdateInfo,
        timestamp: datetime.datetime | None = None,
    ) -> JumpMarkovStateUpdate:
        posterior = JumpMarkovStateUpdate(
            modes,
            self.predictor.transition_model.names,
            timestamp=prediction.timestamp if timestamp is None else timestamp,
            hypothesis=hypothesis,
            info=info,
        )
        same = modes is getattr(prediction, "modes", None)
        return remember(posterior, origin_of(prediction)) if same else posterior

    def _sensor(
        self, measurement_model: MeasurementModel | Sensor | None, timestamp: datetime.datetime | None
    ) -> Sensor:
        found: Sensor = driven(
            super()._sensor(measurement_model, timestamp), self.predictor.transition_model.inputs
        )
        return found

    def _reading(self, state: State, sensor: GaussianSensor) -> tuple[Floats, Floats, Floats, Floats]:
        modes = self.predictor.modes_of(state)
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


def _info(modes: ModeDensities, **known: Any) -> ModesUpdateInfo:
    """What an update says whose evidence is zero unless it is known."""
    default: dict[str, Any] = {"accepted": True, "log_evidence": 0.0}
    return ModesUpdateInfo(n_particles=modes.n_particles, error=modes.error, **default | known)


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
