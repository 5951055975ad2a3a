"""Time with a shortcut and without, taken in turns, and how far the results differ."""

import time
from dataclasses import dataclass

import numpy as np

from sphfilter import initialize
from sphfilter.density.initialize import Gaussian

__all__ = ["Measured", "lattice_against_box", "measured"]

_SAMPLE = 0.005  # seconds one sample takes at least


@dataclass(frozen=True)
class Measured:
    """One row of the table.

    Attributes
    ----------
    name, scene : str
    on, off : float
        Median seconds of processor time a call.
    difference : float
        Largest difference of mean and covariance, in standard deviations of the result without the shortcut.
    """

    name: str
    scene: str
    on: float
    off: float
    difference: float

    @property
    def ratio(self):
        """Time without over time with the shortcut."""
        return self.off / self.on


def measured(case, n_samples):
    """Measure a `Case`; the medians of `n_samples` samples each."""
    difference = _difference(case.on(), case.off())  # compiles too
    timed = [(run, _calls(run)) for run in (case.on, case.off)]
    seconds = [[_seconds(run, n) for run, n in timed] for _ in range(n_samples)]
    on, off = np.median(seconds, axis=0)
    return Measured(case.name, case.scene, float(on), float(off), difference)


def _calls(run):
    """Calls that fill a sample."""
    return max(1, int(np.ceil(_SAMPLE / max(_seconds(run, 1), 1e-7))))


def _seconds(run, n_calls):
    """Processor time of a call: other programs on the machine do not count."""
    begin = time.process_time()
    for _ in range(n_calls):
        run()
    return (time.process_time() - begin) / n_calls


def _difference(on, off):
    whiten = np.linalg.inv(np.linalg.cholesky(off[1]))
    mean = whiten @ (on[0] - off[0])
    cov = whiten @ (on[1] - off[1]) @ whiten.T
    return float(max(np.abs(mean).max(), np.abs(cov).max()))


def lattice_against_box(n, n_particles):
    """Particles of a Gaussian's level-set lattice, and the nodes of the box around it.

    Parameters
    ----------
    n : int
        States, correlated by one half.
    n_particles : int

    Returns
    -------
    kept, whitened box, box along the states' own axes : int
    """
    cov = 0.5 * np.eye(n) + 0.5
    p = initialize(Gaussian(np.zeros(n), cov), n_particles)
    cells = np.ptp(p.field.node[: p.field.kept], axis=0) + 1
    extent = np.ptp(p.x, axis=0)
    own = np.prod(extent / np.abs(np.linalg.det(p.field.A)) ** (1.0 / n) + 1)
    return p.n_particles, int(np.prod(cells)), int(own)
