"""A Gaussian, or a sum of them, carried by a linear model, exactly."""

import math
from typing import Any

import numpy as np

from .._types import Floats
from ..density.as_family import gaussians_of, moments_on_line, pieces_density
from ..density.distributions import gaussian_log_pdf
from ..density.particle_density import ParticleDensity
from ..density.pieces import OF_CHANGE, Pieces, merged, pieces_of
from ..info import PredictInfo
from ..lattice.level_set import lattice_depth, lay, root_of
from ..model.discretization import linear_transition
from ..model.dynamics import Dynamics
from ._shared import Predicted

_GAUSSIAN = 1e-2  # largest distance of log p from a quadratic: exp(.01) = 1.01, the density within 1 %


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


def propagate_exactly(
    density: ParticleDensity, model: Dynamics, t1: float, n_particles: int
) -> Predicted | None:
    """Return (density, info) at t1 by the matrix exponential, or None where the density is not Gaussian."""
    if density.form.cell is None:
        return None
    found = _quadratic(density)
    if found is None:
        return None
    mean, cov = found
    transition, offset, Q = linear_transition(model, t1 - density.t)
    mean, cov = transition @ mean + offset, transition @ cov @ transition.T + Q
    depth = lattice_depth(None, density.dim)
    factor: Any = np.linalg.cholesky(cov)
    laid = lay(gaussian_log_pdf(mean, cov), mean, factor, mean[None], n_particles, depth)
    info = PredictInfo(scheme="exact_linear", skipped=("everything: a Gaussian through a linear model",))
    return ParticleDensity.on_lattice(
        laid, float(t1), density.capacity, density.gaussian, density.domain
    ), info


def _quadratic(density: ParticleDensity) -> tuple[Floats, Floats] | None:
    """Mean and covariance of the quadratic that log p is, or None if it is none."""
    log_density: Any = density.log_density
    n, d = density.dim, density.x - density.mean()
    scale = np.sqrt(np.diag(density.cov()))
    z = d / scale
    pairs = np.triu_indices(n)
    basis = np.hstack([np.ones((len(z), 1)), z, z[:, pairs[0]] * z[:, pairs[1]]])
    c, *_ = np.linalg.lstsq(basis, log_density, rcond=None)
    if np.abs(basis @ c - log_density).max() > _GAUSSIAN:
        return None
    H = np.zeros((n, n))
    H[pairs] = c[1 + n :]
    precision = -(H + H.T)
    if np.linalg.eigvalsh(precision)[0] <= 0:
        return None
    cov = np.linalg.inv(precision)
    return density.mean() + scale * (cov @ c[1 : 1 + n]), scale[:, None] * cov * scale
