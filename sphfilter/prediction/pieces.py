"""A sum of Gaussians carried by a linear model, exactly."""

import math
from typing import Any

import numpy as np

from ..density.as_family import gaussians_of, moments_on_line, pieces_density
from ..density.merging import OF_CHANGE, merged
from ..density.particle_density import ParticleDensity
from ..density.pieces import Pieces, pieces_of, root_of
from ..info import PredictInfo
from ..model.discretization import linear_transition
from ..model.dynamics import Dynamics
from ._shared import Predicted


def carried_pieces(density: ParticleDensity, model: Dynamics, t1: float, allowed: float) -> Predicted:
    """Carry pieces to time t1, and merge those that noise has made alike."""
    own: Any = density.pieces
    moved = _linearly(own, model, t1 - density.t)
    pieces, change = merged(moved, allowed / OF_CHANGE)
    error = math.hypot(density.error, OF_CHANGE * change)
    skipped = ("particles: a few Gaussians are the density",)
    told = PredictInfo(scheme="pieces", error=error, skipped=skipped)
    return pieces_density(density, pieces, t=float(t1), error=error), told


def carried_exactly(density: ParticleDensity, model: Dynamics, t1: float) -> ParticleDensity:
    """Carry a Gaussian or pieces to time t1 by a linear model, and merge none."""
    pieces = gaussians_of(density) or pieces_of(*moments_on_line(density))
    return pieces_density(density, _linearly(pieces, model, t1 - density.t), t=float(t1)).noted(
        needs=density.needs
    )


def _linearly(pieces: Pieces, model: Dynamics, dt: float) -> Pieces:
    flow, offset, Q = linear_transition(model, dt)
    cov = np.einsum("ab,kbc,dc->kad", flow, pieces.cov, flow) + Q
    return Pieces(pieces.log_w, pieces.mean @ flow.T + offset, root_of(cov))
