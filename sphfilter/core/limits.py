"""Numbers that many files share: where double precision ends, and how much is looked at to know something."""

import math

import numpy as np

__all__ = ["ALIKE", "EDGE", "LARGEST_EXPONENT", "LITTLE", "LOOK", "NOTHING", "ROUNDING", "ROUNDS", "TINY"]

_EPS = float(np.finfo(float).eps)
#: Keeps what divides off zero: 1e-300 > 2^-1022, the least number of full precision, and so has its inverse.
TINY = 1e-300
#: Part of a number, below which a difference of two like it is rounding: half the digits.
ROUNDING = math.sqrt(_EPS)
#: Nats below the largest, from which a term adds nothing to a sum: exp(-NOTHING) = eps.
NOTHING = -math.log(_EPS)
#: Nats whose exponential is a number, and so are sums of a thousand: exp(700) = 1e304 < 2^1024 / 1000.
LARGEST_EXPONENT = 700.0
#: Standard deviations that hold a Gaussian: 2 (1 - Φ(6)) = 2e-9 of it lies beyond.
EDGE = 6.0
#: Points by which something is judged that an eighth of a standard deviation does for: 1/√64 = 1/8.
LOOK = 64
#: Part of an error that is allowed, that needs no look: √(1 + LITTLE²) = 1.005 of it.
LITTLE = 0.1
#: Ratio of two variances that are as good as one: their deviations differ by √.9 = .95.
ALIKE = 0.9
#: Rounds of a search that halves what it does not know: 2^-30 = 1e-9 of it is left.
ROUNDS = 30
