"""scheme="auto": the log-density, if need be on more particles, else moment-corrected SPH."""

from dataclasses import replace

from ..config import CorrectedScheme, LogDensityScheme, PaperScheme
from ..density.affine import with_moments
from ..errors import LatticeError, PropagationError, UnresolvedError
from ..lattice import field
from . import corrected, log_density, paper
from ._shared import carried_off

__all__ = ["FINEST", "MOST_FINER", "SUMMED"]


def _corrected(density, model, target, scheme, n_particles):
    return corrected.propagate(_uncut(density), model, target, scheme, n_particles)


def _uncut(density):
    """Nodes with the mean and covariance of the density that their lattice was cut out of.

    A Gaussian cut at Z keeps F(Z²; n + 2) / F(Z²; n) of its covariance, F the distribution of chi square: in
    four dimensions a hundredth is gone at Z = 4, and particles that obey the moment equations never find it.
    """
    if density.field is None or density.moments is None:
        return density
    moved = with_moments(density, *density.moments)
    return replace(moved, log_density=field.at(density.field, moved.x))


def _best(density, model, target, n_particles, most):
    """The log-density where it can be carried, if need be on more particles; else moment-corrected SPH."""
    reason = log_density.fits(model, density, n_particles)
    if not reason:
        try:
            return log_density.propagate(density, model, target, LogDensityScheme(), n_particles)
        except (LatticeError, UnresolvedError) as problem:
            return _finer(density, model, target, n_particles, most, problem)
        except PropagationError as problem:
            reason = str(problem)
    if density.domain is not None:
        moved, info = paper.propagate(density, model, target, SUMMED, n_particles)
        return moved, replace(info, status=f"not log_density: {reason}")
    try:
        moved, info = _corrected(density, model, target, CorrectedScheme(), n_particles)
    except PropagationError as problem:
        told = "stopped at" in reason
        raise PropagationError(reason if told else str(problem)) from problem
    return moved, replace(info, status=f"not log_density: {reason}")


def _finer(density, model, target, n_particles, most, problem):
    """Carry a density on more particles than allowed; the next update has as many as are.

    Where a lattice loses probability, the density is finer than its particles for a while: between two wells,
    along a fold. Other schemes see no more on as few particles, and do not notice.
    """
    blown = carried_off(model, density.x, density.t, target)
    if blown:
        raise PropagationError(blown) from problem
    for times in _FINER:
        if times > FINEST**model.dim or times * n_particles > most:
            break
        try:
            more = times * n_particles
            moved, info = log_density.propagate(density, model, target, LogDensityScheme(), more)
        except PropagationError:
            continue
        return moved, replace(info, status=f"on {times} times the particles: {problem}")
    raise problem


#: How many times the particles are tried where the lattice loses probability.
_FINER = 3, 9, 27
#: How many times finer a lattice may be along an axis than that of the density it starts from: beyond, it
#: sees the borders between that one's polynomials.
FINEST = 3
MOST_FINER = 30_000
#: Plain sums over kernels, for domains whose ends other schemes do not know.
SUMMED = PaperScheme(kernel="wendland_c2")
