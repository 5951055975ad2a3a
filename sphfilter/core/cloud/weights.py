"""Weighted points: moments, effective numbers, systematic resampling."""

import math

import numpy as np

from .._jit import jit
from .._views import stretch
from ..elementary import FAST
from ..limits import LITTLE, LOOK, ROUNDING, TINY
from ..small_matrices import cholesky, invert_lower, whiten
from ..sums import dot, summed
from .blocks import about, squares
from .noise import LANES

#: Rows of lineages: those of one reading and of more, and in the last those that go back farthest. Measured:
#: of 507 errors of means 28 were told to a third at most with one, 20, 16, 14, 13 with two, three, six, 8.
LINES = 6
AWAY = 1.0 / ROUNDING  # extents, from which a point has run away: AWAY² = 1 / eps leaves others no digit


@jit
def weighted_moments(X, w, mean, cov):
    """Fill mean (n,) and covariance (n, n) of states X (n, N) with weights w (N,) that sum to one.

    Sums are over a few states at a time, which fit the first-level cache.
    """
    (n, N), off, heavy = X.shape, np.empty((len(X), LANES)), np.empty((1, LANES))
    for a in range(n):
        mean[a] = dot(w, stretch(X, a, 0, N))
        for b in range(n):
            cov[a, b] = 0.0
    for first in range(0, N, LANES):
        K = min(LANES, N - first)
        for a in range(n):
            own, about = stretch(X, a, first, K), mean[a]
            for i in range(K):
                off[a, i] = own[i] - about
                heavy[0, i] = w[first + i] * off[a, i]
            for b in range(a + 1):
                cov[a, b] += dot(stretch(heavy, 0, 0, K), stretch(off, b, 0, K))
    for a in range(n):
        for b in range(a):
            cov[b, a] = cov[a, b]


@jit
def floored(cov, part):
    """A covariance (n, n) in which a state without spread has next to none, or that part of all of it."""
    P, trace = cov.copy(), 0.0
    for a in range(len(P)):
        trace += P[a, a]
    for a in range(len(P)):
        P[a, a] = max(P[a, a], part * trace, 1e-280)
    return P


@jit
def extent(cov):
    """Geometric mean of the standard deviations of a covariance (n, n) along its axes."""
    n, total = len(cov), 0.0
    L = np.empty((n, n))
    if not cholesky(floored(cov, 1e-24), L):
        return 1e-140
    for a in range(n):
        total += math.log(L[a, a]) / n
    return math.exp(total)


@jit
def compared(mean, cov, other, own):
    """Squared errors that two clouds show of a mean (n,) and a covariance (n, n), in units of the first's.

    Of the mean on average over the states, in standard deviations; of the covariance relative, over n; and
    of that variance which is off most, if this is more.
    """
    n = mean.size
    L, off, wider = np.empty((n, n)), np.empty(n), np.empty((n, n))
    if not cholesky(floored(cov, 0.0), L):
        return np.nan, np.nan, np.nan
    for a in range(n):
        off[a] = other[a] - mean[a]
        for b in range(n):
            wider[b, a] = own[a, b] - cov[a, b]
    whiten(L, off)
    for a in range(n):
        whiten(L, wider[a])
    wider = wider.T.copy()
    first = second = most = 0.0
    for a in range(n):
        whiten(L, wider[a])
        first += off[a] * off[a] / n
        for b in range(n):
            second += wider[a, b] * wider[a, b] / n
        if cov[a, a] > 0.0:
            most = max(most, (own[a, a] / cov[a, a] - 1.0) ** 2)
    return first, second, max(second, most)


@jit
def finite_rows(x):
    """Which of states x (n, N) are numbers, (N,), and whether all are."""
    n, N = x.shape
    fine, every = np.ones(N, np.bool_), summed(0.0 * x.reshape(-1)) == 0.0
    for a in range(0 if every else n):
        for i in range(N):
            fine[i] &= abs(x[a, i]) < np.inf
    return fine, every


@jit
def any_beyond(few, x):
    """Whether one of few points (n, K) lies beyond all x (n, N): steps that are too long throw them."""
    for a in range(len(x)):
        low, high = x[a, 0], x[a, 0]
        for i in range(x.shape[1]):
            low, high = min(low, x[a, i]), max(high, x[a, i])
        reach = LITTLE * (high - low)
        for i in range(few.shape[1]):
            if not low - reach <= few[a, i] <= high + reach:
                return True
    return False


