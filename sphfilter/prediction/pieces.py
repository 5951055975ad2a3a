"""A few Gaussians carried by the model: exactly if it is linear, else each as a family of degree two."""

import math

import numpy as np

from ..config import FamilyScheme
from ..core.limits import LITTLE
from ..density.as_family import family_density, moments_on_line, pieces_density
from ..density.family import gaussian_family
from ..density.merging import OF_CHANGE, merged
from ..density.particle_density import ParticleDensity
from ..density.pieces import HEAVY, Pieces, pieces_of, root_of
from ..errors import PropagationError
from ..info import PredictInfo
from ..model.discretization import linear_transition
from ..model.sde import SDE
from . import family

__all__ = ["carried_exactly", "carried_pieces"]


def carried_pieces(
    density: ParticleDensity, model: SDE, t1: float, allowed: float
) -> tuple[ParticleDensity, PredictInfo]:
    """Carry pieces to time t1, and merge those that noise has made alike.

    Raises
    ------
    PropagationError
        The drift bends too much over a piece for an error of `allowed`.
    """
    assert density.pieces is not None
    if model.linear and model.domain.unbounded:
        moved, off, info = _linearly(density.pieces, model, t1 - density.t), 0.0, PredictInfo()
    else:
        moved, off, info = _one_by_one(density, model, t1, allowed)
    pieces, change = merged(moved, allowed / OF_CHANGE)
    error = math.hypot(density.error, off, OF_CHANGE * change)
    skipped = ("particles: a few Gaussians are the density",)
    told = PredictInfo(
        scheme="pieces",
        error=error,
        n_steps=info.n_steps,
        n_evaluations=info.n_evaluations,
        skipped=skipped,
    )
    return pieces_density(density, pieces, t=float(t1), error=error), told


def carried_exactly(density: ParticleDensity, model: SDE, t1: float) -> ParticleDensity:
    """Carry a Gaussian or pieces to time t1 by a linear model, and merge none."""
    pieces = density.pieces or pieces_of(*moments_on_line(density))
    return pieces_density(density, _linearly(pieces, model, t1 - density.t), t=float(t1)).noted(
        needs=density.needs
    )


def _linearly(pieces: Pieces, model: SDE, dt: float) -> Pieces:
    flow, offset, Q = linear_transition(model, dt)
    cov = np.einsum("ab,kbc,dc->kad", flow, pieces.cov, flow) + Q
    return Pieces(pieces.log_w, pieces.mean @ flow.T + offset, root_of(cov))


def _one_by_one(
    density: ParticleDensity, model: SDE, t1: float, allowed: float
) -> tuple[Pieces, float, PredictInfo]:
    """Each piece as a family of its own; their errors, weighed by their shares; and what they took."""
    assert density.pieces is not None
    moved, infos, off = [], [], 0.0
    for share, mean, cov in zip(density.pieces.w, density.pieces.mean, density.pieces.cov, strict=True):
        own = family_density(density, gaussian_family(mean, cov, 2), error=0.0, gaussian=True)
        scheme = FamilyScheme(degree=2, tolerance=LITTLE * allowed)
        most = allowed * max(1.0, HEAVY / share)
        new, info = family.carried_family(own, model, t1, scheme, 0, most)
        moved.append(new.moments)
        infos.append(info)
        off += share * info.error
        if off > allowed:
            raise PropagationError("the drift bends too much over the pieces")
    mean, cov = (np.array(part) for part in zip(*moved, strict=True))
    steps = {name: sum(getattr(info, name) for info in infos) for name in ("n_steps", "n_evaluations")}
    return Pieces(density.pieces.log_w, mean, root_of(cov)), off, PredictInfo(**steps)
