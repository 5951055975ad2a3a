"""Errors that a prior brings to its posterior: of its mean, and of what its shape is.

Moments of prior and posterior meet as `along`: how far the mean has gone, (n,), and what is left of the
covariance, (n, n), both along axes in which the prior's is one.
"""

import math
from typing import NamedTuple

import numpy as np
from numba.extending import register_jitable

from .._jit import jit
from .._views import stretch
from ..limits import HIGHEST, LITTLE, TINY
from ..small_matrices import add_squared, cholesky, eigen, invert_lower, product
from ..sums import dot
from .control import both, may_be_wrong
from .lineages import LINES
from .weights import weighted_moments

#: Of the shift of a mean by a defect, of errors without a sign, and of what its polynomials leave: what the
#: error told is made of. Measured on 30 models of three seeds: told over made 1.6, .79 to 5.5 (8 of 10), and
#: .016 below a third; with .2 of the second .024 are.
OF_SHIFT, OF_UNSIGNED, _OF_REST = 1.2, 0.4, 0.15
#: Degree of the polynomials for which the shape is taken that others inherit of a family: what those have in
#: one state. Measured: six tails are told .6 to 1.2 of what is made, with 5 .75 to 2.1, with 8 .3 to .7.
ROUGH = HIGHEST
#: Standard deviations. Measured: .029 of 592 errors are told to a third at most and .46 to three times as
#: much; with ten times .020 and .52, with none .16 and .33.
_LEAST = 1e-5
LEFT = 0.25  # least part of an error² left; measured: half: no change, twice: .95, 1.06 times the work


class Inherited(NamedTuple):
    """Errors of the mean, in standard deviations, that a cloud has from before, and what tells the first."""

    error: float  # from before there were points, as far as readings have left it
    missed: float  # flagged when it came, that few points have left to a cloud and its shadow
    wider: float  # error of the variances, as a part of them, of such a reading
    unsigned: float  # part of the first that has no sign
    rough: float  # size of what the shape was off by, until a reading finds it
    log_mass: float  # mean now of what follows
    off: np.ndarray  # (N,) nats by which each point of the begin was too light, as long as lineages know it


@register_jitable
def error_with(own, shown, inherited):
    """Error of a mean that is off by its own, of which a shadow and steps have shown a part, and `Inherited`.

    Of few points that have missed something the own error may be: the larger one counts.
    """
    return both(max(own, both(shown, inherited.missed)), inherited.error)


@register_jitable
def variance_error_with(own, shown, inherited):
    """Error of the variances likewise, of which a mean's is worth √2."""
    own = max(spread_with(own, shown, inherited), both(shown, math.sqrt(2.0) * inherited.missed))
    return both(own, math.sqrt(2.0) * inherited.error)


@register_jitable
def spread_with(own, shown, inherited):
    """Error of the variances without what a mean's is worth: it decides whether they are flagged."""
    return max(own, both(shown, inherited.wider))


@jit
def whitener(cov):
    """The matrix W (n, n) for which W C W^T = I; zero where a state has no variance."""
    lower = np.empty(cov.shape)
    return invert_lower(lower) if cholesky(cov, lower) else np.zeros(cov.shape)


@jit
def turned(W, C):
    """W C W^T, of matrices (n, n)."""
    out = np.zeros(C.shape)
    add_squared(W, C, np.empty(C.shape), out)
    return out


@jit
def along(mean, cov, own_mean, own_cov):
    """Where a posterior is, (n,), and how wide, (n, n), in the frame of its prior."""
    W, shift = whitener(cov), np.zeros(len(mean))
    for a in range(len(mean)):
        for b in range(a + 1):
            shift[a] += W[a, b] * (own_mean[b] - mean[b])
    return shift, turned(W, own_cov)


@jit
def shift_left(spread, least):
    """Part of a shift of the mean that a reading leaves of a prior, which has become so wide (n, n)."""
    return math.sqrt(min(max(np.trace(spread) / len(spread), least), 1.0))


