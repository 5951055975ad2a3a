"""What a march from lattice to lattice aims at, counts, remembers from step to step, and how it ends."""

from typing import NamedTuple

from numba import typeof, types

__all__ = [
    "CONTROL",
    "COUNTERS",
    "COUNTS",
    "EVALUATIONS",
    "LATTICE_STEP",
    "LONGEST",
    "LOST",
    "LOST_MASS",
    "NOT_FINITE",
    "OK",
    "OUTGROWN",
    "PATH_STEP",
    "PAUSED",
    "REJECTED",
    "RELAID",
    "STALLED",
    "STATE",
    "STATUS",
    "STEPS",
    "TOO_FEW",
    "VOLUME",
    "Control",
]

STATUS = ("ok", "not finite", "paused", "stalled", "too few nodes", "outgrown", "lost")
OK, NOT_FINITE, PAUSED, STALLED, TOO_FEW, OUTGROWN, LOST = range(7)
COUNTERS = ("steps", "rejected", "evaluations", "relaid")
STEPS, REJECTED, EVALUATIONS, RELAID = range(4)
#: What a march's `state` holds: filled volume of the whitened lattice, next step of the paths, sum of
#: |log mass| lost, longest step, next step of the lattice.
VOLUME, PATH_STEP, LOST_MASS, LONGEST, LATTICE_STEP = range(5)


class Control(NamedTuple):
    """What the march aims at."""

    n_particles: int
    depth: float  # Z^2 / 2: log p of the lightest nodes below that of the heaviest
    tolerance: float  # of one step's paths, in standard deviations
    noise_share: float  # largest variance a step's noise may have, in units of the density's own
    bent_share: float  # the same of noise that the drift has sheared
    curved: float  # how far from linear the paths' ends may be in their noise, in standard deviations
    most_lost: float  # sum over steps of |log of the lattice's integral| at which to stop
    pause_after: int  # steps


#: Numba's types of a `Control`, of the counters, and of the state.
CONTROL = typeof(Control(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0))
COUNTS, STATE = types.int64[::1], types.float64[::1]
