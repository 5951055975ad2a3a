"""Densities moved affinely, so that their particles have given moments."""

import math
from dataclasses import replace

import numpy as np

__all__ = ["with_moments"]


def with_moments(density, mean, cov):
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
