"""Clouds: weighted points that stand for a density, smoothed where the density between them is asked for."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from .._types import Floats, OfStates
from ..core.cloud import weights
from ..core.limits import TINY
from ..core.sph.kernels import Kernel
from ..model.domain import Domain
from . import mixture
from .local_kernels import local_kernels
from .moments import moments
from .quasi_random import systematic
from .shapes import Kernels

KERNEL = "wendland_c2"
#: Points that stand for a cloud, over those that stand for one kernel of other densities, 128 or 16: of 2^14
#: random ones the mean were known within 1 / √2^14 = .008 standard deviations, of 2^11 within .02.
_STATES = 128


class Cloud(Kernels):
    """Weighted points, any of which may be heavy: moments are sums over them.

    The density between them is that of kernels as wide as the density about each is; in a domain, or where
    points are flat, of kernels whose width follows from the effective number of points.
    """

    @cached_property
    def mixture(self) -> Any:
        local = local_kernels(self.x, self.mass) if self.images is None else self.images
        return mixture.mixture(self.x, self.mass, self.h, self.kernel) if local is None else local

    @property
    def own_points(self) -> tuple[Floats, Floats]:
        return self.x, self.mass

    @cached_property
    def summed(self) -> tuple[Floats, Floats]:
        """Mean (n,) and covariance (n, n) of the points as they lie."""
        return moments(self.x, self.mass)

    def mean(self) -> Floats:
        return self.summed[0].copy()

    def cov(self, centre: Floats) -> Floats:
        return self.summed[1] + np.outer(self.summed[0] - centre, self.summed[0] - centre)

    def states(self, count: int, smooth: bool) -> tuple[Floats, Floats]:
        """Points in the kernels, as many for the whole cloud as serve a lattice: always the same ones."""
        mix, total = self.mixture, _STATES * count
        offsets = mixture.standing_for(mix.kernel.kind, self.x.shape[1], count)
        X = mix.points(np.tile(offsets, (_STATES, 1)), systematic(mix.mass[: len(self.x)], total))
        return X, np.full(total, 1.0 / total)

    def expected(self, function: OfStates, X: Floats, w: Floats) -> float:
        """Expectation of a function: of the kernels, drawn to that of the points.

        That of kernels is smooth; it is drawn as far as the two are further apart than points at random would
        be: kernels are wider than the tails that they see. (W. James, C. Stein, "Estimation with quadratic
        loss", 4th Berkeley Symposium, 1961, the positive part.)
        """
        values = function(X)
        smoothed = float(w @ values)
        at_points = function(self.x.copy())  # which a compiled function may not be given read-only
        own = float(self.mass @ at_points)
        scatter = max(self.mass @ (at_points - own) ** 2, w @ (values - smoothed) ** 2)
        return float(self._drawn(smoothed, own, scatter))

    def distribution(self, y: Floats, F: Floats) -> Floats:
        """Distribution function F (K,) of kernels at places (K,) of one state, drawn to that of points."""
        order = np.argsort(self.x[:, 0])
        below = np.searchsorted(self.x[order, 0], y, side="right")
        own = np.append(0.0, np.minimum(np.cumsum(self.mass[order]), 1.0))[below]
        return np.maximum.accumulate(self._drawn(F, own, np.maximum(own * (1.0 - own), F * (1.0 - F))))

    def _drawn(self, smoothed: Any, own: Any, scatter: Any) -> Any:
        """Expectations of kernels drawn to those of points, of functions that scatter so much (variance)."""
        off = scatter * float(self.mass @ self.mass) / np.maximum((own - smoothed) ** 2, TINY)
        return smoothed + np.maximum(1.0 - off, 0.0) * (own - smoothed)

    def marginal(self, axes: Sequence[int]) -> dict[str, Any]:
        """Fields of the points along some axes, by name."""
        h = smoothing_length(self.mass, self.summed[1][np.ix_(axes, axes)])
        return {"x": self.x[:, axes], "mass": self.mass, "h": h, "read_out": "cloud"}

    def around(self, domain: Domain) -> "Cloud":
        """Points with images beyond the ends of a domain; kernels are as wide as each axis asks."""
        n = self.x.shape[1]
        off = domain.nearest(self.x - domain.mean(self.x, self.mass))
        std = np.sqrt(np.maximum((off**2 * self.mass[:, None]).sum(axis=0), TINY))
        ends = zip(domain.kinds, domain.low / std, domain.high / std, strict=True)
        h = np.full(len(self.x), mixture.silverman(self.mass, n) / math.sqrt(self.kernel.variance))
        seen = Domain(*ends).seen(domain.fold(self.x) / std, self.mass, h, self.kernel.radius * h[0])
        return replace(self, images=mixture.mixture(*seen, self.kernel, factor=np.diag(std)))


def smoothing_length(mass: Floats, cov: Floats) -> Floats:
    """Smoothing lengths (N,) of points with covariance (n, n): spheres as large as the best kernel."""
    n = len(cov)
    kernel = Kernel.of(KERNEL, n)
    size = mixture.silverman(mass, n) * weights.extent(cov)
    return np.full(len(mass), size / math.sqrt(kernel.variance))
