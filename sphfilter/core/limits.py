"""Numbers that many files share: where double precision ends, and how much is looked at to know something."""

import math

import numpy as np

_EPS = float(np.finfo(float).eps)
TINY = 1e-300  # keeps what divides off zero: 1e-300 > 2^-1022, the least number of full precision
ROUNDING = math.sqrt(_EPS)  # part of a number, below which a difference like it is rounding: half its digits
STEP = 1e-4  # of differences, in widths of what is smooth: h² / 6 = 2e-9 of a third derivative is missed
DIFFERENCE = _EPS ** (1.0 / 3.0)  # step of differences: eps / h, rounding, is as much as h²
NOTHING = -math.log(_EPS)  # nats below the largest, where a term adds nothing to a sum: exp(-NOTHING) = eps
LARGEST_EXPONENT = 700.0  # nats: a thousand exponentials have a sum still, exp(700) = 1e304 < 2^1024 / 1000
LOG_2_PI = math.log(math.tau)
GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)  # (√5 - 1) / 2: its multiples modulo one are spread evenly, in any run
EDGE = 6.0  # standard deviations that hold a Gaussian: 2 (1 - Φ(6)) = 2e-9 of it lies beyond
OUTLYING = 5.0  # standard deviations, beyond which something else is at work: 2 Φ(-5) = 6e-7 lies so far out
FAR = 3.0  # standard deviations, beyond which there is next to nothing: 2 Φ(-3) = .003 of a Gaussian
AROUND = 2.5  # standard deviations that hold what is usual: 2 Φ(-2.5) = .012 of a Gaussian lies beyond
LEAP = 2.0  # widths of its top that Newton's method goes at once; measured: half and twice change no fit
HIGHEST = 6  # degree of a family's polynomial that is taken unless another is asked for
LOOK = 64  # points by which is judged what an eighth of a standard deviation does for: 1 / √64 = 1/8
#: Probability, from which it is said, and something done about it, that it was lost or guessed: at `FAR` it
#: moves a mean by 3 · .01 = .03 standard deviations.
SAID = 0.01
#: Part of a variance that is wrong by it, whose root is √1.2 = 1.1 times itself; as wrong is a mean that is
#: off by as much of a standard deviation.
WRONG = 0.2
LITTLE = 0.1  # part of an error that is allowed, that needs no look: √(1 + LITTLE²) = 1.005 of it
ADDED = 0.25  # part of an error that is allowed, that one more source may add: √(1 + ADDED²) = 1.03 of it
ALIKE = 0.9  # ratio of two variances that are as good as one: their deviations differ by √.9 = .95
ENTRIES = 2**21  # numbers worked on at once: 8 ENTRIES = 16 MB
ROUNDS = 30  # rounds of a search that halves what it does not know: 2^-30 = 1e-9 of it is left
