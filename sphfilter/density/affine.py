"""Densities moved affinely, so that their particles have given moments."""

import math
from dataclasses import replace

import numpy as np

from .._types import Floats
from ..lattice import field
from .particle_density import ParticleDensity

__all__ = ["uncut", "with_moments"]


def uncut(density: ParticleDensity) -> ParticleDensity:
    """Nodes with the mean and covariance of the density that their lattice was cut out of.

    A Gaussian cut at Z keeps F(Z²; n + 2) / F(Z²; n) of its covariance, F the distribution of chi square: in
    four dimensions a hundredth is gone at Z = 4, and particles that obey the moment equations never find it.
    A density on no lattice is returned as it is.
    """
    if density.field is None or density.moments is None:
        return density
    moved = with_moments(density, *density.moments)
    return replace(moved, log_density=field.at(density.field, moved.x))


def with_moments(density: ParticleDensity, mean: Floats, cov: Floats) -> ParticleDensity:
    """Shift and stretch a density until the points of its particles have this mean and covariance.

    The nodes of a lattice that ends somewhere have a little less covariance than the density on it.

    Parameters
    ----------
    density : ParticleDensity
        On no lattice afterwards: its `field` is dropped.
    mean : ndarray, shape (n,)
    cov : ndarray, shape (n, n)

    Returns
    -------
    ParticleDensity
    """
    change = np.linalg.cholesky(cov) @ np.linalg.inv(np.linalg.cholesky(density.cov("points")))
    grown = math.log(np.prod(np.diag(change)))
    log_density = None if density.log_density is None else density.log_density - grown
    return replace(
        density,
        x=mean + (density.x - density.mass @ density.x) @ change.T,
        h=density.h * math.exp(grown / density.dim),
        log_density=log_density,
        field=None,
        volume=None,
        moments=None,
        gaussian=False,
    )
