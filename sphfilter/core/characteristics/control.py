"""What a march from lattice to lattice aims at, counts, remembers from step to step, and how it ends."""

from typing import NamedTuple

import numpy as np
from numba import typeof, types

STATUS = ("ok", "not finite", "paused", "stalled", "too few nodes", "outgrown", "lost")
OK, NOT_FINITE, PAUSED, STALLED, TOO_FEW, OUTGROWN, LOST = range(7)
COUNTERS = ("steps", "rejected", "evaluations", "relaid")
STEPS, REJECTED, EVALUATIONS, RELAID = range(4)
#: What a march's `state` holds: filled volume of the whitened lattice, next step of the paths, sum of
#: |log mass| lost, longest step, next step of the lattice, residual of the last lattice, the sum of the
#: steps' errors, that of the squares of the lattices', the nodes that the next lattice needs, the error that
#: no shorter step makes smaller, and the sum of log mass.
(
    VOLUME, PATH_STEP, LOST_MASS, LONGEST, LATTICE_STEP, RESIDUAL, STEP_ERRORS, SQUARES, NODES, FLOOR,
    NET_MASS, STATE_SIZE,
) = range(12)  # fmt: skip


class Control(NamedTuple):
    """Aims of the march."""

    n_particles: int
    depth: float  # Z^2 / 2: log p of the lightest nodes below that of the heaviest
    tolerance: float  # of one step's paths, in standard deviations
    share: float  # of the last lattice's residual, that a step's error may be
    least: float  # residual that steps go by where the lattice's own is smaller
    noise_share: float  # largest variance a step's noise may have, in units of the density's own
    most_lost: float  # sum over steps of |log of the lattice's integral| at which to stop, once in doubt
    doubtful: float  # what steps and lattices have got wrong, from which the density is in doubt
    steps: float  # sum of the steps' errors to be kept to; zero where the number of nodes says what is right
    fewest: int  # nodes of a lattice, with it
    lattices: float  # root of the sum of squares of the lattices' residuals to be kept to, with it
    pause_after: int  # steps
    most_work: float  # evaluations of the drift, after which it pauses, too


class Run(NamedTuple):
    """A march on its way: what it aims at, and what it remembers and counts, kept up to date."""

    control: Control
    state: np.ndarray  # as the names above say
    counters: np.ndarray  # by `COUNTERS`


#: Numba's types of a `Control` and of a `Run`.
CONTROL = typeof(Control(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0, 0.0, 0, 0.0))
RUN = types.NamedTuple([CONTROL, types.float64[::1], types.int64[::1]], Run)