@jit
def log_evidence_off(shift, spread):
    """By how much the log-evidence is off, nats, for each standard deviation that a prior's mean is off by.

    Its variances are off by √2 of that: what a Hermite polynomial of the second degree in log p makes of a
    variance, where one of the first shifts a mean by as much. A shift of the prior changes the evidence by
    the mean of the posterior, along the prior's axes, and a wider one by its mean square less one: that of a
    Gaussian, whatever the sensor.
    """
    square = 0.0
    for a in range(len(shift)):
        square += shift[a] ** 2 + 0.5 * (spread[a, a] + shift[a] ** 2 - 1.0) ** 2
    return math.sqrt(square)


@jit
def steepness(shift, spread, degree):
    """How steep polynomials of the next degrees are where a reading leads.

    Slopes of Hermite polynomials of the prior, over the posterior: along the way of the mean, and where it
    stays but for the width that shrinks most.
    """
    n, square, width, most = len(shift), 0.0, 0.0, 0.0
    for a in range(n):
        square += shift[a] ** 2
        for b in range(n):
            width += shift[a] * spread[a, b] * shift[b]
    widths = np.empty(n)
    eigen(spread.copy(), widths, np.empty((n, n)))
    for far, wide in ((math.sqrt(square), width / max(square, TINY)), (0.0, widths.min())):
        before, here, factorial = 1.0, far, 1.0  # means of Hermite's polynomials of N(far, wide)
        root = math.sqrt(max(wide, 0.0))  # of almost no width rounding may leave less than none
        for j in range(1, degree + 2):
            factorial *= j
            if j >= degree:  # degrees j + 1
                most = max(most, root * math.sqrt((j + 1.0) / factorial) * abs(here))
            before, here = here, far * here + j * (wide - 1.0) * before
    return most


@jit
def left_of_shape(shift, spread):
    """Part of an error of the mean that a reading leaves, or makes of a wrong shape; and what it adds, nats.

    Of that no more is known: it is taken for the lowest polynomials that are a shape, of degrees three and
    four, without a sign.
    """
    left, steep = shift_left(spread, LEFT), OF_UNSIGNED * steepness(shift, spread, 2)
    return both(left, steep), log_evidence_off(shift, spread)


@jit
def of_shape(rough, shift, spread):
    """Error of the mean by which a reading finds what a family got wrong of the shape of log p."""
    return OF_UNSIGNED * rough * steepness(shift, spread, ROUGH - 1) if rough > 0.0 else 0.0


@jit
def told_at(x, w, off, U, rest):
    """What a defect of values `off` (N,) at states x (n, N) of weights w tells, as `density.defect.Told`.

    To first order moments shift by their covariance with the defect. The square of the defect's own variance
    stands for the second order. A state of no variance has no error.
    """
    (n, N), log_mass = x.shape, dot(w, off)
    mean, cov, wider = np.empty(n), np.empty((n, n)), np.empty((n, n))
    weighted_moments(x, w, mean, cov)
    away, heavy = np.empty((n, N)), w * (off - log_mass)
    for a in range(n):
        for i in range(N):
            away[a, i] = x[a, i] - mean[a]
    for a in range(n):
        own = heavy * stretch(away, a, 0, N)
        for b in range(a + 1):
            wider[a, b] = wider[b, a] = dot(own, stretch(away, b, 0, N))
    W, square, most, shifted, changed = whitener(cov), dot(heavy, off - log_mass), 0.0, 0.0, 0.0
    change = turned(W, wider)
    for a in range(n):
        shift = 0.0
        for b in range(n):
            shift += W[a, b] * dot(heavy, stretch(away, b, 0, N))
            changed += change[a, b] ** 2
        shifted += shift**2
        most = max(most, abs(wider[a, a]) / max(cov[a, a], TINY))
    known = OF_SHIFT * math.sqrt(max(shifted, 0.25 * changed) / n)
    unsigned = OF_UNSIGNED**2 * np.trace(turned(W, U)) / n + (_OF_REST * rest) ** 2 + square**2 + _LEAST**2
    variance = math.sqrt((OF_SHIFT * most) ** 2 + 2.0 * unsigned)
    return math.sqrt(known**2 + unsigned), math.sqrt(unsigned), log_mass, variance


