"""Errors that a cloud and its shadow tell, and what the next step takes by them: numbers, and no points.

All are functions of Python, which compiled code takes in as well: a number costs less than a call.
"""

import math

from numba.extending import register_jitable

from ..limits import ADDED, ALIKE, LOOK, TINY, WRONG
from ..step_control import MORE

SHADOW = 8  # points of a cloud over those of its shadow: an eighth of the time, 8^.6 = 3.5 times the error
STEPS_ORDER = 3.0  # of the steps' bias, of additive noise: measured by tests/core/test_cloud_core.py
_ORDER = 0.6  # of errors in the number of points: measured as .45 to .82, .61 on average (CLOUD.md)
_NEW = 0.4  # weight of the last squared difference; measured: half, twice change evaluations by .09 at most
#: Times fewer steps of a shadow: 1.65³ - 1 = 8^.6, what both are apart by is to what the cloud is off by as
#: for errors of points, and is seen where a reading makes much of it, as in a tail.
_FEWER = (1.0 + SHADOW**_ORDER) ** (1.0 / STEPS_ORDER)
#: Error of a mean over that of as many points drawn at random: .3 to .65 after first readings of 90 random
#: models. So much it is at least of few among many. Measured: with half errors are up to 1.6 times as large.
_OF_RANDOM = 0.5
#: Times what one reading shows, squared, that those before it may tell: by chance one of 140 shows so little
#: that a third is told, of two numbers that are pooled: 1 - exp(-1 / (9 * 16)) = .007.
_AT_MOST = 16.0
_USUAL = 0.25  # error of a cloud of one point a typical reading leaves, over N^-1/2, before anything tells it
#: Of the bias that is allowed, that steps get longer for (measured: with a tenth 1 to 1.9 times the steps).
_AIMED = 0.5
#: The most points of a cloud, whose error is some _OF_RANDOM / √2^17 = 1.4e-3.
MOST_POINTS = 2**17
#: Points of a shadow over n + 1, at least: so many draws leave a covariance 21^-.5 = .22 off. Measured on
#: scenes asked .1 and .03, error² times time: with half of the points 1.4 times as much (two and three
#: states), with 256 in five and six states 2 to 4 times (`experiments benchmark`).
_OF_SHADOW = 21
#: Part of points below which carriers are few: the way piece by piece, at six times the cost, divides errors
#: by five; as many times the points divide them by 6^.6 = 2.9.
_FEW = 0.25
#: What points lose of their carriers along that way; the part of points below which tempering is tried, at
#: twenty times the cost.
_LOST, _THIN = 2.0, 1.0 / 16.0
_ENOUGH = 50.0  # independent points, of which a mean has an error of 1 / √50 = .14
_FAR_MORE = 2.0  # times the carriers of one way, by which another is better: 1 / √2 = .7 of its errors
_NEXT_TO_NONE = 16.0  # of as many, evidence is 1 / √16 = .25 nats off, and weights' own number is believed
_SETTLED = 3  # readings before there are more again; measured: with 2 modes of tests/filter miss .01
_PATIENCE = 2  # readings that ask for fewer before there are; measured: errors up to 1.7 times with 4


@register_jitable
def smoothed(old, new, part=1.0):
    """Square of an error over the record, where one more of its readings has a new one; either may be NaN.

    What is much worse than before is believed at once, to a quarter of its square. What is not new may count
    for a part only.
    """
    if old != old or new != new:
        return new if old != old else old
    return max(0.25 * new, part * (old + _NEW * (new - old)))


@register_jitable
def remembered(old, new):
    """Part of squares over the record that counts, where that of the mean was old, and one is new.

    After a reading that was unlike all others the next are much better: at once, to `_AT_MOST` times the new
    square of the mean, which several numbers are pooled for.
    """
    average = smoothed(old, new)
    return min(_AT_MOST * new / average, 1.0) if new == new and average > 0.0 else 1.0


