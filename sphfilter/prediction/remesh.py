"""Particles on a new lattice while a density is carried: when, and how (002 section 5.3)."""

import math
from dataclasses import dataclass

import numpy as np

from ..config import LogDensityScheme, PaperScheme, RemeshRule, Scheme
from ..core.limits import TINY
from ..density.health import health
from ..density.particle_density import ParticleDensity
from ..density.resample import regrid
from ..errors import PropagationError
from ..model.dynamics import Dynamics
from ..model.sde import SDE
from .automatic import SUMMED
from .log_density import why_not

_NUDGE = 1e-6  # standard deviations, of a difference that rounding gets wrong by eps / _NUDGE = 2e-10
_MOST_LOOKS = 100  # while the time that is left shrinks by a factor e: (1 - 1/100)^100 = .37 = 1/e
_ON_TIME = 1e-9  # of the seconds between two lattices: the rounding of k of them, k eps, with k = 5 million


@dataclass(frozen=True)
class Remeshing:
    """When the particles of a transient solution are put on a new lattice.

    It follows from the density alone: a solution that was stopped goes on as it would have.
    """

    when: RemeshRule  # `SolverConfig.remesh`
    scheme: Scheme
    n_particles: int  # upper bound of a new lattice's

    def applies(self, density: ParticleDensity, model: SDE) -> bool:
        """Do sums over kernels carry the density from here? A log-density is on a lattice at every step."""
        if self.when == "never" or isinstance(self.scheme, LogDensityScheme) or density.form.own_points:
            return False
        return self.scheme != "auto" or bool(why_not(model, density, self.n_particles))

    def stop(self, density: ParticleDensity, model: Dynamics, t: float) -> float:
        """Time at which to look again, at most t, seconds.

        Neighbours part by about their distance in the time that the drift needs to turn or strain the density
        by one: that is how often its health is looked at.
        """
        if not isinstance(model, SDE) or not self.applies(density, model):
            return t
        if isinstance(self.when, str):
            span, rate = t - density.t, _strain(density, model)
            return density.t + max(1.0 / rate, span / _MOST_LOOKS) if rate * span > 1.0 else t
        count = math.floor(density.t / self.when + _ON_TIME) + 1
        return t if count * self.when > t - _ON_TIME * self.when else count * self.when

    def renewed(
        self, density: ParticleDensity, model: Dynamics, t: float
    ) -> tuple[ParticleDensity, str, bool]:
        """The density on a new lattice if it is time for one, before it is carried to time t.

        Then why it has one, or why not if it should, empty if nothing was to be done; and whether it has one.
        """
        applies = t > density.t and isinstance(model, SDE) and self.applies(density, model)
        reason = self._reason(density) if applies else ""
        if not reason:
            return density, "", False
        try:
            scheme = self.scheme if isinstance(self.scheme, PaperScheme) else SUMMED
            new, _ = regrid(density, self.n_particles, scheme)
        except PropagationError as problem:
            return density, f"{reason}, but no new lattice: {problem}", False
        if self.when == "health" and health(new).severity >= health(density).severity:
            return density, f"{reason}, but a new lattice of so few particles is no better", False
        return new, f"re-gridded: {reason}", True

    def _reason(self, density: ParticleDensity) -> str:
        if isinstance(self.when, str):
            return health(density).complaint
        due = abs(math.remainder(density.t, self.when)) <= _ON_TIME * self.when
        return f"every {self.when:g} s" if density.invariant is not None and due else ""


def _strain(density: ParticleDensity, model: SDE) -> float:
    """Gradient of the drift, states in standard deviations: rms over the mass and the states, 1/seconds."""
    std = np.maximum(np.sqrt(np.diag(density.cov("points"))), TINY)
    drift, total = model.drift(density.x, density.t), 0.0
    for step in _NUDGE * np.diag(std):
        change = (model.drift(density.x + step, density.t) - drift) / (_NUDGE * std)
        total += density.mass @ (change**2).sum(axis=1)
    return math.sqrt(total / density.dim)