@jit
def left_by_reading(inherited, prior, x, w, lineage, posterior, own):
    """What a reading leaves of what a cloud has `Inherited`, and what of its log-evidence is off by it, nats.

    Prior and posterior are mean (n,) and covariance (n, n) each; points x (n, N) of weights w (N,) have come
    from ancestors (readings, N). Beside errors of their own that are ten times as large, nothing is kept: of
    the mean, and of the variances as parts of them.
    """
    error, missed, wider, unsigned, rough, log_mass, off = inherited
    shift, spread = along(prior[0], prior[1], posterior[0], posterior[1])
    (left, nats), n = left_of_shape(shift, spread), len(shift)
    of_missed, more = missed * nats, error * nats
    missed = missed * left if missed * left > LITTLE * own[0] else 0.0
    wider *= left * min(left, 1.0)  # as the variance itself, in a Gaussian
    wider = wider if wider > LITTLE * own[1] else 0.0
    error *= left
    if off.size > 0:
        unsigned = both(unsigned * left, of_shape(rough, shift, spread))
        own_off = np.empty(len(w))
        for i in range(len(w)):
            own_off[i] = off[lineage[-1, i] % off.size]
        told, _, mass, _ = told_at(x, w, own_off, np.zeros((n, n)), 0.0)
        error = both(told, unsigned)
        more = both(mass - log_mass, unsigned * nats / left)
        rough, log_mass = 0.0, mass
    if not error > LITTLE * own[0]:
        error = 0.0
    if error == 0.0 or len(lineage) == LINES:
        unsigned, rough, log_mass, off = 0.0, 0.0, 0.0, off[:0]
    return (error, missed, wider, unsigned, rough, log_mass, off), both(of_missed, more)


@register_jitable
def after_prediction(inherited, part):
    """What a prediction leaves of errors of few points, that keeps such a part of a mean's."""
    return Inherited(inherited.error, inherited.missed * part, inherited.wider * part**2, *inherited[3:])


@register_jitable
def with_missed(inherited, own, shown, flagged):
    """Errors with what a reading adds that is flagged for its mean, from an error on, or for its variances.

    Of own errors of both that is the part which a shadow does not show, and later ones will not.
    """
    missed, wider = inherited.missed, inherited.wider
    if own[0] > flagged:
        missed = max(missed, math.sqrt(max(own[0] ** 2 - shown[0] ** 2, 0.0)))
    if may_be_wrong(own[1], flagged):
        wider = max(wider, math.sqrt(max(own[1] ** 2 - shown[1] ** 2, 0.0)))
    return Inherited(inherited.error, missed, wider, *inherited[3:])


@jit
def kept(x, moved, w, cov):
    """What of an error of the mean a prediction leaves, in standard deviations, by regression.

    States x (n, N) of weights w (N,) have moved to others, or on the average over noise; afterwards their
    covariance is (n, n). All of it where that, or theirs, is flat.
    """
    n, square = len(x), 0.0
    mean, C, before, after = np.empty(2 * n), np.empty((2 * n, 2 * n)), np.empty((n, n)), np.empty((n, n))
    weighted_moments(np.concatenate((x, moved)), w, mean, C)
    if not (cholesky(C[:n, :n].copy(), before) and cholesky(cov, after)):
        return 1.0
    A, half = invert_lower(before), np.empty((n, n))
    product(invert_lower(after), C[n:, :n].copy(), 1.0, half)
    for a in range(n):
        for b in range(n):
            part = 0.0
            for c in range(n):
                part += half[a, c] * A[b, c]
            square += part**2
    return min(math.sqrt(square / n), 1.0)