@register_jitable
def apart_by(first, second):
    """Squared error of a mean, from those that two clouds show of mean and variances.

    In standard deviations, on average over the states. A sample's variances are off by twice as much (in
    squares): both are pooled, as numbers of the same count. Measured on 40 models of one to four states: with
    all of the covariances .59 of what is made is told in four states, where one of them is slow, for .80.
    """
    return (2.0 * first + second) / 4.0


@register_jitable
def expected_square(number):
    """Square of what a shadow of so many independent points usually shows of a mean."""
    return _OF_RANDOM**2 / max(number, 1.0)


@register_jitable
def square_of_more(square, times):
    """Square of what so many times the points show; fewer points leave what was wrong as it was."""
    return square * max(times, 1.0) ** (-2.0 * _ORDER)


@register_jitable
def error_by(square):
    """Error of a cloud whose shadow shows this square, if both fall alike with the number of points."""
    return math.sqrt(square) * SHADOW**-_ORDER


@register_jitable
def both(one, other):
    """Error of two that are independent."""
    return math.sqrt(one * one + other * other)


@register_jitable
def least_error(number, size):
    """Error at least of an average of so many independent points among those of a cloud.

    Where a small part of the points carries a posterior, it is no more even than if it were drawn at random;
    and a shadow sees the same few. Of twice as many each way from there on it is as even as others are.
    """
    if number < LOOK:
        return 1.0 / math.sqrt(number)
    uneven = max(math.sqrt(LOOK / number), _OF_RANDOM)
    return uneven * max(1.0 - number / size, 0.0) / math.sqrt(number)


@register_jitable
def is_led(lineages, number, count):
    """Whether points of a reading are to be led piece by piece, of as many lineages.

    They are `count`, as good as a number of independent ones before it.
    """
    return lineages < ALIKE * number and lineages < _FEW * count


@register_jitable
def least_led(lineages):
    """Points that the first guide of such a way chooses at least, if it is to be better than so many."""
    return _LOST * _FAR_MORE * lineages if lineages > _NEXT_TO_NONE else 0.0


@register_jitable
def is_tempered(lineages, number, count, hidden):
    """Whether points are to be tempered; `hidden` where some sensor says nothing but a likelihood."""
    few = lineages < min(_THIN * count, _ENOUGH if hidden else _NEXT_TO_NONE)
    return few and lineages < ALIKE * number


@register_jitable
def is_better(one, other):
    """Whether one way to a posterior is better than another, by what each has `Carried`.

    It has far more carriers; where both have next to none, the higher evidence. Both know the evidence
    without bias: what has missed the posterior says too little, most of the time. What has found its peak
    may have missed the tails that carry its variance.
    """
    if min(one.lineages, one.alone) > _FAR_MORE * min(other.lineages, other.alone):
        return True
    return max(one.lineages, other.lineages) < _NEXT_TO_NONE and one.log_evidence > other.log_evidence


@register_jitable
def shown(square, bias):
    """Error of the mean that a shadow shows by a square, and steps by a bias: what is more, it has, too."""
    return both(error_by(square), bias)


@register_jitable
def errors_told(mean, variance, found, size, bias):
    """Errors of mean and variances: what a shadow shows (squares), at least that of few points, and a `Bias`.

    By what a cloud of some size has `Carried`: as many of its points as a number count for the mean, and as
    another for the variances, and of both a part is missed.
    """
    root = math.sqrt(2.0)  # of what a mean is off by, a variance is, where nothing more is known
    least = least_error(found.effective, size)
    wider = max(error_by(variance), root * max(least, least_error(found.of_variance, size)), found.outermost)
    error = max(error_by(mean), least)
    if found.missed > 0.0:
        error, wider = both(error, found.missed), both(wider, root * found.missed)
    return both(error, bias.mean), both(wider, bias.variance)


