"""What a filter of a model that switches is between two calls: one value, as `FilterState` is."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

from numpy.typing import ArrayLike

from .._types import Floats
from ..density.modes import ModeDensities
from ..info import UpdateInfo
from ..model.measurements import Sensor
from ..prediction.switching import ModesPrediction
from .found import found
from .state import said_of_reading

__all__ = ["JumpMarkovState"]


@dataclass(frozen=True)
class JumpMarkovState:
    """The densities of all modes, and what the last steps said; attributes as those of `FilterState`."""

    modes: ModeDensities
    x_prior: Floats
    P_prior: Floats
    x_post: Floats
    P_post: Floats
    z: Floats | None = None
    y: Floats | None = None
    S: Floats | None = None
    log_likelihood: float = 0.0
    log_evidence: float = 0.0
    prediction: ModesPrediction | None = None  # the last one, if the densities come from it
    inputs: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def begun(cls, modes: ModeDensities, inputs: Mapping[str, float]) -> "JumpMarkovState":
        """The state of a filter that starts with densities and has inputs."""
        return cls(modes, *2 * _moments(modes), inputs=dict(inputs))

    @cached_property
    def _moments(self) -> tuple[Floats, Floats]:
        return _moments(self.modes)

    @property
    def x(self) -> Floats:
        """Mean over all modes, shape (n,)."""
        return self._moments[0]

    @property
    def P(self) -> Floats:
        """Covariance over all modes, shape (n, n)."""
        return self._moments[1]

    def predicted(self, modes: ModeDensities, prediction: ModesPrediction) -> "JumpMarkovState":
        """The state after a prediction."""
        x, P = _moments(modes)
        inputs = dict(prediction.model.inputs)
        return replace(self, modes=modes, x_prior=x, P_prior=P, prediction=prediction, inputs=inputs)

    def updated(
        self,
        prior: ModeDensities,
        modes: ModeDensities,
        info: UpdateInfo,
        measurement: Sensor,
        z: ArrayLike | None,
    ) -> "JumpMarkovState":
        """The state after an update, whose prior may be another than the densities now."""
        (x_prior, P_prior), (x, P) = _moments(prior), _moments(modes)
        return replace(
            self,
            modes=modes,
            prediction=self.prediction if modes is prior else None,
            x_prior=x_prior,
            P_prior=P_prior,
            x_post=x,
            P_post=P,
            **said_of_reading(measurement, z, info),
            log_likelihood=info.log_evidence,
            log_evidence=self.log_evidence + info.log_evidence,
        )


def _moments(modes: ModeDensities) -> tuple[Floats, Floats]:
    mean, cov = modes.moments
    return found(mean), found(cov)
