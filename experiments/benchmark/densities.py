"""Posterior densities of all filters in one form, and how far they are from the reference's."""

from copy import copy
from dataclasses import dataclass

import numpy as np
from scipy.stats import multivariate_normal

from reference_filters.boxed_grid import BoxedGridFilter
from reference_filters.closed_forms import BenesFilter
from reference_filters.grid_density import Box, GridDensity
from reference_filters.particle import ParticleFilter


@dataclass(frozen=True)
class Cloud:
    """Weighted states X (N, n), w (N,); their density is a Gaussian kernel estimate (Silverman's width)."""

    X: np.ndarray
    w: np.ndarray

    def on(self, box):
        """Density on the nodes of a box: counted at the nearest nodes, then blurred."""
        n = self.X.shape[1]
        nodes = np.rint(box.indices(self.X)).astype(int)
        inside = np.all((nodes >= 0) & (nodes < box.size), axis=1)
        counts = np.zeros(box.shape)
        np.add.at(counts, tuple(nodes[inside].T), self.w[inside])
        effective = 1.0 / np.sum(self.w**2)
        width = (4.0 / ((n + 2) * effective)) ** (1.0 / (n + 4))
        Y = self.X - self.w @ self.X
        blur = width**2 * (self.w[:, None] * Y).T @ Y
        return GridDensity(box, counts / box.cell).blurred(blur).values


@dataclass(frozen=True)
class _Function:
    """A density given as a function of states (N, n)."""

    pdf: object

    def on(self, box):
        """Density on the nodes of a box."""
        return self.pdf(box.nodes()).reshape(box.shape)


def normal(mean, cov):
    """N(mean, cov), what a Kalman filter believes."""
    return _Function(multivariate_normal(mean, cov).pdf)


def snapshot(filt):
    """The density a filter has now, as an object with ``on(box)``."""
    if isinstance(filt, ParticleFilter):
        return Cloud(filt.particles.copy(), filt.weights)
    if isinstance(filt, BoxedGridFilter):
        return _Function(_boxed(filt).pdf)
    if isinstance(filt, BenesFilter):
        now = copy(filt)
        return _Function(lambda X: now.pdf(X[:, 0]))
    density = getattr(filt, "density", None)
    return normal(filt.x.copy(), filt.P.copy()) if density is None else _Function(density.pdf)


def _boxed(filt):
    """The density of a boxed grid filter, whose nodes are the centres of cells."""
    low, high = filt.nodes.min(axis=0), filt.nodes.max(axis=0)
    size = round(len(filt.nodes) ** (1.0 / filt.model.dim))
    cell = (high - low) / (size - 1)
    box = Box(low + 0.5 * size * cell, np.diag(0.5 * size * cell), size)
    return GridDensity(box, filt.probabilities.reshape(box.shape) / box.cell)


def hellinger(found, reference):
    """Hellinger distance of a snapshot from a reference `GridDensity`, in [0, 1].

    H² = ½ ∫ (√p - √q)², summed over the nodes of the reference; what is missing there of a mass of one is
    counted as lying outside.
    """
    cell = reference.box.cell
    p = np.maximum(reference.values, 0.0)
    p = p / (p.sum() * cell)
    q = np.maximum(found.on(reference.box), 0.0)
    outside = max(0.0, 1.0 - q.sum() * cell)
    return float(np.sqrt(0.5 * (((np.sqrt(p) - np.sqrt(q)) ** 2).sum() * cell + outside)))
