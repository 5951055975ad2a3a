"""States of a Stone Soup track that carry a density for every mode of a model that switches."""

import datetime
from typing import Any

import numpy as np
from stonesoup.base import Property, clearable_cached_property
from stonesoup.types.prediction import Prediction
from stonesoup.types.update import Update

from ..._types import Floats
from ...config import FilterConfig
from ...density.modes import ModeDensities
from ...density.particle_density import ParticleDensity
from ...errors import ModelError
from ...filter.update_modes import ModesUpdateInfo
from ...prediction.mixing_modes import whatever_the_mode
from ...prediction.switching import ModesInfo
from ...validate import short
from .states import DensityState

__all__ = ["JumpMarkovState", "JumpMarkovStatePrediction", "JumpMarkovStateUpdate"]


class JumpMarkovState(DensityState):
    """A state known by a density for every mode of a model that switches, and their probabilities.

    Predictions and updates make it; a track starts from a GaussianState, or an SPHState.

    Parameters
    ----------
    modes : ModeDensities
    names : tuple of str, length M
        Of the modes.
    timestamp : datetime.datetime, optional

    Attributes
    ----------
    state_vector, mean : StateVector, shape (n, 1)
        The mean over all modes; read-only.
    covar : CovarianceMatrix, shape (n, n)
    mode_probabilities : ndarray, shape (M,)
        In the order of `names`.
    mode : str
        The most probable one.
    densities : dict of str to ParticleDensity
        Of the modes that have a probability.
    density : ParticleDensity
        Of the states, whatever the mode; made when it is asked for.
    ndim : int

    Raises
    ------
    ModelError
        The modes are no ModeDensities, or not as many as the names.
    """

    _known_by = "modes"
    modes: ModeDensities = Property(doc="Densities of all modes, and their probabilities.")
    names: tuple[str, ...] = Property(doc="Names of the modes.")
    timestamp: datetime.datetime = Property(default=None, doc="Timestamp of the state. Default None.")

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        if not isinstance(self.modes, ModeDensities) or len(self.modes.densities) != len(self.names):
            raise ModelError(
                f"a JumpMarkovState takes ModeDensities of the modes {list(self.names)}, as those of another "
                f"state are, got {short(self.modes)}"
            )

    @property
    def _moments(self) -> tuple[Floats, Floats]:
        """Mean (n,) and covariance (n, n) over all modes."""
        return self.modes.moments

    @clearable_cached_property("modes")
    def density(self) -> ParticleDensity:
        """The density of the states, whatever the mode: the sum of those of the modes."""
        return whatever_the_mode(self.modes, FilterConfig().target_error)

    @property
    def mode_probabilities(self) -> Floats:
        """Probabilities of the modes, shape (M,), in the order of `names`."""
        return self.modes.w

    @property
    def mode(self) -> str:
        """The most probable mode."""
        return self.names[int(np.argmax(self.modes.log_w))]

    @property
    def densities(self) -> dict[str, ParticleDensity]:
        """Densities by mode, of those that have a probability."""
        return {self.names[i]: p for i, _, p in self.modes.some}


class JumpMarkovStatePrediction(Prediction, JumpMarkovState):
    """Predicted densities of all modes; `info` says how they were carried (`ModesInfo`)."""

    info: ModesInfo = Property(default=None, doc="What the prediction did.")


class JumpMarkovStateUpdate(Update, JumpMarkovState):
    """Posterior densities of all modes; `info` says what was done with the detection (`ModesUpdateInfo`).

    After one detection `info.log_evidence` is the logarithm of its predicted density; after an association of
    several, whose weights were given, zero.
    """

    info: ModesUpdateInfo = Property(default=None, doc="What the update did.")
