"""Lineages of weighted points: of how many independent ones means, variances and evidences are averages."""

import math
from typing import NamedTuple

import numpy as np

from .._jit import jit
from .._views import stretch
from ..limits import LOOK, ROUNDING, TINY
from ..small_matrices import cholesky, invert_lower
from ..sums import dot
from .weights import effective, finite_rows, normalise, taken, weighted_moments

#: Rows of lineages: those of one reading and of more, and in the last those that go back farthest. Measured:
#: of 507 errors of means 28 were told to a third at most with one, 20, 16, 14, 13 with two, three, six, 8.
LINES = 6
#: Lineages that know what they miss. Measured by tests/filter/test_ladder.py: of 55 to 75, what is told of it
#: is five times what is made.
_KNOWN = 0.5 * LOOK


class Carried(NamedTuple):
    """Weighted points, the evidence, and how many independent points they are.

    All, without weights, where none has any.
    """

    x: np.ndarray  # (n, N), those that weigh something
    w: np.ndarray  # (N,) of sum one
    lineage: np.ndarray  # (readings, N): ancestors among the prior's points, and those of readings before
    log_evidence: float
    mean: np.ndarray  # (n,)
    cov: np.ndarray  # (n, n)
    outermost: float  # of a variance, what no point stands for
    unseen: float  # of the evidence, what no lineage stands for
    missed: float  # error of the mean, in standard deviations, that comes of it
    alone: float  # for variances, were each point its own
    of_variance: float  # for variances
    effective: float  # for means
    lineages: float  # for the evidence


@jit
def carriers(x, log_w, ancestor, mass, older):
    """Points that weigh something, and of how many independent ones they are an average.

    Lineages are independent of each other, so that the variance of the mean is the sum of the squares of what
    each adds to it (Chan & Lai 2013); over that of one point that is the mean's number. The evidence knows of
    no more than the lineages' weights. What came from few points some readings ago is as wrong as those were,
    until noise has parted it: the mean's number is the least by lineages of one reading and of more (Olsson &
    Douc 2019).

    States x (n, N) that are no numbers weigh nothing; exp(log_w) (N,) have the evidence as their sum. Each
    has an ancestor (N,) among the prior's M points, of weights `mass` (M,), and these `older` ones (readings,
    M) among those of the reading before, of the one before that, and so on. Returns the values of a
    `Carried`: an interrupt in the making of a named tuple is none to Python.
    """
    n, N = x.shape
    log_w, w, mean, cov = log_w.copy(), np.zeros(N), np.zeros(n), np.zeros((n, n))
    fine, every = finite_rows(x)
    for i in range(0 if every else N):
        log_w[i] = log_w[i] if fine[i] else -np.inf
    log_evidence = normalise(log_w, w)
    if not abs(log_evidence) < np.inf:
        return x, w, _lines(ancestor, older, 0.0), -np.inf, mean, cov, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    heavy = np.flatnonzero(w > 0.0)
    if heavy.size < N:
        x, w, ancestor = taken(x, heavy), w[heavy], ancestor[heavy]
    weighted_moments(x, w, mean, cov)
    added, member = _added(x, w, ancestor, mean, cov)
    squares, part, wider = _squares(added, cov)
    lineages = 1.0 / squares
    beyond = unseen(added[n], added[n] / mass[member], lineages) if lineages < _KNOWN else 0.0
    missed = beyond * math.sqrt(part / squares) if part > 0.0 else beyond  # it lies as far off as they do
    number, alone = lineages, of_variances(x, w, mean, cov)
    of_variance = least_number(alone, squares, wider)
    if part > 0.0:
        # few lineages may agree by chance, and one agrees with itself: a variance seen L - 1 times
        number = max(lineages, min(effective(w), (1.0 - squares) / part, lineages * lineages))
    together = squares
    for own in older:
        added, member = _gathered(added, member, own)
        together, part, wider = _squares(added, cov)
        of_variance, number = least_number(of_variance, together, wider), least_number(number, together, part)
    numbers = outermost(x, w, mean, cov), beyond, missed, alone, of_variance, number, lineages
    return x, w, _lines(ancestor, older, together), log_evidence, mean, cov, *numbers


@jit
def least_number(number, together, part):
    """A number, or that which lineages tell by squares of weights and of what they add, if less."""
    known = part > 0.0 and 1.0 - together > ROUNDING  # else one has left all, and tells nothing
    return min(number, max((1.0 - together) / part, 1.0)) if known else number


@jit
def unseen(shares, weights, number):
    """Part of the evidence that no lineage stands for, by shares of it, and those over shares before (L,).

    Where few come from far out, those that would come from further out are missing, and what there is agrees
    with itself. Where weights fall with their rank to the power of -k, the part up to the first rank has
    2^-k / (1 - k) of what the first lineage, which is its middle, has. The index k is that of the tail which
    Vehtari, Simpson, Gelman, Yao, Gabry (2024) take: below .15 where a reading is usual, .3 to 40 of thirty
    outliers of 8 to 15 deviations (`tests/filter/test_outliers.py`). Where likelihoods bound the weights, as
    many as the `number` of lineages that count have an index below zero, and none are missed.
    """
    m = int(min(3.0 * math.sqrt(len(weights)), len(weights) / 5.0))
    if m < 5:
        return 0.0
    tail = np.sort(weights)[-m - 1 :]
    k = min(pareto_index(tail[1:] - tail[0]), 1.0 - 1.0 / m)  # from one, so many do not tell it apart
    m = max(min(int(number), m), 5)
    if not k > 0.0 or not pareto_index(tail[-m:] - tail[-m - 1]) > 0.0:
        return 0.0
    return min(shares.max() * (2.0**-k / (1.0 - k) - 1.0), 1.0)


