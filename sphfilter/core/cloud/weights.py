"""Weighted points: moments, effective numbers, systematic resampling."""

import math

import numpy as np

from .._jit import jit
from .._views import stretch
from ..elementary import FAST
from ..limits import LITTLE, LOOK, ROUNDING, TINY
from ..small_matrices import cholesky, invert_lower, whiten
from ..sums import dot, summed
from .blocks import combined, squares
from .noise import LANES


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

    Of the mean, in standard deviations of its states, and of their variances, relative: on average over the
    states; of the covariance relative, over n, or of that variance which is off most, if this is more.
    """
    n, P = mean.size, floored(cov, 0.0)
    L, wider = np.empty((n, n)), (own - cov).T.copy()
    if not cholesky(P, L):
        return np.nan, np.nan, np.nan
    for a in range(n):
        whiten(L, wider[a])
    wider = wider.T.copy()
    first = second = together = most = 0.0
    for a in range(n):
        whiten(L, wider[a])
        for b in range(n):
            together += wider[a, b] * wider[a, b] / n
        first += (other[a] - mean[a]) ** 2 / P[a, a] / n
        square = (own[a, a] / P[a, a] - 1.0) ** 2 if cov[a, a] > 0.0 else 0.0
        second, most = second + square / n, max(most, square)
    return first, second, max(together, most)


@jit
def finite_rows(x):
    """Which of states x (n, N) are numbers, (N,), and whether all are."""
    n, N = x.shape
    fine, numbers = np.ones(N, np.bool_), x.reshape(-1)
    every = dot(numbers, numbers) < np.inf  # else some are none, or squares overflow
    for a in range(0 if every else n):
        for i in range(N):
            fine[i] &= abs(x[a, i]) < np.inf
    return fine, every or fine.all()


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
def near_others(x):
    """Which of points x (n, N) lie so near that others have digits beside them; and whether all do.

    Farther off than the extent of all over `ROUNDING` a point has run away: its square leaves others none.
    The extent is that between an eighth and seven of the values of a few dozen of them.
    """
    (n, N), every = x.shape, True
    near = np.ones(N, np.bool_)
    for a in range(n):
        low, high, _ = eighths(x[a], max(N // LOOK, 1))
        reach, beyond = (high - low) / ROUNDING + abs(low) + abs(high), 0
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

    One shift on [0, 1) moves all strata. Of points without a weight that is a number it is the first.
    """
    first, passed, out = np.empty(w.size), 0.0, np.zeros(count + 1, np.int64)
    for j in range(w.size):
        first[j] = passed
        passed += w[j]
    for j in range(w.size if 0.0 < passed < np.inf else 0):
        # where draws of each begin: one that has none begins where the next one does, which is written later
        out[min(math.ceil(first[j] / passed * count - shift), count)] = j
    for i in range(1, count):
        out[i] = max(out[i], out[i - 1])
    return out[:count]


@jit
def distances(x, mean, cov):
    """Squares (N,) of how far points x (n, N) are from a mean, in standard deviations, over n.

    Zero where there is no root of the covariance.
    """
    (n, N), L, one = x.shape, np.empty(cov.shape), np.zeros(x.shape[1], np.int64)
    if not cholesky(cov, L):
        return np.zeros(N)
    off = combined(np.ones(1), x, -np.ones(1), mean.reshape(1, n), one)
    return squares(invert_lower(L).reshape(1, n, n) / math.sqrt(n), off, one)


@jit
def oftener(w, more, count):
    """How often (N,) points of weights w (N,) are drawn, each so many times `more` than it weighs at most.

    That makes no more than one draw of `count` of any, as copies know no more than it does.
    """
    by = w.copy()
    for i in range(w.size):
        extra = w[i] * more[i]
        by[i] += extra / (1.0 + count * extra) if extra < np.inf else 0.0  # of one carrier there is no d
    return by


@jit
def for_moments(x, w, mean, cov, order, count, shift):
    """Numbers and weights (count,) of points drawn from weighted ones, x (n, N) and w (N,), all of sum one.

    They are drawn in an order (N,). Their mean is (n,), their covariance (n, n).

    A point d standard deviations from the mean is drawn up to 1 + d²/n times as often as its weight says, and
    weighs as much less: mean and covariance hang on it so much more, and so may what is read next.
    """
    by = oftener(w, distances(x, mean, cov), count)
    chosen = order[systematic(by[order], count, shift)]
    own = w[chosen] / by[chosen]
    return chosen, own / own.sum()
