"""The measurement acceptance test of 002 6.3: does the posterior lie where the prior has particles?"""

from typing import NamedTuple

import numpy as np

from .._types import Floats, Ints
from ..config import AcceptanceTest
from ..density.particle_density import ParticleDensity


class Acceptance(NamedTuple):
    accepted: bool
    reason: str


def test_measurement(
    density: ParticleDensity, z: Floats, variance: Floats, states: Ints, settings: AcceptanceTest
) -> Acceptance:
    """Compare the expected posterior along each measured state with the prior's domain (002 (60)-(62)).

    z and variance (k,) are the measured values of the states of these numbers (k,), and their noise
    variances.
    """
    mean, prior_variance = density.mean()[states], np.diag(density.cov())[states]
    total = prior_variance + variance
    mu = (z * prior_variance + mean * variance) / total  # (60)
    half = settings.z_pi * np.sqrt(prior_variance * variance / total)
    low, high = density.x[:, states].min(axis=0), density.x[:, states].max(axis=0)
    overhang = density.mean_support
    above, below = mu + half - high, low - (mu - half)
    beyond = np.where(mu >= mean, above, below)
    for d in np.flatnonzero(beyond > overhang):  # (61)
        return Acceptance(
            False, _sentence(states[d], mu[d], half[d], low[d], high[d], "outside the particles")
        )
    edge = np.maximum(above, 0.0) + np.maximum(below, 0.0)
    for d in np.flatnonzero(edge > settings.f_edge * 2.0 * half):  # (62)
        return Acceptance(False, _sentence(states[d], mu[d], half[d], low[d], high[d], "on the edge kernels"))
    return Acceptance(True, "")


def _sentence(state: int, mu: float, half: float, low: float, high: float, where: str) -> str:
    return (
        f"the posterior expected for state {state}, {mu:.4g} ± {half:.3g}, lies too far {where}, "
        f"which span {low:.4g} to {high:.4g}"
    )
