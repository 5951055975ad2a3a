"""scheme="auto": the log-density, if need be on more particles, else a cloud, or sums over kernels.

A cloud, which takes over where these are refused, comes back to a lattice where one holds it.
"""

import math
from contextlib import suppress

import numpy as np

from .._types import Floats
from ..config import CloudScheme, LogDensityScheme, PaperScheme
from ..core.limits import SAID
from ..density.cloud import KERNEL
from ..density.moments import matched
from ..density.particle_density import ParticleDensity
from ..density.quasi_random import FEW_STATES, systematic
from ..density.resample import no_weight, times_likelihood
from ..density.statistics import FEW_SUBPOINTS
from ..errors import LatticeError, PropagationError, UnresolvedError
from ..info import WITHIN, Code
from ..model.sde import SDE
from . import cloud, log_density, paper
from ._shared import Predicted, carried_off
from .again import Ladder

#: Particles on which a prediction is made again where the lattice loses probability. Measured: half and twice
#: change no run.
MOST_FINER = 30_000
#: Plain sums over kernels, for domains whose ends other schemes do not know.
SUMMED = PaperScheme(kernel="wendland_c2")
_MOST_STATES = 4  # of which a lattice is tried again
_LEAST_ERROR, _RESIDUAL = 0.005, 0.1  # for a lattice to stand for a cloud


def propagate(
    density: ParticleDensity,
    model: SDE,
    t1: float,
    n_particles: int,
    most: int | None = None,
    allowed: float = 0.0,
    most_work: float = math.inf,
) -> Predicted:
    """Carry a density to time t1, seconds, by the log-density where that can be, else as a cloud.

    The log-density may have `most` particles where it needs more than `n_particles`, and an `allowed` error,
    as of `log_density.propagate`. After `most_work` evaluations of the drift it is given up: whoever bounds
    them goes on with a cloud, which knows its error.
    """
    points = density.form.own_points
    if points is not None:
        laid = _on_lattice(density, points, n_particles)
        if laid is None:
            return cloud.propagate(density, model, t1, CloudScheme(), n_particles)
        density = laid
    reason = log_density.why_not(model, density, n_particles)
    if not reason:
        try:
            return log_density.propagate(
                density, model, t1, LogDensityScheme(), n_particles, allowed, most_work
            )
        except (LatticeError, UnresolvedError) as problem:
            return _on_more(density, model, t1, (n_particles, allowed, most_work), problem, most)
        except PropagationError as problem:
            if most_work < math.inf and density.domain is None:
                raise
            reason = str(problem)
    if density.domain is not None:
        moved, info = _in_domain(density, model, t1, n_particles)
        return moved, info.marked(Code.FALLBACK, f"not log_density: {reason}")
    moved, info = cloud.propagate(density, model, t1, CloudScheme(), n_particles)
    return moved, info.marked(Code.FALLBACK, f"{info.status}; not log_density: {reason}")


def _on_lattice(
    density: ParticleDensity, points: tuple[Floats, Floats], n_particles: int
) -> ParticleDensity | None:
    """A cloud of points on a lattice that has its mean, covariance and density, or None where none has."""
    if density.dim > _MOST_STATES or abs(density.lost) > SAID:
        return None
    mean, cov = density.mean(), density.cov()
    x, mass = points[0][systematic(points[1], FEW_STATES)], np.full(FEW_STATES, 1.0 / FEW_STATES)
    try:
        root = np.linalg.inv(np.linalg.cholesky(cov))
        x = matched(x, mass, mean, cov) if density.domain is None else x
    except np.linalg.LinAlgError:  # flat along some combination of the states
        return None
    few = ParticleDensity(
        x=x,
        mass=mass,
        h=density.h[:1].repeat(FEW_STATES),
        kernel=KERNEL,
        read_out="cloud",
        t=density.t,
        domain=density.domain,
    )
    try:
        laid, *_ = times_likelihood(few, no_weight, n_particles, "auto")
    except PropagationError:
        return None
    off = np.sqrt(np.mean((root @ (laid.mean() - mean)) ** 2))
    wider = np.abs(root @ laid.cov() @ root.T - np.eye(density.dim)).max()
    X, _ = few.form.states(FEW_SUBPOINTS, True)
    residual = np.mean(np.abs(np.expm1(np.clip(laid.logpdf(X) - few.logpdf(X), -1.0, 1.0))))
    if max(off, 0.5 * wider) > WITHIN * max(density.error, _LEAST_ERROR) or residual > _RESIDUAL:
        return None
    error = math.hypot(density.error, float(off))
    return laid.noted(error=error, lost=density.lost, capacity=density.capacity)


def _in_domain(density: ParticleDensity, model: SDE, t1: float, n_particles: int) -> Predicted:
    """Carry a density that no lattice holds: a cloud sees walls better than sums over kernels do."""
    kinds = model.domain.kinds
    if density.form.smooth and "reflecting" in kinds and "bounded" not in kinds:
        with suppress(PropagationError):  # its paths look beyond walls, kernels do not
            return cloud.propagate(density, model, t1, CloudScheme(), n_particles)
    return paper.propagate(density, model, t1, SUMMED, n_particles)


def _on_more(
    density: ParticleDensity,
    model: SDE,
    t1: float,
    asked: tuple[int, float, float],
    problem: PropagationError,
    most: int | None,
) -> Predicted:
    """Carry a density on more particles than allowed; the next update has as many as are.

    Where a lattice loses probability, the density is finer than its particles for a while: between two wells,
    along a fold. Other schemes see no more on as few particles, and do not notice.
    """
    blown = carried_off(model, density.x, density.t, t1)
    if blown:
        raise PropagationError(blown) from problem
    n_particles, *bounds = asked
    ladder = Ladder(times=(3, 9, 27), most=MOST_FINER if most is None else most).within(model.dim)
    rung, (moved, info) = ladder.climbed(
        n_particles,
        lambda rung: log_density.propagate(density, model, t1, LogDensityScheme(), rung.n_particles, *bounds),
        problem,
    )
    return moved, info.marked(Code.FINER, f"on {rung.times} times the particles: {problem}")
