"""How many nodes a lattice needs for a target error."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from ..core.step_control import HELPED, MORE, TRIES
from ..density.memory import AIMED, error_budget
from ..density.particle_density import ParticleDensity
from ..errors import PropagationError, StoppedError
from ..info import Code, PredictInfo
from ..lattice.level_set import min_nodes
from ..lattice.resolved import MOST
from ._shared import Predicted


class Time(NamedTuple):
    """Numbers of particles that a time budget leaves for the first try, and for one more on a number."""

    most: int = MOST
    fits: Callable[[int], bool] = lambda n_particles: True

    def for_lattices(self, density: ParticleDensity, target: float) -> float:
        """Error by which the lattices of a prediction choose their nodes; zero where time chooses them."""
        return error_budget(density.error, target, AIMED) if self.most >= MOST else 0.0


#: No time budget.
ALWAYS = Time()


ORDER = 1.5  # the error falls about as N^-1.5


def carried_to_target(
    density: ParticleDensity,
    predicted: Callable[[int], Predicted],
    target: float,
    n_particles: int,
    time: Time = ALWAYS,
    most_work: float = math.inf,
) -> tuple[ParticleDensity, PredictInfo, int]:
    """Predict on a lattice, again with more nodes where the estimated error is above the target.

    `predicted` makes the prediction of the density on a number of nodes, of which the first try has
    `n_particles`; the target is in standard deviations, and all tries may take `most_work` evaluations of the
    drift together. Returns what was predicted, and the number of nodes for the next step. Raises
    `PropagationError` if the first try could not be made, or the one that the target asks for next is too
    much work.
    """
    best: tuple[ParticleDensity, PredictInfo, int] | None = None
    ratio, allowed, work = math.inf, error_budget(density.error, target), 0.0
    n_particles = min(n_particles, time.most)
    for _ in range(1 + TRIES):
        try:
            moved, info = predicted(n_particles)
        except PropagationError:
            if best is None:
                raise
            break
        if moved.form.cell is None:
            return moved, info, n_particles
        alike = best is not None and best[1].code == info.code == Code.OK
        if best is not None and alike and info.mass_error > HELPED * best[1].mass_error:
            break  # the density itself is coarse, not what it becomes
        best = moved, info, n_particles
        ratio = math.sqrt(max(info.error**2 - density.error**2, 0.0)) / allowed
        if not ratio > 1.0 or n_particles >= MOST:
            break
        more = min(math.ceil(n_particles * min(max(ratio ** (1.0 / ORDER), 1.2), 3.0)), MOST)
        work += info.n_evaluations
        if work + info.n_evaluations * more / n_particles > most_work:
            raise StoppedError(f"a lattice of {more} particles would take more work than there may be")
        if not time.fits(more):
            late = f"the prediction on {more} particles that the target asks for: no time for it"
            best = moved, replace(info, skipped=(*info.skipped, late)), n_particles
            break
        n_particles = more
    assert best is not None  # the first try raises or is one
    moved, info, bound = best
    if ratio < 1.0 / MORE:
        bound = max(min_nodes(density.dim), int(0.8 * bound))
    return moved, info, bound
