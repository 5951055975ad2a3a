"""Probabilities of detections from the predicted density itself."""

import datetime
from collections.abc import Set
from typing import Any

import numpy as np
from scipy.stats import chi2
from stonesoup.base import Property
from stonesoup.hypothesiser.base import Hypothesiser
from stonesoup.measures import SquaredMahalanobis
from stonesoup.types.detection import Detection, MissedDetection
from stonesoup.types.hypothesis import SingleProbabilityHypothesis
from stonesoup.types.multihypothesis import MultipleHypothesis
from stonesoup.types.numeric import Probability
from stonesoup.types.track import Track

from ...errors import ModelError
from ...validate import positive, real
from .predictor import DensityPredictor
from .updater import DensityUpdater


class EvidenceHypothesiser(Hypothesiser):
    """A hypothesiser by the evidence of detections, the integral of predicted density times likelihood.

    It works as Stone Soup's PDAHypothesiser, with the predicted density of the detection in the place of a
    Gaussian with its mean and covariance: P_D p(z_i) / lambda for a detection, 1 - P_D P_G for a miss. For
    NearestNeighbour, GNN, PDA and JPDA.

    Parameters
    ----------
    predictor : SPHPredictor or JumpMarkovPredictor
    updater : SPHUpdater or JumpMarkovUpdater
    clutter_spatial_density : float
        lambda, false detections in a unit of the measurement space and a scan.
    prob_detect : Probability
        P_D.
    prob_gate : Probability
        P_G: detections outside of the ellipse that holds this probability of a Gaussian prediction are left
        out, which saves work. With 1 all detections are scored, and the sensor needs a likelihood only.
    normalise : bool
        Probabilities add up to one.
    """

    predictor: DensityPredictor = Property(doc="Predicts tracks to detection times.")
    updater: DensityUpdater = Property(doc="Knows the evidence of detections.")
    clutter_spatial_density: float = Property(doc="False detections in a unit of the measurement space.")
    prob_detect: Probability = Property(default=Probability(0.85), doc="Probability that the target is seen.")
    prob_gate: Probability = Property(
        default=Probability(0.999), doc="Probability that its detection lies in the gate."
    )
    normalise: bool = Property(default=True, doc="Whether probabilities add up to one.")

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        positive("clutter_spatial_density", self.clutter_spatial_density)
        for name in ("prob_detect", "prob_gate"):
            value = real(name, float(getattr(self, name)))
            if not 0.0 < value <= 1.0:
                raise ModelError(f"{name} must be above 0 and at most 1, got {value:g}")

    def hypothesise(
        self, track: Track, detections: Set[Detection], timestamp: datetime.datetime, **kwargs: Any
    ) -> MultipleHypothesis:
        """Scored hypotheses: that of a miss, and of every detection inside the gate."""
        prediction = self.predictor.predict(track, timestamp=timestamp, **kwargs)
        missed = Probability(1.0 - float(self.prob_detect) * float(self.prob_gate))
        hypotheses = [SingleProbabilityHypothesis(prediction, MissedDetection(timestamp=timestamp), missed)]
        # by their numbers: a set's order changes from run to run
        for detection in sorted(detections, key=lambda found: tuple(map(float, found.state_vector))):
            scored = self._scored(track, detection, **kwargs)
            if scored is not None:
                hypotheses.append(scored)
        return MultipleHypothesis(hypotheses, normalise=self.normalise)

    def _scored(
        self, track: Track, detection: Detection, **kwargs: Any
    ) -> SingleProbabilityHypothesis | None:
        """The hypothesis of a detection, or None outside of the gate."""
        prediction = self.predictor.predict(track, timestamp=detection.timestamp, **kwargs)
        reading = None
        if self.prob_gate < 1:
            reading = self.updater.predict_measurement(prediction, detection.measurement_model, **kwargs)
            limit = chi2.ppf(float(self.prob_gate), reading.ndim)
            if SquaredMahalanobis(state_covar_inv_cache_size=0)(reading, detection) > limit:
                return None
        log_p = self.updater.log_evidence(prediction, detection)
        score = log_p + np.log(float(self.prob_detect)) - np.log(self.clutter_spatial_density)
        return SingleProbabilityHypothesis(prediction, detection, Probability(score, log_value=True), reading)