@jit
def pareto_index(x):
    """Index k of a generalised Pareto distribution from m values x (m,) in ascending order, from zero on.

    The empirical Bayes estimate of Zhang and Stephens (2009), drawn to one half by ten values.
    """
    m, places = len(x), 30 + int(math.sqrt(len(x)))
    quartile = x[int(m / 4.0 + 0.5) - 1]
    if not quartile > 0.0:
        return 0.0
    b, likelihood = np.empty(places), np.empty(places)
    for i in range(places):
        b[i] = 1.0 / x[-1] + (1.0 - math.sqrt(places / (i + 0.5))) / (3.0 * quartile)
        k = _mean_log(b[i], x)
        likelihood[i] = m * (math.log(-b[i] / k) - k - 1.0)
    best, total, mean = likelihood.max(), 0.0, 0.0
    for i in range(places):
        w = math.exp(likelihood[i] - best)
        total, mean = total + w, mean + w * b[i]
    return (m * _mean_log(mean / total, x) + 5.0) / (m + 10.0)


@jit
def _mean_log(b, x):
    """Mean of log(1 - b x)."""
    total = 0.0
    for value in x:
        total += math.log1p(-b * value)
    return total / len(x)


@jit
def of_variances(x, w, mean, cov):
    """Number of random points of a Gaussian whose variances would be as unsure as those of x (n, N).

    Weights w (N,) have sum one. Of heavy tails a few points carry the variance, and the mean knows nothing of
    it; of the states the worst counts.
    """
    (n, N), least = x.shape, np.inf
    for a in range(n):
        s = 0.0
        for i in range(N):
            more = w[i] * ((x[a, i] - mean[a]) ** 2 - cov[a, a])
            s += more * more
        if s > 0.0:
            least = min(least, 2.0 * cov[a, a] ** 2 / s)
    return least


@jit
def outermost(x, w, mean, cov):
    """Part of a variance that no point stands for: what the outermost carries beyond the next, twice.

    Each point of x (n, N) stands for a part of the probability, and of the last, which has no end, it is the
    middle. Where what points carry falls as (k - 1/2)^-a with their rank k, the parts lack sum_k of
    (k^(1 - a) - (k - 1)^(1 - a)) / (1 - a) - (k - 1/2)^-a: once to three times that difference for a from
    .5 to .8, next to nothing of a Gaussian. Geometric Brownian motion lacks 1 to 1.4 times what is told
    (`tests/filter/test_guided.py`). Weights w (N,) have sum one; of the states the worst counts.
    """
    (n, N), most = x.shape, 0.0
    for a in range(n):
        first, second = 0.0, 0.0
        for i in range(N):
            more = w[i] * (x[a, i] - mean[a]) ** 2
            first, second = max(first, more), max(second, min(first, more))
        if first > second:
            most = max(most, 2.0 * (first - second) / cov[a, a])
    return most


@jit
def _lines(ancestor, older, together):
    """Ancestors (rows, N) of points, from those (N,) of the last reading and theirs, of `LINES` rows at most.

    The last row goes back as far as it tells lineages apart: as long as none of them has most of the weight,
    by the sum of their squares, it stays and the one before it goes.
    """
    kept = older
    if len(older) == LINES:
        kept = older[:-1].copy()
        if together < 0.5:
            kept[-1] = older[-1]
    return np.concatenate((ancestor.copy().reshape(1, -1), taken(kept, ancestor)))


@jit
def _added(x, w, lineage, mean, cov):
    """What lineages add to mean, weight and variances, (2 n + 1, lineages), and the number of each."""
    n, N = x.shape
    out, member, count = np.zeros((2 * n + 1, lineage.max() + 1)), np.empty(N, np.int64), 0
    for i in range(N):
        out[n, lineage[i]] += w[i]
    for a in range(n):
        for i in range(N):
            off = x[a, i] - mean[a]
            out[a, lineage[i]] += w[i] * off
            out[n + 1 + a, lineage[i]] += w[i] * (off * off - cov[a, a])
    for k in range(out.shape[1]):
        if out[n, k] > 0.0:
            member[count] = k
            count += 1
    return taken(out, member[:count]), member[:count]


@jit
def _gathered(added, member, older):
    """What those that lineages come from add, in place of these; and the number of a member of each."""
    place, number, count = np.full(older.max() + 1, -1), np.empty(len(member), np.int64), 0
    for k in range(len(member)):
        own = older[member[k]]
        if place[own] < 0:
            place[own], member[count] = count, member[k]
            count += 1
        number[k] = place[own]
    out = np.zeros((len(added), count))
    for a in range(len(added)):
        for k in range(len(number)):
            out[a, number[k]] += added[a, k]
    return out, member[:count]


@jit
def _squares(added, cov):
    """Squares of what lineages add: of their weights, to the mean and to the variance that is least sure.

    Those over what one point of a Gaussian adds.
    """
    n, N, part, wider = len(cov), added.shape[1], 0.0, 0.0
    L, S = np.empty(cov.shape), np.empty((n + 1, n + 1))
    for a in range(n + 1):
        for b in range(a + 1):
            S[a, b] = dot(stretch(added, a, 0, N), stretch(added, b, 0, N))
    for a in range(n):
        own = stretch(added, n + 1 + a, 0, N)
        wider = max(wider, dot(own, own) / max(2.0 * cov[a, a] ** 2, TINY))
    if not cholesky(cov, L):
        return S[n, n], np.nan, wider
    W = invert_lower(L)
    for a in range(n):
        for b in range(a + 1):
            for c in range(a + 1):
                part += W[a, b] * S[max(b, c), min(b, c)] * W[a, c] / n
    return S[n, n], part, wider
