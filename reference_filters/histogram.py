"""Histograms of samples with Knuth's number of bins, as densities.

K. Knuth, "Optimal data-based binning for histograms" (2006), used by 002 section 3.2.1: the density is taken
as constant in each of B equal bins, with Jeffreys' prior on their probabilities; B is the one that the
samples make most probable.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from sphfilter import validate
from sphfilter.errors import ModelError

#: Bins an axis that are tried at most, times N^(-1/(n+2)); and how far from the best so far, near a guess.
_MOST, _WINDOW = 8, 4


@dataclass(frozen=True)
class Histogram:
    """A density that is constant in every bin of a box.

    Attributes
    ----------
    edges : tuple of n arrays
        Of the bins along each axis.
    density : ndarray, shape (B₁, ..., Bₙ)
        Integrates to the fraction of the samples that lies in the box.
    """

    edges: tuple
    density: np.ndarray

    @property
    def centres(self):
        """Centres of all bins, shape (B, n), in the order of ``density.ravel()``."""
        axes = [0.5 * (e[1:] + e[:-1]) for e in self.edges]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def knuth_log_posterior(counts, n_bins):
    """Logarithm of the probability of B bins, up to a constant, 002 (33).

    B counts the bins of all axes together, B = Π B_d; 002 prints Σ B_d.

    Parameters
    ----------
    counts : array_like
        Samples in each bin; empty bins may be left out.
    n_bins : int
        B.
    """
    C = np.asarray(counts, dtype=float).ravel()
    C = C[C > 0]
    N, B = C.sum(), float(n_bins)
    # an empty bin gives ln Γ(½), which is taken off again
    filled = (gammaln(C + 0.5) - gammaln(0.5)).sum()
    return float(N * np.log(B) + gammaln(0.5 * B) - gammaln(N + 0.5 * B) + filled)


def knuth_bins(samples, box=None, near=None):
    """Knuth's number of bins along every axis, the same for all: 002 (34), simplified as there.

    Parameters
    ----------
    samples : array_like, shape (N, n) or (N,)
    box : array_like, shape (n, 2), optional
        What is divided into bins; the range of the samples if not given. Others do not count.
    near : int, optional
        Search near this number, such as that of the last time, for as long as it gets better.

    Returns
    -------
    int
    """
    X, box = _inside(samples, box)
    N, n = X.shape
    unit = (X - box[:, 0]) / (box[:, 1] - box[:, 0])
    most = max(2, int(np.ceil(_MOST * N ** (1.0 / (n + 2)))))
    tried = {}

    def best_of(numbers):
        for m in numbers:
            if m not in tried:
                tried[m] = knuth_log_posterior(_counts(unit, m), m**n)
        return max(tried, key=lambda m: (tried[m], -m))

    if near is None:
        return best_of(range(1, most + 1))
    best, last = validate.count("near", near), None
    while best != last:
        last = best
        best = best_of(range(max(1, last - _WINDOW), last + _WINDOW + 1))
    return best


def density_histogram(samples, bins=None, box=None):
    """Return the histogram of samples as a density.

    Parameters
    ----------
    samples : array_like, shape (N, n) or (N,)
    bins : int or sequence of n int, optional
        Along each axis; Knuth's number if not given.
    box : array_like, shape (n, 2), optional
        The range of the samples if not given.

    Returns
    -------
    Histogram
    """
    X, checked = _inside(samples, box)
    n = X.shape[1]
    bins = knuth_bins(X, checked) if bins is None else bins
    numbers = [validate.count("bins", m) for m in (bins if np.ndim(bins) else [bins] * n)]
    if len(numbers) != n:
        raise ModelError(f"bins has {len(numbers)} numbers, but the samples have {n} axes.")
    counts, edges = np.histogramdd(X, numbers, [tuple(ends) for ends in checked])
    volume = np.prod(checked[:, 1] - checked[:, 0]) / np.prod(numbers)
    return Histogram(tuple(edges), counts / (len(samples) * volume))


def _inside(samples, box):
    """Samples (N, n) within the box, and the box (n, 2)."""
    X = np.asarray(samples, dtype=float)
    X = validate.array("samples", X[:, None] if X.ndim == 1 else X, (None, None))
    if box is None:
        if len(X) < 2 or np.any(np.ptp(X, axis=0) == 0.0):
            raise ModelError("samples that are all the same have no histogram; give box=.")
        return X, np.column_stack([X.min(axis=0), X.max(axis=0)])
    box = validate.array("box", box, (X.shape[1], 2))
    if np.any(box[:, 1] <= box[:, 0]):
        raise ModelError(f"box must hold (low, high) with low < high for every axis, got {box.tolist()}.")
    X = X[np.all((box[:, 0] <= X) & (box[:, 1] >= X), axis=1)]
    if not len(X):
        raise ModelError("none of the samples lies in the box.")
    return X, box


def _counts(unit, m):
    """Samples in those of the mⁿ bins of the unit cube that have any."""
    cell = np.minimum((unit * m).astype(np.int64), m - 1)
    flat = cell @ m ** np.arange(unit.shape[1])
    if m ** unit.shape[1] <= 4 * len(unit) + 1000:
        return np.bincount(flat)
    return np.unique(flat, return_counts=True)[1]
