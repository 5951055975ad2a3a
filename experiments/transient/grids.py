"""Tables of a transient file: where particles start, what is probed, what is written."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from sphfilter.files.text import Row
from sphfilter.settings import Count, Positive, settings

MOST_NODES = 1_000_000  # of a probing grid


@settings
class Lattice:
    """Nodes of a hyper-rectangle, at both ends of each side (000 5.2.3)."""

    # length n: lowest corner and lengths of the sides, in the units of the states
    origin: Row
    size: Row
    spacing: float | Row  # length n: distance of the nodes, or the next smaller one that fits

    @model_validator(mode="after")
    def _fits(self):
        n, spacing = len(self.origin), self.spacing
        if len(self.size) != n:
            raise ValueError(f"origin has {n} values, but size {len(self.size)}")
        if isinstance(spacing, tuple) and len(spacing) != n:
            raise ValueError(f"origin has {n} values, but spacing {len(spacing)}; give one, or one a state")
        self._check(np.array(self.size), np.broadcast_to(spacing, n))
        return self

    def _check(self, size, spacing):
        if np.any(size <= 0):
            raise ValueError(f"size must be positive, got {list(self.size)}")
        if np.any(spacing <= 0) or np.any(spacing > size * (1 + 1e-12)):
            raise ValueError(f"spacing must be positive and no longer than size, got {self.spacing}")

    @property
    def box(self):
        """Lower and upper ends, shape (n, 2)."""
        return np.transpose([self.origin, np.add(self.origin, self.size)])


@settings
class Probe(Lattice):
    """Points at which densities are looked at, the same at all times (000 5.2.7).

    Its size is zero along a state that is held at its origin: a slice. A smoothing length is the mean over
    the kernels at a point, a velocity that of the probability, by drift and diffusion together.
    """

    data: tuple[
        Literal["density", "log_density", "smoothing_length", "density_gradient", "velocity"], ...
    ] = ("density",)
    fps: Annotated[float, Field(gt=0, le=100)] = 10.0  # times a second of --animate

    def _check(self, size, spacing):
        sides = size > 0
        if not self.data:
            raise ValueError("data must name one quantity at least")
        if np.any(size < 0) or not sides.any():
            raise ValueError(f"size must be positive, or zero along some states, got {list(self.size)}")
        if np.any(spacing[sides] <= 0) or np.any((spacing > size * (1 + 1e-12))[sides]):
            raise ValueError(f"spacing must be positive and no longer than size, got {self.spacing}")
        count = np.prod([len(axis) for axis in self._axes(spacing)], dtype=float)
        if count > MOST_NODES:
            raise ValueError(f"spacing = {self.spacing} makes {count:.2g} points; at most {MOST_NODES:g}")

    def _axes(self, spacing):
        sides = zip(self.origin, self.size, spacing, strict=True)
        return [np.linspace(low, low + side, _cells(side, ds) + 1) for low, side, ds in sides]

    @property
    def axes(self):
        """Coordinates of the points along each state, a tuple of n arrays."""
        return tuple(self._axes(np.broadcast_to(self.spacing, len(self.origin))))

    @property
    def long(self):
        """Numbers of the states along which there is more than one point."""
        return [d for d, side in enumerate(self.size) if side > 0]


def _cells(side, spacing):
    """Cells of a side, none of one without length; no more than anybody could have asked for."""
    return int(np.ceil(min(side / spacing * (1 - 1e-12), MOST_NODES))) if side > 0 else 0


@settings
class Written:
    """What is written of the densities; moments and probabilities are, at all times of output."""

    # densities are kept, probed and filmed at every so many times of output, and at the last
    every: Count = 1
    interval: Positive | None = None  # instead at the first time of output after every so many seconds
    # write the particles at those times as CSV too: states, velocities, masses, smoothing lengths, densities
    # and their gradients
    csv: bool = False

    @model_validator(mode="after")
    def _one_way(self):
        if self.interval is not None and self.every != 1:
            raise ValueError("give either every or interval")
        return self

    def kept(self, times, start):
        """Numbers of the times at which densities are kept, the last among them; shape (K,)."""
        last = len(times) - 1
        if self.interval is None:
            return np.union1d(np.arange(self.every - 1, last, self.every), [last])
        slot = np.floor((times - start) / self.interval * (1 + 1e-12))
        return np.union1d(np.flatnonzero(np.diff(slot, prepend=0.0) > 0), [last])