@register_jitable
def error_ahead(square, inherited, bias):
    """Error of a prediction's mean: what a shadow shows (squared), what is `Inherited`, and that of steps."""
    return both(both(max(error_by(square), inherited.missed), bias.mean), inherited.error)


@register_jitable
def evidence_error(square, found, size, n):
    """Error of the log-evidence, nats: what the shadow shows, and at least that of the lineages `Carried`.

    And what none of these stands for. In the order of one state points are strata, which leave far less than
    points at random.
    """
    least = least_error(found.lineages, size if n > 1 else found.lineages)
    return max(error_by(square), least, found.unseen)


@register_jitable
def bias_allowed(error, count, inherited, most, target, legs):
    """Bias that steps of one of several predictions may have, beside the error of the points, or NaN.

    All in standard deviations; `most` is an error in which nothing is right. What steps add, a cloud and its
    shadow share, and modes keep it for many readings: measured, half of `ADDED` takes 1.2 to 1.65 times the
    evaluations, twice .7 to 1.
    """
    error = _USUAL / math.sqrt(count) if error != error else error
    return ADDED * max(min(both(error, inherited), most), target) / legs


@register_jitable
def over_allowed(bias, allowed, n):
    """How many times what is allowed of n states a `Bias` of steps is."""
    return decisive(bias.mean, bias.variance, allowed / ADDED, n) / allowed


@register_jitable
def step_after(dt, number, over):
    """Length of the next step after so many over a time, whose bias was so much of what is allowed.

    It may be longer than that time, which may have been a moment between two sensors.
    """
    return dt / max(number * min(over / _AIMED, 1.0) ** (1.0 / STEPS_ORDER), TINY)


@register_jitable
def steps_of_shadow(steps, alike, least):
    """Steps of the shadow of a cloud that takes so many; `alike` where fewer might not be stable."""
    return steps if alike else max(math.floor(steps / _FEWER + 0.5), least)


@register_jitable
def power_of_two(count, n=0):
    """The next power of two, for which nets are evenest, within what clouds of n states may have."""
    return min(2 ** math.ceil(math.log2(max(count, SHADOW * _OF_SHADOW * (n + 1)))), MOST_POINTS)


@register_jitable
def decisive(mean, variance, target, n):
    """The error that decides on the points of n states: the mean's, or that as which a variance's counts.

    A variance may be off by half of what is said of it, or by as much as it is beside a mean on target in a
    random sample, if that is more: a state that no reading sees may be off where the mean is right.
    """
    return max(mean, variance * min(2.0 * target / WRONG, (n + 1.0) ** -0.5))


@register_jitable
def wrong_beside(flagged):
    """Part of a variance, by which it may be off and nothing is said, beside a mean flagged from an error on.

    A variance may be off by twice what is told of it.
    """
    return max(WRONG, 2.0 * flagged)


@register_jitable
def may_be_wrong(variance, flagged):
    """Whether variances told to be off so much are flagged, beside a mean that is from an error on."""
    return 2.0 * variance > wrong_beside(flagged)


@register_jitable
def points_for(count, error, target, n):
    """Points of n states that have a target error where so many have an error; as many if it is NaN."""
    times = (error / target) ** (1.0 / _ORDER) if error == error else 1.0
    return power_of_two(count * min(times, MORE), n)


@register_jitable
def next_points(now, wanted, calm):
    """Points of the next cloud where this one of `now` would have wanted so many; and how calm it was then.

    More at once, fewer after a while; `calm` counts readings in a row that asked for fewer, and below zero
    those to wait before there are more.
    """
    if wanted > now and calm >= 0:
        return min(wanted, 2 * now), -_SETTLED  # a power of two at a time: what tells it may be chance
    if wanted >= now:  # what there was before takes readings to be forgotten, whatever the points
        return now, min(calm + 1, 0)
    calm = max(calm, 0) + 1
    return wanted if calm >= _PATIENCE else now, calm % _PATIENCE
