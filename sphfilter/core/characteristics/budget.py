"""What each step of a march, and each of its lattices, may get wrong where a target error is shared out."""

import math

from .._jit import jit
from ..step_control import MORE, next_step
from .control import SQUARES, STEP_ERRORS

_OVERDRAWN = 0.3  # of an even share, that is left to the rest of an interval at least
ORDER = 5.0  # of a lattice's residual in its spacing: polynomials of degree 4 leave h^5


@jit
def for_step(run, h, left, span):
    """Error that a step of length h may have, of those of which the time left is made up."""
    steps = run.control.steps
    return h * max((steps - run.state[STEP_ERRORS]) / left, _OVERDRAWN * steps / span)


@jit
def for_lattice(run, h, left, span):
    """Residual that the lattice after a step of length h may have; those of lattices add up by squares."""
    squares = run.control.lattices**2
    return math.sqrt(h * max((squares - run.state[SQUARES]) / left, _OVERDRAWN * squares / span))


@jit
def nodes_for(residual, allowed, count, control, n):
    """Nodes for a residual, after a lattice of `count`, whose own tells."""
    times = next_step(1.0, residual / allowed, ORDER) ** -n
    count *= min(max(times, 1.0 / MORE), MORE)
    return min(max(count, float(control.fewest)), float(control.n_particles))