@jit
def near_others(x, away):
    """Which of points x (n, N) lie no farther off than `away` times the extent of all; and whether all do.

    The extent is that between an eighth and seven of the values of a few dozen of them.
    """
    (n, N), every = x.shape, True
    near = np.ones(N, np.bool_)
    for a in range(n):
        low, high, _ = eighths(x[a], max(N // LOOK, 1))
        reach, beyond = away * (high - low) + abs(low) + abs(high), 0
        for i in range(N):
            beyond += not low - reach <= x[a, i] <= high + reach
        every &= beyond == 0
        for i in range(N if beyond else 0):
            near[i] &= low - reach <= x[a, i] <= high + reach
    return near, every


@jit
def eighths(v, each):
    """An eighth and seven of the finite ones among numbers v (K,), of which one in so many is taken.

    And how many there are; infinite where there are none.
    """
    count = 0
    for i in range(0, v.size, each):
        count += abs(v[i]) < np.inf
    least, greatest = np.full(count // 8 + 1, np.inf), np.full(count // 8 + 1, np.inf)
    for i in range(0, v.size, each):
        if abs(v[i]) < np.inf:
            _sorted_in(least, v[i])
            _sorted_in(greatest, -v[i])
    return least[-1], -greatest[-1], count


@jit
def _sorted_in(least, value):
    """Put a value among the least so far, in order, if it is one of them."""
    at = least.size - 1
    if value < least[at]:
        while at > 0 and least[at - 1] > value:
            least[at] = least[at - 1]
            at -= 1
        least[at] = value


@jit
def prior_times(w, log_l):
    """Logarithms (N,) of weights w (N,) times likelihoods."""
    out = np.empty(w.size)
    for i in range(w.size):
        known = log_l[i] + FAST.log(max(w[i], TINY))
        out[i] = known if w[i] > 0.0 else -np.inf
    return out


@jit
def carriers(x, log_w, ancestor, older):
    """Points that weigh something, and of how many independent ones they are an average.

    Lineages are independent of each other, so that the variance of the mean is the sum of the squares of what
    each adds to it (Chan & Lai 2013); over that of one point that is the mean's number. The evidence knows of
    no more than the lineages' weights. What came from few points some readings ago is as wrong as those were,
    until noise has parted it: the mean's number is the least by lineages of one reading and of more (Olsson &
    Douc 2019).

    States x (n, N) that are no numbers weigh nothing; exp(log_w) (N,) have the evidence as their sum. Each
    has an ancestor (N,) among the prior's M points, and these `older` ones (readings, M) among those of the
    reading before, of the one before that, and so on.

    Returns
    -------
    x, w, lineage : ndarray, shapes (n, N), (N,), (1 + readings, N)
        Those with weights, of sum one, and their ancestors; all, without weights, where none has any.
    log_evidence : float
    mean, cov : ndarray, shapes (n,), (n, n)
    of_variance, effective, lineages : float
        Numbers for variances, for the mean and for the evidence.
    """
    n, N = x.shape
    log_w, w, mean, cov = log_w.copy(), np.zeros(N), np.zeros(n), np.zeros((n, n))
    fine, every = finite_rows(x)
    for i in range(0 if every else N):
        log_w[i] = log_w[i] if fine[i] else -np.inf
    log_evidence = normalise(log_w, w)
    if not abs(log_evidence) < np.inf:
        return x, w, _lines(ancestor, older, 0.0), -np.inf, mean, cov, 0.0, 0.0, 0.0
    heavy = np.flatnonzero(w > 0.0)
    if heavy.size < N:
        x, w, ancestor = taken(x, heavy), w[heavy], ancestor[heavy]
    weighted_moments(x, w, mean, cov)
    added, member = _added(x, w, ancestor, mean)
    squares, part = _squares(added, cov)
    lineages = 1.0 / squares
    number = lineages
    if part > 0.0:
        # few lineages may agree by chance, and one agrees with itself: a variance seen L - 1 times
        number = max(lineages, min(effective(w), (1.0 - squares) / part, lineages * lineages))
    together = squares
    for own in older:
        added, member = _gathered(added, member, own)
        together, part = _squares(added, cov)
        if part > 0.0 and 1.0 - together > ROUNDING:  # else one has left all, and tells nothing
            number = min(number, max((1.0 - together) / part, 1.0))
    numbers = of_variances(x, w, mean, cov), number, lineages
    return x, w, _lines(ancestor, older, together), log_evidence, mean, cov, *numbers


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
def taken(x, number):
    """Points (n, M) of x (n, N), or lineages of theirs, by their number (M,)."""
    y = np.empty((len(x), number.size), x.dtype)
    for a in range(len(x)):
        for i in range(number.size):
            y[a, i] = x[a, number[i]]
    return y


@jit
def beside(x, y):
    """Points x (n, N) and y (n, M) as one array (n, N + M)."""
    (n, N), M = x.shape, y.shape[1]
    out = np.empty((n, N + M))
    for a in range(n):
        first, last = stretch(out, a, 0, N), stretch(out, a, N, M)
        for i in range(N):
            first[i] = x[a, i]
        for i in range(M):
            last[i] = y[a, i]
    return out


@jit
def turned(x):
    """An array (n, N) with rows for columns, (N, n)."""
    n, N = x.shape
    y = np.empty((N, n))
    for a in range(n):
        for i in range(N):
            y[i, a] = x[a, i]
    return y


@jit
def _added(x, w, lineage, mean):
    """What lineages add to the mean (n,) and to the weight, (n + 1, lineages), and the number of each."""
    n, N = x.shape
    out, member, count = np.zeros((n + 1, lineage.max() + 1)), np.empty(N, np.int64), 0
    for i in range(N):
        out[n, lineage[i]] += w[i]
    for a in range(n):
        for i in range(N):
            out[a, lineage[i]] += w[i] * (x[a, i] - mean[a])
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
    """Squares of what lineages add: of their weights, and to the mean, over one point's variances."""
    (n, N), part = added.shape, 0.0
    n, L, S = n - 1, np.empty(cov.shape), np.empty((n, n))
    for a in range(n + 1):
        for b in range(a + 1):
            S[a, b] = dot(stretch(added, a, 0, N), stretch(added, b, 0, N))
    if not cholesky(cov, L):
        return S[n, n], np.nan
    W = invert_lower(L)
    for a in range(n):
        for b in range(a + 1):
            for c in range(a + 1):
                part += W[a, b] * S[max(b, c), min(b, c)] * W[a, c] / n
    return S[n, n], part


@jit
def effective(w):
    """Effective number of points of weights (N,), (Σ w)² / Σ w²."""
    total, squares = summed(w), summed(w * w)
    return total * total / squares if squares > 0.0 else 0.0


@jit
def normalise(log_w, w):
    """Fill weights w (N,) of sum one from their logarithms; return the logarithm of what the sum was.

    Without a weight above zero the sum's logarithm is -inf, and the weights are nothing.
    """
    top = -np.inf
    for i in range(log_w.size):
        top = log_w[i] if log_w[i] > top else top
    if not np.isfinite(top):
        return -np.inf
    for i in range(log_w.size):
        w[i] = FAST.exp(log_w[i] - top) if log_w[i] > -np.inf else 0.0
    total = summed(w)
    for i in range(log_w.size):
        w[i] /= total
    return top + math.log(total)


@jit
def systematic(w, count, shift):
    """Numbers (count,) of points of weights w (N,), each as often as its weight says but for rounding.

    One shift on [0, 1) moves all strata; what rounding may have lost at the end of the weights goes to the
    last point that has any.
    """
    last = w.size - 1
    while last > 0 and w[last] == 0.0:
        last -= 1
    total = summed(w)
    out, j, passed = np.empty(count, np.int64), 0, w[0]
    for i in range(count):
        position = (i + shift) / count * total
        while position >= passed and j < last:
            j += 1
            passed += w[j]
        out[i] = j
    return out


@jit
def for_moments(x, w, mean, cov, count, shift):
    """Numbers and weights (count,) of points drawn from weighted ones, x (n, N) and w (N,), all of sum one.

    Their mean is (n,), their covariance (n, n).

    A point d standard deviations from the mean is drawn up to 1 + d²/n times as often as its weight says, and
    weighs as much less: mean and covariance hang on it so much more, and so may what is read next. That makes
    no more than one draw of any, as copies know no more than it does.
    """
    (n, N), by, L = x.shape, w.copy(), np.empty(cov.shape)
    if cholesky(cov, L):
        one = np.zeros(N, np.int64)
        square = squares(invert_lower(L).reshape(1, n, n), about(mean.reshape(1, n), x, one), one)
        for i in range(N):
            more = w[i] * square[i] / n
            by[i] += more / (1.0 + count * more) if more < np.inf else 0.0  # of one carrier there is no d
    chosen = systematic(by, count, shift)
    own = w[chosen] / by[chosen]
    return chosen, own / own.sum()
