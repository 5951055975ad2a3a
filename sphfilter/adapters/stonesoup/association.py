"""Several detections, one at most the target's: what each says alone, and all of them together."""

from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from ...errors import ModelError, PropagationError
from ...resample import bound
from ...update import update

__all__ = ["FINER", "Alone", "Association", "alone", "error_of", "mixed_mean", "one_prediction",
           "probability_of"]  # fmt: skip

FINER = 1, 3, 9  # times the particles that a product of density and likelihood is tried on


class Association:
    """The likelihood of detections of which one at most is the target's, whose probabilities are given.

    p(x | all) = p(x) (b_0 + sum_i b_i p(z_i | x) / p(z_i)): each detection's posterior, and the prior for a
    miss, weighted as data association has weighted them. No mixture is merged.

    Parameters
    ----------
    missed : float
        b_0, the probability that none is.
    parts : sequence of (sensor, z, b_i, log p(z_i))
    """

    H = directly_observed = noise_cov = None
    angles = ()

    def __init__(self, missed, parts):
        total = missed + sum(weight for _, _, weight, _ in parts)
        self._missed = missed / total
        self._parts = [(sensor, z, np.log(weight / total) - log_p) for sensor, z, weight, log_p in parts]

    def observed(self, z):
        """Something was."""
        return np.ones(1, dtype=bool)

    def log_likelihood(self, z, X, t=0.0):
        """Logarithm of the sum above for each state X (N, n), shape (N,)."""
        with np.errstate(divide="ignore"):
            terms = [np.full(len(X), np.log(self._missed))]
        terms += [scale + sensor.log_likelihood(z, X, t) for sensor, z, scale in self._parts]
        return logsumexp(terms, axis=0)


class Alone(NamedTuple):
    """The log-evidence of a detection, and the mean of its posterior; None where it would not be used."""

    log_evidence: float
    mean: np.ndarray | None


def alone(density, sensor, z, config, n_particles, log_likelihood):
    """What a detection says alone, given its log-likelihood at the particles (N,)."""
    for times in FINER:
        try:
            posterior, info = update(
                density, sensor, z, config, n_particles=times * bound(density, n_particles)
            )
        except PropagationError:
            continue
        return Alone(info.log_evidence, posterior.mean() if info.accepted else None)
    return Alone(float(logsumexp(log_likelihood, b=density.mass)), None)


def mixed_mean(parts):
    """Mean of a mixture of weights and means, shape (n,)."""
    weights, means = zip(*parts, strict=True)
    return np.average(means, axis=0, weights=weights)


def error_of(density, expected, log_mass):
    """How far a posterior is off its mean, in standard deviations, or off the mass one."""
    if expected is None:
        return abs(log_mass)
    return max(abs(log_mass), np.abs((density.mean() - expected) / np.sqrt(np.diag(density.cov()))).max())


def one_prediction(hypotheses):
    """The prediction that hypotheses share."""
    predictions = [hypothesis.prediction for hypothesis in hypotheses]
    if not predictions:
        raise ModelError("there is no hypothesis: data association keeps one at least, that of a miss")
    times = {prediction.timestamp for prediction in predictions}
    if len(times) > 1:
        raise ModelError(
            f"the detections of an association have {len(times)} timestamps: give those of one time to it, "
            f"or associate each alone (NearestNeighbour)"
        )
    return predictions[0]


def probability_of(hypothesis):
    """The probability of a hypothesis, as a float."""
    if not hasattr(hypothesis, "probability"):
        raise ModelError(
            "an association needs hypotheses with probabilities (PDAHypothesiser, EvidenceHypothesiser), "
            f"got a {type(hypothesis).__name__}"
        )
    return float(hypothesis.probability)
