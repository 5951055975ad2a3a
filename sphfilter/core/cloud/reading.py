"""A reading of a cloud in one call: weighted, and once more from ancestors that the reading chooses.

That is what `filter.guided` does of any sensor and any way, for one prediction since the last reading and
noise that is the same in all states.
"""

import numpy as np

from .._jit import jit
from ..limits import ALIKE
from .blocks import steered
from .guide import NEAR, WIDER, Moved, look_ahead, near_of, over_both, wrapped
from .move import shifted
from .noise import even_normals, mixed, stored
from .reader import GUIDE, PARTS, as_one, as_seen, gone, likelihoods, read
from .way import AGAIN
from .weights import beside, effective, normalise, prior_times, taken, weighted_moments

#: Times what linearity misses, that the guide sees, as of the reading's noise: about the mean of its
#: neighbours' a point's rest has 1 + 1 / (2 NEAR) times its own variance: OWN = 1.5 · 1.25 = 1.875.
OWN = WIDER * (1.0 + 0.5 / NEAR)


@jit
def foreseen(reader, x, w, mean):
    """Innovation (k,) of a reading by a function h, and its covariance (k, k).

    Of points x (n, N) of weights w (N,) and a mean. Angles are averaged around the reading of the mean.
    """
    k = reader.z.size
    off, S = np.zeros(k), np.empty((k, k))
    expected, h = read(reader, mean.copy().reshape((-1, 1))), read(reader, x)
    for a in range(k):
        for i in range(w.size):
            h[a, i] = wrapped(h[a, i] - expected[a, 0], reader.angle[a])
    weighted_moments(h, w, off, S)
    for a in range(k):
        off[a] = wrapped(reader.z[a] - (expected[a, 0] + off[a]), reader.angle[a])
        for b in range(k):
            S[a, b] += reader.R[a, b]
    return off, S


@jit
def weigh(way, nets, key):
    """Prior times likelihood, of both passes.

    The way is a `Reader`; the prediction as a `Leg`, whether its change is linear, and its key; points where
    they began and where they are, (n, N), their weights and blocks (N,); the noise that begins the way and
    the prediction, each a `Part`; and what moved the points in each, (n, N). Nets (n, N) are standard normals
    of the guide and of both passages.

    Returns states (n, M), logarithms (M,) of weights whose sum is the evidence, and ancestors (M,); and how
    many likelihoods are no number: then the rest is of no worth.
    """
    reader, leg, linear, passage, x, y, w, block, kernel, moved, u, v = way
    n, N = x.shape
    own = mixed(np.uint64(key), np.uint64(GUIDE))
    h = read(reader, y)
    log_l, wrong = likelihoods(reader, y, h)
    log_w, alone = prior_times(w, log_l), np.arange(N)
    first = np.zeros(N)
    if wrong or not abs(normalise(log_w, first)) < np.inf or effective(first) >= ALIKE * effective(w):
        return y, log_w, alone, wrong
    flow, lower, rows, whole = as_one(kernel, moved, u, v, block)
    points = Moved(x, y, whole, w, block, flow, lower)
    ahead = as_seen(reader, points, h, moved.end, OWN, near_of(leg.kind))
    ancestor, new, log_ratio = look_ahead(ahead, whole, w, block, nets[0], own)
    if ancestor.size == 0:
        return y, log_w, alone, wrong
    end, block = taken(x, ancestor), block[ancestor]
    u = even_normals(nets[1], np.uint64(stored(own, PARTS)))
    v = even_normals(nets[2], np.uint64(stored(own, PARTS + 1)))
    U = np.concatenate((u, v))
    steered(rows, block, new, U)
    end = shifted(end, U[:n], block, kernel.lower)
    end = gone(leg, linear, end, U[n:], block, moved, mixed(np.uint64(passage), np.uint64(AGAIN)))
    more, wrong = likelihoods(reader, end, read(reader, end))
    both = over_both(np.concatenate((log_l, more)), log_ratio, w)
    return beside(y, end), both, np.concatenate((alone, ancestor)), wrong
